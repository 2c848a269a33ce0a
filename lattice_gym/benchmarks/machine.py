"""What the machine can do: multiply-adds a second on one core, size of a core's second-level cache."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from numba import njit

from lattice_gym.benchmarks.timing import seconds

CHAIN = 8
"""Multiply-adds on a number between load and store: few enough that the core overlaps those of enough others."""
SIZE = 512
"""Numbers at work: a small part of any first-level cache."""
CACHES = Path("/sys/devices/system/cpu/cpu0/cache")


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _multiply_add(numbers: npt.NDArray[np.float64], factor: float, term: float, rounds: int) -> None:
    """Replace every number by factor * number + term, over and over; vectorised over the numbers."""
    for _ in range(rounds):
        for j in range(numbers.shape[0]):
            number = numbers[j]
            for _ in range(CHAIN):
                number = number * factor + term
            numbers[j] = number


def multiply_add_rate(rounds: int = 4000) -> float:
    """Operations a second of independent multiply-adds on one core, two for each: what numba makes of this machine."""
    numbers = np.ones(SIZE)
    _multiply_add(numbers, 0.5, 0.5, 1)  # compiles
    taken = seconds(lambda: _multiply_add(numbers, 0.5, 0.5, rounds))
    return 2.0 * CHAIN * SIZE * rounds / taken


def second_level_cache(caches: Path = CACHES) -> int | None:
    """Size of the second-level cache of a core [bytes]; None where the machine does not say."""
    for cache in sorted(caches.glob("index*")):
        level, size = ((cache / name).read_text().strip() for name in ("level", "size"))
        if level == "2" and size.endswith("K"):
            return 1024 * int(size[:-1])
    return None
