"""The stability report: predicted over measured critical step."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from lattice_gym.benchmarks.results_files import table, write
from lattice_gym.benchmarks.stability.cases import BOUNDS, Case, grid_cases, random_cases
from lattice_gym.benchmarks.stability.figure import draw
from lattice_gym.benchmarks.stability.limits import (
    FINEST,
    FORK_TENSION,
    MIN_RATIO,
    REFINEMENT,
    TOLERANCE,
    Limit,
    measure_all,
)
from lattice_gym.body.design import LatticeDesign

MEDIAN_RATIO = 0.7
"""What predicted over measured should be at least in the median; nowhere above 1."""


def report(folder: Path, *, command: str, quick: bool, jobs: int, seed: int, n_random: int | None = None) -> bool:
    """Write stability.json, .md and .png; True if no prediction is above a limit, and all aims are met within 1 %."""
    number = (20 if quick else 120) if n_random is None else n_random
    cases = [*grid_cases(quick), *random_cases(number, seed)]
    limits = measure_all(cases, jobs)
    summary = summarise(limits)
    result = {
        "summary": summary,
        "cases": [asdict(limit) | {"ratio": limit.ratio} for limit in limits],
    }
    write(folder, "stability", result, _tables(limits, summary), command)
    draw(limits, folder / "stability.png")
    return bool(summary["stable"]["n_above_1"] == 0 and summary["within_1_percent"]["holds"])


def summarise(limits: list[Limit]) -> dict[str, Any]:
    """Figures of the whole under either criterion, each with its own cases apart."""
    return {
        "n_case": len(limits),
        "n_no_limit": sum(limit.beyond == "no limit" for limit in limits),
        "stable": _judge(limits, "stable"),
        "within_1_percent": _judge(limits, "accurate"),
        "seconds": sum(limit.seconds for limit in limits),
    }


def _judge(limits: list[Limit], criterion: str) -> dict[str, Any]:
    """Predicted over measured limit of one criterion; apart are the cases in which no step meets it, or none can."""
    whole = [limit for limit in limits if not limit.beyond]
    decided = [limit for limit in whole if criterion == "stable" or not limit.forks]
    counted = [limit for limit in decided if getattr(limit, criterion)]
    ratios = np.array([limit.usable / getattr(limit, criterion) for limit in counted])
    near = ratios[[limit.case.group not in BOUNDS for limit in counted]]
    designs = {LatticeDesign(**limit.case.design): limit.case.group for limit in counted}
    low, median, high = float(near.min()), float(np.median(near)), float(ratios.max())
    return {
        "n_counted": len(counted),
        "n_design": len(designs),
        "n_random": sum(group == "random" for group in designs.values()),
        "n_collapse": sum(limit.beyond == "collapse" for limit in limits) + len(decided) - len(counted),
        "n_forked": len(whole) - len(decided),
        "min": low,
        "median": median,
        "max": high,
        "n_above_1": int(np.sum(ratios > 1.0)),
        "n_below_0.4": int(np.sum(near < MIN_RATIO)),
        "holds": high <= 1.0 and low >= MIN_RATIO and median >= MEDIAN_RATIO,
    }


def _tables(limits: list[Limit], summary: dict[str, Any]) -> list[str]:
    text = (
        "Distinct designs: the grids share some. The groups "
        f"{' and '.join(BOUNDS)} count for what is above 1 only: their prediction is for all that may touch. "
        f"Apart under both: {summary['n_no_limit']} cases that hold at one step a command, the longest there is. No "
        f"step holds: none down to 1/{FINEST} of the prediction over the same time. Forks: a change of "
        f"{FORK_TENSION:.1%} in the tensions moves the run at dt/{REFINEMENT} by more than {TOLERANCE:.0%}, or decides "
        "whether and how it fails, so that no run could be compared with it."
    )
    first = Counter(limit.reason.removesuffix(f" at dt/{REFINEMENT}") for limit in limits if not limit.beyond)
    over = [f"{_name(limit.case)} ({limit.ratio:.2f})" for limit in limits if limit.ratio > 1.0]
    inaccurate = [limit for limit in limits if not limit.beyond and limit.usable > (limit.accurate or 0.0)]
    parts = [
        "Predicted over measured largest step:",
        _criteria_table(summary),
        text,
        "By group, first criterion:",
        _group_table(limits),
        "Predicted above the limit of stability: " + ("; ".join(over) or "none") + ".",
        "First fault above the limit: " + ", ".join(f"{name} {n}" for name, n in first.most_common()) + ".",
    ]
    if inaccurate:
        parts += ["Cases whose predicted step is too long for the 1 %:", _inaccurate_table(inaccurate)]
    return parts


def _criteria_table(summary: dict[str, Any]) -> str:
    header = ["a step holds if", "counted", "distinct designs", "of them random", "no step holds", "forks"]
    header += ["min", "median", "max", "above 1", "below 0.4"]
    counts = ("n_counted", "n_design", "n_random", "n_collapse", "n_forked")
    rows = [
        [label, *(str(found[key]) for key in counts)]
        + [f"{found[key]:.2f}" for key in ("min", "median", "max")]
        + [str(found[key]) for key in ("n_above_1", "n_below_0.4")]
        for label, found in (
            ("finite, not inverted, motion no stronger than at dt/8", summary["stable"]),
            ("and within 1 % of the height of the run at dt/8", summary["within_1_percent"]),
        )
    ]
    return table(header, rows)


def _group_table(limits: list[Limit]) -> str:
    rows = []
    for group in dict.fromkeys(limit.case.group for limit in limits):
        members = [limit for limit in limits if limit.case.group == group]
        ratios = [limit.ratio for limit in members if not math.isnan(limit.ratio)]
        steps = [limit.stable for limit in members if limit.stable and not limit.beyond]
        apart = [sum(limit.beyond == kind for limit in members) for kind in ("collapse", "no limit")]
        rows.append(
            [group, str(len(members)), *map(str, apart)]
            + [f"{value:.2f}" for value in (min(ratios), float(np.median(ratios)), max(ratios))]
            + [f"{1e6 * min(steps):.3g} to {1e6 * max(steps):.3g}"]
        )
    return table(["cases", "number", "no step holds", "no step fails", "min", "median", "max", "limit [us]"], rows)


def _inaccurate_table(limits: list[Limit]) -> str:
    default = LatticeDesign().damping
    rows = [
        [
            _name(limit.case),
            *(f"{1e6 * (dt or 0.0):.3g}" for dt in (limit.usable, limit.stable, limit.accurate)),
            f"{limit.case.design.get('damping', default) / default:.3g}",
            "yes" if limit.forks else "no",
        ]
        for limit in limits
    ]
    return table(["case", "predicted [us]", "stable [us]", "within 1 % [us]", "damping / default", "forks"], rows)


def _name(case: Case) -> str:
    """Group and factors of a case of the grid; what tells a random one."""
    if case.factors:
        return f"{case.group}: " + ", ".join(f"{name} {value:g}" for name, value in case.factors.items())
    kind = f"{case.design['n_pairs']} pairs, {case.design['elements_per_segment']} elements"
    return f"{case.group}: {kind}, {case.design['base']}, {case.design['muscle_model']}s"
