"""Cost as work grows: of one worm, of batches, of features, of finer bodies; and how near the machine's peak it is.

Every limit below is a target of the design; the report says of each whether it is reached.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lattice_gym.benchmarks.cold_start import ENV_ID as START_ID
from lattice_gym.benchmarks.cold_start import cold_starts
from lattice_gym.benchmarks.engines import BENCHMARK_DT, CONTROL_DT, STEP_LIMIT
from lattice_gym.benchmarks.machine import multiply_add_rate, second_level_cache
from lattice_gym.benchmarks.operations import Work, count_operations
from lattice_gym.benchmarks.precision_study import Progress
from lattice_gym.benchmarks.results_files import table, write
from lattice_gym.benchmarks.scaling import Growth, Line, scaling
from lattice_gym.benchmarks.scene_costs import SCENES, scene_costs
from lattice_gym.benchmarks.throughput_study import (
    COURSE_STEPS,
    ENV_ID,
    ENV_WORMS,
    EPISODE_STEPS,
    FULL,
    N_SUBSTEPS,
    QUICK,
    TENSION,
    Batches,
    Plan,
    Single,
    batches,
    single,
    thread_counts,
    time_engine,
)
from lattice_gym.benchmarks.timing import digits, interleaved, median, spread
from lattice_gym.body.design import LatticeDesign
from lattice_gym.engines.fused import kernels
from lattice_gym.recording.provenance import provenance

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
US, NS = 1e6, 1e9


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


def over_bare(scenes: dict[str, list[float]], name: str) -> list[float]:
    """Share by which a scene costs more than the bare one, round by round."""
    return [own / bare - 1.0 for own, bare in zip(scenes[name], scenes["bare"], strict=True)]


def targets(
    alone: Single,
    worms: Batches,
    scenes: dict[str, list[float]],
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
        Target("cost of a ground over the bare scene", median(over_bare(scenes, "ground")), GROUND, unit="%"),
        Target(
            "departure of the cost from a line in the elements",
            None if line is None else line.departure,
            STRAIGHT,
            unit="%",
        ),
        Target("first step, compiled before", median(starts["cached"]), CACHED_START, unit="s"),
        Target("first step from nothing", median(starts["from nothing"]), FIRST_START, unit="s"),
    ]


def _single_table(alone: Single) -> str:
    names = {
        "fused": "fused engine",
        "pyelastica": "reference engine (PyElastica behind our interface)",
        "plain": "plain PyElastica, as its user would write it",
    }
    fused = median(alone.times["fused"])
    rows = [
        [
            label,
            spread(alone.times[name], US),
            digits(median(alone.times[name]) / fused),
            "" if name == "fused" else spread(alone.ratios(name)),
        ]
        for name, label in names.items()
    ]
    return table(["one worm, one core", "us per step", "over fused (medians)", "over fused (round by round)"], rows)


def _batch_table(worms: Batches) -> str:
    plain = median(worms.plain)
    rows = [
        [
            str(n_worm),
            str(threads),
            spread(times, US),
            f"{1.0 / median(times):.3g}",
            f"{plain / median(times):.0f}",
            f"{1.0 / median(worms.control[n_worm, threads]):.3g}",
        ]
        for (n_worm, threads), times in worms.physics.items()
    ]
    return table(
        ["worms", "threads", "us per worm and step", "worm-steps / s", "times PyElastica", "control steps / s"], rows
    )


def _scene_table(costs: dict[str, list[float]]) -> str:
    differences = {scene.name: scene.difference for scene in SCENES}
    rows = [
        [
            name,
            spread(times, US),
            "" if name == "bare" else f"{spread(over_bare(costs, name), 100.0)} %",
            differences[name],
        ]
        for name, times in costs.items()
    ]
    return table(["scene", "us per step", "over bare", "how it differs"], rows)


def _growth_table(name: str, growth: Growth) -> str:
    slopes = ["", *(digits(NS * slope) for slope in growth.slopes)]
    rows = [
        [str(count), spread(times, US), slope, f"{size / 1024:.0f}"]
        for count, times, slope, size in zip(growth.count, growth.times, slopes, growth.memory, strict=True)
    ]
    return table([name, "us per step", "ns for each further one", "records [KiB]"], rows)


def _line_row(name: str, line: Line | None) -> list[str]:
    if line is None:
        return [name, "too few points", "", ""]
    return [name, f"{US * line.start:.3g}", f"{NS * line.slope:.3g}", f"{100.0 * line.departure:.2g} %"]


def _growth_parts(grown: dict[str, Growth], plan: Plan, cache: int | None) -> list[str]:
    elements = grown["elements"]
    held = elements.within(cache)
    size = "of unknown size" if cache is None else f"of {cache // 1024} KiB"
    rows = [_line_row("elements, as far as the second-level cache holds them", held.line())]
    if len(held.count) < len(elements.count):
        rows.append(_line_row("all elements", elements.line()))
    rows += [_line_row(name, grown[name].line()) for name in ("muscles", "rods")]
    segments = LatticeDesign().n_segment
    return [
        f"Growth: elements in all, of the 12 rods with {segments * plan.meshes[0]} to {segments * plan.meshes[-1]} "
        "each and of the benchmark's muscles; muscles on the default lattice; rods of its length without muscles.",
        *(_growth_table(name, growth) for name, growth in grown.items()),
        "Straight lines through the medians, each by its relative distance:",
        table(["cost against", "start [us]", "for each [ns]", "largest departure"], rows),
        f"The second-level cache of a core is {size}; every step goes through all records, and what goes beyond it is "
        f"fetched from further away. Rods of one length stand {kernels.LANES} to a block, and a block costs the same "
        "however many of its lanes are taken, so that cost grows by blocks.",
    ]


def _machine_text(work: Work, fused: list[float], peaks: list[float]) -> str:
    rate = work.total / median(fused)
    lanes = work.elements / work.lane_elements
    kinds = ", ".join(f"{count / work.elements:.1f} {kind}" for kind, count in work.operations.items())
    return (
        f"A step of the benchmark scene takes {work.total} floating-point operations, {work.total / work.elements:.0f} "
        f"for each of its {work.elements} elements with its share of nodes and joints ({kinds}), counted by running "
        "the kernels' source on numbers that count (`reports/operations.py`); signs, comparisons and spare lanes are "
        f"not in it. That is {rate / 1e9:.3g} GFLOP/s, {100.0 * rate / median(peaks):.0f} % of the "
        f"{spread(peaks, 1e-9)} GFLOP/s of independent multiply-adds on one core, measured in the same rounds (two "
        f"operations each, `reports/machine.py`). {100.0 * lanes:.0f} % of the lanes hold a rod. A record takes "
        f"{work.bytes_per_element:.0f} bytes for each element."
    )


def _json(alone: Single, worms: Batches) -> dict[str, Any]:
    return {
        "single": asdict(alone),
        "batches": [
            {
                "worms": n_worm,
                "threads": threads,
                "seconds_per_worm_step": times,
                "seconds_per_control_step": worms.control[n_worm, threads],
            }
            for (n_worm, threads), times in worms.physics.items()
        ],
        "pyelastica_beside_batches": worms.plain,
        "overhead": {str(threads): shares for threads, shares in worms.overhead.items()},
        "seconds_per_reset": worms.reset,
        "bytes_per_worm": worms.bytes_per_worm,
    }


def report(folder: Path, *, quick: bool, command: str) -> bool:
    """Write throughput.md, .json and .png; returns whether every target is reached."""
    from lattice_gym.benchmarks.throughput_figure import draw

    plan, progress = QUICK if quick else FULL, Progress("throughput")
    progress("one worm")
    alone = single(plan)
    progress("scenes")
    scenes = scene_costs(plan.repeats, 1 if quick else 4)
    progress("scaling")
    grown = scaling(plan)
    progress("the machine")
    work = count_operations()
    machine = interleaved({"fused": lambda: time_engine(plan.steps["fused"]), "peak": multiply_add_rate}, plan.repeats)
    worms = batches(plan, progress)
    progress("cold starts")
    starts = cold_starts(plan.starts)
    cache = second_level_cache()
    reached = targets(alone, worms, scenes, grown["elements"].within(cache), starts)
    parts = [
        "Every time is the median of "
        f"{plan.repeats} rounds (least to greatest), in which all that is compared takes its turn; one worm by the "
        "processor time of its thread, batches and starts by the wall's clock. Benchmark scene: default design, "
        f"`extension` muscles, {TENSION:g} N, a step of {1e3 * BENCHMARK_DT:g} ms, PyElastica's damping.",
        table(["target", "limit", "measured", "verdict"], [target.row() for target in reached]),
        _single_table(alone),
        "After one step positions of the fused engine differ from PyElastica's by "
        f"{alone.step_difference['position']:.1e} and velocities by {alone.step_difference['velocity']:.1e} of their "
        f"largest; after {COURSE_STEPS} the reference engine's positions do by {alone.course_difference:.1e}.",
        f'Batches, {N_SUBSTEPS} steps a call; control steps are those of `gymnasium.make_vec("{ENV_ID}")`, of as many '
        f"physics steps each; plain PyElastica, in the same rounds, takes {spread(worms.plain, US)} us per step:",
        _batch_table(worms),
        "Few worms on several threads cost more each: what a thread has of them leaves lanes spare (4 worms of 12 rods "
        "fill all lanes, 2 do not), and it waits for the others, or to be woken, for more of a short call. "
        f"A further worm in a batch takes {worms.bytes_per_worm / 1024:.0f} KiB. Of the {EPISODE_STEPS} control steps "
        f"of an episode of {ENV_WORMS} environments, all but `BatchEngine.advance` takes "
        + ", ".join(
            f"{spread(share, 100.0)} % on {threads} thread{'s' if threads > 1 else ''}"
            for threads, share in worms.overhead.items()
        )
        + f"; their reset takes {spread(worms.reset, 1e3)} ms.",
        f"Scenes, one worm in control steps of {CONTROL_DT:g} s:",
        _scene_table(scenes),
        *_growth_parts(grown, plan, cache),
        _machine_text(work, machine["fused"], machine["peak"]),
        f'First step of `gymnasium.make("{START_ID}")` from the start of Python, {plan.starts} times: '
        f"{spread(starts['cached'])} s with compiled code kept, {spread(starts['from nothing'])} s without.",
    ]
    result = {
        "quick": quick,
        "targets": [asdict(target) | {"reached": target.reached} for target in reached],
        **_json(alone, worms),
        "scenes": scenes,
        "scaling": {name: asdict(growth) for name, growth in grown.items()},
        "second_level_cache": cache,
        "work": asdict(work),
        "seconds_per_step_beside_peak": machine["fused"],
        "multiply_add_rate": machine["peak"],
        "cold_starts": starts,
        "made": provenance(command),
    }
    write(folder, "throughput", result, parts)
    draw(worms, scenes, grown, cache, folder / "throughput.png")
    return all(target.reached for target in reached)
