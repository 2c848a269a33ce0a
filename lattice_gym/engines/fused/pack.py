"""Packs of worms: several `RodModel`s of one shape side by side in lanes; one compiled call advances them."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.fused import kernels
from lattice_gym.engines.health import Health, Status, joint_gap_limits, overstretched, torn
from lattice_gym.physics.assembly import Joint, Line, RodModel
from lattice_gym.physics.laws.damping import Splitting, damping_shares
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.rod import MAX_DILATATION, MIN_DILATATION, Rod
from lattice_gym.physics.state import RodState
from lattice_gym.physics.world import Ground

_CACHE_LINE = 64


@dataclass(frozen=True)
class _Placement:
    """Where every rod of every worm stands: its first record and lane, shape (n_worm, n_rod).

    Blocks are rows (first record, one past the last).
    """

    rod_cell: IntArray
    rod_lane: IntArray
    passive: IntArray
    active: IntArray
    n_cell: int


def _place(model: RodModel, n_worm: int) -> _Placement:
    """Rods of one element count share blocks; muscles have their own, so that no other block pays for tension."""
    muscles = set(model.muscles)
    groups: dict[tuple[bool, int], list[tuple[int, int]]] = defaultdict(list)
    for worm in range(n_worm):
        for index, rod in enumerate(model.rods):
            groups[index in muscles, rod.n_elem].append((worm, index))
    rod_cell, rod_lane = np.zeros((2, n_worm, model.n_rod), np.int64)
    bounds: dict[bool, list[tuple[int, int]]] = {False: [], True: []}
    n_cell = 0
    for (is_muscle, n_elem), members in sorted(groups.items()):
        for start in range(0, len(members), kernels.LANES):
            block = tuple(np.array(members[start : start + kernels.LANES]).T)
            rod_cell[block], rod_lane[block] = n_cell, np.arange(len(block[0]))
            bounds[is_muscle].append((n_cell, n_cell + n_elem + 1))
            n_cell += n_elem + 1
    passive, active = (np.array(bounds[kind], np.int64).reshape(-1, 2) for kind in (False, True))
    return _Placement(rod_cell, rod_lane, passive, active, n_cell)


def n_record(model: RodModel, n_worm: int) -> int:
    """Count the records that worms side by side take."""
    muscles = set(model.muscles)
    rods = Counter((index in muscles, rod.n_elem) for index, rod in enumerate(model.rods))
    return sum(-(-count * n_worm // kernels.LANES) * (n_elem + 1) for (_, n_elem), count in rods.items())


def _aligned(dtype: np.dtype[np.void], count: int) -> kernels.Cells:
    """Make records of zeros that begin on a cache line, so that no packed load straddles two."""
    space = np.zeros(count * dtype.itemsize + _CACHE_LINE, np.uint8)
    start = -space.ctypes.data % _CACHE_LINE
    return space[start : start + count * dtype.itemsize].view(dtype)


def _fill_lane(cells: kernels.Cells, lane: int, rod: Rod, dt: float) -> None:
    """Write a rod's constants and rest shape into one lane of its records, shape (n_elem + 1,)."""
    elements, voronoi = cells[:-1], cells[:-2]
    cells["x"][:, :, lane] = rod.position
    elements["q"][:, :, lane] = rod.directors.reshape(-1, 9)
    elements["rest"][:, lane] = rod.rest_length
    elements["inv_rest"][:, lane] = 1.0 / rod.rest_length
    elements["shear"][:, lane] = rod.shear_stiffness
    elements["stretch"][:, lane] = rod.stretch_stiffness
    elements["spin_kick"][:, lane] = dt / rod.inertia / rod.rest_length
    elements["spin_decay"][:, lane] = 0.5 * dt * rod.rotational_damping / rod.inertia / rod.rest_length
    # Together with the cube of twice the rest length, by which the kernel's sum of lengths is to be divided.
    voronoi["bend"][:, lane] = 16.0 * rod.bend_stiffness * rod.rest_voronoi**2
    voronoi["twist"][:, lane] = 16.0 * rod.twist_stiffness * rod.rest_voronoi**2
    voronoi["rest_turn"][:, :, lane] = 0.5 * rod.rest_kappa * rod.rest_voronoi[:, None]


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


def node_decay(model: RodModel, dt: float) -> FloatArray:
    """Rate of damping of every node times the step, shape (n_node,)."""
    rate: FloatArray = model.node_damping / model.node_mass * dt
    return rate


class Features(NamedTuple):
    """What a scene has, and so what is compiled for it: worms side by side have all of it in common.

    Alone, a worm that lacks a feature pays nothing for it, and the code that has none rounds differently.
    """

    splitting: Splitting
    damped_joints: bool
    lines: bool
    loads: bool
    torques: bool
    damped_spin: bool
    hill: Hill | None
    ground: Ground | None


def features(model: RodModel, splitting: Splitting) -> Features:
    """Find what a scene has."""
    return Features(
        splitting,
        any(joint.damping > 0.0 for joint in model.joints),
        len(model.lines) > 0,
        bool(_loads(model).any()),
        len(model.torques) > 0,
        any(rod.rotational_damping > 0.0 for rod in model.rods),
        model.hill,
        model.ground,
    )


def _loads(model: RodModel) -> FloatArray:
    """Weights and point forces: what the force on a node starts from in every step, shape (n_node, 3)."""
    load = model.node_weight.copy()
    for force in model.forces:
        load[int(model.node_offset[force.rod]) + force.node] += force.force
    return load


class Pack:
    """Worms of one shape and with the same features side by side in lanes: what the compiled code works on.

    A worm moves to the last bit as it would alone. `position` and `velocity`, shape (n, n_node, 3), are written in the
    `rows` of its worms where they end a call in a sound state.
    """

    def __init__(
        self,
        models: Sequence[RodModel],
        dt: float,
        splitting: Splitting,
        rows: npt.ArrayLike = (0,),
        position: FloatArray | None = None,
        velocity: FloatArray | None = None,
    ) -> None:
        model, n_worm = models[0], len(models)
        self.models = list(models)
        self.dt = dt
        self.features = has = features(model, splitting)
        self.time = np.zeros(n_worm)
        place = self.place = _place(model, n_worm)
        counts = np.array([rod.n_elem for rod in model.rods])
        nodes = np.concatenate([np.arange(n + 1) for n in counts])
        elements = np.concatenate([np.arange(n) for n in counts])
        self.node = np.repeat(place.rod_cell, counts + 1, axis=1) + nodes, np.repeat(place.rod_lane, counts + 1, axis=1)
        self.element = np.repeat(place.rod_cell, counts, axis=1) + elements, np.repeat(place.rod_lane, counts, axis=1)
        self.cells = _aligned(kernels.CELL, place.n_cell)
        self.work = _aligned(kernels.WORK, 2)
        n_joint, n_line, n_muscle = len(model.joints), len(model.lines), len(model.muscles)
        self.joints = kernels.Joints(*self._ends(model.joints), np.zeros(n_worm * n_joint))
        self.joint_damping = np.zeros(n_worm * n_joint) if has.damped_joints else None
        self.lines = kernels.Lines(*self._ends(model.lines), *np.zeros((4, n_worm * n_line))) if has.lines else None
        muscle = np.full(model.n_rod, -1)
        muscle[list(model.muscles)] = np.arange(n_muscle)
        muscle_of = np.repeat(muscle, counts)
        pulled = muscle_of >= 0
        self._flat = self.cells.view(np.float64)
        place_of = np.arange(self._flat.size).view(kernels.CELL)
        at = self.element[0][:, pulled], self.element[1][:, pulled]
        self._pulled = np.array([place_of[name][at] for name in ("tension", "tension_rise")]).view(np.int64)
        self._muscle = muscle_of[pulled]
        self.rows: IntArray = np.array(rows, np.int64)
        shape = n_worm, model.n_node, 3
        self.worms = kernels.Worms(
            *self.node, *self.element, np.zeros((n_worm, n_joint)), self.rows,
            np.zeros(shape) if position is None else position, np.zeros(shape) if velocity is None else velocity,
            *np.zeros((2, n_worm), np.int64),
        )  # fmt: skip
        self.hill = _pack_hill(model.hill)
        self.ground = self._pack_ground(model)
        for worm, own in enumerate(models):
            self.fill(worm, own)
        self._fill_spare_lanes()

    def _ends(self, ties: Sequence[Joint | Line]) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        """Find records and lanes of the first and the second node of each tie, worm by worm."""
        cell, lane = self.place.rod_cell, self.place.rod_lane
        rod_a, node_a, rod_b, node_b = (
            np.array([getattr(tie, name) for tie in ties], np.int64) for name in ("rod_a", "node_a", "rod_b", "node_b")
        )
        return (
            (cell[:, rod_a] + node_a).ravel(), lane[:, rod_a].ravel(),
            (cell[:, rod_b] + node_b).ravel(), lane[:, rod_b].ravel(),
        )  # fmt: skip

    def _pack_ground(self, model: RodModel) -> kernels.Ground | None:
        """Constants of the ground; friction by direction is along the axis of the first worm, which is then alone."""
        ground, axis = model.ground, None
        if ground is None:
            return None
        if not ground.isotropic:
            (tail, head), (cell, lane) = model.rod_ends, (of[0] for of in self.node)
            axis = kernels.Axis(cell[tail], lane[tail], cell[head], lane[head], np.zeros(3))
        friction = ground.static_friction, ground.kinetic_friction
        factors = ground.forward, ground.backward, ground.sideways
        return kernels.Ground(ground.stiffness, ground.damping, *friction, *factors, axis)

    def fill(self, worm: int, model: RodModel) -> None:
        """Write the constants of a model, and its rest state, into the lanes of a worm."""
        self.models[worm] = model
        place, cells, has = self.place, self.cells, self.features
        node, element = (self.node[0][worm], self.node[1][worm]), (self.element[0][worm], self.element[1][worm])
        for cell, lane, rod in zip(place.rod_cell[worm], place.rod_lane[worm], model.rods, strict=True):
            _fill_lane(cells[cell : cell + rod.n_elem + 1], lane, rod, self.dt)
        before, after = damping_shares(node_decay(model, self.dt), has.splitting)
        cells["keep"][node] = before * after
        cells["push"][node] = self.dt / model.node_mass * after
        for clamp in model.clamps:
            cell, lane = place.rod_cell[worm, clamp.rod], place.rod_lane[worm, clamp.rod]
            if clamp.node is not None:
                cells["keep"][cell + clamp.node, lane] = cells["push"][cell + clamp.node, lane] = 0.0
            if clamp.element is not None:
                cells["spin_kick"][cell + clamp.element, lane] = 0.0
        if has.loads:
            for name in ("load", "force"):
                cells[name][node[0], :, node[1]] = _loads(model)
        if has.ground is not None:
            cells["height"][node] = model.node_radius
        if has.torques:
            cells["couple"][element[0], :, element[1]] = 0.0
            for load in model.torques:
                cell, lane = place.rod_cell[worm, load.rod] + load.element, place.rod_lane[worm, load.rod]
                cells["couple"][cell, :, lane] += load.torque
        own = slice(worm * len(model.joints), (worm + 1) * len(model.joints))
        self.joints.stiffness[own] = [joint.stiffness for joint in model.joints]
        self.worms.reach[worm] = joint_gap_limits(model)
        if self.joint_damping is not None:
            self.joint_damping[own] = [joint.damping for joint in model.joints]
        if self.lines is not None:
            own = slice(worm * len(model.lines), (worm + 1) * len(model.lines))
            self.lines.rest_length[own] = [line.rest_length for line in model.lines]
            self.lines.stiffness[own] = [line.stiffness for line in model.lines]
        self.restore(worm, model.rest_state())

    def _fill_spare_lanes(self) -> None:
        """Fill spare lanes with copies of their block's first rod that neither move nor turn, nor touch the ground."""
        place = self.place
        for start, stop in (*place.passive, *place.active):
            worm, rod = np.nonzero(place.rod_cell == start)
            for lane in range(len(rod), kernels.LANES):
                _fill_lane(self.cells[start:stop], lane, self.models[worm[0]].rods[rod[0]], self.dt)
            self.cells["spin_kick"][start:stop, len(rod) :] = 0.0
            self.cells["height"][start:stop, len(rod) :] = -np.inf

    def state(self, worm: int) -> RodState:
        """Copy the state of a worm, without a ball."""
        cells = self.cells
        node, lane = self.node[0][worm], self.node[1][worm]
        element, own = self.element[0][worm], self.element[1][worm]
        return RodState(
            position=cells["x"][node, :, lane],
            velocity=cells["v"][node, :, lane],
            directors=cells["q"][element, :, own].reshape(-1, 3, 3),
            omega=cells["w"][element, :, own],
            time=float(self.time[worm]),
        )

    def restore(self, worm: int, state: RodState) -> None:
        """Take over the state of a worm; it is not checked."""
        cells, row = self.cells, self.worms.row[worm]
        node, lane = self.node[0][worm], self.node[1][worm]
        element, own = self.element[0][worm], self.element[1][worm]
        cells["x"][node, :, lane] = self.worms.position[row] = state.position
        cells["v"][node, :, lane] = self.worms.velocity[row] = state.velocity
        cells["q"][element, :, own] = state.directors.reshape(-1, 9)
        cells["w"][element, :, own] = state.omega
        self.time[worm] = state.time

    def advance(
        self,
        start: FloatArray,
        end: FloatArray,
        n_substeps: int,
        ball: kernels.Ball | None = None,
        contact: kernels.Contact | None = None,
        account: kernels.Account | None = None,
    ) -> IntArray:
        """Advance with tensions that go from `start` to `end` [N], shape (n_worm, n_muscle).

        Returns
        -------
        Status codes, shape (n_worm,).
        """
        rise = (end - start) / n_substeps
        first = start + 0.5 * rise
        # Twice as fast as to write the fields.
        self._flat[self._pulled] = np.array([first, rise]).take(self._muscle, axis=-1)
        if self.lines is not None:
            n_rod = len(self.models[0].muscles)
            self.lines.tension[:] = first[:, n_rod:].ravel()
            self.lines.rise[:] = rise[:, n_rod:].ravel()
        has = self.features
        kernels.run(
            self.cells,
            self.work,
            self.place.passive,
            self.place.active,
            self.joints,
            self.joint_damping,
            self.lines,
            self.hill,
            1.0 if has.loads else None,
            self.ground,
            1.0 if has.torques else None,
            1.0 if has.damped_spin else None,
            1.0 if has.splitting == "symmetric" else None,
            ball,
            contact,
            account,
            n_substeps,
            self.dt,
            self.worms,
            MIN_DILATATION,
            MAX_DILATATION,
        )
        self.time += n_substeps * self.dt
        return self.worms.status

    def health(self, worm: int) -> Health:
        """How a worm ended the last call, and where it failed."""
        model, code, found = self.models[worm], Status(self.worms.status[worm]), int(self.worms.found[worm])
        if code == Status.OK:
            return Health()
        if code == Status.TORN:
            return torn(model, found)
        if found >= model.n_elem:
            return overstretched(model, found - model.n_elem)
        rod = int(np.searchsorted(model.element_offset, found, side="right")) - 1
        return Health(code, rod, found - int(model.element_offset[rod]))
