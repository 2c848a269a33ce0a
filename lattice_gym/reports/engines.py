"""The fused engine against PyElastica: how far apart they are, and how much faster it is.

The benchmark scene is the paper's extension motion: default design, `extension` layout, 0.5 N in every muscle.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from lattice_gym.design import LatticeDesign
from lattice_gym.engines import Engine, EngineName, make_engine
from lattice_gym.lattice import build_lattice
from lattice_gym.model import RodModel, build_model, default_dt
from lattice_gym.muscles import named_layout
from lattice_gym.reports.provenance import provenance, table, write

ENGINES: tuple[EngineName, EngineName] = ("fused", "pyelastica")
BENCHMARK_DT = 1e-4
FIELDS = {"position": "m", "velocity": "m/s", "directors": "1", "omega": "rad/s"}


def agreement(model: RodModel, control_dt: float, n_control: int) -> list[dict[str, Any]]:
    """Largest difference of every field of the state after one step and after `n_control` random control periods."""
    dt = default_dt(model, control_dt)
    engines = [make_engine(name, model, dt) for name in ENGINES]
    rng = np.random.default_rng(0)
    pull = rng.uniform(0.0, 0.5, model.n_muscle)
    for engine in engines:
        engine.advance(pull, 1)
    after = [("one step", _differences(*engines))]
    for _ in range(n_control):
        ramp = rng.uniform(0.0, 0.5, (2, model.n_muscle))
        for engine in engines:
            engine.advance(ramp, round(control_dt / dt))
    after.append((f"{n_control * control_dt:g} s of random activation ({n_control * round(control_dt / dt)} steps)",
                  _differences(*engines)))  # fmt: skip
    return [{"after": label, **differences} for label, differences in after]


def _differences(fused: Engine, reference: Engine) -> dict[str, float]:
    a, b = fused.state, reference.state
    return {field: float(np.abs(getattr(a, field) - getattr(b, field)).max()) for field in FIELDS}


def speed(model: RodModel, repeats: int) -> dict[str, list[float]]:
    """Seconds per step of either engine, interleaved; the same number of steps of the same motion in every repeat."""
    steps = {"fused": 2000, "pyelastica": 100}
    pull = np.full(model.n_muscle, 0.5)
    times: dict[str, list[float]] = {name: [] for name in ENGINES}
    engines = {name: make_engine(name, model, BENCHMARK_DT) for name in ENGINES}
    rest = model.rest_state()
    for repeat in range(-1, repeats):
        for name in ENGINES:
            engines[name].restore(rest)
            start = time.perf_counter()
            engines[name].advance(pull, steps[name])
            if repeat >= 0:  # the first round compiles and warms up
                times[name].append((time.perf_counter() - start) / steps[name])
    return times


def report(folder: Path, *, command: str, repeats: int = 7, n_control: int = 20) -> float:
    """Write engines.md and engines.json; returns the ratio of the medians."""
    lattice = build_lattice(LatticeDesign())
    differences = agreement(build_model(lattice, named_layout("all", lattice)), 0.05, n_control)
    times = speed(build_model(lattice, named_layout("extension", lattice)), repeats)
    medians = {name: float(np.median(times[name])) for name in ENGINES}
    ratio = medians["pyelastica"] / medians["fused"]
    pairs = np.array(times["pyelastica"]) / np.array(times["fused"])
    result = {
        "differences": differences,
        "seconds_per_step": times,
        "median_seconds_per_step": medians,
        "ratio": ratio,
        "made": provenance(command),
    }
    tables = [
        "Largest difference between the engines, default design, all 90 muscles:",
        table(
            ["after", *(f"{field} [{unit}]" for field, unit in FIELDS.items())],
            [[row["after"], *(f"{row[field]:.1e}" for field in FIELDS)] for row in differences],
        ),
        f"Time per step, benchmark scene, one thread, median of {repeats} interleaved repeats:",
        table(["engine", "us per step"], [[name, f"{1e6 * medians[name]:.1f}"] for name in ENGINES]),
        f"The fused engine is {ratio:.0f} times faster (pair by pair {pairs.min():.0f} to {pairs.max():.0f}).",
    ]
    write(folder, "engines", result, tables)
    return ratio
