"""What each optional feature of a worm's world costs in a step of the fused engine, alone and with all others."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lattice_gym.benchmarks.benchmark_scene import BENCHMARK_DT, CONTROL_DT, TENSION
from lattice_gym.benchmarks.timing import interleaved, seconds
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.engines.simulation import simulate
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.adaptation import Adaptation
from lattice_gym.physics.laws.contact import Contact
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.measures import muscle_strain
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model
from lattice_gym.tasks.crawl import Crawl
from lattice_gym.tasks.transport import Transport

BARE = replace(LatticeDesign(), rotational_damping=0.0)
"""The default worm without its only optional part; translational damping is always there."""
MEDIUM = Medium(drag=0.1)
BALL = Transport.world(build_lattice(LatticeDesign())).ball
BY_DIRECTION = Ground(static_friction=0.6, forward=0.5, backward=1.5, sideways=0.8)
ADAPTATION = Adaptation(strain_gain=0.1, force_gain=0.1, fatigue_rate=0.1, recovery_rate=0.1)


@dataclass(frozen=True, kw_only=True)
class Feature:
    """The bare worm with something more; its muscles pull as in the benchmark scene, from rest."""

    name: str
    difference: str
    """From the bare scene, in words."""
    design: LatticeDesign = BARE
    world: World = field(default_factory=World)
    hill: Hill | None = None
    adaptation: Adaptation | None = None
    checks: Mapping[str, Any] = field(default_factory=dict)
    """Those of `simulate` that are on."""

    def build(self) -> RodModel:
        """Model of the worm."""
        lattice = build_lattice(self.design)
        return build_model(lattice, named_layout("extension", lattice), self.world, hill=self.hill)


CRAWL = replace(BARE, base="free")
FEATURES = (
    Feature(name="bare", difference="default design without rotational damping, nothing around"),
    Feature(
        name="rotational damping",
        difference="the default design: the benchmark scene",
        design=LatticeDesign(),
    ),
    Feature(name="gravity and medium", difference="weight, buoyancy and drag", world=World(medium=MEDIUM)),
    Feature(
        name="ground",
        difference="the world of crawl: free, lying, gravity and medium, a ground with friction",
        design=CRAWL,
        world=Crawl.world(build_lattice(CRAWL)),
    ),
    Feature(
        name="friction by direction",
        difference="the same, other coefficients forwards, backwards, sideways and at rest",
        design=CRAWL,
        world=World(medium=Medium(), ground=BY_DIRECTION, lying=True),
    ),
    Feature(name="ball", difference="that of transport, held by two rings, without weight", world=World(ball=BALL)),
    Feature(
        name="self-contact",
        difference="every element of a rod may touch those of others",
        world=World(contact=Contact()),
    ),
    Feature(name="Hill muscles", difference="force by length and speed in every muscle element", hill=Hill()),
    Feature(
        name="muscles as lines",
        difference="no muscle rods: a force between two nodes",
        design=replace(BARE, muscle_model="line"),
    ),
    Feature(name="adaptation", difference="strengths brought up to date each control step", adaptation=ADAPTATION),
    Feature(name="energy ledger", difference="`energy_check=True`", checks={"energy_check": True}),
    Feature(
        name="step check",
        difference="`step_check=True`: a run at half the step beside it",
        checks={"step_check": True},
    ),
    Feature(
        name="all together",
        difference="all of these, but muscles as rods",
        design=replace(LatticeDesign(), base="free"),
        world=World(medium=MEDIUM, ground=BY_DIRECTION, ball=BALL, contact=Contact(), lying=True),
        hill=Hill(),
        adaptation=ADAPTATION,
        checks={"energy_check": True, "step_check": True},
    ),
)
"""The bare scene first."""


def _timer(feature: Feature, n_control: int) -> Callable[[], float]:
    """Find the seconds per step over so many control steps from rest."""
    model = feature.build()
    engine = simulate("fused", model, BENCHMARK_DT, **feature.checks)
    active, n_substeps, adaptation = np.ones(model.n_muscle), round(CONTROL_DT / BENCHMARK_DT), feature.adaptation

    def control() -> None:
        strength = None if adaptation is None else adaptation.initial(model.n_muscle)
        for _ in range(n_control):
            pull = TENSION * active if strength is None else TENSION * strength.factor
            health = engine.advance(pull, n_substeps)
            if not health.ok:
                raise RuntimeError(f"{feature.name}: {health}")
            if adaptation is not None and strength is not None:
                strain = muscle_strain(model, engine.state.position)
                strength = adaptation.advance(strength, active, pull, strain, CONTROL_DT)

    def timed() -> float:
        engine.restore(model.rest_state())
        return seconds(control) / (n_control * n_substeps)

    return timed


def feature_costs(features: Iterable[Feature], repeats: int, n_control: int) -> dict[str, list[float]]:
    """Seconds per step with each feature, by name; control steps are those of the environment."""
    return interleaved({feature.name: _timer(feature, n_control) for feature in features}, repeats, "features")
