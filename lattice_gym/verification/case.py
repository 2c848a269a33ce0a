"""What an exact case is made of: a scene that an engine can run, and what is read off it beside the exact result."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lattice_gym.checks import FloatArray
from lattice_gym.engines.registry import EngineName
from lattice_gym.engines.simulation import Simulation, simulate
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.state import RodState

SETTLING = 1.0
"""Damping rate over the slowest angular frequency where a scene is to come to rest: no mode creeps, each falls as
exp(-rate t / 2)."""
CRITICAL_SHARE = 0.5
"""Time step of a scene over its predicted critical one, where nothing else sets it."""


@dataclass(frozen=True, eq=False)
class Reading:
    """What was measured, and what theory says, at the same places or times."""

    x: FloatArray
    measured: FloatArray
    exact: FloatArray
    scale: float | None = None
    """What errors are relative to; None: the largest exact value."""

    @cached_property
    def error(self) -> float:
        """Largest deviation over the scale."""
        scale = np.abs(self.exact).max() if self.scale is None else self.scale
        return float(np.abs(self.measured - self.exact).max() / scale)


@dataclass(frozen=True, eq=False)
class Scene:
    """A model, its start and its time step; `observe` takes an engine that stands there, runs it and reads it."""

    model: RodModel
    start: RodState
    dt: float
    observe: Callable[[Simulation], Reading]

    def run(self, engine_name: EngineName, splitting: Splitting = "pyelastica") -> tuple[Reading, RodState]:
        """Measure on an engine; returns its last state, too."""
        engine = simulate(engine_name, self.model, self.dt, splitting)
        engine.restore(self.start)
        return self.observe(engine), engine.state


@dataclass(frozen=True, kw_only=True)
class Case:
    """One exact case of the literature."""

    name: str
    title: str
    quantity: str
    """What is measured, with its unit."""
    abscissa: str
    """Over what it is plotted, with its unit."""
    exact: str
    """The exact result as a formula."""
    source: str
    build: Callable[[int], Scene]
    """Scene of a number of elements."""
    n_elem: int
    coarse: int
    """Elements for a quick check."""
    meshes: tuple[int, ...] = ()
    """Element counts over which the order of convergence is fitted; none where the mesh makes no error."""
    tolerance: Callable[[int], float]
    """Largest relative error that passes, of the number of elements."""
    reason: str
    """Where the tolerance comes from."""


def exact_case(
    title: str,
    *,
    quantity: str,
    abscissa: str,
    exact: str,
    source: str,
    tolerance: float | Callable[[int], float],
    reason: str,
    n_elem: int,
    coarse: int | None = None,
    meshes: tuple[int, ...] = (),
) -> Callable[[Callable[[int], Scene]], Case]:
    """Make a `Case` of the function that builds its scene; the case has the function's name.

    `coarse` is `n_elem` unless given, and a tolerance that is a number holds on every mesh.
    """

    def decorate(build: Callable[[int], Scene]) -> Case:
        return Case(
            name=build.__name__,
            title=title,
            quantity=quantity,
            abscissa=abscissa,
            exact=exact,
            source=source,
            build=build,
            n_elem=n_elem,
            coarse=n_elem if coarse is None else coarse,
            meshes=meshes,
            tolerance=tolerance if callable(tolerance) else lambda _: tolerance,
            reason=reason,
        )

    return decorate


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one case came to on one engine."""

    case: Case
    engine: EngineName
    n_elem: int
    dt: float
    reading: Reading
    state: RodState
    seconds: float

    @property
    def tolerance(self) -> float:
        """Largest error that passes on this mesh."""
        return self.case.tolerance(self.n_elem)

    @property
    def passed(self) -> bool:
        """True if the error is within the tolerance; a NaN is not."""
        return self.reading.error <= self.tolerance


def run(case: Case, engine_name: EngineName, n_elem: int | None = None, splitting: Splitting = "pyelastica") -> Outcome:
    """Build the case with `n_elem` elements (default: the case's own) and measure it on one engine."""
    n_elem = case.n_elem if n_elem is None else n_elem
    began = time.perf_counter()
    scene = case.build(n_elem)
    reading, state = scene.run(engine_name, splitting)
    return Outcome(case, engine_name, n_elem, scene.dt, reading, state, time.perf_counter() - began)


def difference(first: Outcome, second: Outcome) -> float:
    """Largest difference of two final states: of node positions, over the assembly's extent, and of directors."""
    a, b = first.state, second.state
    apart = np.abs(a.position - b.position).max() / np.ptp(a.position, axis=0).max()
    return float(max(apart, np.abs(a.directors - b.directors).max()))


def advance_by(engine: Simulation, duration: float, tension: FloatArray | None = None) -> RodState:
    """Advance by the whole steps next to `duration` [s], at least one; returns the state.

    Muscles hold a constant `tension` [N], shape (n_muscle,); a scene without muscles needs none.

    Raises
    ------
    RuntimeError
        The state diverged.
    """
    health = engine.advance([] if tension is None else tension, max(1, round(duration / engine.dt)))
    if not health.ok:
        raise RuntimeError(f"exact case diverged: {health}")
    return engine.state


def sample(
    engine: Simulation,
    times: Iterable[float],
    measure: Callable[[RodState], FloatArray | float],
    tension: FloatArray | None = None,
) -> FloatArray:
    """Advance from one time [s] to the next, evenly spaced and the first of them one interval away; measure at each.

    Returns what `measure` gave, shape (n_time, ...).
    """
    times = list(times)
    return np.array([measure(advance_by(engine, times[0], tension)) for _ in times])
