"""The fused engine against PyElastica: how far apart they are, and how much faster it is."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lattice_gym.benchmarks.benchmark_scene import BENCHMARK_DT, CONTROL_DT, ENGINES, TENSION, benchmark_model
from lattice_gym.benchmarks.results_files import table, write
from lattice_gym.benchmarks.timing import interleaved, seconds_per_step
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.engines.simulation import Simulation, simulate
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.critical_step import default_dt
from lattice_gym.physics.worm import build_model

FIELDS = {"position": "m", "velocity": "m/s", "directors": "1", "omega": "rad/s"}
EPISODE = 10.0
"""Duration of the longest registered episode [s]."""
STEP_LIMIT, EPISODE_LIMIT, SPEED_LIMIT = 1e-12, 1e-9, 100.0
"""Agreement after one step (position and velocity over their largest) and after an episode (position [m]); ratio."""


def agreement(model: RodModel, n_control: int) -> list[dict[str, Any]]:
    """Largest difference of every field of the state after one step and after `n_control` random control periods."""
    dt = default_dt(model, CONTROL_DT)
    engines = [simulate(name, model, dt) for name in ENGINES]
    rng = np.random.default_rng(0)
    pull = rng.uniform(0.0, TENSION, model.n_muscle)
    for engine in engines:
        engine.advance(pull, 1)
    after = [("one step", _differences(*engines))]
    for _ in range(n_control):
        ramp = rng.uniform(0.0, TENSION, (2, model.n_muscle))
        for engine in engines:
            engine.advance(ramp, round(CONTROL_DT / dt))
    steps = n_control * round(CONTROL_DT / dt)
    after.append((f"{n_control * CONTROL_DT:g} s of random activation ({steps} steps)", _differences(*engines)))
    return [{"after": label, **differences} for label, differences in after]


def _differences(fused: Simulation, reference: Simulation) -> dict[str, float]:
    """Largest difference of every field, and for `relative NAME` over the field's largest value."""
    a, b = fused.state, reference.state
    differences = {field: float(np.abs(getattr(a, field) - getattr(b, field)).max()) for field in FIELDS}
    largest = {field: float(np.abs(getattr(b, field)).max()) for field in FIELDS}
    return differences | {
        f"relative {field}": differences[field] / largest[field] for field in FIELDS if largest[field] > 0.0
    }


def _shown(row: dict[str, Any], field: str) -> str:
    """Absolute difference, and the relative one where the field is not zero all over."""
    relative = row.get(f"relative {field}")
    return f"{row[field]:.1e}" + ("" if relative is None else f" ({relative:.1e})")


def speed(model: RodModel, repeats: int) -> dict[str, list[float]]:
    """Seconds per step of either engine, interleaved; the same number of steps of the same motion in every repeat."""
    steps, pull = {"fused": 2000, "pyelastica": 100}, np.full(model.n_muscle, TENSION)
    engines = {name: simulate(name, model, BENCHMARK_DT) for name in ENGINES}
    return interleaved(
        {name: partial(seconds_per_step, engine, pull, steps[name]) for name, engine in engines.items()}, repeats
    )


def report(folder: Path, *, command: str, repeats: int = 7, n_control: int = round(EPISODE / CONTROL_DT)) -> bool:
    """Write engines.md and engines.json; returns whether the engines agree and the ratio of the medians is reached."""
    lattice = build_lattice(LatticeDesign())
    differences = agreement(build_model(lattice, named_layout("all", lattice)), n_control)
    times = speed(benchmark_model(), repeats)
    medians = {name: float(np.median(times[name])) for name in ENGINES}
    ratio = medians["pyelastica"] / medians["fused"]
    pairs = np.array(times["pyelastica"]) / np.array(times["fused"])
    step, episode = differences
    agree = (
        max(step["relative position"], step["relative velocity"]) < STEP_LIMIT and episode["position"] < EPISODE_LIMIT
    )
    result = {
        "differences": differences,
        "agree": agree,
        "seconds_per_step": times,
        "median_seconds_per_step": medians,
        "ratio": ratio,
    }
    tables = [
        "Largest difference between the engines (over the largest value), default design, all 90 muscles:",
        table(
            ["after", *(f"{field} [{unit}]" for field, unit in FIELDS.items())],
            [[row["after"], *(_shown(row, field) for field in FIELDS)] for row in differences],
        ),
        f"The engines {'agree' if agree else 'DO NOT AGREE'} within {STEP_LIMIT:g} of position and velocity "
        f"after a step, and {EPISODE_LIMIT:g} m at the end.",
        f"Time per step, benchmark scene (default design, `extension` layout, 0.5 N), median of {repeats} interleaved "
        "repeats, one thread; the PyElastica engine holds what a user of PyElastica would write:",
        table(["engine", "us per step"], [[name, f"{1e6 * medians[name]:.1f}"] for name in ENGINES]),
        f"The fused engine is {ratio:.0f} times faster (pair by pair {pairs.min():.0f} to {pairs.max():.0f}).",
    ]
    write(folder, "engines", result, tables, command)
    return agree and ratio >= SPEED_LIMIT
