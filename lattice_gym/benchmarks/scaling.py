"""How the cost of a step of the fused engine grows with elements, muscles and rods."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from lattice_gym.benchmarks.throughput_study import TENSION, Plan
from lattice_gym.benchmarks.timing import interleaved, median, seconds
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import MuscleLayout, named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.fused import kernels
from lattice_gym.engines.fused.pack import n_record
from lattice_gym.engines.registry import make_engine
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.worm import build_model

SCALING_DT = 1e-5
"""Stable on every mesh [s]; the cost of a step does not depend on it."""
N_STEPS = 300
LEVELS_PER_PAIR = 4
"""Pairs of rods for a period of the default height: then every lattice has the segments of the default one."""

CACHE_SHARE = 0.9
"""Of a cache, for records: it holds joints and code as well."""


@dataclass(frozen=True)
class Line:
    """Cost = start + slope * count, fitted to medians."""

    start: float
    """[s]"""
    slope: float
    """[s] for each further one."""
    departure: float
    """Largest distance of a point from the line, over the point."""


@dataclass(frozen=True)
class Growth:
    """Cost of a step against what grows."""

    count: list[int]
    """Elements, muscles or rods in all."""
    times: list[list[float]]
    """Seconds per step."""
    memory: list[int]
    """Bytes of the records that a step goes through."""

    @property
    def medians(self) -> list[float]:
        """Median seconds per step."""
        return [median(times) for times in self.times]

    @property
    def slopes(self) -> list[float]:
        """Seconds for each further one, from every point to the next."""
        points = list(zip(self.count, self.medians, strict=True))
        return [(later - cost) / (more - count) for (count, cost), (more, later) in pairwise(points)]

    def within(self, cache: int | None) -> Growth:
        """Those points whose records a cache of that size holds; all where it is not known."""
        kept = [k for k, size in enumerate(self.memory) if cache is None or size <= CACHE_SHARE * cache]
        return Growth(*([column[k] for k in kept] for column in (self.count, self.times, self.memory)))  # type: ignore[arg-type]

    def line(self) -> Line | None:
        """Straight line through the medians; None through fewer than three."""
        return fit(self.count, self.medians) if len(self.count) >= 3 else None


def fit(count: Sequence[float], cost: Sequence[float]) -> Line:
    """Line of least squares, every point weighted by its inverse: relative errors count."""
    weights = 1.0 / np.asarray(cost)
    slope, start = np.polyfit(count, cost, 1, w=weights)
    fitted: FloatArray = start + slope * np.asarray(count)
    return Line(float(start), float(slope), float(np.abs(fitted * weights - 1.0).max()))


def record_bytes(model: RodModel) -> int:
    """Size of the records of a model [bytes]: rods of one length share blocks of lanes, muscles apart from others."""
    return int(kernels.CELL.itemsize) * n_record(model, 1)


def _worm(design: LatticeDesign, n_muscle: int | None = None) -> RodModel:
    """Benchmark worm of another design, or with the first few of all muscles."""
    lattice = build_lattice(design)
    if n_muscle is None:
        return build_model(lattice, named_layout("extension", lattice))
    return build_model(lattice, MuscleLayout(named_layout("all", lattice).active[:n_muscle]))


def scaling(plan: Plan) -> dict[str, Growth]:
    """Cost against elements (in all), muscles and rods, each with the others held."""
    default = LatticeDesign()
    ratio = {pairs: pairs / LEVELS_PER_PAIR for pairs in plan.pairs}
    models = {
        "elements": [_worm(replace(default, elements_per_segment=mesh)) for mesh in plan.meshes],
        "muscles": [_worm(default, n_muscle) for n_muscle in plan.muscles],
        "rods": [_worm(replace(default, n_pairs=pairs, period_ratio=ratio[pairs]), 0) for pairs in plan.pairs],
    }
    counts = {
        "elements": [model.n_elem for model in models["elements"]],
        "muscles": [model.n_muscle for model in models["muscles"]],
        "rods": [model.n_rod for model in models["rods"]],
    }
    tasks: dict[tuple[str, int], Callable[[], float]] = {}
    for name, grown in models.items():
        for k, model in enumerate(grown):
            tasks[name, k] = _timer(model)
    times = interleaved(tasks, plan.repeats)
    return {
        name: Growth(counts[name], [times[name, k] for k in range(len(grown))], [record_bytes(one) for one in grown])
        for name, grown in models.items()
    }


def _timer(model: RodModel) -> Callable[[], float]:
    """Find the seconds per step of an engine made anew: how well a cache holds it depends on where it lies."""
    pull = np.full(model.n_muscle, TENSION)

    def timed() -> float:
        engine = make_engine("fused", model, SCALING_DT)
        engine.advance(pull, N_STEPS // 10)
        return seconds(lambda: engine.advance(pull, N_STEPS)) / N_STEPS

    return timed
