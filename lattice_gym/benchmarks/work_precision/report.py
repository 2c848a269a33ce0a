"""The work-precision report: what time step, mesh, damping, muscles and engine cost, and what they buy."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from lattice_gym.benchmarks.results_files import table, write
from lattice_gym.benchmarks.work_precision.figure import draw
from lattice_gym.benchmarks.work_precision.motions import SAMPLE_DT, SCENES
from lattice_gym.benchmarks.work_precision.pefrl import pefrl_faults
from lattice_gym.benchmarks.work_precision.study import (
    DEFAULT_MESH,
    FULL,
    QUICK,
    TARGETS,
    Plan,
    Point,
    Study,
    gait_returns,
    same_course,
    study,
)
from lattice_gym.body.design import LatticeDesign
from lattice_gym.envs.fidelity import FIDELITIES

MIN_GAIN = 100.0
"""How many times less computing than PyElastica the fused engine must need at every target."""
GAIT_STEPS = {"peristalsis": 200, "extension": 40, "compression": 40, "bending": 40}
"""Control steps of an episode of registered length."""


def _percent(value: float) -> str:
    return f"{100.0 * value:.2g} %" if np.isfinite(value) else "failed"


TARGET_HEADER = (
    "scene",
    "error of the outcome",
    "PyElastica takes",
    "and needs",
    "fused takes",
    "and needs",
    "fused over PyElastica",
)


def _target_rows(studies: Iterable[Study]) -> list[list[str]]:
    rows = []
    for measured in studies:
        for target, found in measured.targets.items():
            row = [measured.scene.name, f"{target:g}"]
            for point in found.values():
                if point is None:
                    row += ["not reached", ""]
                else:
                    row += [f"{point.setting.splitting}, {1e3 * point.setting.dt:.3g} ms", f"{point.cost:.3g} s"]
            reference, fused = found["pyelastica"], found["fused"]
            row.append(f"1/{reference.cost / fused.cost:.0f}" if reference and fused else "")
            rows.append(row)
    return rows


def _setting_row(measured: Study, point: Point) -> list[str]:
    setting = point.setting
    return [
        measured.scene.name,
        str(setting.elements_per_segment),
        setting.muscle_model,
        setting.splitting,
        f"{1e3 * setting.dt:.3g} ms",
        f"{1e3 * point.cost:.3g} ms",
        _percent(point.error.outcome),
        _percent(point.error.sites),
        _percent(point.time_error.outcome),
    ]


SETTING_HEADER = (
    "scene",
    "elements per segment",
    "muscles",
    "damping",
    "step",
    "computing per simulated s",
    "error of the outcome",
    "error of the sites",
    "of the outcome in time alone",
)


def _mesh_rows(studies: list[Study]) -> list[list[str]]:
    meshes = sorted(
        {mesh for measured in studies for mesh in measured.mesh_errors}, key=lambda m: (m[1] == "line", m[0])
    )
    return [
        [str(mesh[0]), mesh[1]]
        + [
            f"{_percent(measured.mesh_errors[mesh].outcome)}, {_percent(measured.mesh_errors[mesh].sites)}"
            for measured in studies
        ]
        for mesh in meshes
    ]


def _failed_rows(studies: list[Study]) -> list[list[str]]:
    """Largest step that held and smallest that failed, by mesh and scene, muscles as rods."""
    rows = []
    for mesh in sorted({p.setting.elements_per_segment for p in studies[0].points}):
        row = [str(mesh)]
        for measured in studies:
            own = [p for p in measured.points if p.setting.mesh == (mesh, "rod")]
            failed = sorted({p.setting.dt for p in own if p.status != "ok"})
            held = sorted({p.setting.dt for p in own} - set(failed))
            row.append(f"{1e3 * held[-1]:.3g} / {1e3 * failed[0]:.3g} ms" if failed else f"{1e3 * held[-1]:.3g} ms / -")
        rows.append(row)
    return rows


def _short(value: float) -> float | None:
    """Four digits; None where there is no number."""
    return float(f"{value:.4g}") if np.isfinite(value) else None


def _flat(point: Point) -> dict[str, Any]:
    return asdict(point.setting) | {
        "engine": point.engine,
        "dt": point.setting.dt,
        "cost": _short(point.cost),
        "error": [_short(point.error.outcome), _short(point.error.sites)],
        "time_error": [_short(point.time_error.outcome), _short(point.time_error.sites)],
        "status": point.status,
    }


def _json(measured: Study) -> dict[str, Any]:
    """Figures of a scene; errors are pairs: of the outcome, of the sites."""
    return {
        "scene": asdict(measured.scene),
        "points": [_flat(point) for point in measured.points],
        "fidelities": {name: _flat(point) for name, point in measured.fidelities.items()},
        "mesh_errors": [
            {"elements_per_segment": mesh, "muscle_model": model, "error": [error.outcome, error.sites]}
            for (mesh, model), error in measured.mesh_errors.items()
        ],
        "reference_error": [measured.reference_error.outcome, measured.reference_error.sites],
        "targets": {
            f"{target:g}": {name: point and _flat(point) for name, point in found.items()}
            for target, found in measured.targets.items()
        },
    }


def _scenes_text(plan: Plan, doubt: float) -> str:
    """Say what is run, what errors are relative to, and how far the reference is to trust."""
    coarse, fine = plan.reference_meshes
    return (
        "**Scenes.** "
        + "; ".join(f"{s.name} ({s.layout} muscles, {s.duration:g} s, outcome: {s.outcome})" for s in plan.scenes)
        + f". Default design; the first two hold {LatticeDesign().max_tension:g} N from rest, the third follows the "
        "hand-made gait. **Errors**, sampled every 0.05 s: of the outcome, the largest difference at any time over the "
        "largest change; of the sites, the root mean square distance over the root mean square displacement. "
        f"**Damping** is stated per node, so that finer meshes would be damped more and no limit would exist: here the "
        f"rods of every mesh keep the damping per length of the default one ({DEFAULT_MESH} elements per segment), as "
        f"`LatticeDesign(damping_mesh={DEFAULT_MESH})` does. **Reference**: muscles as rods of two elements, mesh "
        f"extrapolated linearly in the element length from {coarse} and {fine} elements per segment; from "
        f"{plan.check_meshes[0]} and {plan.check_meshes[1]} the outcome comes out within {_percent(doubt)} of it. "
        f"**Run time**: processor time of one thread per simulated second, median of {plan.repeats} interleaved "
        "repeats, without compilation."
    )


def report(folder: Path, *, command: str, quick: bool) -> bool:
    """Write work-precision.md, .json and .png; returns whether the fused engine needs 1/100 of PyElastica's time."""
    plan = QUICK if quick else FULL
    n_sample = 2 if quick else 6
    apart = same_course(SCENES[0], n_sample)
    gained, damped = pefrl_faults()
    studies = [study(scene, plan) for scene in plan.scenes]
    returns = gait_returns({task: count // (10 if quick else 1) for task, count in GAIT_STEPS.items()})
    names = [measured.scene.name for measured in studies]
    doubt = max(measured.reference_error.outcome for measured in studies)
    parts = [
        _scenes_text(plan, doubt),
        "Engines at equal error in time, default mesh, muscles as rods; each at its own cheapest step and damping:",
        table(TARGET_HEADER, _target_rows(studies)),
        "PyElastica's errors are those of the fused engine with PyElastica's damping, whose sites stay within "
        f"{apart:.0e} m of PyElastica's own over {SAMPLE_DT * n_sample:g} s of extension at a step of 0.4 ms; its run "
        "time is measured. Its PEFRL stepper is left out: under a constant force it gives "
        f"{gained:.2f} times the velocity, and it damps {damped:.2f} times a step (measured; both should be 1).",
        "Fidelities of `LatticeWormEnv`, at the step it gives them:",
        table(
            ["fidelity", *SETTING_HEADER],
            [[name, *_setting_row(measured, p)] for measured in studies for name, p in measured.fidelities.items()],
        ),
        f"Return of the hand-made gaits over {'a tenth of ' if quick else ''}an episode, at each fidelity:",
        table(
            ["task", *FIDELITIES],
            [[task, *(f"{value:.3f}" for value in values.values())] for task, values in returns.items()],
        ),
        "Error in space of the outcome and of the sites, at a step so small that it does not count; lines hold their "
        "muscles' model error too:",
        table(["elements per segment", "muscles", *names], _mesh_rows(studies)),
        "Best settings of the fused engine: nothing cheaper has a smaller error of the outcome.",
        table(SETTING_HEADER, [_setting_row(measured, p) for measured in studies for p in measured.best()]),
        "Largest step that held and smallest that failed, muscles as rods, either damping:",
        table(["elements per segment", *names], _failed_rows(studies)),
    ]
    reached = [(found["pyelastica"], found["fused"]) for measured in studies for found in measured.targets.values()]
    ratios = [reference.cost / fused.cost for reference, fused in reached if reference and fused]
    good = len(ratios) == len(studies) * len(TARGETS) and min(ratios) >= MIN_GAIN
    result = {
        "quick": quick,
        "studies": [_json(measured) for measured in studies],
        "gait_returns": returns,
        "same_course": apart,
        "pefrl": {"velocity": gained, "damping": damped},
        "least_ratio": min(ratios, default=None),
    }
    write(folder, "work-precision", result, parts, command)
    draw(studies, folder / "work-precision.png")
    return good
