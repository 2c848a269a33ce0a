"""The largest stable time step of an assembly, predicted from its forces around rest.

Around rest the forces are linear: M x'' = -K x - C x', with the dampers of nodes and elements apart. A step that flips
the sign of a motion y, x_n = (-1)^n y, is the largest that the scheme bears. In position Verlet whose damper leaves the
shares a and b of a velocity before and after the kick (`engines.damping_shares`), and with dashpots C that see the
velocity before the kick, that is (dt^2 K + 2 dt C) y = 2 M (1/b + a) y. All matrices are symmetric, so the largest
eigenvalue decides for the whole assembly. It is found by Lanczos' iteration. A ground adds its spring and its dashpot
to K and C as if it bore every node. Weights are constant, and friction, of ground and ball, only takes from velocities,
which matters not. With `hill.Hill` factors every element of a muscle is a dashpot and a spring more, each at its
steepest and under full tension.
Contact between rods adds as if every node were touched by other rods on both sides, see `_crowded`.

Left out is what forces around rest do not show: kinks of a right angle between elements and, with the "pyelastica"
splitting, elements that spin about their rod. That step takes the gyroscopic term from before the kick, which feeds the
spin of slender, hardly damped elements on a coarse mesh: such a worm may be stable only well below the prediction.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.laws.damping import Splitting, damping_shares
from lattice_gym.physics.laws.elasticity import MIN_DILATATION
from lattice_gym.physics.laws.joints import Joint
from lattice_gym.physics.laws.lines import Line
from lattice_gym.physics.rod import rotation_between

SAFETY = 0.72
"""Share of the computed limit that `stable_dt` gives. Chosen on the report's grid and its random designs of seed 0."""

DT_MARGIN = 0.72
"""Share of the predicted stable step that `default_dt` may use."""

OVERSHOOT = 1.5
"""Load on what a muscle shortens, over its tension: what is pulled swings past its balance. Chosen so that the muscles
of an undamped default worm under random commands stay within it."""

LEAST_CONTRACTION = 0.5
"""Length over rest length below which no rod but a muscle is taken to go. An assumption, no bound."""

DEEPEST = 0.1
"""Depth over the reach to which rods are taken to press into each other. An assumption, no bound."""

N_LANCZOS = 80
"""Steps k of Lanczos' iteration: from a random start the largest of n eigenvalues is then expected to within
0.103 (ln(n (k - 1)^4) / (k - 1))^2 (Kuczynski and Wozniakowski 1992, SIAM J. Matrix Anal. Appl. 13), 1.4 % of it and
0.7 % of the step for a hundred thousand."""

N_CENTRES = 256
"""Elements, at most, at whose middles it is looked how much a ball reaches from there."""

_MAX_ROUNDS = 100
_ROUND_TOLERANCE = 2e-3
_MAX_EXPONENT = 500.0
_FROZEN = 50.0


def stable_dt(model: RodModel, max_tension: float = 0.0, splitting: Splitting = "pyelastica") -> float:
    """Predict the largest stable step of an assembly [s]; infinite where its dampers, or its clamps, hold every step.

    Parameters
    ----------
    model
        Any assembly.
    max_tension
        Largest tension of a muscle [N]: stretch, shear and bending all stiffen as elements shorten, see `contraction`.
    splitting
        When velocities are damped, see `engines`.

    Raises
    ------
    ValueError
        A tension that is negative or not finite.
    """
    if not (math.isfinite(max_tension) and max_tension >= 0.0):
        raise ValueError(f"max_tension = {max_tension!r}: must be finite and not negative [N]")
    return SAFETY * _Linear(model, max_tension).largest_dt(splitting)


def default_dt(model: RodModel, control_dt: float, max_tension: float = 0.0) -> float:
    """Largest step [s] that divides `control_dt` and is at most `DT_MARGIN` of what is stable without any damper.

    A damper may make larger steps stable, but where it does it is not resolved: the motion freezes. Where clamps hold
    everything it is `control_dt`.
    """
    limit = SAFETY * _Linear(model, max_tension).largest_dt(None)
    return control_dt / max(1, math.ceil(control_dt / (DT_MARGIN * limit)))


def contraction(model: RodModel, max_tension: float) -> tuple[FloatArray, FloatArray]:
    """Length over rest length to which muscles may shorten each rod and each line, shapes (n_rod,) and (n_line,).

    A force F shortens a rod of stiffness E A to E A / (E A + F), for it resists with E A (1 - e) / e. A muscle can do
    that to itself. It may load any other rod with its tension, but shorten it no further than itself, and not below
    `LEAST_CONTRACTION`: rather than that, rods that are not muscles bend.
    """
    if model.n_muscle == 0:
        return np.ones(model.n_rod), np.ones(0)
    load = OVERSHOOT * max_tension
    rod_stiffness = np.array([rod.stretch_stiffness.min() for rod in model.rods])
    line_stiffness = np.array([line.stiffness for line in model.lines])
    rod = rod_stiffness / (rod_stiffness + load)
    line = np.maximum(line_stiffness, np.finfo(float).tiny) / (line_stiffness + load + np.finfo(float).tiny)
    muscle = np.zeros(model.n_rod, dtype=np.bool_)
    muscle[list(model.muscles)] = True
    shortest = float(np.concatenate([rod[muscle], line]).min())
    least = np.where(muscle, MIN_DILATATION, max(shortest, LEAST_CONTRACTION))
    return np.maximum(rod, least), np.maximum(line, MIN_DILATATION)


@dataclass(frozen=True)
class _Ties:
    """What acts between two nodes each: their rows, shape (n_tie,), and its matrix [N/m], shape (n_tie, 3, 3)."""

    first: IntArray
    second: IntArray
    matrix: FloatArray

    def __call__(self, displacement: FloatArray) -> FloatArray:
        """Return the force against a displacement of the nodes [N]; both of shape (n_node, 3)."""
        pull = np.einsum("nij,nj->ni", self.matrix, displacement[self.second] - displacement[self.first])
        force = np.zeros_like(displacement)
        np.add.at(force, self.first, -pull)
        np.add.at(force, self.second, pull)
        return force


@dataclass(frozen=True)
class _Floor:
    """What acts on every node against its displacement [N/m]: a number for each component, or for each and node."""

    stiffness: FloatArray

    def __call__(self, displacement: FloatArray) -> FloatArray:
        """Return the force against a displacement of the nodes [N]; both of shape (n_node, 3)."""
        return displacement * self.stiffness


def _crowded(model: RodModel, shortened: FloatArray) -> FloatArray:
    """Contacts that every node of a rod but a muscle is taken to bear, shape (n_node, 1).

    A contact between the places p and q bears no more than 2 p^2 + 2 q^2, by the lever rule two springs of its
    stiffness at either node. A node is touched on two sides, an assumption, as rods may lie closer: by nodes, both its
    elements by two each. Two terms more count where elements are short, rods being pressed together by `DEEPEST`.
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
    reach = 2.0 * max(float(model.rods[rod].radius.max()) for rod in solid)
    stubby = reach / min(float(shortened[rod] * model.rods[rod].rest_length.min()) for rod in solid)
    overlap = 2.0 * math.sqrt(1.0 - (1.0 - DEEPEST) ** 2)
    sides, springs = 2.0, 2.0
    touching = 2.0 + 0.5 * math.floor(overlap * stubby) + 2.0 * DEEPEST * (1.0 - DEEPEST) * stubby**2
    for rod in solid:
        contacts[model.nodes(rod)] = 2.0
    contacts[model.node_offset[:-1]] *= 0.5
    contacts[model.node_offset[1:] - 1] *= 0.5
    return sides * touching * springs * contacts[:, None]


def _ties(model: RodModel, ties: Sequence[Joint | Line], matrix: FloatArray) -> _Ties:
    return _Ties(*model.tie_nodes(ties), matrix.reshape(-1, 3, 3))


def _line_matrix(model: RodModel, dilatation: FloatArray, max_tension: float) -> FloatArray:
    """Stiffness of each line [N/m], shape (n_line, 3, 3): E A / (L e^2) along it, tension over length across."""
    place = model.rest_state().position
    first, second = model.tie_nodes(model.lines)
    side = place[second] - place[first]
    along = np.einsum("ni,nj->nij", side, side) / np.sum(side**2, axis=1)[:, None, None]
    rest = np.array([line.rest_length for line in model.lines])
    stretch = np.array([line.stiffness for line in model.lines]) / (rest * dilatation**2)
    across = max_tension / (rest * dilatation)
    matrix: FloatArray = stretch[:, None, None] * along + across[:, None, None] * (np.eye(3) - along)
    return matrix


def _muscle_ties(model: RodModel, low: IntArray, max_tension: float) -> _Ties:
    """Ties along every element of a muscle and every line, of its tension over its length at rest [N/m].

    `low` holds the first node of each element, shape (n_elem,).
    """
    elements = np.concatenate([np.arange(model.n_elem)[model.elements(rod)] for rod in model.muscles] or [low[:0]])
    first, second = model.tie_nodes(model.lines)
    place = model.rest_state().position
    first, second = np.concatenate([low[elements], first]), np.concatenate([low[elements] + 1, second])
    rest = np.concatenate([rod.rest_length for rod in model.rods])[elements]
    rest = np.append(rest, [line.rest_length for line in model.lines])
    side = place[second] - place[first]
    along = np.einsum("ni,nj->nij", side, side) / np.sum(side**2, axis=1)[:, None, None]
    return _Ties(first, second, max_tension / rest[:, None, None] * along)


def _log_derivative(angle: FloatArray) -> FloatArray:
    """Change of a rotation vector with a small turn after it, shape (n, 3, 3); transposed: with one before it."""
    size = np.linalg.norm(angle, axis=1)
    skew = np.cross(np.eye(3)[None], angle[:, None, :])
    safe = np.where(size > 1e-3, size, 1.0)
    curve = np.where(size > 1e-3, 1.0 / safe**2 - 0.5 / (safe * np.tan(0.5 * safe)), 1.0 / 12.0)
    return np.eye(3) + 0.5 * skew + curve[:, None, None] * (skew @ skew)


class _Linear:
    """Forces of an assembly in line with small displacements [m] and turns [rad, material frame], muscles shortened.

    An element of length e times its rest length l bears along it E A / (l e^2), across it G A / (l e), and against
    turning l e G A, each per unit; a Voronoi region E I / (D e^3), against an inertia of J / e.
    """

    def __init__(self, model: RodModel, max_tension: float) -> None:
        rods = model.rods
        shortened, line_shortened = contraction(model, max_tension)
        peak = max_tension * (1.0 if model.hill is None else model.hill.peak)
        n_elem = [rod.n_elem for rod in rods]
        e = np.repeat(shortened, n_elem)
        pull = np.zeros(model.n_rod)
        pull[list(model.muscles)] = peak
        rest, shear, stretch, inertia = (
            np.concatenate([getattr(rod, name) for rod in rods])
            for name in ("rest_length", "shear_stiffness", "stretch_stiffness", "inertia")
        )
        self.low = np.delete(np.arange(model.n_node), model.node_offset[1:] - 1)
        self.frame = np.concatenate([rod.directors for rod in rods])
        # An element under axial force N turns against G A - N.
        cross = shear + stretch * (1.0 - e) / e
        across = (shear + np.repeat(pull, n_elem)) / (rest * e)
        self.stretch = np.stack([across, across, stretch / (rest * e**2)], axis=1)
        self.couple_across, self.turn = cross, rest * e * cross

        self.left = np.delete(np.arange(model.n_elem), model.element_offset[1:] - 1)
        angle = np.concatenate([rotation_between(rod.directors[:-1], rod.directors[1:]) for rod in rods])
        stiff = np.concatenate(
            [np.stack([rod.bend_stiffness, rod.bend_stiffness, rod.twist_stiffness], axis=1) / rod.rest_voronoi[:, None]
             for rod in rods]
        )  # fmt: skip
        root = np.sqrt(stiff / np.repeat(shortened, [n - 1 for n in n_elem])[:, None] ** 3)
        after = _log_derivative(angle)
        self.after, self.before = root[:, :, None] * after, root[:, :, None] * after.transpose(0, 2, 1)

        spring = np.array([joint.stiffness for joint in model.joints])[:, None, None] * np.eye(3)
        dashpot = np.array([joint.damping for joint in model.joints])[:, None, None] * np.eye(3)
        self.ties: list[_Ties | _Floor] = [_ties(model, model.joints, spring)]
        if model.lines:
            self.ties.append(_ties(model, model.lines, _line_matrix(model, line_shortened, peak)))
        self.dashpots: list[_Ties | _Floor] = [_ties(model, model.joints, dashpot)] if dashpot.any() else []
        if model.hill is not None and model.n_muscle > 0:
            spring_share, dashpot_share = model.hill.peak * model.hill.steepest_length, model.hill.steepest_speed
            muscle = _muscle_ties(model, self.low, max_tension)
            self.ties.append(replace(muscle, matrix=spring_share * muscle.matrix))
            if dashpot_share * max_tension > 0.0:
                self.dashpots.append(replace(muscle, matrix=dashpot_share * muscle.matrix))
        if model.ground is not None:
            upward = np.array([0.0, 0.0, 1.0])
            self.ties.append(_Floor(model.ground.stiffness * upward))
            if model.ground.damping > 0.0:
                self.dashpots.append(_Floor(model.ground.damping * upward))
        if model.contact is not None:
            crowded = _crowded(model, shortened)
            self.ties.append(_Floor(model.contact.stiffness * crowded))
            if model.contact.damping > 0.0:
                self.dashpots.append(_Floor(model.contact.damping * crowded))
        ball = model.bolus
        self.contact = (0.0, 0.0) if ball is None else (ball.stiffness, ball.damping)

        self.n_node, self.n_elem = model.n_node, model.n_elem
        damping = np.repeat([rod.rotational_damping for rod in rods], n_elem)
        mass = np.repeat(model.node_mass, 3)
        spin_mass = ((inertia / e)[:, None] * [1.0, 1.0, 2.0]).ravel()
        self.mass = np.concatenate([mass, spin_mass])
        self.rate = np.concatenate([np.repeat(model.node_damping, 3) / mass, np.repeat(damping, 3) / spin_mass])
        if ball is not None:
            self.mass = np.append(self.mass, np.full(3, ball.mass))
            self.rate = np.append(self.rate, np.zeros(3))
        free_node, free_element = np.ones((model.n_node, 3)), np.ones((model.n_elem, 3))
        for clamp in model.clamps:
            if clamp.node is not None:
                free_node[model.node_offset[clamp.rod] + clamp.node] = 0.0
            if clamp.element is not None:
                free_element[model.element_offset[clamp.rod] + clamp.element] = 0.0
        self.free = np.concatenate([free_node.ravel(), free_element.ravel(), np.ones(3 * model.n_bolus)])
        self.on_ball = 0.0 if ball is None else _most_touched(model, ball)
        self.on_node = np.full(model.n_node, 2.0)
        self.on_node[model.node_offset[:-1]] = self.on_node[model.node_offset[1:] - 1] = 1.0
        if ball is not None:
            given, taken = (
                (self.on_node / model.node_mass)[free_node[:, 0] > 0.0].max(initial=0.0),
                self.on_ball / ball.mass,
            )
            self.on_node *= (given + taken) / given if given > 0.0 else 1.0
            self.on_ball *= (given + taken) / taken if taken > 0.0 else 1.0

    def largest_dt(self, splitting: Splitting | None) -> float:
        """Largest stable step [s]; without dampers (but with dashpots) where splitting is None.

        The dampers' share and that of the dashpots depend on the step. Each round takes them at the step of the round
        before; the first is too short, and so no round goes beyond the limit.
        """
        spring = self._largest(self.mass, 1.0, 0.0)
        if spring == 0.0:
            return math.inf
        lagging = bool(self.dashpots) or self.contact[1] > 0.0
        dashpot = self._largest(self.mass, 0.0, 1.0) if lagging else 0.0
        # An oscillator with a lagged dashpot is stable while spring dt^2 + 2 dashpot dt <= 4.
        dt = 4.0 / (math.sqrt(dashpot**2 + 4.0 * spring) + dashpot)
        if not lagging and (splitting is None or not self.rate.any()):
            return dt
        for _ in range(_MAX_ROUNDS):
            square = self._largest(self._effective_mass(dt, splitting), 1.0, 2.0 / dt)
            longer = 2.0 / math.sqrt(square)
            if splitting == "pyelastica" and longer * self.rate.min() > _FROZEN:
                return math.inf
            if longer < (1.0 + _ROUND_TOLERANCE) * dt:
                return longer
            dt = longer
        return dt

    def _effective_mass(self, dt: float, splitting: Splitting | None) -> FloatArray:
        """Mass that a step of dt has to turn round: m (1/late + early) / 2 with the `damping_shares` of a kick."""
        if splitting is None:
            return self.mass
        decay = self.rate * dt
        if splitting == "pyelastica":
            decay = np.minimum(decay, _MAX_EXPONENT)
        early, late = damping_shares(decay, splitting)
        mass: FloatArray = self.mass * 0.5 * (1.0 / late + early)
        return mass

    def _largest(self, mass: FloatArray, springs: float, dashpots: float) -> float:
        """Largest eigenvalue of springs * K + dashpots * C over the given masses."""
        scale = self.free / np.sqrt(mass)

        def apply(x: FloatArray) -> FloatArray:
            moved = scale * x
            scaled: FloatArray = scale * (springs * self.stiff(moved) + dashpots * self.dash(moved))
            return scaled

        return _largest_eigenvalue(apply, scale.size)

    def dash(self, x: FloatArray) -> FloatArray:
        """Return the force of all dashpots against velocities x, shape as for `stiff`."""
        against = self._ball_force(x, self.contact[1])
        shift = x[: 3 * self.n_node].reshape(-1, 3)
        for dashpots in self.dashpots:
            against[: 3 * self.n_node] += dashpots(shift).ravel()
        return against

    def stiff(self, x: FloatArray) -> FloatArray:
        """Return the forces and couples against displacements and turns x.

        Shape (3 n_node + 3 n_elem + 3 n_bolus,): nodes, elements, ball.
        """
        n_node, n_rod = 3 * self.n_node, 3 * (self.n_node + self.n_elem)
        shift, turn = x[:n_node].reshape(-1, 3), x[n_node:n_rod].reshape(-1, 3)
        side = np.einsum("nij,nj->ni", self.frame, shift[self.low + 1] - shift[self.low])
        pull = self.stretch * side
        pull[:, 0] -= self.couple_across * turn[:, 1]
        pull[:, 1] += self.couple_across * turn[:, 0]
        pull = np.einsum("nji,nj->ni", self.frame, pull)
        couple = np.zeros_like(turn)
        couple[:, 0] = self.couple_across * side[:, 1] + self.turn * turn[:, 0]
        couple[:, 1] = -self.couple_across * side[:, 0] + self.turn * turn[:, 1]
        bend = np.einsum("nij,nj->ni", self.after, turn[self.left + 1])
        bend -= np.einsum("nij,nj->ni", self.before, turn[self.left])
        couple[self.left + 1] += np.einsum("nji,nj->ni", self.after, bend)
        couple[self.left] -= np.einsum("nji,nj->ni", self.before, bend)
        force = sum((ties(shift) for ties in self.ties), np.zeros_like(shift))
        force[self.low] -= pull
        force[self.low + 1] += pull
        against = self._ball_force(x, self.contact[0])
        against[:n_rod] += np.concatenate([force.ravel(), couple.ravel()])
        return against

    def _ball_force(self, x: FloatArray, contact: float) -> FloatArray:
        """Force against x of springs (dashpots) between the ball and the elements it touches; 0 without a ball.

        What it touches changes. By the lever rule a contact between the shares p and q bears, for any s > 0, no more
        than p (1 + 1/s) and q (1 + 1/s) of its stiffness at either node and 1 + s at the ball, whatever the normal.
        Here every node bears both its elements in full, and the ball all that it may touch; s makes its rate and that
        of the lightest node alike, the sum of both alone.
        """
        against = np.zeros_like(x)
        if contact > 0.0:
            n_node = 3 * self.n_node
            against[:n_node] = (contact * self.on_node[:, None] * x[:n_node].reshape(-1, 3)).ravel()
            against[-3:] = contact * self.on_ball * x[-3:]
        return against


def _most_touched(model: RodModel, ball: Ball) -> float:
    """Elements that a ball touches at once, at most: those within its reach at rest, wherever its centre is on a rod.

    An assumption, no bound: elements come closer to each other where rods are squeezed.
    """
    place = model.rest_state().position
    start = np.delete(place, model.node_offset[1:] - 1, axis=0)
    side = np.delete(place, model.node_offset[:-1], axis=0) - start
    square, reach = np.sum(side**2, axis=1), (1.0 + 1e-6) * (ball.radius + model.element_radius)
    most = 0
    for centre in [ball.position, *(start + 0.5 * side)[:: math.ceil(model.n_elem / N_CENTRES)]]:
        gap = centre - start
        far = np.clip(np.sum(gap * side, axis=1) / square, 0.0, 1.0)
        most = max(most, int(np.sum(np.sum((gap - far[:, None] * side) ** 2, axis=1) < reach**2)))
    return float(most)


def _largest_eigenvalue(apply: Callable[[FloatArray], FloatArray], size: int) -> float:
    """Largest eigenvalue of a symmetric operator on vectors of the given size, by Lanczos' iteration.

    Products of vectors are not left to the linear algebra library: it shares them among threads, which wait for each
    other for milliseconds where other processes run, as they do in training.
    """
    now = np.random.default_rng(0).standard_normal(size)
    now /= math.sqrt(_product(now, now))
    before, link = np.zeros(size), 0.0
    diagonal, links = [], []
    for _ in range(min(N_LANCZOS, size)):
        new = apply(now) - link * before
        diagonal.append(_product(new, now))
        new -= diagonal[-1] * now
        link = math.sqrt(_product(new, new))
        links.append(link)
        if link <= 1e-12 * max(map(abs, diagonal)):
            break
        before, now = now, new / link
    off = np.diag(links[:-1], 1)
    return float(np.linalg.eigvalsh(np.diag(diagonal) + off + off.T)[-1])


def _product(a: FloatArray, b: FloatArray) -> float:
    return float(np.einsum("i,i->", a, b))
