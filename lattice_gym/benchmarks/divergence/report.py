"""The divergence report: how many runs go wrong, and which of them are caught."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, get_args

import numpy as np
from tqdm import tqdm

from lattice_gym.benchmarks.divergence.figure import draw
from lattice_gym.benchmarks.divergence.judge import (
    FORK_TENSION,
    OK,
    REFINEMENT,
    RIGHT,
    WRONG,
    Run,
    compare,
    find_truth,
)
from lattice_gym.benchmarks.divergence.runs import FIRST_SEED, N_CONTROL, plan
from lattice_gym.benchmarks.results_files import table, write
from lattice_gym.engines.health import Status
from lattice_gym.engines.step_doubling import STEP_TOLERANCE
from lattice_gym.physics.energy import ENERGY_TOLERANCE
from lattice_gym.physics.laws.damping import Splitting

FINER = 4
"""Steps in one of the reference's with which the reference with most spurious energy is run again."""
FULL, QUICK = 400, 40
"""Runs of the report, and of its quick form."""
VERDICTS = {
    "right": f"right: never more than {RIGHT:.0%} of the height from the run at dt/{REFINEMENT}",
    "between": f"between {RIGHT:.0%} and {WRONG:.0%}",
    "wrong": f"wrong: more than {WRONG:.0%}",
    "collapsed": f"collapsed: the run at dt/{REFINEMENT} is flagged, too",
    "undecided": "undecided: forked before anything could be compared",
}
"""In words."""


def count(runs: Sequence[Run]) -> dict[str, dict[str, int]]:
    """Count runs by verdict: flagged in the control step in which they go wrong, in the next, later or never."""
    rows = {}
    for verdict in VERDICTS:
        chosen = [run for run in runs if run.verdict == verdict]
        delays = [0 if verdict in ("right", "between") and run.status != OK else run.delay for run in chosen]
        rows[verdict] = {
            "runs": len(chosen),
            "forked": sum(run.forked for run in chosen),
            "flagged at once": sum(delay is not None and delay <= 0 for delay in delays),
            "one step later": sum(delay == 1 for delay in delays),
            "later": sum(delay is not None and delay > 1 for delay in delays),
            "not flagged": sum(delay is None for delay in delays),
        }
    return rows


def all_caught(rows: dict[str, dict[str, int]]) -> bool:
    """Whether every wrong run and every collapse was flagged within one control step, and no right run ever."""
    caught = all(rows[v]["not flagged"] + rows[v]["later"] == 0 for v in ("wrong", "collapsed"))
    return caught and rows["right"]["not flagged"] == rows["right"]["runs"]


def report(folder: Path, *, command: str, quick: bool = False) -> bool:
    """Write divergence.md, divergence.json and divergence.png; returns whether all was as it should be."""
    total = QUICK if quick else FULL
    runs = [compare(FIRST_SEED + k) for k in tqdm(range(total), desc="divergence", unit="run")]
    rows = count(runs)
    right = [run for run in runs if run.verdict == "right"]
    wrong = [run for run in runs if run.verdict == "wrong"]
    missed = [run for run in runs if run.verdict in ("wrong", "collapsed") and (run.delay is None or run.delay > 1)]
    missed += [run for run in right if run.status != OK]
    complete = [run for run in right if run.n_compared == N_CONTROL]
    strangest = max(runs, key=lambda run: run.reference_residual)
    stays = find_truth(plan(strangest.seed), FINER * REFINEMENT).residual
    split = {name: count([run for run in runs if run.splitting == name]) for name in get_args(Splitting)}
    result: dict[str, Any] = {
        "counts": rows,
        "counts_by_splitting": split,
        "all_caught": all_caught(rows),
        "checks": Counter(run.status for run in wrong),
        "largest_residual_of_right_runs": max((run.residual for run in right), default=0.0),
        "largest_step_error_of_right_runs": max((run.step_error for run in right), default=0.0),
        "right_runs_compared_to_the_end": len(complete),
        "largest_residual_of_references": strangest.reference_residual,
        "seed_of_largest_residual_of_references": strangest.seed,
        "the_same_with_finer_steps": {"refinement": FINER * REFINEMENT, "residual": stays},
        "runs": [asdict(run) for run in runs],
    }
    header = ["damping", "deviation", *next(iter(rows.values()))]
    checks = ", ".join(f"{name} {number}" for name, number in result["checks"].most_common())
    tables = [
        f"{total} random worms with random muscles switched on and off, at 0.3 to 2 of the predicted critical step and "
        f"0.1 to 10 N, beside themselves at dt/{REFINEMENT}:",
        table(
            header,
            [
                [splitting, VERDICTS[verdict], *map(str, row.values())]
                for splitting, of_splitting in split.items()
                for verdict, row in of_splitting.items()
            ],
        ),
        _compared(right, complete),
        f"What stopped the wrong runs: {checks or 'nothing, there were none'}. Forked runs are compared until a change "
        f"of {FORK_TENSION:.1%} in the tensions moves their reference by {RIGHT:.0%} of the height; undecided ones "
        "forked too early for that, and count neither as right nor as wrong.",
        f"Spurious energy in one control step, over the energy at stake: at most "
        f"{result['largest_residual_of_right_runs']:.1%} in right runs, "
        f"{float(np.median([run.residual for run in right] or [0.0])):.2%} in their median; flagged above "
        f"{ENERGY_TOLERANCE:.0%}. Distance from the run at dt/2: at most "
        f"{result['largest_step_error_of_right_runs']:.2%} in right runs, {_least_step_error(wrong)} in wrong runs "
        f"that no other check stopped; flagged above {STEP_TOLERANCE:.0%}.",
        f"Spurious energy in the runs at dt/{REFINEMENT} themselves, whose energy check is ignored: at most "
        f"{strangest.reference_residual:.1%} (seed {strangest.seed}), and {stays:.1%} in the same run at "
        f"dt/{FINER * REFINEMENT}. What stays there is the law in a snap, not the step: the energy check may flag such "
        "a snap in a right run.",
    ]
    if missed:
        header = ["seed", "damping", "step/predicted", "tension", "verdict", "status", "deviation", "residual"]
        tables += ["Misjudged:", table(header, map(_misjudged, missed))]
    write(folder, "divergence", result, tables, command)
    draw(runs, folder / "divergence.png")
    return bool(result["all_caught"])


def _misjudged(run: Run) -> list[str]:
    """Row of the table of misjudged runs."""
    drawn = [str(run.seed), run.splitting, f"{run.share:.2f}", f"{run.tension:.2f} N"]
    return [*drawn, run.verdict, run.status, f"{run.deviation:.3f}", f"{run.residual:.1%}"]


def _compared(right: Sequence[Run], complete: Sequence[Run]) -> str:
    """How long right runs were compared."""
    said = f"Of {len(right)} right runs {len(complete)} were compared to the end, {N_CONTROL} control steps"
    others = [run.n_compared for run in right if run not in complete]
    if not others:
        return f"{said}."
    return f"{said}; the others over {min(others)} to {max(others)}, {float(np.median(others)):g} in their median."


def _least_step_error(runs: Sequence[Run]) -> str:
    least = min((run.step_error for run in runs if run.status == Status.INACCURATE.name.lower()), default=None)
    return "nothing to tell" if least is None else f"{least:.1%} or more"
