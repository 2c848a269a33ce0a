"""Many worms of one shape at once: side by side in lanes where that can be, in packs spread over threads."""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait

import numpy as np
import numpy.typing as npt

from lattice_gym.checks import FloatArray, IntArray, shown, whole_number
from lattice_gym.engines.base import Health, positive_step, step_count, tension_ramp
from lattice_gym.engines.fused import kernels
from lattice_gym.engines.fused.pack import Features, Pack, features, n_record
from lattice_gym.engines.registry import EngineName, check_options, make_engine
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.state import RodState

_CACHE = 2**20
"""Bytes that a core keeps at hand: what its second-level cache holds, 1 MiB where this was measured."""


class BatchEngine:
    """Worms of one shape of assembly, each of which moves to the last bit as it would in an engine of its own.

    What one does, diverging included, no other feels. Fused worms with the same features (see `fused.Features`) share
    packs, and packs share threads; with a ball, contact, friction by direction or a check each has an engine of its
    own, as it has on the pyelastica engine, which has no use for threads.

    Parameters
    ----------
    models
        One model a worm: the same rods by number of elements, the same joints, lines, muscles and ball; all else may
        differ.
    dt, splitting, engine, energy_check, step_check
        As in `engines.make_engine`.
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
    bolus_position, bolus_velocity
        Of the balls [m], [m/s], shape (n_worm, n_bolus, 3), likewise.

    Raises
    ------
    ValueError
        No model, one of another shape, `num_threads` that is no whole number above 0, or what `make_engine` refuses.
    """

    def __init__(
        self,
        models: Sequence[RodModel],
        dt: float,
        splitting: Splitting = "pyelastica",
        *,
        engine: EngineName = "fused",
        energy_check: bool = False,
        step_check: bool = False,
        num_threads: int | None = None,
    ) -> None:
        check_options(engine, splitting, energy_check, step_check)
        self.models = _alike(models)
        self.n_worm = len(self.models)
        self.dt = positive_step(dt)
        self._options = engine, splitting, energy_check, step_check
        self._n_thread = _thread_count(num_threads)
        model = self.models[0]
        self.position, self.velocity = np.zeros((2, self.n_worm, model.n_node, 3))
        self.bolus_position, self.bolus_velocity = np.zeros((2, self.n_worm, model.n_bolus, 3))
        self._parts: list[Pack | _Alone] = []
        self._seat: list[tuple[Pack | _Alone, int]] = []
        self._health = [Health()] * self.n_worm
        self._pool: tuple[int, ThreadPoolExecutor] | None = None
        self._arrange()

    def _group(self, worm: int) -> Features | int:
        """Key that the worms of a pack share: their features; the worm itself where it has an engine of its own."""
        model, (engine, splitting, *checks) = self.models[worm], self._options
        alone = engine != "fused" or any(checks) or model.bolus is not None or model.contact is not None
        # The body axis, which friction by direction turns with, is one a pack.
        alone = alone or (model.ground is not None and not model.ground.isotropic)
        return worm if alone else features(model, splitting)

    def _arrange(self) -> None:
        """Put every worm into a pack, at rest, or into an engine of its own, where it may be already."""
        old = dict(enumerate(self._seat))
        groups: dict[Features | int, list[int]] = defaultdict(list)
        for worm in range(self.n_worm):
            groups[self._group(worm)].append(worm)
        self._parts = []
        for key, worms in groups.items():
            if isinstance(key, int):
                part = old[key][0] if key in old else None
                self._parts.append(part if isinstance(part, _Alone) else _Alone(self, key))
                continue
            for rows in np.array_split(np.array(worms), _pack_count(self.models[worms[0]], len(worms), self._n_thread)):
                models = [self.models[worm] for worm in rows]
                self._parts.append(Pack(models, self.dt, key.splitting, rows, self.position, self.velocity))
        seats = {int(worm): (part, seat) for part in self._parts for seat, worm in enumerate(part.rows)}
        self._seat = [seats[worm] for worm in range(self.n_worm)]

    def advance(self, tension: npt.ArrayLike, n_substeps: int) -> IntArray:
        """Advance every worm by n_substeps * dt; return their status codes (see `engines.Status`), shape (n_worm,).

        A worm that failed goes on from where it is in the next call, unless it is restored or replaced.

        Parameters
        ----------
        tension
            Muscle tensions [N], shape (n_worm, n_muscle) and held, or (2, n_worm, n_muscle): linear in time, as in
            `Engine.advance`.
        n_substeps
            Number of steps, at least 1.

        Raises
        ------
        ValueError
            Wrong shape, a tension that is negative or not finite, or no step.
        """
        start, end = tension_ramp(tension, (self.n_worm, self.models[0].n_muscle))
        count = step_count(n_substeps)
        codes, parts = np.zeros(self.n_worm, np.int64), iter(self._parts)

        def work() -> None:
            for part in parts:
                codes[part.rows] = part.advance(start[part.rows], end[part.rows], count)

        n_thread = min(self._n_thread, len(self._parts)) if self._options[0] == "fused" else 1
        # This thread works as well: to wake another takes as long as some steps.
        others = [self._threads().submit(work) for _ in range(n_thread - 1)]
        try:
            work()
            for other in others:
                other.result()
        except BaseException:  # An interrupt too: begin no further part, and leave no thread at work on what is shown.
            for _ in parts:
                pass
            wait(others)
            raise
        self._health = [Health()] * self.n_worm
        for worm in np.flatnonzero(codes).tolist():
            part, seat = self._seat[worm]
            self._health[worm] = part.health(seat)
        return codes

    def _threads(self) -> ThreadPoolExecutor:
        """Threads of this process: those of a parent do not live on in a fork of it."""
        if self._pool is None or self._pool[0] != os.getpid():
            self._pool = os.getpid(), ThreadPoolExecutor(self._n_thread - 1, "worms")
        return self._pool[1]

    def health(self, worm: int) -> Health:
        """How a worm ended the last call to `advance`, and where it failed."""
        return self._health[worm]

    def state(self, worm: int) -> RodState:
        """Copy the state of a worm, sound or not."""
        part, seat = self._seat[worm]
        return part.state(seat)

    def restore(self, worm: int, state: RodState) -> None:
        """Take over the state of a worm; going on from it gives to the last bit what the engine that gave it would.

        Raises
        ------
        ValueError
            The state does not fit the model, is not finite, or has moved a clamped node.
        """
        state.check(self.models[worm])
        part, seat = self._seat[worm]
        part.restore(seat, state)

    def replace(self, worm: int, model: RodModel) -> None:
        """Let a worm begin again from the rest state of another model of the same shape.

        Cheap where it has the features of the one before; else all worms are packed anew.

        Raises
        ------
        ValueError
            The model is of another shape.
        """
        if (differs := _difference(self.models[worm], model)) is not None:
            raise ValueError(f"model: must have the shape of the one before, but differs in {differs}")
        group, (part, seat) = self._group(worm), self._seat[worm]
        self.models[worm] = model
        if self._group(worm) == group:
            part.fill(seat, model)
        else:
            self._repack(worm)

    def _repack(self, worm: int) -> None:
        """Arrange all worms anew; all but one keep what they have."""
        others = [other for other in range(self.n_worm) if other != worm]
        states = {other: self.state(other) for other in others}
        shown = [array[others] for array in (self.position, self.velocity)]
        self._arrange()
        for other in others:
            part, seat = self._seat[other]
            if isinstance(part, Pack):
                part.restore(seat, states[other])
        self.position[others], self.velocity[others] = shown

    def close(self) -> None:
        """End the threads; a later call to `advance` would begin new ones."""
        if self._pool is not None and self._pool[0] == os.getpid():
            self._pool[1].shutdown()
        self._pool = None


class _Alone:
    """An engine of its own behind the face of a `Pack` of one worm."""

    def __init__(self, batch: BatchEngine, worm: int) -> None:
        self.rows = np.array([worm])
        self._batch = batch
        self.fill(0, batch.models[worm])

    def fill(self, _: int, model: RodModel) -> None:
        """Begin at the rest state of a model."""
        name, splitting, energy_check, step_check = self._batch._options
        self._engine = make_engine(name, model, self._batch.dt, splitting, energy_check, step_check)
        self._health = Health()
        self._show()

    def advance(self, start: FloatArray, end: FloatArray, n_substeps: int) -> IntArray:
        """Advance by n_substeps; return the status code, shape (1,)."""
        self._health = self._engine.advance(np.stack([start[0], end[0]]), n_substeps)
        if self._health.ok:
            self._show()
        return np.array([self._health.status], np.int64)

    def health(self, _: int) -> Health:
        """How the last call ended."""
        return self._health

    def state(self, _: int) -> RodState:
        """Copy the state."""
        return self._engine.state

    def restore(self, _: int, state: RodState) -> None:
        """Take over a state."""
        self._engine.restore(state)
        self._show()

    def _show(self) -> None:
        """Write out where nodes and ball are."""
        state, batch, row = self._engine.state, self._batch, self.rows[0]
        batch.position[row], batch.velocity[row] = state.position, state.velocity
        batch.bolus_position[row], batch.bolus_velocity[row] = state.bolus_position, state.bolus_velocity


def _difference(model: RodModel, other: object) -> str | None:
    """Name what keeps a model from having the shape of another, or None."""
    if not isinstance(other, RodModel):
        return f"being {shown(other)}, no RodModel"
    parts: dict[str, Callable[[RodModel], object]] = {
        "the elements of its rods": lambda x: [rod.n_elem for rod in x.rods],
        "what its joints join": lambda x: [(t.rod_a, t.node_a, t.rod_b, t.node_b) for t in x.joints],
        "what its lines join": lambda x: [(t.rod_a, t.node_a, t.rod_b, t.node_b) for t in x.lines],
        "its muscles": lambda x: x.muscles,
        "having a ball or not": lambda x: x.n_bolus,
    }
    return next((name for name, part in parts.items() if part(model) != part(other)), None)


def _alike(models: Sequence[RodModel]) -> list[RodModel]:
    """Models as a list, or a ValueError if they are none, or not all of one shape."""
    if not isinstance(models, Sequence) or len(models) == 0 or not isinstance(models[0], RodModel):
        raise ValueError(f"models = {shown(models)}: must be a sequence of RodModel, at least one")
    for worm, model in enumerate(models):
        if (differs := _difference(models[0], model)) is not None:
            raise ValueError(f"models[{worm}]: must have the shape of models[0], but differs in {differs}")
    return list(models)


def available_cores() -> int:
    """Count the cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _thread_count(num_threads: int | None) -> int:
    """Threads to use at most, or a ValueError."""
    if num_threads is None:
        return available_cores()
    count = whole_number(num_threads)
    if count is None or count < 1:
        raise ValueError(f"num_threads = {shown(num_threads)}: must be a whole number, at least 1, or None")
    return count


def _pack_count(model: RodModel, n_worm: int, n_thread: int) -> int:
    """Find into how many packs worms go: what the busiest thread has to step through is to be least.

    Few worms leave lanes spare; more than a core's cache holds wait for it.
    """
    best, least = n_worm, math.inf
    for size in range(1, -(-n_worm // n_thread) + 1):
        count = n_record(model, size)
        if size > 1 and count * kernels.CELL.itemsize > _CACHE:
            break
        n_pack = -(-n_worm // size)
        if (cost := -(-n_pack // n_thread) * count) < least:
            best, least = n_pack, cost
    return best
