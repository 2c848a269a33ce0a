"""The report on what a change left as it was: an older commit's checkout and this one, on the same machine.

Each runs in its own process with its own package. Episodes of every registered environment are compared to the last
bit; run times are taken in turn, and judged by the median over rounds of the ratio within a round.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from lattice_gym.benchmarks.results_files import table, write
from lattice_gym.benchmarks.throughput.cold_start import first_step
from lattice_gym.benchmarks.timing import interleaved, median, spread
from lattice_gym.benchmarks.unchanged import worker

HERE = Path(__file__).resolve().parents[3]
"""This checkout."""
EPISODE, QUICK_STEPS = 10**6, 5
"""Control steps that are compared, at most: a whole episode, and in the quick form."""
ROUNDS, QUICK_ROUNDS = 41, 3
TIMED = {
    "one": ("step, one worm", "us", 1e6, 1.03),
    "many": (f"step of a worm, {worker.N_WORM} at once", "us", 1e6, 1.03),
    "env": ("`env.step` of one worm", "ms", 1e3, 1.03),
    "start": ("first step from the start of Python, compiled before", "s", 1.0, 1.0),
    "nothing": ("first step from the start of Python, nothing compiled", "s", 1.0, 1.0),
}
"""What is timed, on one thread: in words, unit, units in a second, and the largest median of new over old that passes.
"""
SHARE_FROM_NOTHING = 8
"""What takes 10 s is taken this many times less often."""

Ask = Callable[..., Any]


@contextmanager
def _checkout(folder: Path) -> Iterator[Ask]:
    """Start a worker in a checkout; yields the function that asks it."""
    process = subprocess.Popen(
        [sys.executable, "-P", worker.__file__],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(folder)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    questions, answers = process.stdin, process.stdout

    def ask(*question: object) -> Any:
        questions.write(json.dumps(question) + "\n")
        questions.flush()
        if not (answer := answers.readline()):
            raise RuntimeError(f"the worker in {folder} ended at {question}")
        return json.loads(answer)

    with process:
        try:
            yield ask
        finally:
            questions.close()


def first_difference(old: list[dict[str, str]], new: list[dict[str, str]]) -> str:
    """Say where two records part: control step and names; "" where they are the same as far as both name things.

    A name that only one of them has is no difference: a commit may observe or store more than another.
    """
    for step, (before, after) in enumerate(zip(old, new, strict=False)):
        if names := [name for name in before if name in after and before[name] != after[name]]:
            return f"control step {step}: {', '.join(names)}"
    return "" if len(old) == len(new) else f"{len(old) - 1} control steps became {len(new) - 1}"


def compare(old: Ask, new: Ask, n_steps: int) -> dict[str, dict[str, str]]:
    """First difference in the episodes of every environment of the older commit, by id and kind of actions."""
    now = new("ids")
    return {
        env_id: {
            actions: first_difference(old("record", env_id, actions, n_steps), new("record", env_id, actions, n_steps))
            if env_id in now
            else "no longer registered"
            for actions in ("random", "zero")
        }
        for env_id in tqdm(old("ids"), desc="episodes", unit="id")
    }


def measure(old: Ask, new: Ask, old_folder: Path, rounds: int) -> dict[str, dict[str, list[float]]]:
    """Seconds of each thing that is timed, of the older commit ("old") and this one ("new"), round by round."""
    asked = {"old": (old, old_folder), "new": (new, HERE)}
    tasks: dict[tuple[str, str], Callable[[], float]] = {}
    starts: dict[tuple[str, str], Callable[[], float]] = {}
    with tempfile.TemporaryDirectory() as kept:
        for side, (ask, folder) in asked.items():
            tasks |= {(what, side): partial(ask, "time", what) for what in ("one", "many", "env")}
            tasks["start", side] = partial(first_step, f"{kept}/{side}", folder)
            starts["nothing", side] = partial(_first_step_from_nothing, folder)
        times = interleaved(tasks, rounds, "run times")
    times |= interleaved(starts, -(-rounds // SHARE_FROM_NOTHING), "from nothing")
    return {what: {side: times[what, side] for side in asked} for what in TIMED}


def _first_step_from_nothing(checkout: Path) -> float:
    with tempfile.TemporaryDirectory() as nothing:
        return first_step(nothing, checkout)


def _ratios(times: dict[str, list[float]]) -> list[float]:
    """Divide new by old, round by round."""
    return [after / before for before, after in zip(times["old"], times["new"], strict=True)]


def report(folder: Path, *, command: str, old: Path, quick: bool) -> bool:
    """Write unchanged.md and unchanged.json; returns whether all is the same and nothing is slower."""
    old = old.resolve()
    with _checkout(old) as ask_old, _checkout(HERE) as ask_new:
        found = compare(ask_old, ask_new, QUICK_STEPS if quick else EPISODE)
        times = measure(ask_old, ask_new, old, QUICK_ROUNDS if quick else ROUNDS)
    same = not any(difference for by_actions in found.values() for difference in by_actions.values())
    rows, fast = [], True
    for what, (words, unit, scale, limit) in TIMED.items():
        ratios = _ratios(times[what])
        passed = median(ratios) <= limit
        fast &= passed
        shown = [f"{spread(times[what][side], scale)} {unit}" for side in ("old", "new")]
        rows.append([words, *shown, spread(ratios), f"{limit:g}", _verdict(passed)])
    length = f"the first {QUICK_STEPS} control steps" if quick else "whole episodes"
    parts = [
        f"Commit {_commit(HERE)} beside {_commit(old)}: states, observations and rewards, to the last bit, over "
        f"{length} of every environment of the older commit, with random actions and with none.",
        table(
            ["id", "random actions", "zero actions"],
            [[env_id, *(_verdict(not what, what) for what in by.values())] for env_id, by in found.items()],
        ),
        "Run times on one thread, the commits in turn: median (least to greatest) over rounds.",
        table(["", "old", "new", "new over old, round by round", "at most", "verdict"], rows),
        _verdict(same and fast),
    ]
    write(folder, "unchanged", {"differences": found, "seconds": times, "passed": same and fast}, parts, command)
    return same and fast


def _commit(checkout: Path) -> str:
    """Short name of a checkout's commit; "unknown" where it is no checkout of git."""
    command = ["git", "-C", str(checkout), "describe", "--always", "--dirty"]
    known = (checkout / ".git").exists()
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip() if known else "unknown"


def _verdict(passed: bool, reason: str = "") -> str:
    return "PASS" if passed else f"FAIL {reason}".strip()
