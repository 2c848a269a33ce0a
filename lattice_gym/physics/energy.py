"""Where the energy of an assembly is, and the ledger that says where it came from and went.

The law of PyElastica is not quite that of an elastic body: stretch and shear pull with Q^T n / e and couples act with
B (kappa - kappa0) / e^3, which no potential gives wherever stretch comes together with shear or bending. Stored here is
the work that straining in proportion from rest takes,

    stretch and shear   l (S |shear|^2 + E A (e - 1)^2) (e - 1 - ln e) / (e - 1)^2     (alone: E A l (e - 1 - ln e))
    bending and twist   D (kappa - kappa0) . B (kappa - kappa0) / (2 e^2)

with e the length over the rest length l of an element, and of a Voronoi region of length D. What other paths of
straining give or take beyond that is of third order in the strains. It is part of the ledger's residual, like the
spin that a stretching element carries, and the integration error.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws import contact
from lattice_gym.physics.rod import rotation_between
from lattice_gym.physics.state import RodState

ENERGY_TOLERANCE = 0.1
"""Share of the energy at stake that may come from nowhere within one call.

The law is no elastic body's, so that even a fine step finds some: at most 4.7 % in runs that are right to 1 % of their
height, 0.03 % in their median (`python -m lattice_gym.benchmarks divergence`), though 41 % in one violent snap, at any
step. An unstable step multiplies its energy within a few steps and is soon beyond any share.
"""

LEAST_STRAIN = 1e-4
"""Energy below that of all rods stretched by this much is too little to judge a run by."""


_SMALL_STRAIN = 1e-3
"""Below this the series of (e - 1 - ln e) / (e - 1)^2 is exact to 1e-13 where the closed form has lost digits."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredEnergy:
    """Energy by place [J]."""

    translation: FloatArray
    """Kinetic energy of every node, shape (n_node,)."""
    rotation: FloatArray
    """Kinetic energy of every element's spin, shape (n_elem,)."""
    stretch: FloatArray
    """Stretch and shear of every element, shape (n_elem,)."""
    bend: FloatArray
    """Bending and twist of every Voronoi region, shape (n_elem - n_rod,)."""
    joint: FloatArray
    """Spring of every joint, shape (n_joint,)."""
    line: FloatArray
    """Stretch of every line, shape (n_line,)."""
    bolus: FloatArray
    """Kinetic energy of the ball, shape (n_bolus,)."""
    contact: FloatArray
    """Spring between the ball and every element, shape (n_bolus n_elem,)."""
    self_contact: FloatArray
    """Springs between rods that touch: of every element its share, one half, shape (n_elem,); none without contact."""
    weight: FloatArray
    """Weight in the medium times height above rest of every node, shape (n_node,); none without gravity."""
    ground: FloatArray
    """Spring of the ground under every node, shape (n_node,); none without ground."""

    @cached_property
    def total(self) -> float:
        """All of it [J]."""
        return float(sum(part.sum() for part in vars(self).values() if isinstance(part, np.ndarray)))


@dataclass(frozen=True)
class Flow:
    """What entered and left over some time [J]."""

    muscle_work: float = 0.0
    """Work that the muscles' tension did, as far as it acted (`hill.Hill`)."""
    load_work: float = 0.0
    """Work that point forces and torques did, and the constant force on the ball."""
    dissipated: float = 0.0
    """What damping of nodes, spin and joints, contacts of ball and rods, dashpots and friction of the ground took."""


@dataclass(frozen=True)
class Ledger:
    """Energy over some time [J]: muscle work + load work = stored + dissipated + residual."""

    muscle_work: float
    load_work: float
    stored: float
    """What the assembly holds more than before."""
    dissipated: float
    residual: float
    """What is missing; where it is negative, energy came from nowhere."""
    scale: float
    """Energy at stake: the most that was stored at either end, and all work and dissipation.

    Of weights it is the work, as their energy counts from anywhere.
    """


class EnergyMeter:
    """Reads the stored energy of states of one model."""

    def __init__(self, model: RodModel) -> None:
        self.model = model
        rods, offset = model.rods, model.element_offset
        first = np.delete(np.arange(model.n_elem), offset[1:] - 1)
        self._pair = first, first + 1
        self._lower = np.delete(np.arange(model.n_node), model.node_offset[1:] - 1)
        self._rest = np.concatenate([rod.rest_length for rod in rods])
        self._shear = np.concatenate([rod.shear_stiffness for rod in rods])
        self._stretch = np.concatenate([rod.stretch_stiffness for rod in rods])
        self._inertia = np.concatenate([rod.inertia for rod in rods])
        self._voronoi = np.concatenate([rod.rest_voronoi for rod in rods])
        self._kappa = np.concatenate([rod.rest_kappa for rod in rods])
        bend, twist = (
            np.concatenate([getattr(rod, f"{name}_stiffness") for rod in rods]) for name in ("bend", "twist")
        )
        self._rigidity = np.stack([bend, bend, twist], axis=1)
        self._joint_ends, self._line_ends = model.tie_nodes(model.joints), model.tie_nodes(model.lines)
        self._spring = np.array([joint.stiffness for joint in model.joints])
        self._line_rest = np.array([line.rest_length for line in model.lines])
        self._line_stiffness = np.array([line.stiffness for line in model.lines])
        self.least = 0.5 * LEAST_STRAIN**2 * float(self._stretch @ self._rest)
        """Energy that counts as none [J]."""
        self._place = model.rest_state().position
        self._forces = [(int(model.node_offset[f.rod]) + f.node, np.array(f.force)) for f in model.forces]

    def stored(self, state: RodState) -> StoredEnergy:
        """Return the stored energy of a state."""
        x, q = state.position, state.directors
        side = x[self._lower + 1] - x[self._lower]
        length = np.sqrt(np.einsum("ni,ni->n", side, side))
        e = length / self._rest
        strain = np.einsum("nij,nj->ni", q, side) / self._rest[:, None]
        strain[:, 2] -= 1.0
        square = strain * strain
        quadratic = self._shear * (square[:, 0] + square[:, 1]) + self._stretch * square[:, 2]
        spin = state.omega * state.omega
        first, second = self._pair
        bent = rotation_between(q[first], q[second]) / self._voronoi[:, None] - self._kappa
        region = 0.5 * (length[first] + length[second]) / self._voronoi
        return StoredEnergy(
            translation=0.5 * self.model.node_mass * np.einsum("ni,ni->n", state.velocity, state.velocity),
            rotation=0.5 * self._inertia / e * (spin[:, 0] + spin[:, 1] + 2.0 * spin[:, 2]),
            stretch=self._rest * quadratic * _path_share(e),
            bend=0.5 * self._voronoi * np.einsum("ni,ni->n", self._rigidity, bent * bent) / region**2,
            joint=0.5 * self._spring * _square_distance(x, *self._joint_ends),
            line=self._line_energy(x),
            bolus=self._ball_energy(state),
            contact=self._contact_energy(state),
            self_contact=self._self_contact_energy(x),
            weight=self._weight_energy(x),
            ground=self._ground_energy(x),
        )

    def _ball_energy(self, state: RodState) -> FloatArray:
        ball = self.model.bolus
        if ball is None:
            return np.zeros(0)
        square = [np.sum(moving**2, axis=1) for moving in (state.bolus_velocity, state.bolus_omega)]
        energy: FloatArray = 0.5 * ball.mass * square[0] + 0.5 * ball.inertia * square[1]
        return energy

    def _contact_energy(self, state: RodState) -> FloatArray:
        ball = self.model.bolus
        if ball is None:
            return np.zeros(0)
        start = state.position[self._lower]
        side, centre = state.position[self._lower + 1] - start, state.bolus_position - start
        share = np.clip(np.sum(centre * side, axis=1) / np.sum(side**2, axis=1), 0.0, 1.0)
        distance = np.linalg.norm(centre - share[:, None] * side, axis=1)
        depth = np.maximum(ball.radius + self.model.element_radius - distance, 0.0)
        energy: FloatArray = 0.5 * ball.stiffness * depth**2
        return energy

    def _self_contact_energy(self, x: FloatArray) -> FloatArray:
        law = self.model.contact
        if law is None:
            return np.zeros(0)
        pairs = contact.overlapping(self.model, x)
        pairs = pairs[~np.isin(pairs @ [self.model.n_elem, 1], self._excluded)]
        energy = 0.5 * law.stiffness * contact.depths(self.model, x, pairs) ** 2
        share = np.zeros(self.model.n_elem)
        np.add.at(share, pairs, 0.5 * energy[:, None])
        return share

    @cached_property
    def _excluded(self) -> IntArray:
        """Pairs of elements that never touch, each as one number."""
        numbers: IntArray = contact.excluded(self.model) @ np.array([self.model.n_elem, 1])
        return numbers

    def _weight_energy(self, x: FloatArray) -> FloatArray:
        if self.model.gravity is None:
            return np.zeros(0)
        energy: FloatArray = np.einsum("ni,ni->n", self.model.node_weight, self._place - x)
        return energy

    def _ground_energy(self, x: FloatArray) -> FloatArray:
        ground = self.model.ground
        if ground is None:
            return np.zeros(0)
        depth = np.maximum(self.model.node_radius - x[:, 2], 0.0)
        energy: FloatArray = 0.5 * ground.stiffness * depth**2
        return energy

    def _line_energy(self, x: FloatArray) -> FloatArray:
        e = np.sqrt(_square_distance(x, *self._line_ends)) / self._line_rest
        energy: FloatArray = self._line_stiffness * self._line_rest * (e - 1.0) ** 2 * _path_share(e)
        return energy

    def force_work(self, before: RodState, after: RodState) -> float:
        """Work of the constant forces on nodes and on the ball between two states [J]."""
        work = sum(float(force @ (after.position[node] - before.position[node])) for node, force in self._forces)
        if self.model.bolus is not None:
            work += float((after.bolus_position - before.bolus_position)[0] @ self.model.bolus.force)
        return work

    def most(self, energy: StoredEnergy) -> tuple[int, int]:
        """Rod and element that hold most, by kinetic, stretch and bending energy."""
        share = energy.rotation + energy.stretch
        share += 0.5 * (energy.translation[self._lower] + energy.translation[self._lower + 1])
        for side in self._pair:
            share[side] += 0.5 * energy.bend
        element = int(np.argmax(share))
        rod = int(np.searchsorted(self.model.element_offset, element, side="right")) - 1
        return rod, element - int(self.model.element_offset[rod])


def ledger(before: StoredEnergy, after: StoredEnergy, flow: Flow, least: float) -> Ledger:
    """Ledger between two states; `least` is the energy that counts as none [J]."""
    stored = after.total - before.total
    high, low = float(before.weight.sum()), float(after.weight.sum())
    moved = abs(flow.muscle_work) + abs(flow.load_work) + abs(low - high) + abs(flow.dissipated)
    return Ledger(
        muscle_work=flow.muscle_work,
        load_work=flow.load_work,
        stored=stored,
        dissipated=flow.dissipated,
        residual=flow.muscle_work + flow.load_work - stored - flow.dissipated,
        scale=max(before.total - high, after.total - low, least) + moved,
    )


def _path_share(e: FloatArray) -> FloatArray:
    """(e - 1 - ln e) / (e - 1)^2: 1/2 at rest."""
    strain = e - 1.0
    small = np.abs(strain) < _SMALL_STRAIN
    safe = np.where(small, 1.0, strain)
    series = 0.5 - strain / 3.0 + strain**2 / 4.0 - strain**3 / 5.0
    share: FloatArray = np.where(small, series, (safe - np.log1p(safe)) / safe**2)
    return share


def _square_distance(x: FloatArray, a: IntArray, b: IntArray) -> FloatArray:
    apart = x[b] - x[a]
    square: FloatArray = np.einsum("ni,ni->n", apart, apart)
    return square
