"""What the throughput report is to show: every limit is a target of the design."""

from __future__ import annotations

from dataclasses import dataclass

from lattice_gym.benchmarks.engine_comparison import STEP_LIMIT
from lattice_gym.benchmarks.throughput.growth import Growth
from lattice_gym.benchmarks.throughput.study import COURSE_STEPS, ENV_WORMS, Batches, Single, thread_counts
from lattice_gym.benchmarks.timing import median

SINGLE_RATIO, BATCH_RATIO = 200.0, 400.0
"""Times faster than PyElastica: one worm on one core, and `ENV_WORMS` worms on two threads."""
CONSTANT, FEWEST = 0.15, 4
"""Largest share by which the cost per worm may vary over batches of at least so many worms."""
OVERHEAD = 0.05
"""Share of the time of `ENV_WORMS` environments that observation, reward and Python may take."""
GROUND = 0.15
"""Share by which a ground may raise the cost of the bare scene."""
STRAIGHT = 0.05
"""Largest departure of the cost from a line in the number of elements, where the second-level cache holds them."""
CACHED_START, FIRST_START = 2.0, 30.0
"""Seconds to the first step, with compiled code kept and without."""


@dataclass(frozen=True)
class Target:
    """What was to be reached."""

    name: str
    measured: float | None
    """None where it could not be measured."""
    limit: float
    at_least: bool = False
    """The limit is the least value, not the greatest."""
    unit: str = ""

    @property
    def reached(self) -> bool:
        """False where nothing was measured, and for a NaN."""
        if self.measured is None:
            return False
        return self.measured >= self.limit if self.at_least else self.measured <= self.limit

    def row(self) -> list[str]:
        """Cells of the table."""
        bound = f"{'at least' if self.at_least else 'at most'} {_number(self.limit, self.unit)}"
        measured = "not measured" if self.measured is None else _number(self.measured, self.unit)
        return [self.name, bound, measured, "reached" if self.reached else "NOT REACHED"]


def _number(value: float, unit: str) -> str:
    return f"{100.0 * value:.3g} %" if unit == "%" else f"{value:.3g}{unit and ' '}{unit}"


def variation(costs: list[float]) -> float:
    """Greatest over least, less one."""
    return max(costs) / min(costs) - 1.0


def over_bare(features: dict[str, list[float]], name: str) -> list[float]:
    """Share by which a worm with a feature costs more than the bare one, round by round."""
    return [own / bare - 1.0 for own, bare in zip(features[name], features["bare"], strict=True)]


def targets(
    alone: Single,
    worms: Batches,
    features: dict[str, list[float]],
    growth: Growth,
    starts: dict[str, list[float]],
) -> list[Target]:
    """Every target beside what was measured."""
    plain = median(worms.plain)
    pair = worms.physics.get((ENV_WORMS, 2))
    # With more threads than worms there is nothing to hold constant.
    rows = {
        threads: [median(times) for (n, own), times in worms.physics.items() if own == threads and n >= FEWEST]
        for threads in thread_counts()
        if threads <= FEWEST
    }
    shares = [median(share) for threads, share in worms.overhead.items() if threads <= 2]
    line = growth.line()
    return [
        Target(
            "one worm on one core, times faster than PyElastica",
            median(alone.times["plain"]) / median(alone.times["fused"]),
            SINGLE_RATIO,
            at_least=True,
        ),
        Target("after one step, relative difference from PyElastica", max(alone.step_difference.values()), STEP_LIMIT),
        Target(
            f"after {COURSE_STEPS} steps, that of the reference engine from PyElastica",
            alone.course_difference,
            STEP_LIMIT,
        ),
        Target(
            f"{ENV_WORMS} worms on two threads, times faster than PyElastica",
            None if pair is None else plain / median(pair),
            BATCH_RATIO,
            at_least=True,
        ),
        *(
            Target(
                f"variation of the cost per worm from {FEWEST} worms up, threads: {threads}",
                variation(costs),
                CONSTANT,
                unit="%",
            )
            for threads, costs in rows.items()
        ),
        Target(f"{ENV_WORMS} environments, share that is not physics", max(shares), OVERHEAD, unit="%"),
        Target("cost of a ground over the bare scene", median(over_bare(features, "ground")), GROUND, unit="%"),
        Target(
            "departure of the cost from a line in the elements",
            None if line is None else line.departure,
            STRAIGHT,
            unit="%",
        ),
        Target("first step, compiled before", median(starts["cached"]), CACHED_START, unit="s"),
        Target("first step from nothing", median(starts["from nothing"]), FIRST_START, unit="s"),
    ]
