"""Three motions of the default worm on any mesh and at any step, and how far apart two runs of one are."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import pairwise

import numpy as np

from lattice_gym.benchmarks.timing import interleaved, seconds_per_step
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import MuscleLayout, named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.health import describe
from lattice_gym.engines.registry import EngineName
from lattice_gym.engines.simulation import simulate
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.activation import advance_activation
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.measures import bend_angle, ring_radii, site_positions, strain
from lattice_gym.physics.worm import build_model
from lattice_gym.tasks.registry import gait

SAMPLE_DT = 0.05
"""Time between two samples of a motion, and between two commands of a gait [s]."""
WAVE = {"speed": 0.1, "wavelength": 0.1, "amplitude": 0.055, "phase": 0.0}
"""Command of the peristaltic gait: one body height a second and long, the middle of what the task draws."""


@dataclass(frozen=True)
class Scene:
    """A motion from rest: every muscle pulled at once, or the task's gait through the activation dynamics."""

    name: str
    layout: str
    duration: float
    """[s]"""
    outcome: str
    """What the motion is about, in words."""

    def tensions(self, lattice: Lattice, layout: MuscleLayout) -> list[FloatArray]:
        """Tension of every muscle for each sample period [N], as `Engine.advance` takes it."""
        design, count = lattice.design, round(self.duration / SAMPLE_DT)
        if self.name != "peristalsis":
            return [np.full(len(layout), design.max_tension)] * count
        command = gait(self.name, lattice, layout, WAVE)
        activation = [np.zeros(len(layout))]
        for step in range(count):
            wanted = command(step * SAMPLE_DT)
            activation.append(
                advance_activation(activation[-1], wanted, SAMPLE_DT, design.rise_time, design.decay_time)
            )
        return [design.max_tension * np.stack(pair) for pair in pairwise(activation)]

    def measure(self, lattice: Lattice, position: FloatArray) -> FloatArray:
        """Outcome: strain, bend angle [rad], or the radius of every ring [m], shape (1,) or (n_level,)."""
        if self.name == "extension":
            return np.array([strain(lattice, position)])
        if self.name == "bending":
            return np.array([bend_angle(lattice, position)])
        return ring_radii(lattice, position)


SCENES = (
    Scene("extension", "extension", 0.5, "strain"),
    Scene("bending", "bending", 0.5, "bend angle"),
    Scene("peristalsis", "all", 2.0, "ring radii"),
)


@dataclass(frozen=True)
class Setting:
    """How a scene is computed."""

    elements_per_segment: int = 5
    muscle_model: str = "rod"
    splitting: Splitting = "symmetric"
    n_substeps: int = 125
    """Steps in `SAMPLE_DT`."""

    @property
    def dt(self) -> float:
        """Time step [s]."""
        return SAMPLE_DT / self.n_substeps

    @property
    def mesh(self) -> tuple[int, str]:
        """What the model depends on."""
        return self.elements_per_segment, self.muscle_model


@dataclass(frozen=True, eq=False)
class Course:
    """What a scene came to: at every sample, rest included, the sites [m] and the outcome; nothing where it failed."""

    sites: FloatArray
    """Shape (n_sample + 1, n_site, 3)."""
    outcome: FloatArray
    """Shape (n_sample + 1, n_value)."""
    status: str = "ok"

    @property
    def ok(self) -> bool:
        """True where the run reached its end."""
        return self.status == "ok"


@dataclass(frozen=True)
class Error:
    """Distance of a run from a reference; NaN where it failed."""

    sites: float
    """Root mean square distance of the sites over all times, over their root mean square displacement."""
    outcome: float
    """Largest difference of the outcome at any time, over its largest change."""


@cache
def worm(scene: Scene, elements_per_segment: int, muscle_model: str) -> tuple[Lattice, MuscleLayout, RodModel]:
    """Body of a scene, with the damping per length of the default mesh."""
    default = LatticeDesign()
    design = replace(
        default,
        elements_per_segment=elements_per_segment,
        damping_mesh=default.elements_per_segment,
        muscle_model=muscle_model,
    )
    lattice = build_lattice(design)
    layout = named_layout(scene.layout, lattice)
    return lattice, layout, build_model(lattice, layout)


def run(scene: Scene, setting: Setting, engine_name: EngineName = "fused") -> Course:
    """Compute a scene."""
    lattice, layout, model = worm(scene, *setting.mesh)
    engine = simulate(engine_name, model, setting.dt, setting.splitting)
    positions, status = [engine.state.position], "ok"
    for tension in scene.tensions(lattice, layout):
        health = engine.advance(tension, setting.n_substeps)
        if not health.ok:
            status = describe(health, lattice, layout)
            break
        positions.append(engine.state.position)
    return Course(
        np.array([site_positions(lattice, position) for position in positions]),
        np.array([scene.measure(lattice, position) for position in positions]),
        status,
    )


def extrapolated(coarse: Course, fine: Course, ratio: float) -> Course:
    """Limit of vanishing elements where the error falls with their length, `ratio` times shorter in `fine`."""
    share = 1.0 / (ratio - 1.0)
    return Course(
        fine.sites + share * (fine.sites - coarse.sites), fine.outcome + share * (fine.outcome - coarse.outcome)
    )


def compare(course: Course, reference: Course) -> Error:
    """How far a run is from the reference."""
    if not course.ok:
        return Error(np.nan, np.nan)
    apart, moved = course.sites - reference.sites, reference.sites - reference.sites[0]
    change = np.abs(reference.outcome - reference.outcome[0]).max()
    return Error(
        float(np.sqrt(np.mean(apart**2) / np.mean(moved**2))),
        float(np.abs(course.outcome - reference.outcome).max() / change),
    )


def step_costs(
    scene: Scene, settings: Sequence[tuple[EngineName, Setting]], repeats: int, n_steps: dict[EngineName, int]
) -> list[list[float]]:
    """Processor time of a step [s] with each engine and setting, one a repeat; the repeats are interleaved.

    Processor time of this process, one thread: what else runs on the machine does not count, though it may slow it.
    """
    tasks: dict[int, Callable[[], float]] = {}
    for k, (name, setting) in enumerate(settings):
        lattice, layout, model = worm(scene, *setting.mesh)
        engine = simulate(name, model, setting.dt, setting.splitting)
        tension = scene.tensions(lattice, layout)[0]
        tasks[k] = partial(seconds_per_step, engine, tension, n_steps[name], time.process_time)
    return list(interleaved(tasks, repeats, f"{scene.name}, cost of a step").values())
