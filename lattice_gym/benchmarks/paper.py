"""Table 2 of Schaffer, Pamu and Webster-Wood 2024 beside ours: three motions, with a check that the lattice held."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lattice_gym.benchmarks.results_files import table, write
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.health import describe
from lattice_gym.engines.registry import EngineName
from lattice_gym.engines.simulation import simulate
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.measures import bend_angle, dilatation, joint_gap, straightness, strain
from lattice_gym.physics.state import RodState
from lattice_gym.physics.worm import build_model
from lattice_gym.rendering.figures import Still, render_strip

MIN_STRAIGHTNESS = 0.9
"""A stretch of rod whose chord is shorter than this share of its length (relative to rest) counts as buckled."""


@dataclass(frozen=True)
class Motion:
    """One row of the paper's Table 2 (Ryzen 7 3700, one thread)."""

    name: str
    unit: str
    value: float
    run_time: float
    simulated: float
    dt: float


TABLE_2 = (
    Motion("extension", "%", 49.73, 25.90, 0.5, 2e-4),
    Motion("compression", "%", -30.59, 29.27, 0.3, 1e-4),
    Motion("bending", "deg", 48.60, 44.31, 0.5, 1e-4),
)


@dataclass(frozen=True)
class Outcome:
    """What one motion came to under one tension."""

    motion: str
    tension: float
    """[N]"""
    value: float
    """Strain [%] or bend angle [deg]; NaN where the run failed."""
    deviation: float
    """Relative to the paper's value."""
    run_time: float
    """[s], without compilation"""
    simulated: float
    dt: float
    status: str
    joint_gap: float
    """Largest distance between two joined nodes [m]."""
    least_dilatation: float
    straightness: float

    @property
    def verdict(self) -> str:
        """What held and what did not, in words."""
        if self.status != "ok":
            return self.status
        faults = []
        if self.joint_gap > LatticeDesign().structure_radius:
            faults.append("joint open by more than a rod's radius")
        if self.straightness < MIN_STRAIGHTNESS:
            faults.append("rod buckled")
        return ", ".join(faults) or "held"


def _measure(motion: Motion, lattice: Lattice, position: FloatArray) -> float:
    if motion.name == "bending":
        return math.degrees(float(bend_angle(lattice, position)))
    return 100.0 * float(strain(lattice, position))


def run_motion(motion: Motion, tension: float, engine_name: EngineName) -> tuple[Outcome, Lattice, RodModel, RodState]:
    """Hold `tension` [N] in every muscle of the motion's layout for the paper's time at the paper's step."""
    lattice = build_lattice(LatticeDesign())
    layout = named_layout(motion.name, lattice)
    model = build_model(lattice, layout)
    engine = simulate(engine_name, model, motion.dt)
    start = time.perf_counter()
    health = engine.advance(np.full(model.n_muscle, tension), round(motion.simulated / motion.dt))
    run_time = time.perf_counter() - start
    state = engine.state
    value = _measure(motion, lattice, state.position) if health.ok else math.nan
    outcome = Outcome(
        motion=motion.name,
        tension=tension,
        value=value,
        deviation=value / motion.value - 1.0,
        run_time=run_time,
        simulated=motion.simulated,
        dt=motion.dt,
        status=describe(health, lattice, layout),
        joint_gap=float(joint_gap(model, state.position)),
        least_dilatation=float(dilatation(model, state.position).min()),
        straightness=float(straightness(lattice, model, state.position)),
    )
    return outcome, lattice, model, state


def _compile(engine_name: EngineName) -> float:
    """Time to build the scene and take its first step [s]: compilation, or loading what was compiled before."""
    start = time.perf_counter()
    lattice = build_lattice(LatticeDesign())
    model = build_model(lattice, named_layout("all", lattice))
    simulate(engine_name, model, 1e-4).advance(np.zeros(model.n_muscle), 1)
    return time.perf_counter() - start


def _row(motion: Motion, outcome: Outcome) -> list[str]:
    whole = outcome.status == "ok"
    return [
        outcome.motion,
        f"{outcome.tension:g} N",
        f"{motion.value:+.2f} {motion.unit}",
        f"{outcome.value:+.2f} {motion.unit}" if whole else "-",
        f"{100.0 * outcome.deviation:+.1f} %" if whole else "-",
        f"{motion.run_time:.2f} s",
        f"{outcome.run_time:.3f} s",
        f"{outcome.simulated:g} s",
        f"{1e3 * outcome.dt:g} ms",
        f"{1e3 * outcome.joint_gap:.2f} mm" if whole else "-",
        f"{outcome.least_dilatation:.2f}" if whole else "-",
        outcome.verdict,
    ]


HEADER = (
    "motion",
    "tension",
    "paper",
    "ours",
    "deviation",
    "paper's run time",
    "our run time",
    "simulated",
    "step",
    "largest gap",
    "shortest element",
    "lattice",
)


def report(folder: Path, *, command: str, engine: EngineName, tension: Sequence[float], pictures: bool) -> bool:
    """Run every motion at every tension, write paper.md and paper.json, and paper.png where pictures are wanted.

    Returns whether every lattice held.
    """
    first_step = _compile(engine)
    rows, outcomes, stills = [], [], []
    for pull in tension:
        for motion in TABLE_2:
            outcome, lattice, model, state = run_motion(motion, pull, engine)
            rows.append(_row(motion, outcome))
            outcomes.append(outcome)
            if pictures and outcome.status == "ok":
                stills.append(
                    Still(
                        lattice=lattice,
                        model=model,
                        position=state.position,
                        activation=np.ones(model.n_muscle),
                        title=f"{motion.name}, {pull:g} N: {outcome.value:+.1f} {motion.unit}",
                    )
                )
    total = sum(outcome.run_time for outcome in outcomes)
    result: dict[str, Any] = {
        "engine": engine,
        "first_step": first_step,
        "run_time": total,
        "outcomes": [asdict(outcome) | {"verdict": outcome.verdict} for outcome in outcomes],
    }
    times = (
        f"Engine `{engine}`: {total:.2f} s for the {len(outcomes)} motions, after {first_step:.2f} s to the first "
        "step (compilation, or loading what was compiled before)."
    )
    write(folder, "paper", result, [table(HEADER, rows), times], command)
    if stills:
        render_strip(stills, folder / "paper.png")
    return all(outcome.verdict == "held" for outcome in outcomes)
