"""Engines advance a `RodModel` in time: "fused" (compiled, the default) and "pyelastica" (the reference).

Both take steps of position Verlet: half a drift; all forces of that instant (internal, muscle tension, joints, lines,
weights and point loads, the ball's push, rods that touch, then the ground's normal force, with the velocities before
the kick); a full kick, clamps; the friction of the ground, then that of the ball, on the velocities that all this
leaves; half a drift. Damping follows the kick, as in PyElastica 1.0.0, or goes along with it (see `Splitting`), but
comes before friction. Friction acts on the centre line: a rod that rolls on the spot is not held, as rods of a lattice
do not roll.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from lattice_gym.checks import FloatArray, finite_number, real_array, shown, whole_number
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.energy import ENERGY_TOLERANCE, EnergyMeter, Flow, Ledger, StoredEnergy, ledger
from lattice_gym.physics.state import RodState

STEP_TOLERANCE = 0.03
"""Distance of a node from its place in a run at half the step, over the longest side of the assembly at rest, above
which the step is too long: between the 1 % that counts as right and the 10 % that counts as wrong."""
MAX_STEPS = 2**62
"""What the step counter of the compiled code holds."""


class Status(IntEnum):
    """How a call to `Engine.advance` ended.

    NON_FINITE: a position, velocity or director is NaN or infinite. OVERSTRETCHED: an element or a line is shorter than
    `MIN_DILATATION` or longer than `MAX_DILATATION` times its rest length. INVERTED: an element points against its d3.
    TORN: two joined nodes are further apart than the radii of their rods reach, see `joint_reach`. ENERGY: more energy
    came from nowhere than the ledger tolerates, see `energy.ENERGY_TOLERANCE`; looked for only with the energy check.
    INACCURATE: a run at half the step, taken along since the state was last set, is further away than `STEP_TOLERANCE`,
    or failed itself; looked for only with the step check.
    """

    OK = 0
    NON_FINITE = 1
    OVERSTRETCHED = 2
    INVERTED = 3
    TORN = 4
    ENERGY = 5
    INACCURATE = 6


@dataclass(frozen=True)
class Health:
    """Status, and where it shows: rod and element, and the joint where one is torn (-1 where there is none).

    A failure without a rod is the ball's.
    """

    status: Status = Status.OK
    rod: int = -1
    element: int = -1
    joint: int = -1

    @property
    def ok(self) -> bool:
        """True while the state can be trusted to be a state at all."""
        return self.status is Status.OK

    def __str__(self) -> str:
        if self.ok:
            return "ok"
        if self.rod < 0:
            return f"{self.status.name.lower()} (ball)"
        joint = f", joint {self.joint}" if self.joint >= 0 else ""
        return f"{self.status.name.lower()} (rod {self.rod}, element {self.element}{joint})"


def joint_reach(model: RodModel) -> FloatArray:
    """Gap at which each joint counts as torn [m], shape (n_joint,): its gap at rest and the radii of both rods.

    Two rods that lie further apart than that have come off each other.
    """
    reach = np.zeros(len(model.joints))
    for k, joint in enumerate(model.joints):
        a, b = model.rods[joint.rod_a], model.rods[joint.rod_b]
        gap = float(np.linalg.norm(a.position[joint.node_a] - b.position[joint.node_b]))
        radii = (rod.radius[min(node, rod.n_elem - 1)] for rod, node in ((a, joint.node_a), (b, joint.node_b)))
        reach[k] = gap + float(sum(radii))
    return reach


def torn(model: RodModel, joint: int) -> Health:
    """Health that names a torn joint, by its first rod and the element at its node there."""
    tie = model.joints[joint]
    return Health(Status.TORN, tie.rod_a, _element_at(model, tie.rod_a, tie.node_a), joint)


def overstretched(model: RodModel, line: int) -> Health:
    """Health that names the rod and element at the first end of an over-stretched line."""
    tie = model.lines[line]
    return Health(Status.OVERSTRETCHED, tie.rod_a, _element_at(model, tie.rod_a, tie.node_a))


def _element_at(model: RodModel, rod: int, node: int) -> int:
    """Element that begins at a node, or the last one."""
    return min(node, model.rods[rod].n_elem - 1)


def positive_step(dt: float) -> float:
    """Time step [s], or a ValueError."""
    if (step := finite_number(dt)) is None or step <= 0.0:
        raise ValueError(f"dt = {shown(dt)}: must be positive and finite [s]")
    return step


def tension_ramp(tension: npt.ArrayLike, shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """Tensions at the start and the end of a call, both of the given shape, or a ValueError."""
    pull = real_array("tension", tension)
    if pull.shape not in (shape, (2, *shape)):
        raise ValueError(f"tension: shape must be {shape} or {(2, *shape)}, got {pull.shape}")
    if (pull < 0.0).any():
        raise ValueError("tension: must be finite and not negative [N]")
    return (pull[0], pull[1]) if pull.ndim > len(shape) else (pull, pull)


def step_count(n_substeps: int) -> int:
    """Find a number of steps that the compiled code can count, or raise a ValueError."""
    count = whole_number(n_substeps)
    if count is None or not 1 <= count <= MAX_STEPS:
        raise ValueError(f"n_substeps = {shown(n_substeps)}: must be a whole number, at least 1")
    return count


class Engine(ABC):
    """Integrates one assembly with a fixed time step."""

    def __init__(self, model: RodModel, dt: float, energy_check: bool = False) -> None:
        self.model = model
        self.dt = positive_step(dt)
        self._meter = EnergyMeter(model) if energy_check else None
        self._shadow: Engine | None = None
        self._size = float(np.ptp(model.rest_state().position, axis=0).max())
        self._step_error: float | None = None
        self._before: tuple[RodState, StoredEnergy] | None = None
        self._ledger: Ledger | None = None

    @property
    @abstractmethod
    def state(self) -> RodState:
        """A copy of the state."""

    def restore(self, state: RodState) -> None:
        """Take over a state; going on from it gives to the last bit what the engine that gave it would.

        Raises
        ------
        ValueError
            The state does not fit the model, is not finite, or has moved a clamped node.
        """
        state.check(self.model)
        self._restore(state)
        if self._meter is not None:
            self._flow()  # A call that failed has left its sums, finite or not.
        if self._shadow is not None:
            self._shadow.restore(state)
        self._before = self._ledger = self._step_error = None

    @property
    def ledger(self) -> Ledger | None:
        """Energy over the last call to `advance`, that of one which failed by it included.

        None before the first call, after any other failure, and without the check.
        """
        return self._ledger

    @property
    def step_error(self) -> float | None:
        """Largest distance of a node or the ball from a run at half the step, over the longest side at rest.

        None before the first call to `advance`, where either run failed, and without the check.
        """
        return self._step_error

    def advance(self, tension: npt.ArrayLike, n_substeps: int) -> Health:
        """Advance by n_substeps * dt.

        Parameters
        ----------
        tension
            Muscle tensions [N], shape (n_muscle,) and held, or (2, n_muscle): linear in time from the first row at the
            start of the call to the second at its end (each step takes the value at its middle).
        n_substeps
            Number of steps, at least 1.

        Raises
        ------
        ValueError
            Wrong shape, a tension that is negative or not finite, or no step.
        """
        start, end = tension_ramp(tension, (self.model.n_muscle,))
        count = step_count(n_substeps)
        if self._meter is not None and self._before is None:
            self._before = (state := self.state), self._meter.stored(state)
        self._ledger = self._step_error = None
        health = self._advance(start, end, count)
        other = None if self._shadow is None else self._shadow._advance(start, end, 2 * count)
        if not health.ok:
            return health
        if self._meter is not None and self._before is not None:
            health = self._audit(self._meter, *self._before)
        if self._shadow is not None and other is not None:
            compared = self._compared(self._shadow.state, other)
            health = compared if health.ok else health
        return health

    def shadowed(self, shadow: Engine) -> Engine:
        """Take along an engine of half the step, at the same state, and compare with it after every call."""
        self._shadow = shadow
        return self

    def _compared(self, other: RodState, health: Health) -> Health:
        """Judge how far nodes and ball are from where the engine at half the step has them, which ended in `health`."""
        if not health.ok:
            return replace(health, status=Status.INACCURATE)
        own, place = ((np.concatenate([state.position, state.bolus_position])) for state in (self.state, other))
        apart = np.linalg.norm(own - place, axis=1)
        node = int(np.argmax(apart))
        self._step_error = float(apart[node]) / self._size
        if self._step_error <= STEP_TOLERANCE:
            return Health()
        if node >= self.model.n_node:
            return Health(Status.INACCURATE)
        rod = int(np.searchsorted(self.model.node_offset, node, side="right")) - 1
        return Health(Status.INACCURATE, rod, _element_at(self.model, rod, node - int(self.model.node_offset[rod])))

    def _audit(self, meter: EnergyMeter, state: RodState, stored: StoredEnergy) -> Health:
        """Draw up the ledger of a call that began with a state, and judge it."""
        now, flow = self.state, self._flow()
        held = meter.stored(now)
        work = replace(flow, load_work=flow.load_work + meter.force_work(state, now))
        self._before, self._ledger = (now, held), ledger(stored, held, work, meter.least)
        if not self._ledger.residual >= -ENERGY_TOLERANCE * self._ledger.scale:
            return Health(Status.ENERGY, *meter.most(held))
        return Health()

    @abstractmethod
    def _restore(self, state: RodState) -> None: ...

    @abstractmethod
    def _advance(self, start: FloatArray, end: FloatArray, n_substeps: int) -> Health: ...

    @abstractmethod
    def _flow(self) -> Flow:
        """Energy that entered and left since the last call; asked for only with the energy check."""
