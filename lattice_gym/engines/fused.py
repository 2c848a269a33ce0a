"""The fused engine: packs a `RodModel` into lanes and lets one compiled call advance it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lattice_gym import contact
from lattice_gym.design import FloatArray, IntArray
from lattice_gym.energy import Flow
from lattice_gym.engines import (
    MAX_DILATATION,
    MIN_DILATATION,
    Engine,
    Health,
    Splitting,
    Status,
    damping_shares,
    joint_reach,
    kernels,
    overstretched,
    torn,
)
from lattice_gym.hill import Hill
from lattice_gym.model import Joint, Line, Rod, RodModel, RodState

_LARGEST_RATE = 300.0
_CACHE_LINE = 64
_SKIN = 0.25
"""How much further than they touch elements are listed, over the largest radii of two of them together."""


@dataclass(frozen=True)
class _Placement:
    """Where every rod stands: its first record and lane; blocks are rows (first record, one past the last)."""

    rod_cell: IntArray
    rod_lane: IntArray
    passive: IntArray
    active: IntArray
    n_cell: int

    def cell(self, rod: int, index: int) -> int:
        """Record of a node or element."""
        return int(self.rod_cell[rod]) + index


def _place(model: RodModel) -> _Placement:
    """Rods of one element count share blocks; muscles have their own, so that no other block pays for tension."""
    muscles = set(model.muscles)
    groups: dict[tuple[bool, int], list[int]] = defaultdict(list)
    for index, rod in enumerate(model.rods):
        groups[index in muscles, rod.n_elem].append(index)
    rod_cell, rod_lane = np.zeros(model.n_rod, np.int64), np.zeros(model.n_rod, np.int64)
    bounds: dict[bool, list[tuple[int, int]]] = {False: [], True: []}
    n_cell = 0
    for (is_muscle, n_elem), members in sorted(groups.items()):
        for start in range(0, len(members), kernels.LANES):
            block = members[start : start + kernels.LANES]
            rod_cell[block], rod_lane[block] = n_cell, np.arange(len(block))
            bounds[is_muscle].append((n_cell, n_cell + n_elem + 1))
            n_cell += n_elem + 1
    passive, active = (np.array(bounds[kind], np.int64).reshape(-1, 2) for kind in (False, True))
    return _Placement(rod_cell, rod_lane, passive, active, n_cell)


def _aligned(n_cell: int) -> kernels.Cells:
    """Make records of zeros that begin on a cache line, so that no packed load straddles two."""
    space = np.zeros(n_cell * kernels.CELL.itemsize + _CACHE_LINE, np.uint8)
    start = -space.ctypes.data % _CACHE_LINE
    return space[start : start + n_cell * kernels.CELL.itemsize].view(kernels.CELL)


def _fill_lane(cells: kernels.Cells, lane: int, rod: Rod, dt: float) -> None:
    """Write a rod's constants and rest shape into one lane of its records, shape (n_elem + 1,)."""
    elements, voronoi = cells[:-1], cells[:-2]
    cells["x"][:, :, lane] = rod.position
    elements["q"][:, :, lane] = rod.directors.reshape(-1, 9)
    elements["rest"][:, lane] = rod.rest_length
    elements["inv_rest"][:, lane] = 1.0 / rod.rest_length
    elements["shear"][:, lane] = rod.shear_stiffness
    elements["stretch"][:, lane] = rod.stretch_stiffness
    elements["spin_kick"][:, lane] = dt / rod.inertia
    elements["spin_decay"][:, lane] = 0.5 * dt * rod.rotational_damping / rod.inertia
    elements["free"][:, lane] = 1.0
    voronoi["rest_voronoi"][:, lane] = rod.rest_voronoi
    voronoi["inv_rest_voronoi"][:, lane] = 1.0 / rod.rest_voronoi
    voronoi["bend"][:, lane] = rod.bend_stiffness
    voronoi["twist"][:, lane] = rod.twist_stiffness
    voronoi["rest_kappa"][:, :, lane] = rod.rest_kappa


def _pack_hill(hill: Hill | None) -> kernels.Hill | None:
    """Constants of the Hill factors; a factor that is absent has a 0."""
    if hill is None:
        return None
    return kernels.Hill(
        0.0 if hill.width is None else 1.0 / hill.width,
        1.0 / hill.optimal_length,
        0.0 if hill.max_speed is None else 1.0 / hill.max_speed,
        1.0 / hill.curvature,
        hill.eccentric,
        (2.0 + 2.0 / hill.curvature) / (hill.eccentric - 1.0),
    )


class FusedEngine(Engine):
    """All rods of equal element count side by side in lanes; see `kernels`."""

    def __init__(
        self, model: RodModel, dt: float, splitting: Splitting = "pyelastica", energy_check: bool = False
    ) -> None:
        super().__init__(model, dt, energy_check)
        self._symmetric = 1.0 if splitting == "symmetric" else None
        place = self._place = _place(model)
        counts = np.array([rod.n_elem for rod in model.rods])
        self._node_lane = np.repeat(place.rod_lane, counts + 1)
        self._node_cell = np.concatenate([c + np.arange(n + 1) for c, n in zip(place.rod_cell, counts, strict=True)])
        self._element_lane = np.repeat(place.rod_lane, counts)
        self._element_cell = np.concatenate([c + np.arange(n) for c, n in zip(place.rod_cell, counts, strict=True)])
        self._cells = self._pack_rods()
        muscle = np.full(model.n_rod, -1)
        muscle[list(model.muscles)] = np.arange(len(model.muscles))
        muscle_of = np.repeat(muscle, counts)
        pulled = muscle_of >= 0
        self._pull = self._element_cell[pulled], self._element_lane[pulled], muscle_of[pulled]
        self._joints, self._joint_damping = self._pack_joints()
        self._lines = self._pack_lines()
        self._hill = _pack_hill(model.hill)
        self._reach = joint_reach(model)
        self._loads = self._pack_loads()
        self._ground = self._pack_ground()
        self._couples = self._pack_torques()
        self._spin_damping = 1.0 if any(rod.rotational_damping > 0.0 for rod in model.rods) else None
        self._ball = self._pack_ball()
        self._contact = self._pack_contact()
        self._account = self._open_account() if energy_check else None
        self._time = 0.0

    def _pack_rods(self) -> kernels.Cells:
        """All records at rest. A spare lane holds a copy of its block's first rod, which neither moves nor turns."""
        place, cells = self._place, _aligned(self._place.n_cell)
        for start, stop in (*place.passive, *place.active):
            members = np.flatnonzero(place.rod_cell == start).tolist()
            for lane in range(kernels.LANES):
                rod = self.model.rods[members[lane] if lane < len(members) else members[0]]
                _fill_lane(cells[start:stop], lane, rod, self.dt)
            cells["free"][start:stop, len(members) :] = 0.0
        before, after = damping_shares(self._decay(), "symmetric" if self._symmetric else "pyelastica")
        cells["keep"][self._node_cell, self._node_lane] = before * after
        cells["push"][self._node_cell, self._node_lane] = self.dt / self.model.node_mass * after
        for clamp in self.model.clamps:
            lane = place.rod_lane[clamp.rod]
            if clamp.node is not None:
                cell = place.cell(clamp.rod, clamp.node)
                cells["keep"][cell, lane] = cells["push"][cell, lane] = 0.0
            if clamp.element is not None:
                cells["free"][place.cell(clamp.rod, clamp.element), lane] = 0.0
        return cells

    def _decay(self) -> FloatArray:
        """Rate of damping of every node times the step, shape (n_node,)."""
        rate: FloatArray = self.model.node_damping / self.model.node_mass * self.dt
        return rate

    def _open_account(self) -> kernels.Account:
        """Account with nothing in it: constants of every node and element by record and lane."""
        n_cell, lanes = self._place.n_cell, kernels.LANES
        after, before, mixed, inertia, length, pull = np.zeros((6, n_cell, lanes))
        velocity, omega = np.zeros((2, n_cell, 3, lanes))
        line, line_pull = np.zeros((2, len(self.model.lines)))
        node, element = (self._node_cell, self._node_lane), (self._element_cell, self._element_lane)
        rate = self._decay()
        if not self._symmetric:
            # A rate this large leaves no speed worth counting; without the bound what it left would overflow.
            rate = np.minimum(rate, _LARGEST_RATE)
        early, late = damping_shares(rate, "symmetric" if self._symmetric else "pyelastica")
        half = 0.5 * self.model.node_mass
        after[node], before[node], mixed[node] = (
            half * (1.0 / late - 1.0),
            half * (1.0 - early),
            half * (1.0 / late - early),
        )
        inertia[element] = np.concatenate([rod.inertia for rod in self.model.rods])
        moved = length, pull, velocity, omega, line, line_pull
        return kernels.Account(np.zeros(3), after, before, mixed, inertia, *moved)

    def _pack_joints(self) -> tuple[kernels.Joints, FloatArray | None]:
        joints = self.model.joints
        damping = np.array([j.damping for j in joints], np.float64)
        packed = kernels.Joints(*self._pack_ends(joints), np.array([j.stiffness for j in joints], np.float64))
        return packed, damping if damping.any() else None

    def _pack_lines(self) -> kernels.Lines | None:
        lines = self.model.lines
        if not lines:
            return None
        rest_length, stiffness = np.array([line.rest_length for line in lines]), np.array([x.stiffness for x in lines])
        tension, rise = np.zeros((2, len(lines)))
        return kernels.Lines(*self._pack_ends(lines), rest_length, stiffness, tension, rise)

    def _pack_ends(self, ties: Sequence[Joint | Line]) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        """Find records and lanes of the first and the second node of each tie."""
        place = self._place
        return (
            np.array([place.cell(tie.rod_a, tie.node_a) for tie in ties], np.int64),
            np.array([place.rod_lane[tie.rod_a] for tie in ties], np.int64),
            np.array([place.cell(tie.rod_b, tie.node_b) for tie in ties], np.int64),
            np.array([place.rod_lane[tie.rod_b] for tie in ties], np.int64),
        )

    def _pack_loads(self) -> float | None:
        """Weights and point forces: what the force on a node starts from in every step."""
        load = self.model.node_weight.copy()
        for force in self.model.forces:
            load[int(self.model.node_offset[force.rod]) + force.node] += force.force
        if not load.any():
            return None
        for name in ("load", "force"):
            self._cells[name][self._node_cell, :, self._node_lane] = load
        return 1.0

    def _pack_ground(self) -> kernels.Ground | None:
        ground, cells = self.model.ground, self._cells
        if ground is None:
            return None
        cells["height"][:] = -np.inf  # no spare lane touches it
        cells["height"][self._node_cell, self._node_lane] = self.model.node_radius
        along, against, across = ground.forward, ground.backward, ground.sideways
        friction = ground.static_friction, ground.kinetic_friction
        return kernels.Ground(ground.stiffness, ground.damping, *friction, along, against, across)

    def _pack_ball(self) -> kernels.Ball | None:
        ball = self.model.bolus
        if ball is None:
            return None
        reach = np.zeros((self._place.n_cell, kernels.LANES))
        reach[self._element_cell, self._element_lane] = ball.radius + self.model.element_radius
        return kernels.Ball(
            place=ball.position.copy(), speed=np.zeros(3), spin=np.zeros(3), force=np.array(ball.force),
            load=np.zeros(7), reach=reach, touching=np.zeros(self._place.n_cell, np.int64),
            kick=self.dt / ball.mass, spin_kick=self.dt / ball.inertia,
            stiffness=ball.stiffness, damping=ball.damping, friction=ball.friction, slip_speed=ball.slip_speed,
        )  # fmt: skip

    def _pack_contact(self) -> kernels.Contact | None:
        law, model = self.model.contact, self.model
        if law is None:
            return None
        element = contact.touchable(model)
        n_elem = len(element)
        rod, radius = contact.rod_of(model)[element], model.element_radius[element]
        never = np.searchsorted(element, contact.excluded(model))
        return kernels.Contact(
            cell=self._element_cell[element], lane=self._element_lane[element], rod=rod, radius=radius,
            never=never[:, 1].copy(), row=np.searchsorted(never[:, 0], np.arange(n_elem + 1)),
            listed=np.zeros((n_elem, 2, 3)), ends=np.zeros((n_elem, 2, 3)), grid=np.zeros((n_elem, 3), np.int64),
            head=np.zeros(2 ** (2 * n_elem).bit_length(), np.int64), behind=np.zeros(n_elem, np.int64),
            stiffness=law.stiffness, damping=law.damping, skin=_SKIN * 2.0 * float(radius.max(initial=0.0)),
        )  # fmt: skip

    def _pack_torques(self) -> float | None:
        for load in self.model.torques:
            cell, lane = self._place.cell(load.rod, load.element), self._place.rod_lane[load.rod]
            self._cells["couple"][cell, :, lane] += load.torque
        return 1.0 if self.model.torques else None

    @property
    def state(self) -> RodState:
        """A copy of the state."""
        cells, n_elem, ball = self._cells, self.model.n_elem, self._ball
        moving = np.zeros((3, 0, 3)) if ball is None else np.stack([ball.place, ball.speed, ball.spin])[:, None]
        return RodState(
            position=cells["x"][self._node_cell, :, self._node_lane],
            velocity=cells["v"][self._node_cell, :, self._node_lane],
            directors=cells["q"][self._element_cell, :, self._element_lane].reshape(n_elem, 3, 3),
            omega=cells["w"][self._element_cell, :, self._element_lane],
            bolus_position=moving[0],
            bolus_velocity=moving[1],
            bolus_omega=moving[2],
            time=self._time,
        )

    def _restore(self, state: RodState) -> None:
        cells = self._cells
        cells["x"][self._node_cell, :, self._node_lane] = state.position
        cells["v"][self._node_cell, :, self._node_lane] = state.velocity
        cells["q"][self._element_cell, :, self._element_lane] = state.directors.reshape(-1, 9)
        cells["w"][self._element_cell, :, self._element_lane] = state.omega
        if self._ball is not None:
            self._ball.place[:], self._ball.speed[:] = state.bolus_position[0], state.bolus_velocity[0]
            self._ball.spin[:] = state.bolus_omega[0]
        self._time = state.time

    def _advance(self, start: FloatArray, end: FloatArray, n_substeps: int) -> Health:
        cell, lane, muscle = self._pull
        rise = (end - start) / n_substeps
        self._cells["tension"][cell, lane] = (start + 0.5 * rise)[muscle]
        self._cells["tension_rise"][cell, lane] = rise[muscle]
        if self._lines is not None:
            n_rod = len(self.model.muscles)
            self._lines.tension[:] = (start + 0.5 * rise)[n_rod:]
            self._lines.rise[:] = rise[n_rod:]
        kernels.advance(
            self._cells,
            self._place.passive,
            self._place.active,
            self._joints,
            self._joint_damping,
            self._lines,
            self._hill,
            self._loads,
            self._ground,
            self._couples,
            self._spin_damping,
            self._symmetric,
            self._ball,
            self._contact,
            self._account,
            n_substeps,
            self.dt,
        )
        self._time += n_substeps * self.dt
        return self._inspected()

    def _flow(self) -> Flow:
        """Return what the account holds, and empty it."""
        assert self._account is not None
        muscle_work, load_work, dissipated = self._account.total.tolist()
        self._account.total[:] = 0.0
        return Flow(muscle_work, load_work, dissipated)

    def _inspected(self) -> Health:
        code, found = kernels.inspect(
            self._cells,
            self._element_cell,
            self._element_lane,
            MIN_DILATATION,
            MAX_DILATATION,
            self._joints,
            self._reach,
            self._lines,
        )
        if code == Status.OK:
            ball = self._ball
            lost = ball is not None and not np.isfinite([ball.place, ball.speed, ball.spin]).all()
            return Health(Status.NON_FINITE if lost else Status.OK)
        if code == Status.TORN:
            return torn(self.model, found)
        if found >= self.model.n_elem:
            return overstretched(self.model, found - self.model.n_elem)
        rod = int(np.searchsorted(self.model.element_offset, found, side="right")) - 1
        return Health(Status(code), rod, found - int(self.model.element_offset[rod]))
