"""Times taken side by side: one round of everything after another, so that what slows the machine slows all."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import TypeVar

import numpy as np
from tqdm import tqdm

from lattice_gym.checks import FloatArray
from lattice_gym.engines.simulation import Simulation

Key = TypeVar("Key", bound=Hashable)
Made = TypeVar("Made")


def seconds(action: Callable[[], object], clock: Callable[[], float] = time.thread_time) -> float:
    """Time that an action takes [s]: by default processor time of this thread, which others' work is no part of."""
    start = clock()
    action()
    return clock() - start


def seconds_per_step(
    engine: Simulation, tension: FloatArray, n_steps: int, clock: Callable[[], float] = time.thread_time
) -> float:
    """Time of a step [s] of a motion from rest under a tension [N]; while it is stable, steps cost the same."""
    engine.restore(engine.model.rest_state())
    return seconds(lambda: engine.advance(tension, n_steps), clock) / n_steps


def interleaved(
    tasks: Mapping[Key, Callable[[], float]], repeats: int, name: str | None = None
) -> dict[Key, list[float]]:
    """Collect what every task gives, round by round, after a round that compiles and warms up.

    With a `name`, progress is shown on stderr.
    """
    given: dict[Key, list[float]] = {key: [] for key in tasks}
    for repeat in tqdm(range(-1, repeats), desc=name, unit="round", disable=name is None):
        for key, task in tasks.items():
            value = task()
            if repeat >= 0:
                given[key].append(value)
    return given


def median(values: Sequence[float]) -> float:
    """Middle of the values."""
    return float(np.median(values))


def digits(value: float) -> str:
    """At least three digits, and no exponent where none is needed."""
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"


def spread(values: Sequence[float], scale: float = 1.0) -> str:
    """Median, least and greatest of the values times a scale, to three digits."""
    shown = [digits(scale * value) for value in (median(values), min(values), max(values))]
    return f"{shown[0]} ({shown[1]} to {shown[2]})"


def allocated(make: Callable[[], Made]) -> tuple[Made, int]:
    """Make something; return it, and the memory that Python and numpy took for it and still hold [bytes]."""
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        made = make()
        return made, tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
