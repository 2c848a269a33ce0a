"""What an exact case is made of: a scene that an engine can run, and what is read off it beside the exact result."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lattice_gym.checks import FloatArray
from lattice_gym.engines.registry import EngineName
from lattice_gym.engines.simulation import Simulation, simulate
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.rod import straight_frames
from lattice_gym.physics.state import RodState

SETTLING = 1.0
"""Damping rate over the slowest angular frequency where a scene is to come to rest: no mode creeps, each falls as
exp(-rate t / 2)."""


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
    engine = simulate(engine_name, scene.model, scene.dt, splitting)
    engine.restore(scene.start)
    reading = scene.observe(engine)
    return Outcome(case, engine_name, n_elem, scene.dt, reading, engine.state, time.perf_counter() - began)


def difference(first: Outcome, second: Outcome) -> float:
    """Largest difference of two final states: of node positions, over the assembly's extent, and of directors."""
    a, b = first.state, second.state
    apart = np.abs(a.position - b.position).max() / np.ptp(a.position, axis=0).max()
    return float(max(apart, np.abs(a.directors - b.directors).max()))


def pass_time(engine: Simulation, duration: float) -> None:
    """Advance a scene without muscles by the whole steps within `duration` [s].

    Raises
    ------
    RuntimeError
        The state diverged.
    """
    health = engine.advance([], max(1, round(duration / engine.dt)))
    if not health.ok:
        raise RuntimeError(f"exact case diverged: {health}")


def with_velocity(state: RodState, velocity: FloatArray) -> RodState:
    """Return the state with other node velocities [m/s]."""
    return replace(state, velocity=velocity)


def clamp_ends(rod: int, n_elem: int) -> tuple[Clamp, Clamp]:
    """Hold the first and the last node of a rod and its first and last element."""
    return Clamp(rod, node=0, element=0), Clamp(rod, node=n_elem, element=n_elem - 1)


def twisted_frames(position: FloatArray, normal: FloatArray, twist: FloatArray) -> FloatArray:
    """Directors along a rod: d1 towards `normal` (one, or one an element), then turned by `twist` [rad] about d3."""
    frames = straight_frames(position, normal)
    cosine, sine = np.cos(twist)[:, None], np.sin(twist)[:, None]
    d1 = cosine * frames[:, 0] + sine * frames[:, 1]
    return np.stack([d1, np.cross(frames[:, 2], d1), frames[:, 2]], axis=1)
