"""Time from the start of a process to the first step of an environment, with what was compiled before and without."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ENV_ID = "LatticeWorm-v0"
_FIRST_STEP = f"""
import gymnasium, lattice_gym
env = gymnasium.make("{ENV_ID}")
env.reset(seed=0)
env.step(env.action_space.sample())
print("stepped", flush=True)
"""


def first_step(cache: str, checkout: Path | None = None) -> float:
    """Seconds from the start of Python to the end of the first step, with compiled code kept in a folder.

    The package is that of a checkout, by default the one that this process would import. Python keeps its own bytecode,
    as it does by default.

    Raises
    ------
    RuntimeError
        It did not get that far.
    """
    given = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    start = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, "-c", _FIRST_STEP],
        cwd=checkout,
        env=given | {"NUMBA_CACHE_DIR": cache} | ({} if checkout is None else {"PYTHONPATH": str(checkout)}),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        said = process.stdout.readline()
        taken = time.perf_counter() - start
        _, errors = process.communicate()
    if said != "stepped\n":
        raise RuntimeError(f"{ENV_ID} did not take a step: {errors[-2000:]}")
    return taken


def cold_starts(repeats: int) -> dict[str, list[float]]:
    """Seconds to the first step from nothing, and once more with what that left, each time in a new folder."""
    times: dict[str, list[float]] = {"from nothing": [], "cached": []}
    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as cache:
            for taken in times.values():
                taken.append(first_step(cache))
    return times
