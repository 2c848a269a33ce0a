"""Packs of worms: several `RodModel`s of one shape side by side in lanes; one compiled call advances them."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.fused.kernels import (
    account,
    ball,
    contact,
    damping,
    elasticity,
    ground,
    hill,
    joints,
    lines,
    loads,
    muscles,
    step,
)
from lattice_gym.engines.fused.kernels.health import WormTable
from lattice_gym.engines.fused.kernels.layout import CELL, LANES, WORK, Blocks, Places, aligned
from lattice_gym.engines.health import Health, Status, joint_gap_limits, overstretched_line, torn_joint
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.laws.elasticity import MAX_DILATATION, MIN_DILATATION
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.rod import Rod
from lattice_gym.physics.state import RodState


class Outputs(NamedTuple):
    """Positions [m] and velocities [m/s] of all nodes and balls, as of the last sound moment of each worm.

    Shapes (n, n_node, 3) and (n, n_ball, 3).
    """

    position: FloatArray
    velocity: FloatArray
    ball_position: FloatArray
    ball_velocity: FloatArray


class Features(NamedTuple):
    """Features for which code is compiled; all worms of a pack have the same ones.

    Absent features cost nothing, but code with and without them rounds differently: so packs are never mixed.
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
        joints.is_damped(model),
        len(model.lines) > 0,
        bool(loads.node_loads(model).any()),
        len(model.torques) > 0,
        any(rod.rotational_damping > 0.0 for rod in model.rods),
        model.hill,
        model.ground,
    )


def needs_own_pack(model: RodModel) -> bool:
    """Whether a worm needs a pack of its own: with a ball, contact, or friction that depends on direction."""
    by_direction = model.ground is not None and not model.ground.isotropic
    return model.ball is not None or model.contact is not None or by_direction


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
    own = set(model.muscles)
    groups: dict[tuple[bool, int], list[tuple[int, int]]] = defaultdict(list)
    for worm in range(n_worm):
        for index, rod in enumerate(model.rods):
            groups[index in own, rod.n_elem].append((worm, index))
    rod_cell, rod_lane = np.zeros((2, n_worm, model.n_rod), np.int64)
    bounds: dict[bool, list[tuple[int, int]]] = {False: [], True: []}
    n_cell = 0
    for (is_muscle, n_elem), members in sorted(groups.items()):
        for start in range(0, len(members), LANES):
            block = tuple(np.array(members[start : start + LANES]).T)
            rod_cell[block], rod_lane[block] = n_cell, np.arange(len(block[0]))
            bounds[is_muscle].append((n_cell, n_cell + n_elem + 1))
            n_cell += n_elem + 1
    passive, active = (np.array(bounds[kind], np.int64).reshape(-1, 2) for kind in (False, True))
    return _Placement(rod_cell, rod_lane, passive, active, n_cell)


def n_record(model: RodModel, n_worm: int) -> int:
    """Count the records that worms side by side take."""
    own = set(model.muscles)
    rods = Counter((index in own, rod.n_elem) for index, rod in enumerate(model.rods))
    return sum(-(-count * n_worm // LANES) * (n_elem + 1) for (_, n_elem), count in rods.items())


class Pack:
    """Worms of one shape and with the same features side by side in lanes: what the compiled code works on.

    A worm moves to the last bit as it would alone. Where it ends a call in a sound state it is written in its row of
    `outputs`. A pack of one worm has ball, contact and energy account where the scene does.

    Parameters
    ----------
    models
        One a worm, at least one, with the same features.
    dt, splitting, energy_check
        As in `engines.base.Engine`; the check in a pack of one worm only.
    rows
        Row of each worm in `outputs`, shape (n_worm,).
    outputs
        Positions and velocities of the worms of all packs.
    """

    def __init__(
        self,
        models: Sequence[RodModel],
        dt: float,
        splitting: Splitting,
        energy_check: bool,
        rows: IntArray,
        outputs: Outputs,
    ) -> None:
        model, n_worm = models[0], len(models)
        self.models, self.rows, self._outputs = list(models), rows, outputs
        self._dt, self._splitting, self._energy_check = dt, splitting, energy_check
        self._time = np.zeros(n_worm)
        place = self._placement = _place(model, n_worm)
        counts = np.array([rod.n_elem for rod in model.rods])
        node = np.concatenate([np.arange(n + 1) for n in counts])
        element = np.concatenate([np.arange(n) for n in counts])
        self._node, self._element = (
            Places(np.repeat(place.rod_cell, repeats, axis=1) + steps, np.repeat(place.rod_lane, repeats, axis=1))
            for repeats, steps in ((counts + 1, node), (counts, element))
        )
        n_work = 2 ** place.n_cell.bit_length() if energy_check else 2
        cells = aligned(CELL, place.n_cell)
        self.blocks = Blocks(cells, aligned(WORK, n_work), place.passive, place.active)
        self._tension = muscles.pack(model, self._element, cells)
        has = features(model, splitting)
        tied = joints.pack(model, self._node)
        self.laws = step.Laws(
            joints=tied,
            joint_damping=joints.pack_damping(model, tied),
            lines=lines.pack(model, self._node),
            hill=hill.pack(model.hill),
            loads=1.0 if has.loads else None,
            torques=1.0 if has.torques else None,
            ground=ground.pack(model, self._node),
            spin_damping=1.0 if has.damped_spin else None,
            symmetric=1.0 if splitting == "symmetric" else None,
            ball=None,
            contact=None,
            account=None,
        )
        self._worms = WormTable(
            node_cell=self._node.cell,
            node_lane=self._node.lane,
            cell=self._element.cell,
            lane=self._element.lane,
            max_gap=np.zeros((n_worm, len(model.joints))),
            min_dilatation=MIN_DILATATION,
            max_dilatation=MAX_DILATATION,
            row=rows,
            position=outputs.position,
            velocity=outputs.velocity,
            status=np.zeros(n_worm, np.int64),
            found=np.zeros(n_worm, np.int64),
        )
        for worm, own in enumerate(models):
            self.fill(worm, own)
        self._fill_spare_lanes()

    def fill(self, worm: int, model: RodModel) -> None:
        """Write the constants of a model with the same features, and its rest state, into the lanes of a worm."""
        self.models[worm] = model
        cells, laws, dt = self.blocks.cells, self.laws, self._dt
        node, element = self._node.of(worm), self._element.of(worm)
        for cell, lane, rod in zip(
            self._placement.rod_cell[worm], self._placement.rod_lane[worm], model.rods, strict=True
        ):
            self._fill_lane(cell, lane, rod)
        damping.fill_nodes(cells, node, model, dt, self._splitting)
        held, turned = node.of(model.clamped_nodes[0]), element.of(model.clamped_elements[0])
        cells["keep"][held] = cells["kick"][held] = cells["spin_kick"][turned] = 0.0
        if laws.loads is not None:
            loads.fill_forces(cells, node, model)
        if laws.torques is not None:
            loads.fill_torques(cells, element, model)
        if laws.ground is not None:
            ground.fill(cells, node, model)
        joints.fill(laws.joints, laws.joint_damping, worm, model)
        lines.fill(laws.lines, worm, model)
        self._worms.max_gap[worm] = joint_gap_limits(model)
        if len(self.models) == 1:
            self._pack_alone(model)
        self.restore(worm, model.rest_state())

    def _pack_alone(self, model: RodModel) -> None:
        """Pack what only a pack of one worm has."""
        node, element, n_cell, dt = self._node.of(0), self._element.of(0), self._placement.n_cell, self._dt
        checked, outputs, row = self._energy_check, self._outputs, self.rows[0]
        self.laws = self.laws._replace(
            ball=ball.pack(model, element, n_cell, dt, (outputs.ball_position[row], outputs.ball_velocity[row])),
            contact=contact.pack(model, element),
            account=account.pack(model, node, element, n_cell, dt, self._splitting) if checked else None,
        )

    def _fill_lane(self, cell: int, lane: int, rod: Rod) -> None:
        cells = self.blocks.cells[cell : cell + rod.n_elem + 1]
        elasticity.fill(cells, lane, rod, self._dt)
        damping.fill_spins(cells, lane, rod, self._dt)

    def _fill_spare_lanes(self) -> None:
        """Fill spare lanes with copies of their block's first rod that neither move nor turn, nor touch the ground."""
        place = self._placement
        for start, stop in (*place.passive, *place.active):
            worm, rod = np.nonzero(place.rod_cell == start)
            for lane in range(len(rod), LANES):
                self._fill_lane(start, lane, self.models[worm[0]].rods[rod[0]])
            cells = self.blocks.cells[start:stop]
            cells["spin_kick"][:, len(rod) :] = 0.0
            ground.fill_spare(cells, len(rod))

    def state(self, worm: int) -> RodState:
        """Copy the state of a worm."""
        cells, sphere = self.blocks.cells, self.laws.ball
        (node, lane), (element, own) = self._node.of(worm), self._element.of(worm)
        state = RodState(
            position=cells["x"][node, :, lane],
            velocity=cells["v"][node, :, lane],
            directors=cells["q"][element, :, own].reshape(-1, 3, 3),
            omega=cells["w"][element, :, own],
            time=float(self._time[worm]),
        )
        if sphere is None:
            return state
        position, velocity, omega = np.stack([sphere.position, sphere.velocity, sphere.omega])[:, None]
        return replace(state, ball_position=position, ball_velocity=velocity, ball_omega=omega)

    def restore(self, worm: int, state: RodState) -> None:
        """Take over the state of a worm; it is neither checked nor shown."""
        cells, sphere = self.blocks.cells, self.laws.ball
        (node, lane), (element, own) = self._node.of(worm), self._element.of(worm)
        cells["x"][node, :, lane] = state.position
        cells["v"][node, :, lane] = state.velocity
        cells["q"][element, :, own] = state.directors.reshape(-1, 9)
        cells["w"][element, :, own] = state.omega
        self._time[worm] = state.time
        if sphere is not None:
            sphere.position[:], sphere.velocity[:] = state.ball_position[0], state.ball_velocity[0]
            sphere.omega[:] = state.ball_omega[0]
        if self.laws.contact is not None:
            contact.clear_list(self.laws.contact)

    def advance(self, start: FloatArray, end: FloatArray, n_substeps: int) -> IntArray:
        """Advance with tensions that go from `start` to `end` [N], shape (n_worm, n_muscle).

        Returns
        -------
        Status codes, shape (n_worm,).
        """
        rise = (end - start) / n_substeps
        first = start + 0.5 * rise
        self._tension.write(first, rise)
        lines.write_tension(self.laws.lines, first, rise)
        step.advance(self.blocks, self.laws, self._worms, n_substeps, self._dt)
        self._time += n_substeps * self._dt
        return self._worms.status

    def health(self, worm: int) -> Health:
        """How a worm ended the last call, and where it failed."""
        model, code, found = self.models[worm], Status(self._worms.status[worm]), int(self._worms.found[worm])
        if code == Status.OK:
            return Health()
        if code == Status.TORN:
            return torn_joint(model, found)
        if found < 0:
            return Health(code)
        if found >= model.n_elem:
            return overstretched_line(model, found - model.n_elem)
        rod = int(model.element_rod[found])
        return Health(code, rod, found - int(model.element_offset[rod]))

    def flow(self) -> Flow:
        """Energy that entered and left the one worm in the last call; only with the energy check."""
        assert self.laws.account is not None
        return account.flow(self.laws.account)
