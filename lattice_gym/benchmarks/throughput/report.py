"""The throughput report: cost of a step as worms, features, elements, muscles and rods grow."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from lattice_gym.benchmarks.benchmark_scene import BENCHMARK_DT, CONTROL_DT, TENSION
from lattice_gym.benchmarks.results_files import table, write
from lattice_gym.benchmarks.throughput.cold_start import ENV_ID as START_ID
from lattice_gym.benchmarks.throughput.cold_start import cold_starts
from lattice_gym.benchmarks.throughput.features import FEATURES, feature_costs
from lattice_gym.benchmarks.throughput.figure import draw
from lattice_gym.benchmarks.throughput.growth import Growth, Line, measure_growth, second_level_cache
from lattice_gym.benchmarks.throughput.study import (
    COURSE_STEPS,
    ENV_ID,
    ENV_WORMS,
    EPISODE_STEPS,
    FULL,
    N_SUBSTEPS,
    QUICK,
    Batches,
    Plan,
    Single,
    batches,
    single,
)
from lattice_gym.benchmarks.throughput.targets import over_bare, targets
from lattice_gym.benchmarks.timing import digits, median, spread
from lattice_gym.body.design import LatticeDesign
from lattice_gym.engines.fused.kernels.layout import LANES

US, NS = 1e6, 1e9


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


def _feature_table(costs: dict[str, list[float]]) -> str:
    differences = {feature.name: feature.difference for feature in FEATURES}
    rows = [
        [
            name,
            spread(times, US),
            "" if name == "bare" else f"{spread(over_bare(costs, name), 100.0)} %",
            differences[name],
        ]
        for name, times in costs.items()
    ]
    return table(["feature", "us per step", "over bare", "how it differs"], rows)


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
        f"fetched from further away. Rods of one length stand {LANES} to a block, and a block costs the same "
        "however many of its lanes are taken, so that cost grows by blocks.",
    ]


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


def report(folder: Path, *, command: str, quick: bool) -> bool:
    """Write throughput.md, .json and .png; returns whether every target is reached."""
    plan = QUICK if quick else FULL
    alone = single(plan)
    costs = feature_costs(plan.features, plan.repeats, plan.n_control)
    grown = measure_growth(plan)
    worms = batches(plan)
    starts = cold_starts(plan.starts)
    cache = second_level_cache()
    reached = targets(alone, worms, costs, grown["elements"].within(cache), starts)
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
        f"of an episode of {ENV_WORMS} environments, all but `Engine.advance` takes "
        + ", ".join(
            f"{spread(share, 100.0)} % on {threads} thread{'s' if threads > 1 else ''}"
            for threads, share in worms.overhead.items()
        )
        + f"; their reset takes {spread(worms.reset, 1e3)} ms.",
        f"Features, one worm in control steps of {CONTROL_DT:g} s:",
        _feature_table(costs),
        *_growth_parts(grown, plan, cache),
        f'First step of `gymnasium.make("{START_ID}")` from the start of Python, {plan.starts} times: '
        f"{spread(starts['cached'])} s with compiled code kept, {spread(starts['from nothing'])} s without.",
    ]
    result = {
        "quick": quick,
        "targets": [asdict(target) | {"reached": target.reached} for target in reached],
        **_json(alone, worms),
        "features": costs,
        "growth": {name: asdict(growth) for name, growth in grown.items()},
        "second_level_cache": cache,
        "cold_starts": starts,
    }
    write(folder, "throughput", result, parts, command)
    draw(worms, costs, grown, cache, folder / "throughput.png")
    return all(target.reached for target in reached)
