"""What the work-precision report measures: every setting of every scene, its errors and its cost.

Errors in time are taken on one mesh against the same mesh at a far smaller step, errors of the whole against the limit
of vanishing elements. All errors are those of runs of the fused engine: with PyElastica's damping it follows PyElastica
to rounding, which the report shows on one case, so that PyElastica need only be timed.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from lattice_gym.benchmarks.motions import (
    SAMPLE_DT,
    SCENES,
    Course,
    Error,
    Scene,
    Setting,
    compare,
    extrapolated,
    run,
    step_costs,
)
from lattice_gym.body.design import LatticeDesign
from lattice_gym.engines.registry import EngineName
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.fidelity import FIDELITIES, FidelityName
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.tasks.registry import gait

TARGETS = (1e-2, 1e-3)
"""Errors of the outcome at which the engines are compared."""
SAME = 0.02
"""Errors that differ by no more than this share count as equal."""
SPLITTINGS: tuple[Splitting, ...] = get_args(Splitting)
_Kind = tuple[EngineName, int, str, Splitting]
DEFAULT_MESH = LatticeDesign().elements_per_segment


@dataclass(frozen=True)
class Plan:
    """What is run."""

    scenes: tuple[Scene, ...]
    meshes: tuple[int, ...]
    steps: tuple[int, ...]
    """Steps in `SAMPLE_DT` on every mesh."""
    fine_steps: tuple[int, ...]
    """Further ones on the default mesh."""
    reference_steps: int
    reference_meshes: tuple[int, int]
    """The limit of vanishing elements is extrapolated from these two ..."""
    check_meshes: tuple[int, int]
    """... and checked against that from these."""
    repeats: int


FULL = Plan(
    scenes=SCENES,
    meshes=(1, 2, 3, 4, 5, 6, 8),
    steps=(32, 40, 50, 64, 80, 100, 125, 160, 200, 250, 320),
    fine_steps=(400, 500, 640, 800, 1000, 1250, 1600),
    reference_steps=4000,
    reference_meshes=(12, 24),
    check_meshes=(8, 16),
    repeats=9,
)
QUICK = Plan(
    scenes=tuple(replace(scene, duration=0.2 if scene.duration < 1.0 else 1.0) for scene in SCENES),
    meshes=(1, 2, 5),
    steps=(50, 100, 125, 250),
    fine_steps=(500, 1000),
    reference_steps=2000,
    reference_meshes=(6, 12),
    check_meshes=(5, 10),
    repeats=3,
)


@dataclass(frozen=True)
class Point:
    """One way to compute a scene."""

    engine: EngineName
    setting: Setting
    time_error: Error
    """Against the same mesh and muscles at a far smaller step."""
    error: Error
    """Against the limit of vanishing elements, muscles as rods."""
    cost: float
    """Processor time per simulated second."""
    status: str


@dataclass(frozen=True)
class Study:
    """All that was measured on one scene."""

    scene: Scene
    points: list[Point]
    fidelities: dict[FidelityName, Point]
    mesh_errors: dict[tuple[int, str], Error]
    """Of each mesh and muscle model alone, at a far smaller step."""
    reference_error: Error
    """Distance between the limit extrapolated from finer and from coarser meshes: how far the reference is to trust."""
    step_costs: dict[_Kind, float]
    """Median processor time of a step [s]."""
    targets: dict[float, dict[str, Point | None]]
    """Cheapest point of the default body that reaches each target in time, for each engine."""

    def best(self) -> list[Point]:
        """Points of the fused engine that no other beats in both cost and error of the outcome, cheapest first."""
        sound = sorted((p for p in self.points if p.engine == "fused" and p.status == "ok"), key=lambda p: p.cost)
        front: list[Point] = []
        for point in sound:
            if not front or point.error.outcome < (1.0 - SAME) * front[-1].error.outcome:
                front.append(point)
        return front


class Progress:
    """A line on stderr at most every ten seconds."""

    def __init__(self, report: str = "work-precision") -> None:
        self._report = report
        self._start = self._last = time.monotonic()

    def __call__(self, text: str) -> None:
        """Say what is being done, if it is time."""
        now = time.monotonic()
        if now - self._last > 10.0:
            self._last = now
            sys.stderr.write(f"{self._report}, {now - self._start:.0f} s: {text}\n")


def _settled(elements_per_segment: int, muscle_model: str, n_substeps: int) -> Setting:
    """Give the setting of a reference: on a fine mesh stability asks for smaller steps than accuracy does."""
    return Setting(elements_per_segment, muscle_model, "symmetric", max(n_substeps, 50 * elements_per_segment))


def _key(engine: EngineName, setting: Setting) -> _Kind:
    """Name what the cost of a step depends on."""
    return engine, setting.elements_per_segment, setting.muscle_model, setting.splitting


def study(scene: Scene, plan: Plan, progress: Progress) -> Study:
    """Run and time every setting on one scene."""

    def limit(coarse: int, fine: int) -> Course:
        courses = []
        for mesh in (coarse, fine):
            progress(f"{scene.name}, reference on {mesh} elements per segment")
            courses.append(run(scene, _settled(mesh, "rod", 500)))
        return extrapolated(courses[0], courses[1], fine / coarse)

    reference = limit(*plan.reference_meshes)
    doubt = compare(limit(*plan.check_meshes), reference)
    sweep = [
        Setting(mesh, muscle, splitting, n_substeps)
        for mesh in plan.meshes
        for muscle in ("rod", "line")
        for splitting in SPLITTINGS
        for n_substeps in (*plan.steps, *(plan.fine_steps if mesh == DEFAULT_MESH else ()))
    ]
    named = {name: _of_fidelity(scene, name) for name in FIDELITIES}
    progress(f"{scene.name}, cost of a step")
    cost = _step_costs(scene, [*sweep, *named.values()], plan.repeats)
    settled: dict[tuple[int, str], Course] = {}

    def point(setting: Setting, engine: EngineName = "fused") -> Point:
        progress(
            f"{scene.name}, {', '.join(map(str, _key(engine, setting)))}, {setting.n_substeps} steps in {SAMPLE_DT} s"
        )
        if setting.mesh not in settled:
            own = setting.elements_per_segment == DEFAULT_MESH
            settled[setting.mesh] = run(scene, _settled(*setting.mesh, plan.reference_steps if own else 1000))
        course = run(scene, setting)
        errors = compare(course, settled[setting.mesh]), compare(course, reference)
        return Point(engine, setting, *errors, cost[_key(engine, setting)] / setting.dt, course.status)

    points = [point(setting) for setting in sweep]
    points += [
        replace(p, engine="pyelastica", cost=cost[_key("pyelastica", p.setting)] / p.setting.dt)
        for p in points
        if _key("pyelastica", p.setting) in cost
    ]
    fidelities = {name: point(setting) for name, setting in named.items()}
    mesh_errors = {mesh: compare(course, reference) for mesh, course in settled.items()}
    return Study(scene, points, fidelities, mesh_errors, doubt, cost, _targets(points))


def _of_fidelity(scene: Scene, name: FidelityName) -> Setting:
    """Give the setting that the environment takes on its own for a fidelity."""
    env = LatticeWormEnv(scene.name, muscles=scene.layout, fidelity=name, control_dt=SAMPLE_DT)
    return Setting(env.design.elements_per_segment, env.design.muscle_model, env.splitting, env.n_substeps)


def _step_costs(scene: Scene, settings: Iterable[Setting], repeats: int) -> dict[_Kind, float]:
    """Median processor time of a step [s] for each kind of setting, and of PyElastica on the default body."""
    reference = Setting(DEFAULT_MESH, "rod", "pyelastica")
    kinds = {_key("pyelastica", reference): reference} | {_key("fused", setting): setting for setting in settings}
    # A step that is stable on every mesh.
    timed = [(key[0], replace(setting, n_substeps=800)) for key, setting in kinds.items()]
    measured = step_costs(scene, timed, repeats, {"fused": 400, "pyelastica": 40})
    return {key: float(np.median(times)) for key, times in zip(kinds, measured, strict=True)}


def _targets(points: Iterable[Point]) -> dict[float, dict[str, Point | None]]:
    own = [p for p in points if p.setting.mesh == (DEFAULT_MESH, "rod") and p.status == "ok"]
    return {
        target: {
            engine: min(
                (p for p in own if p.engine == engine and p.time_error.outcome <= target),
                key=lambda p: p.cost,
                default=None,
            )
            for engine in ("pyelastica", "fused")
        }
        for target in TARGETS
    }


def same_course(scene: Scene, n_sample: int) -> float:
    """Largest distance of a site between the engines [m], over the first samples at the step of 0.4 ms."""
    short = replace(scene, duration=n_sample * SAMPLE_DT)
    setting = Setting(DEFAULT_MESH, "rod", "pyelastica", 125)
    fused, reference = (run(short, setting, name) for name in ("fused", "pyelastica"))
    return float(np.abs(fused.sites - reference.sites).max())


def gait_returns(n_step: dict[str, int], progress: Progress) -> dict[str, dict[FidelityName, float]]:
    """Return of a task's hand-made gait over so many control steps, at every fidelity; commands are those of seed 0."""
    returns: dict[str, dict[FidelityName, float]] = {}
    for task, count in n_step.items():
        returns[task] = {}
        for name in FIDELITIES:
            progress(f"return of the {task} gait, fidelity {name}")
            env = LatticeWormEnv(task, fidelity=name)
            env.reset(seed=0)
            command = gait(task, env.lattice, env.layout, env.task.command)
            returns[task][name] = sum(env.step(command(env.time))[1] for _ in range(count))
    return returns
