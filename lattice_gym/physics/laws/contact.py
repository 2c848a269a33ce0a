"""Rods that touch each other.

Every element of a rod that is no muscle is a cylinder of its rest radius with round ends, and pushes at those of other
rods. Where two overlap by a depth d, with u_n the speed at which the nearest points of their centre lines part,

    N = max(0, stiffness d - damping u_n)

acts on either along the line through these points, shared between its two nodes by the lever rule: momentum and angular
momentum close. There is no friction. Stored is stiffness d^2 / 2. Where rods cross they are joined, and lie in each
other: elements of joined rods that are near each other at rest never touch, see `MARGIN`, nor do any that overlap at
rest. A rod does not touch itself, and muscles, which lie on the crossings, touch nothing.

The stiffness is that of a pair: rods that touch node on node, where two elements meet, are held by four, within
elements by one, and rods that run along each other by the more the finer the mesh. The nearest point of rods that are
all but parallel jumps from end to end of an element as they tilt: the energy is then continuous, but not the force's
lever. Once centre lines have crossed, the push is the other way: the law holds as long as depths stay below the contact
distance, both radii together.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from lattice_gym.checks import FloatArray, IntArray, Parameters, real
from lattice_gym.physics.laws.base import Generalised, Law, Linearised, NodeSprings, Shortened, one_or_none

if TYPE_CHECKING:
    from lattice_gym.physics.assembly import RodModel
    from lattice_gym.physics.state import RodState


PARALLEL = 1e-12
"""Square of the sine of the angle between two elements below which they touch in the middle of where they run along
each other: the nearest points are lost in rounding there. Depths jump by that sine times a length, and energy with
them, so that the bound has to be this small."""

MARGIN = 0.61
"""Elements of joined rods have contact only if at rest they are further apart than 1 + MARGIN times their radii.

Nearer ones belong to the crossing, where contact is off. Without a margin the first elements beyond a crossing would
touch as soon as it closes by any angle, and how much that stiffens it would depend on the mesh. Whole elements are left
out, so the mesh still decides where beyond a crossing contact begins. It is no round number, as elements often lie at
simple multiples of a radius, and rounding would decide which of them touch.
"""

MAX_DEPTH = 0.1
"""Largest depth over the contact distance that the critical time step allows for. An assumption, not a bound."""

_ROUNDING = 1e-9
"""Depth of overlap over the radii that counts as none at rest."""

_AT_A_TIME = 100_000
"""Pairs that are tested at once, which takes some tens of megabytes."""


@dataclass(frozen=True, kw_only=True)
class Contact(Parameters):
    """Rods push at each other where they come to overlap, without friction.

    Muscles touch nothing, a rod does not touch itself, and where rods cross they are joined: elements that are near
    each other at rest there never touch (`contact.MARGIN`). So it acts on the default worm only beyond the strength of
    its muscles. Where those that compress it pull with 3 N, six times their strength, the defaults keep what may touch
    nineteen twentieths of its radii apart.
    """

    stiffness: float = real(300.0, 1e-6, 1e9, "N/m")
    """Of the contact of two elements [N/m]."""
    damping: float = real(0.05, 0.0, 1e6, "N s/m")
    """Of that contact, along the normal [N s/m]."""


class ContactLaw(Law):
    """Push of rods that are no muscles at each other."""

    fields: ClassVar = {"contact": one_or_none(Contact)}

    @classmethod
    def present(cls, model: RodModel) -> bool:
        """Tell whether rods touch."""
        return model.contact is not None

    @cached_property
    def _contact(self) -> Contact:
        assert self.model.contact is not None
        return self.model.contact

    @cached_property
    def _excluded(self) -> IntArray:
        """Pairs of elements that never touch, each as one number."""
        numbers: IntArray = excluded(self.model) @ np.array([self.model.n_elem, 1])
        return numbers

    def touching(self, position: FloatArray) -> IntArray:
        """Pairs of elements that push at each other, shape (n_pair, 2), as `overlapping` has them."""
        pairs = overlapping(self.model, position)
        touching: IntArray = pairs[~np.isin(pairs @ [self.model.n_elem, 1], self._excluded)]
        return touching

    def energy(self, state: RodState) -> Mapping[str, FloatArray]:
        """Energy of the springs, half on either element, shape (n_elem,)."""
        pairs = self.touching(state.position)
        energy = 0.5 * self._contact.stiffness * depths(self.model, state.position, pairs) ** 2
        share = np.zeros(self.model.n_elem)
        np.add.at(share, pairs, 0.5 * energy[:, None])
        return {"contact": share}

    def linearised(self, shortened: Shortened) -> Linearised:
        """Springs and dashpots as if every node were touched by other rods on both sides."""
        contacts, law = _contact_bound(self.model, shortened.rod), self._contact
        return Linearised(
            [NodeSprings(law.stiffness * contacts)], [NodeSprings(law.damping * contacts)] if law.damping > 0.0 else []
        )

    def force(self, state: RodState, tension: FloatArray) -> Generalised:
        """Push pairs apart."""
        force, law, low = Generalised.zeros(self.model), self._contact, self.model.lower_node
        i, j = self.touching(state.position).T
        start, side = state.position[low], state.position[low + 1] - state.position[low]
        share = [s[:, None] for s in nearest(start[i], side[i], start[j], side[j])]
        gap = start[i] + share[0] * side[i] - start[j] - share[1] * side[j]
        distance = np.linalg.norm(gap, axis=1)
        normal, speed = gap / distance[:, None], state.velocity
        first, second = (
            (1.0 - s) * speed[low[of]] + s * speed[low[of] + 1] for s, of in zip(share, (i, j), strict=True)
        )
        depth = self.model.element_radius[i] + self.model.element_radius[j] - distance
        push = np.maximum(law.stiffness * depth - law.damping * np.sum((first - second) * normal, axis=1), 0.0)
        for s, of, way in zip(share, (i, j), (normal, -normal), strict=True):
            np.add.at(force.node, low[of], (1.0 - s) * push[:, None] * way)
            np.add.at(force.node, low[of] + 1, s * push[:, None] * way)
        return force


def nearest(a: FloatArray, along_a: FloatArray, b: FloatArray, along_b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Shares of two segments at which they are nearest, shape (n,) each, 0 at the starts a and b and 1 at the ends.

    The least of a convex function on a square: inside it, where that is within, else on the nearest of four sides.
    """
    square_a, square_b = np.sum(along_a**2, axis=1), np.sum(along_b**2, axis=1)
    both, gap = np.sum(along_a * along_b, axis=1), b - a

    def on_a(t: FloatArray | float) -> FloatArray:
        share: FloatArray = np.clip((np.sum(gap * along_a, axis=1) + t * both) / square_a, 0.0, 1.0)
        return share

    def on_b(s: FloatArray | float) -> FloatArray:
        share: FloatArray = np.clip((s * both - np.sum(gap * along_b, axis=1)) / square_b, 0.0, 1.0)
        return share

    zero, one = np.zeros(len(a)), np.ones(len(a))
    first = np.stack([zero, one, on_a(0.0), on_a(1.0)])
    second = np.stack([on_b(0.0), on_b(1.0), zero, one])
    apart = gap + second[..., None] * along_b - first[..., None] * along_a
    side, every = np.argmin(np.sum(apart**2, axis=2), axis=0), np.arange(len(a))
    s, t = first[side, every], second[side, every]
    turned = square_a * square_b - both**2
    slanted = turned > PARALLEL * square_a * square_b
    safe = np.where(slanted, turned, 1.0)
    inner_s = (np.sum(gap * along_a, axis=1) * square_b - np.sum(gap * along_b, axis=1) * both) / safe
    inner_t = (np.sum(gap * along_a, axis=1) * both - np.sum(gap * along_b, axis=1) * square_a) / safe
    inside = slanted & (inner_s > 0.0) & (inner_s < 1.0) & (inner_t > 0.0) & (inner_t < 1.0)
    s, t = np.where(inside, inner_s, s), np.where(inside, inner_t, t)
    middle = 0.5 * (on_a(0.0) + on_a(1.0))
    beside = ~slanted & (on_a(0.0) != on_a(1.0))
    return np.where(beside, middle, s), np.where(beside, on_b(middle), t)


def touchable(model: RodModel) -> IntArray:
    """Elements of all rods that are no muscles, in order."""
    return np.flatnonzero(~np.isin(model.element_rod, model.muscles))


def depths(model: RodModel, position: FloatArray, pairs: IntArray) -> FloatArray:
    """Depth to which each pair of elements overlaps [m], shape (n_pair,); negative where they are apart."""
    lower = model.lower_node
    start, side = position[lower], position[lower + 1] - position[lower]
    i, j = pairs.T
    s, t = nearest(start[i], side[i], start[j], side[j])
    distance = np.linalg.norm(start[i] + s[:, None] * side[i] - start[j] - t[:, None] * side[j], axis=1)
    depth: FloatArray = contact_distances(model, pairs) - distance
    return depth


def contact_distances(model: RodModel, pairs: IntArray) -> FloatArray:
    """Contact distance of each pair of elements, the sum of their radii [m], shape (n_pair,)."""
    distance: FloatArray = model.element_radius[pairs].sum(axis=1)
    return distance


def overlapping(model: RodModel, position: FloatArray, margin: float = 0.0) -> IntArray:
    """Pairs of touchable elements of different rods that overlap, shape (n_pair, 2): first < second, sorted.

    With a margin also those nearer than 1 + `margin` times their radii. Sorted by their place along the longest side of
    the assembly, elements are tried with those near them on it, some at a time to bound the memory.
    """
    element, rod = touchable(model), model.element_rod
    lower = model.lower_node[element]
    middle = 0.5 * (position[lower] + position[lower + 1])
    if not np.isfinite(middle).all() or len(element) == 0:
        return np.zeros((0, 2), np.int64)
    radius = (1.0 + margin) * model.element_radius[element]
    size = 0.5 * np.linalg.norm(position[lower + 1] - position[lower], axis=1) + radius
    along = middle[:, np.argmax(np.ptp(middle, axis=0))]
    order = np.argsort(along)
    last = np.searchsorted(along[order], along[order] + 2.0 * size.max(), side="right")
    found = []
    for rows in np.array_split(np.arange(len(order)), 1 + int((last - np.arange(len(order))).sum()) // _AT_A_TIME):
        count = last[rows] - rows - 1
        before = np.repeat(rows, count)
        after = before + 1 + np.arange(len(before)) - np.repeat(np.cumsum(count) - count, count)
        a, b = order[before], order[after]
        near = np.sum((middle[a] - middle[b]) ** 2, axis=1) <= (size[a] + size[b]) ** 2
        near &= rod[element[a]] != rod[element[b]]
        a, b = a[near], b[near]
        pairs = np.sort(np.stack([element[a], element[b]], axis=1), axis=1)
        found.append(pairs[depths(model, position, pairs) > -margin * contact_distances(model, pairs)])
    every: IntArray = np.concatenate(found)
    return every[np.lexsort((every[:, 1], every[:, 0]))]


def excluded(model: RodModel) -> IntArray:
    """Pairs of elements that never touch, as `overlapping` has them.

    That is, at rest: those of joined rods that are nearer than 1 + `MARGIN` times their radii, and of other rods those
    that overlap by more than rounding.
    """
    position, rod = model.rest_state().position, model.element_rod
    near = overlapping(model, position, MARGIN)
    joints = np.array([[joint.rod_a, joint.rod_b] for joint in model.joints], np.int64).reshape(-1, 2)
    number = [model.n_rod, 1]
    joined = np.isin(np.sort(rod[near], axis=1) @ number, np.sort(joints, axis=1) @ number)
    never: IntArray = near[joined | (depths(model, position, near) > _ROUNDING * contact_distances(model, near))]
    return never


def _contact_bound(model: RodModel, shortened: FloatArray) -> FloatArray:
    """Contacts that every node of a rod but a muscle is taken to bear, shape (n_node, 1).

    A contact between the places p and q bears no more than 2 p^2 + 2 q^2, by the lever rule two springs of its
    stiffness at either node. A node is touched on two sides, an assumption, as rods may lie closer: by nodes, both its
    elements by two each. Two terms more count where elements are short, rods being pressed together by `MAX_DEPTH`.
    Each element that begins on the length over which they overlap adds two contacts; as that has few itself, or where
    rods run along each other half of them at other nodes, weights other than 2 count it as one. And as an element
    tilts, the place where it is pushed at moves: a force F at a distance d bears tilts by F d over its length squared,
    that of two contacts in which places are free to move. `shortened` has the length over rest length of every rod,
    shape (n_rod,).
    """
    contacts = np.zeros(model.n_node)
    solid = sorted(set(range(model.n_rod)) - set(model.muscles))
    if not solid:
        return contacts[:, None]
    distance = 2.0 * max(float(model.rods[rod].radius.max()) for rod in solid)
    stubby = distance / min(float(shortened[rod] * model.rods[rod].rest_length.min()) for rod in solid)
    overlap = 2.0 * math.sqrt(1.0 - (1.0 - MAX_DEPTH) ** 2)
    sides, springs = 2.0, 2.0
    touching = 2.0 + 0.5 * math.floor(overlap * stubby) + 2.0 * MAX_DEPTH * (1.0 - MAX_DEPTH) * stubby**2
    for rod in solid:
        contacts[model.nodes(rod)] = 2.0
    contacts[model.node_offset[:-1]] *= 0.5
    contacts[model.node_offset[1:] - 1] *= 0.5
    return sides * touching * springs * contacts[:, None]
