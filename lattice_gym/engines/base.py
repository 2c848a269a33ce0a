"""What an engine is: it advances worms of one shape in time, all with one time step.

A step of position Verlet is half a drift, a kick, friction and half a drift. The kick takes all forces at that instant,
with the velocities before it: internal forces, muscle tension, joints, lines, weights and point loads, contact of the
ball and of rods, and the ground's normal force. Clamps come next, then the friction of the ground and that of the ball,
each on the velocities left so far. Damping follows the kick, as in PyElastica 1.0.0, or acts along with it (see
`Splitting`), always before friction. Friction acts on the centre line, so it does not resist a rod that rolls on the
spot; rods of a lattice do not roll.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import get_args

import numpy as np
import numpy.typing as npt

from lattice_gym.checks import FloatArray, IntArray, choice, flag, number, whole
from lattice_gym.engines.arguments import (
    MAX_STEPS,
    difference_in_shape,
    models_of_one_shape,
    tension_ramp,
    thread_count,
)
from lattice_gym.engines.energy_audit import EnergyAudit
from lattice_gym.engines.health import Health
from lattice_gym.engines.step_doubling import StepDoubling
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.energy import Flow, Ledger
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.state import RodState


class Engine(ABC):
    """Advances worms of one shape, each of which moves to the last bit as it would alone.

    No worm affects another, not even one that diverges. A subclass takes the same arguments and gives `_advance`,
    `_health`, `_state`, `_restore`, `_replace` and `_flow`; all else is here: checks of arguments, what worms show, the
    energy ledger, and step doubling.

    Parameters
    ----------
    models
        One model a worm: the same rods by number of elements, the same joints, lines, muscles and ball; all else may
        differ.
    dt
        Time step [s].
    splitting
        When velocities are damped in a step.
    energy_check
        Keep an energy ledger over every call, and fail where too much energy is spurious.
    step_check
        Step doubling: run every worm at half the step too, and fail where both differ; three times the cost.
    num_threads
        How many threads at most advance the worms; None: as many as there are cores for this process.

    Attributes
    ----------
    models : list of RodModel
        One a worm.
    n_worm : int
        Number of worms.
    dt : float
        Time step [s].
    position, velocity
        Of the nodes [m], [m/s], shape (n_worm, n_node, 3), written in place: as of the last sound moment of each worm.
    ball_position, ball_velocity
        Of the balls [m], [m/s], shape (n_worm, n_ball, 3), likewise.

    Raises
    ------
    ValueError
        No model, one of another shape, a step that is not positive and finite, a splitting that the engine lacks, a
        check that is not a bool, `num_threads` that is no whole number above 0.
    RuntimeError
        A call while another thread advances the worms: any number of engines may be used side by side, but each by one
        thread at a time. So it is in the fork of a process in which another thread did.
    """

    def __init__(
        self,
        models: Sequence[RodModel],
        dt: float,
        splitting: Splitting = "pyelastica",
        *,
        energy_check: bool = False,
        step_check: bool = False,
        num_threads: int | None = None,
    ) -> None:
        self.splitting: Splitting = choice("splitting", splitting, get_args(Splitting))
        self.energy_check, self.step_check = flag("energy_check", energy_check), flag("step_check", step_check)
        self.models = models_of_one_shape(models)
        self.n_worm = len(self.models)
        self.dt = number("dt", dt, 0.0, unit="s", above=True)
        self.num_threads = thread_count(num_threads)
        model = self.models[0]
        self.position, self.velocity = np.zeros((2, self.n_worm, model.n_node, 3))
        self.ball_position, self.ball_velocity = np.zeros((2, self.n_worm, model.n_ball, 3))
        for worm, model in enumerate(self.models):
            self._show(worm, model.rest_state())
        self._busy = threading.Lock()
        self._failures: dict[int, Health] = {}
        self._audits = [EnergyAudit(model) for model in self.models] if energy_check else []
        self._comparisons = [StepDoubling(model) for model in self.models] if step_check else []
        self._half_step: Engine | None = None
        if step_check:
            self._half_step = type(self)(self.models, 0.5 * self.dt, splitting, num_threads=num_threads)

    def advance(self, tension: npt.ArrayLike, n_substeps: int) -> IntArray:
        """Advance every worm by n_substeps * dt; return the codes of their `Status`, shape (n_worm,).

        A worm that failed goes on from where it is in the next call, unless it is restored or replaced.

        Parameters
        ----------
        tension
            Muscle tensions [N], shape (n_worm, n_muscle) and held, or (2, n_worm, n_muscle): linear in time from the
            first at the start of the call to the second at its end (each step takes the value at its middle).
        n_substeps
            Number of steps, at least 1.

        Raises
        ------
        ValueError
            Wrong shape, a tension that is negative or not finite, or no step.
        """
        start, end = tension_ramp(tension, (self.n_worm, self.models[0].n_muscle))
        count = whole("n_substeps", n_substeps, 1, MAX_STEPS)
        if not self._busy.acquire(blocking=False):
            raise _in_use()
        try:
            if self._audits or self._half_step is not None:
                return self._advance_checked(start, end, count)
            codes = np.array(self._advance(start, end, count), np.int64)
            self._failures = {worm: self._health(worm) for worm in np.flatnonzero(codes).tolist()}
            return codes
        finally:
            self._busy.release()

    def _advance_checked(self, start: FloatArray, end: FloatArray, n_substeps: int) -> IntArray:
        """Advance with the checks that are on; a worm that fails one keeps showing its state before the call."""
        for worm, audit in enumerate(self._audits):
            if not audit.is_open:
                audit.open(self._state(worm))
        arrays = self.position, self.velocity, self.ball_position, self.ball_velocity
        before = [array.copy() for array in arrays]
        codes = np.array(self._advance(start, end, n_substeps), np.int64)
        finer = None if self._half_step is None else self._half_step._advance(start, end, 2 * n_substeps)
        self._failures = {}
        for worm in range(self.n_worm):
            if codes[worm] != 0:
                self._discard_checks(worm)
                self._failures[worm] = self._health(worm)
                continue
            health = self._checked(worm, finer is not None and finer[worm] != 0)
            if not health.ok:
                codes[worm], self._failures[worm] = health.status, health
                for array, shown in zip(arrays, before, strict=True):
                    array[worm] = shown[worm]
        return codes

    def _checked(self, worm: int, half_step_failed: bool) -> Health:
        """Judge a worm whose call ended in a state."""
        state, health = self._state(worm), Health()
        if self._audits:
            health = self._audits[worm].close(state, self._flow(worm))
        if self._half_step is not None:
            ended = self._half_step._health(worm) if half_step_failed else Health()
            compared = self._comparisons[worm].compare(state, self._half_step._state(worm), ended)
            health = compared if health.ok else health
        return health

    def require_idle(self) -> None:
        """Raise a RuntimeError while a thread advances the worms: what they show is then neither before nor after."""
        if self._busy.locked():
            raise _in_use()

    def health(self, worm: int = 0) -> Health:
        """How a worm ended the last call to `advance`, and where it failed."""
        return self._failures.get(self._row(worm), Health())

    def state(self, worm: int = 0) -> RodState:
        """Copy the state of a worm, sound or not."""
        self.require_idle()
        return self._state(self._row(worm))

    def restore(self, worm: int, state: RodState) -> None:
        """Set the state of a worm; it continues, to the last bit, as in the engine that the state came from.

        Raises
        ------
        ValueError
            The state does not fit the model, is not finite, or has moved a clamped node.
        """
        self.require_idle()
        worm = self._row(worm)
        state.check(self.models[worm])
        self._restore(worm, state)
        self._show(worm, state)
        self._discard_checks(worm)
        if self._half_step is not None:
            self._half_step._restore(worm, state)

    def replace(self, worm: int, model: RodModel) -> None:
        """Let a worm begin again from the rest state of another model of the same shape.

        Raises
        ------
        ValueError
            The model is of another shape.
        """
        self.require_idle()
        worm = self._row(worm)
        if (differs := difference_in_shape(self.models[worm], model)) is not None:
            raise ValueError(f"model: must have the shape of the one before, but differs in {differs}")
        for engine in (self, self._half_step):
            if engine is not None:
                engine._replace(worm, model)
                engine.models[worm] = model
        self._show(worm, model.rest_state())
        if self._audits:
            self._audits[worm] = EnergyAudit(model)
        if self._comparisons:
            self._comparisons[worm] = StepDoubling(model)

    def ledger(self, worm: int = 0) -> Ledger | None:
        """Energy of a worm over the last call to `advance`, that of one which failed by it included.

        None before the first call, after any other failure, and without the check.
        """
        return self._audits[worm].ledger if self._audits else None

    def step_error(self, worm: int = 0) -> float | None:
        """Largest distance of a node or the ball from a run at half the step, over the longest side at rest.

        None before the first call to `advance`, where either run failed, and without the check.
        """
        return self._comparisons[worm].error if self._comparisons else None

    def _row(self, worm: int) -> int:
        """Row of a worm, where negative ones count from the last; an IndexError where there is none."""
        return range(self.n_worm)[worm]

    def close(self) -> None:
        """Give back threads; a later call to `advance` would begin new ones."""
        if self._half_step is not None:
            self._half_step.close()

    def _show(self, worm: int, state: RodState) -> None:
        """Write out where nodes and ball are."""
        self.position[worm], self.velocity[worm] = state.position, state.velocity
        self.ball_position[worm], self.ball_velocity[worm] = state.ball_position, state.ball_velocity

    def _discard_checks(self, worm: int) -> None:
        """Forget what the checks know of a worm."""
        if self._audits:
            self._audits[worm].discard()
        if self._comparisons:
            self._comparisons[worm].discard()

    @abstractmethod
    def _advance(self, start: FloatArray, end: FloatArray, n_substeps: int) -> IntArray:
        """Advance with tensions from `start` to `end` [N], shape (n_worm, n_muscle); return codes, shape (n_worm,).

        Where a worm ends in a sound state its rows of `position`, `velocity`, `ball_position` and `ball_velocity` are
        written, for instance by `_show`; else they stay.
        """

    @abstractmethod
    def _health(self, worm: int) -> Health:
        """How a worm ended the last `_advance`; asked for only where it failed."""

    @abstractmethod
    def _state(self, worm: int) -> RodState:
        """Copy the state of a worm."""

    @abstractmethod
    def _restore(self, worm: int, state: RodState) -> None:
        """Take over a state that fits; nothing of what came before may be felt."""

    @abstractmethod
    def _replace(self, worm: int, model: RodModel) -> None:
        """Begin at the rest state of a model of the same shape; `models` still holds the one before."""

    @abstractmethod
    def _flow(self, worm: int) -> Flow:
        """Energy that entered a worm and left it in the last `_advance`; asked for only with the energy check."""


def _in_use() -> RuntimeError:
    return RuntimeError(
        "engine: another thread is advancing these worms, or was when this process was forked; let one thread at a "
        "time use an environment, or give each its own, and in the fork make one anew"
    )
