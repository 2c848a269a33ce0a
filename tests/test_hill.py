"""Force by length and speed: the stated force on both engines, both engines the same, the books and the step sound."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.health import Status
from lattice_gym.engines.registry import EngineName
from lattice_gym.engines.simulation import Simulation, simulate
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.critical_step import critical_dt, default_dt
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.laws.lines import Line
from lattice_gym.physics.laws.loads import PointForce
from lattice_gym.physics.rod import straight_rod
from lattice_gym.physics.worm import build_model

pytestmark = pytest.mark.slow

SOFT: dict[str, Any] = {"radius": 0.05, "density": 1000.0, "youngs_modulus": 10.0, "shear_modulus": 4.0}
SLOW = Hill(max_speed=2.0)
"""Slow enough that the motions below show it."""


def by_hand(hill: Hill, length: float, rate: float) -> float:
    """Force over tension, from the table of the class."""
    factor = 1.0
    if hill.width is not None:
        factor *= math.exp(-(((length / hill.optimal_length - 1.0) / hill.width) ** 2))
    if hill.max_speed is not None:
        v, c = rate / hill.max_speed, (2.0 + 2.0 / hill.curvature) / (hill.eccentric - 1.0)
        if v <= -1.0:
            factor = 0.0
        elif v <= 0.0:
            factor *= (1.0 + v) / (1.0 - v / hill.curvature)
        else:
            factor *= (1.0 + c * hill.eccentric * v) / (1.0 + c * v)
    return factor


def pull_after_a_step(name: EngineName, model: RodModel, length: float, rate: float, tension: float) -> float:
    """Force with which a muscle pulls on node 0 [N]: what it adds to the kick of a step.

    All of the model moves with `rate` from its rest shape times `length` at the kick.
    """
    dt, rest, speed = 1e-4, model.rest_state(), []
    for pull in (tension, 0.0):
        engine = simulate(name, model, dt)
        start = length - 0.5 * dt * rate
        engine.restore(replace(rest, position=start * rest.position, velocity=rate * rest.position))
        assert engine.advance([pull], 1).ok
        speed.append(engine.state.velocity[0])
    return float(model.node_mass[0] / dt * (speed[0] - speed[1])[2])


MUSCLES = {
    "rod": RodModel(rods=(straight_rod((0, 0, -1), (0, 0, 1), 3, **SOFT),), muscles=(0,)),
    "line": RodModel(rods=(straight_rod((0, 0, -1), (0, 0, 1), 3, **SOFT),), lines=(Line(0, 0, 0, 3, 2.0, 3.0, 0.5),)),
}
"""Length over rest length, and its rate, are those of the whole."""


@pytest.mark.parametrize("muscle", list(MUSCLES))
@pytest.mark.parametrize("hill", [Hill(), Hill(width=None), Hill(max_speed=None, optimal_length=1.2), SLOW,
                                  Hill(width=0.4, max_speed=3.0, curvature=0.5, eccentric=1.8)])  # fmt: skip
@pytest.mark.parametrize(("length", "rate"), [(1.0, 0.0), (0.6, 0.0), (1.5, 0.0), (0.8, -0.7), (1.0, -1.999),
                                              (1.1, -4.0), (0.9, 0.3), (1.0, 50.0)])  # fmt: skip
def test_the_stated_force(engine_name: EngineName, muscle: str, hill: Hill, length: float, rate: float) -> None:
    """A muscle held at a length, or made to shorten or lengthen at a speed, pulls with the force of the formula."""
    model = replace(MUSCLES[muscle], hill=hill)
    force = pull_after_a_step(engine_name, model, length, rate, 5.0)
    assert force == pytest.approx(5.0 * by_hand(hill, length, rate), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.8, 1.1, 1.3])
def test_a_loaded_muscle_goes_at_hills_speed(engine_name: EngineName, share: float) -> None:
    """A load F on the end of a muscle of tension P goes at v = (F - P) / (P + F / A), Hill's equation.

    Beyond P the muscle yields, at (F - P) (M - 1) / ((2 + 2 / A) (M P - F)). The rod that bears the load keeps that
    speed to rounding, and comes nearer to it from another.
    """
    hill, tension = Hill(width=None, max_speed=0.2), 20.0
    rods = tuple(straight_rod((0, 0, z), (0, 0, z + 1.0), 2, **(SOFT | {"youngs_modulus": 1e6})) for z in (-1.0, 1.0))
    model = RodModel(
        rods=rods,
        lines=(Line(0, 2, 1, 0, 1.0, 0.0),),
        clamps=tuple(Clamp(0, node=k) for k in range(3)),
        forces=(PointForce(1, 0, (0.0, 0.0, share * tension)),),
        hill=hill,
    )
    a, m = hill.curvature, hill.eccentric
    speed = (share - 1.0) / (1.0 + share / a)
    if share > 1.0:
        speed = (share - 1.0) * (m - 1.0) / ((2.0 + 2.0 / a) * (m - share))
    speed *= 0.2
    ends = []
    for start in (speed, 0.8 * speed):
        engine = simulate(engine_name, model, 2e-4)
        velocity = np.zeros((6, 3))
        velocity[3:, 2] = start
        engine.restore(replace(model.rest_state(), velocity=velocity))
        assert engine.advance([tension], 1000).ok
        ends.append(engine.state.velocity[3:, 2])
    np.testing.assert_allclose(ends[0], speed, rtol=1e-9)
    assert abs(ends[1].mean() - speed) < 0.15 * abs(speed)


def books(engine: Simulation) -> FloatArray:
    """Muscle work, dissipation, stored energy and residual of ramps up and down [J]."""
    total: FloatArray = np.zeros(4)
    pull = np.full(engine.model.n_muscle, 20.0)
    for ramp in ([0.0 * pull, pull], [pull, 0.0 * pull]) * 2:
        assert engine.advance(ramp, round(0.1 / engine.dt)).ok
        entry = engine.ledger
        assert entry is not None
        total += [entry.muscle_work, entry.dissipated, entry.stored, entry.residual]
    return total


def swinging(muscle: str, hill: Hill | None) -> RodModel:
    """Make a stiff muscle with one end held, a rod, a line or both side by side."""
    stiff = {"youngs_modulus": 2e4, "damping": 0.5, "rotational_damping": 1e-3}
    rod = straight_rod((0, 0, 0), (0, 0, 1), 3, **(SOFT | stiff))
    lines = () if muscle == "rod" else (Line(0, 0, 0, 3, 1.0, 50.0),)
    muscles = () if muscle == "line" else (0,)
    return RodModel(rods=(rod,), lines=lines, muscles=muscles, clamps=(Clamp(0, node=0, element=0),), hill=hill)


@pytest.mark.parametrize("muscle", ["rod", "line"])
@pytest.mark.parametrize("hill", [Hill(max_speed=None), SLOW, Hill(width=None, max_speed=2.0, eccentric=2.0)])
def test_the_ledger_counts_the_force_that_acted(muscle: str, hill: Hill) -> None:
    """What is missing falls with the square of the step; the tension alone would have done another work."""
    model = swinging(muscle, hill)
    steps = (1.25e-4, 6.25e-5, 3.125e-5)  # At larger ones the next order shows, with the line.
    found = [books(simulate("fused", model, dt, "symmetric", True)) for dt in steps]
    left = [entry[3] for entry in found]
    assert (left[0] - left[1]) / (left[1] - left[2]) > 3.8
    assert abs(left[-1]) < 1e-6 * np.abs(found[-1][:3]).sum()
    plain = books(simulate("fused", replace(model, hill=None), steps[-1], "symmetric", True))
    assert abs(found[-1][0] / plain[0] - 1.0) > 2e-3


def test_engines_keep_the_same_books(engine_pair: tuple[EngineName, EngineName]) -> None:
    """PyElastica's steps, counted in numpy, give the same work, dissipation and energy of a rod and a line."""
    model = swinging("both", SLOW)
    both = [books(simulate(name, model, 2e-4, energy_check=True)) for name in engine_pair]
    np.testing.assert_allclose(both[0], both[1], atol=1e-4 * np.abs(both[1]).max())


@pytest.mark.parametrize("options", [{}, {"muscle_model": "line"}, {"n_pairs": 3, "elements_per_muscle": 3}])
def test_engines_agree(options: dict[str, Any], engine_pair: tuple[EngineName, EngineName]) -> None:
    """Random activations: 1e-12 of the scale after a step, 1e-9 m after several hundred."""
    lattice = build_lattice(LatticeDesign(**options))
    model = build_model(lattice, named_layout("all", lattice), hill=Hill(max_speed=50.0, width=0.3))
    dt = default_dt(model, 0.05, 0.5)
    engines = [simulate(name, model, dt) for name in engine_pair]
    rng = np.random.default_rng(0)
    for engine in engines:
        assert engine.advance(np.full(model.n_muscle, 0.3), 1).ok
    a, b = (engine.state for engine in engines)
    assert np.abs(a.velocity - b.velocity).max() < 1e-12 * np.abs(b.velocity).max()
    for _ in range(5):
        ramp = rng.uniform(0.0, 0.5, (2, model.n_muscle))
        for engine in engines:
            assert engine.advance(ramp, 100).ok
    a, b = (engine.state for engine in engines)
    assert np.abs(a.position - b.position).max() < 1e-9
    for field in ("velocity", "directors", "omega"):
        first, second = getattr(a, field), getattr(b, field)
        assert np.abs(first - second).max() < 1e-9 * max(1.0, np.abs(second).max()), field


def test_factors_of_one_change_nothing(engine_name: EngineName) -> None:
    """Both factors off, or both as good as flat: the state without `hill`."""
    lattice = build_lattice(LatticeDesign(n_pairs=3))
    states = []
    for hill in (None, Hill(width=None, max_speed=None), Hill(width=1e6, max_speed=1e9)):
        model = build_model(lattice, named_layout("all", lattice), hill=hill)
        engine = simulate(engine_name, model, 2e-4)
        assert engine.advance(np.full(model.n_muscle, 0.5), 100).ok
        states.append(engine.state.position)
    assert np.abs(states[1] - states[0]).max() < 1e-15
    assert np.abs(states[2] - states[0]).max() < 1e-8


@pytest.mark.parametrize("muscle_model", ["rod", "line"])
@pytest.mark.parametrize("max_speed", [10.0, 1.0])
def test_the_lattice_bears_the_predicted_step(muscle_model: str, max_speed: float) -> None:
    """Random bang-bang tension on a worm at the predicted step: nothing blows up, nothing comes from nowhere."""
    lattice = build_lattice(LatticeDesign(n_pairs=3, elements_per_segment=2, muscle_model=muscle_model))
    model = build_model(lattice, named_layout("all", lattice), hill=Hill(max_speed=max_speed))
    engine = simulate("fused", model, critical_dt(model, 0.5, "symmetric"), "symmetric", energy_check=True)
    rng = np.random.default_rng(0)
    for _ in range(40):
        assert engine.advance(0.5 * rng.integers(0, 2, model.n_muscle), 100).ok
    assert np.abs(engine.state.velocity).max() < 1.0


def test_slack_muscles_settle_alike() -> None:
    """A worm that lies comes to rest in the same place, at the same step, whatever the law of its muscles."""
    small = {"n_pairs": 3, "period_ratio": 1.5, "elements_per_segment": 2}
    plain = LatticeWormEnv("crawl", design=small)
    with pytest.warns(UserWarning, match="hill: the physics step"):
        living = LatticeWormEnv("crawl", design=small, hill=Hill())
    assert living.dt < 0.5 * plain.dt
    np.testing.assert_allclose(living.task.rest.position, plain.task.rest.position, rtol=0.0, atol=1e-12)
    for env in (plain, living):
        env.reset(seed=0)
        assert env.step(np.ones(env.action_space.shape))[4]["status"] == Status.OK
    assert np.abs(living.state.position - plain.state.position).max() > 1e-5


def test_in_the_environment() -> None:
    """Object and dict form make the same; force that depends on speed slows a worm; anything else is refused."""
    small = {"n_pairs": 3, "period_ratio": 1.5, "elements_per_segment": 2, "muscle_model": "line"}
    reached = []
    for hill in (None, Hill(max_speed=2.0), {"max_speed": 2.0}):
        env = LatticeWormEnv("extension", design=small, hill=hill)
        env.reset(seed=0)
        reached.append(env.step(np.ones(env.action_space.shape))[4]["outcome"]["strain"])
    assert reached[1] == reached[2]
    assert 0.0 < reached[1] < 0.9 * reached[0]
    with pytest.raises(ValueError, match="hill"):
        replace(MUSCLES["rod"], hill=2.0)  # type: ignore[arg-type]
    for bad in (1, "fast", {"speed": 1.0}, {"max_speed": 0.0}, {"eccentric": 1.0}, {"curvature": None}):
        with pytest.raises(ValueError, match=r"(?i)hill"):
            LatticeWormEnv("extension", design=small, hill=bad)
