"""Rods that touch each other, by brute force: every pair of elements that may touch is tried at every step.

Which pairs may is found here on its own, from the rule that `physics.laws.contact` states and by another formula for
the nearest points: what both engines shared could not show an error of either. Within a step the points are found by
the numpy formula there, which the compiled engine does not use.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from elastica.external_forces import NoForces
from elastica.rod.cosserat_rod import CosseratRod

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.pyelastica.law import START, Bodies, Law, Simulator
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.laws.contact import MARGIN, ContactLaw, nearest
from lattice_gym.physics.state import RodState

_ROUNDING = 1e-9
"""Depth of overlap at rest, over the contact distance, that counts as none."""


def touchable_pairs(model: RodModel) -> IntArray:
    """Pairs of elements that push at each other once they overlap, shape (n_pair, 2): first < second, sorted.

    Those are elements of different rods that are no muscles, if at rest they are further apart than 1 + `MARGIN` times
    their radii where their rods are joined, and do not overlap where they are not.
    """
    joined = {frozenset((joint.rod_a, joint.rod_b)) for joint in model.joints}
    found = [np.zeros((0, 2), np.int64)]
    for a, b in combinations(sorted(set(range(model.n_rod)) - set(model.muscles)), 2):
        one, other = model.rods[a], model.rods[b]
        distance, contact_distance = _distances(one.position, other.position), np.add.outer(one.radius, other.radius)
        least = 1.0 + MARGIN if frozenset((a, b)) in joined else 1.0 - _ROUNDING
        found.append(np.argwhere(distance >= least * contact_distance) + model.element_offset[[a, b]])
    pairs: IntArray = np.concatenate(found)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def _distances(nodes: FloatArray, others: FloatArray) -> FloatArray:
    """Distances of all elements of one rod from all of another [m], shape (n_elem, n_other), from their nodes [m].

    Ericson 2005, Real-Time Collision Detection, 5.1.9: the nearest point of one line to the other is clamped to its
    element, then the point nearest to that, and where this was clamped the first is found anew.
    """
    along, across = np.diff(nodes, axis=0)[:, None], np.diff(others, axis=0)[None]
    apart = nodes[:-1, None] - others[None, :-1]
    a, e, b = (along * along).sum(-1), (across * across).sum(-1), (along * across).sum(-1)
    c, f = (along * apart).sum(-1), (across * apart).sum(-1)
    slanted = a * e - b * b > 0.0
    s = np.where(slanted, np.clip((b * f - c * e) / np.where(slanted, a * e - b * b, 1.0), 0.0, 1.0), 0.0)
    t = (b * s + f) / e
    clamped = np.clip(t, 0.0, 1.0)
    s = np.where(t == clamped, s, np.clip((b * clamped - c) / a, 0.0, 1.0))
    distance: FloatArray = np.linalg.norm(apart + s[..., None] * along - clamped[..., None] * across, axis=-1)
    return distance


class _Push(NoForces[CosseratRod]):
    """Push of all rods at each other; declared for one of them."""

    def __init__(self, law: Contact) -> None:
        super().__init__()
        self.law = law

    def apply_forces(self, system: CosseratRod, time: np.float64 = START) -> None:
        self.law.push_apart()


class Contact(Law):
    """Rods that push at each other where they overlap."""

    law = ContactLaw

    def __init__(self, bodies: Bodies) -> None:
        super().__init__(bodies)
        assert bodies.model.contact is not None
        self._law = bodies.model.contact
        self._first, self._radius = bodies.model.lower_node, bodies.model.element_radius
        self._pairs = touchable_pairs(bodies.model).T
        self._power = 0.0

    def add_forces(self, simulator: Simulator) -> None:
        """Add the push of all rods at each other."""
        simulator.add_forcing_to(self.bodies.rods[0]).using(_Push, self)

    def push_apart(self) -> None:
        """Add the forces of all pairs that overlap now, and note the power that their dashpots take."""
        self._power, radius, place = 0.0, self._radius, self.bodies.positions()
        start, side = place[self._first], place[self._first + 1] - place[self._first]
        i, j = self._pairs
        share = np.stack(nearest(start[i], side[i], start[j], side[j]))[..., None]
        gap = start[i] + share[0] * side[i] - start[j] - share[1] * side[j]
        distance = np.linalg.norm(gap, axis=1)
        hit = np.flatnonzero(radius[i] + radius[j] > distance)
        if hit.size == 0:
            return
        i, j, share, distance = i[hit], j[hit], share[:, hit], distance[hit]
        normal = gap[hit] / np.where(distance > 0.0, distance, 1.0)[:, None]
        speed, first = self.bodies.velocities(), self._first
        at = [(1.0 - s) * speed[first[e]] + s * speed[first[e] + 1] for s, e in zip(share, (i, j), strict=True)]
        rate = np.sum((at[0] - at[1]) * normal, axis=1)
        spring = self._law.stiffness * (radius[i] + radius[j] - distance)
        push = np.maximum(spring - self._law.damping * rate, 0.0)
        force, on_node = push[:, None] * normal, np.zeros_like(place)
        for s, e, sign in zip(share, (i, j), (1.0, -1.0), strict=True):
            np.add.at(on_node, first[e], sign * (1.0 - s) * force)
            np.add.at(on_node, first[e] + 1, sign * s * force)
        self.bodies.add_node_forces(on_node)
        self._power = float(np.sum((spring - push) * rate))

    def flow(self, before: RodState) -> Flow:
        """Energy that dashpots took."""
        return Flow(dissipated=self.bodies.dt * self._power)
