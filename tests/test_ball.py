"""A rigid ball among rods: it rests, bounces, spins and is held as formulas say, and odd balls are refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from ball_scenes import RADIUS, REACH, ROD, SOFT, ball, momenta, rails, thrown, worm
from elastica.contact_forces import RodSphereContact
from elastica.rigidbody.sphere import Sphere
from elastica.rod.cosserat_rod import CosseratRod
from hypothesis import given, settings
from hypothesis import strategies as st

from lattice_gym.engines.registry import EngineName
from lattice_gym.engines.simulation import simulate
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.critical_step import critical_dt
from lattice_gym.physics.energy import EnergyMeter
from lattice_gym.physics.laws.ball import Ball, RigidBall
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.rod import straight_rod

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("half", [0.0, 0.05])
def test_rest(engine_name: EngineName, half: float) -> None:
    """On one rail it sinks in by weight / k, between two by its share along either normal."""
    upright = np.sqrt(REACH**2 - half**2)
    model = RodModel(**rails(*({-half, half})), ball=ball(upright, stiffness=1e3, damping=40.0, force=(0.0, 0.0, -2.0)))
    engine = simulate(engine_name, model, 1e-3)
    assert engine.advance([], 4000).ok
    x, y, z = engine.state.ball_position[0]
    distance = np.hypot(half, z)
    assert (x, y) == pytest.approx((2.0, 0.0), abs=1e-15)
    assert REACH - distance == pytest.approx(2.0 / 1e3 / (2.0 * z / distance if half else 1.0), rel=1e-9)


def test_bounce(engine_name: EngineName) -> None:
    """Without damping it comes back as fast: the step errs by at most the spring passed over within one."""
    model, start = RodModel(**rails(0.0), ball=ball(0.12)), (0.0, 0.0, -1.0)
    for dt in (4e-4, 1e-4, 2.5e-5):
        engine = simulate(engine_name, model, dt)
        engine.restore(thrown(model, start))
        assert engine.advance([], round(0.06 / dt)).ok
        velocity = engine.state.ball_velocity[0]
        assert abs(velocity[2] ** 2 - 1.0) < (100.0 * dt) ** 2
        assert velocity[2] > 0.0


def test_a_damped_bounce(engine_name: EngineName) -> None:
    """With a dashpot the contact pushes and never pulls: up to the end of the push it is a damped oscillator."""
    damping, mass, stiffness = 30.0, 1.0, 1e4
    model = RodModel(**rails(0.0), ball=ball(REACH, damping=damping, mass=mass, stiffness=stiffness))
    decay, rate = 0.5 * damping / mass, np.sqrt(stiffness / mass - (0.5 * damping / mass) ** 2)
    # k depth = c v_n where tan(rate t) = -2 decay rate / (rate^2 - decay^2): then the push ends for good.
    end = (np.pi - np.arctan2(2.0 * decay * rate, rate**2 - decay**2)) / rate
    left = np.exp(-decay * end) * abs(np.cos(rate * end) - decay / rate * np.sin(rate * end))
    engine = simulate(engine_name, model, 1e-5)
    engine.restore(thrown(model, (0.0, 0.0, -1.0)))
    assert engine.advance([], 5000).ok
    assert engine.state.ball_velocity[0, 2] == pytest.approx(left, rel=1e-3)


def test_friction_spins_the_ball(engine_name: EngineName) -> None:
    """Sliding, it slows by mu g and spins up by mu N r / I; then it rolls, at the speed that the two laws give."""
    friction, gravity, stiffness = 0.3, 9.81, 1e5
    arm = REACH - gravity / stiffness
    model = RodModel(
        **rails(0.0),
        ball=ball(arm, stiffness=stiffness, friction=friction, force=(0.0, 0.0, -gravity)),
    )
    assert model.ball is not None
    inertia = model.ball.inertia
    assert inertia == pytest.approx(0.4 * RADIUS**2)
    engine = simulate(engine_name, model, 1e-4)
    engine.restore(thrown(model, (1.0, 0.0, 0.0)))
    assert engine.advance([], 500).ok
    state = engine.state
    assert state.ball_velocity[0] == pytest.approx([1.0 - friction * gravity * 0.05, 0.0, 0.0], abs=1e-10)
    assert state.ball_omega[0] == pytest.approx([0.0, friction * gravity * arm / inertia * 0.05, 0.0], abs=1e-8)
    assert engine.advance([], 4000).ok
    state = engine.state
    rolling = arm**2 / (inertia + arm**2)
    assert state.ball_velocity[0, 0] == pytest.approx(rolling, abs=1e-10)
    assert state.ball_omega[0, 1] * arm == pytest.approx(rolling, abs=1e-10)


def gripped(load: tuple[float, float, float]) -> RodModel:
    """Ball of 1 kg that a rail on either side presses with 1 N, with a friction of 0.3; the load is its only other."""
    depth, stiffness = 1e-3, 1e3
    across = REACH - depth
    return RodModel(**rails(-across, across), ball=ball(0.0, stiffness=stiffness, friction=0.3, force=load))


@pytest.mark.parametrize("dt", [1e-3, 2.5e-4])
def test_friction_holds(engine_name: EngineName, dt: float) -> None:
    """Below the limit of 0.6 N it stays, but for what the sweeps leave of the speed that the load adds in a step.

    Friction of one adds 1 / m + arm^2 / inertia to its own slip and 1 / m - arm^2 / inertia to that of the other: what
    one leaves after the other is their ratio, 0.5. In six sweeps forth and back they take turns thirteen times.
    """
    time, load, arm = 1.0, 0.57, REACH - 1e-3
    model = gripped((0.8 * load, 0.0, -0.6 * load))
    assert model.ball is not None
    turning = arm**2 / model.ball.inertia
    engine = simulate(engine_name, model, dt)
    assert engine.advance([], round(time / dt)).ok
    way = engine.state.ball_position[0] - model.rest_state().ball_position[0]
    assert np.linalg.norm(way) < ((turning - 1.0) / (turning + 1.0)) ** 12 * load * dt * time


def test_friction_yields(engine_name: EngineName) -> None:
    """Above the limit it slides off with what the load has beyond it: without error, as the force is constant."""
    model = gripped((0.9, 0.0, 0.0))
    engine = simulate(engine_name, model, 1e-3)
    assert engine.advance([], 500).ok
    state = engine.state
    assert state.ball_position[0] == pytest.approx([2.0 + 0.5 * 0.3 * 0.5**2, 0.0, 0.0], abs=1e-12)
    assert state.ball_velocity[0] == pytest.approx([0.3 * 0.5, 0.0, 0.0], abs=1e-12)
    assert state.ball_omega[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize("shorter", [1, 4])
def test_a_worm_holds_it(shorter: int) -> None:
    """By friction alone, below a tenth of its limit: while rods settle it creeps by less than 1/1000 of their radius.

    Where two elements touch it beside the node they share, as good as at one place, the sweeps leave some slip, which
    is a stiff dashpot to what goes on settling there.
    """
    model, dt = worm(Medium(density=967.0), friction=0.3)
    engine = simulate("fused", model, dt / shorter, "symmetric")
    pull, height = np.full(model.n_muscle, 0.2), []
    for time in (3.0, 1.5):
        assert engine.advance(pull, round(time / engine.dt)).ok
        height.append(engine.state.ball_position[0, 2])
    assert abs(height[1] - height[0]) < 1e-3 * model.rods[0].radius[0]


@pytest.mark.parametrize("friction", [0.03, 0.3, 100.0])
def test_friction_feeds_nothing(engine_name: EngineName, friction: float) -> None:
    """Among free rods that move at random a step with it leaves less kinetic energy than one without."""
    rods = tuple(straight_rod((-0.3, y, 0.0), (0.3, y, 0.0), 12, **SOFT) for y in (-0.1, 0.0, 0.1))
    rubbing = ball(0.0, position=np.array([0.01, 0.02, 0.03]), friction=friction, mass=0.3)
    model, left, rng = RodModel(rods=rods, ball=rubbing), [], np.random.default_rng(4)
    start = replace(
        thrown(model, (0.3, -0.2, -0.1)),
        velocity=0.1 * rng.standard_normal((model.n_node, 3)),
        ball_omega=np.array([[5.0, 3.0, -2.0]]),
    )
    for one in (model, replace(model, ball=replace(rubbing, friction=0.0))):
        engine = simulate(engine_name, one, 1e-4)
        engine.restore(start)
        assert engine.advance([], 1).ok
        stored = EnergyMeter(one).stored(engine.state)
        left.append(float(stored.parts["translation"].sum() + stored.parts["ball"].sum()))
        # The rods' own discrete law keeps angular momentum to the order of the step.
        assert np.abs(momenta(one, engine.state) - momenta(one, start)).max() < 1e-10
    assert left[0] < left[1] - 1e-4


@pytest.mark.parametrize("x", [0.0, 0.07, 0.15, 0.29, 0.31])
def test_momentum(engine_name: EngineName, x: float) -> None:
    """Off-centre hits of a free rod, with friction, at a node, within an element, at and past its end."""
    rod = straight_rod((-0.3, 0.01, 0.0), (0.3, 0.01, 0.0), 4, **ROD)
    hitting = RigidBall(
        position=np.array([x, 0.03, 0.105]), radius=RADIUS, mass=0.3, stiffness=1e4, damping=3.0, friction=0.5
    )
    model = RodModel(rods=(rod,), ball=hitting)
    start = replace(thrown(model, (0.3, -0.2, -1.0)), ball_omega=np.array([[5.0, 3.0, -2.0]]))
    engine = simulate(engine_name, model, 1e-5)
    engine.restore(start)
    before = momenta(model, start)
    assert engine.advance([], 1).ok
    after = engine.state
    assert np.abs(after.ball_omega - start.ball_omega).max() > 1e-3
    assert np.abs(momenta(model, after) - before).max() < 1e-15
    assert engine.advance([], 500).ok
    after = engine.state
    assert np.abs(after.ball_velocity - start.ball_velocity).max() > 0.1
    assert np.abs(momenta(model, after)[0] - before[0]).max() < 1e-14
    # The rod's own discrete law keeps angular momentum to the order of the step.
    assert np.abs(momenta(model, after)[1] - before[1]).max() < 1e-9


def test_two_bodies(engine_name: EngineName) -> None:
    """Off the middle of a short stiff rod, the ball leaves as from a rigid body that turns and gives way, to 1 %."""
    rod = straight_rod(
        (-0.05, 0.0, 0.0), (0.05, 0.0, 0.0), 2, radius=0.02, density=1e3, youngs_modulus=1e8, shear_modulus=4e7
    )
    place, stiffness, arm = np.array([0.025, 0.0, RADIUS + 0.0201]), 1e4, 0.025
    model = RodModel(rods=(rod,), ball=ball(0.0, position=place, stiffness=stiffness, mass=2.0))
    inertia = float(rod.mass @ rod.position[:, 0] ** 2 + rod.inertia.sum())
    effective = 1.0 / (1.0 / 2.0 + 1.0 / rod.mass.sum() + arm**2 / inertia)
    engine = simulate(engine_name, model, 0.5 * critical_dt(model))
    engine.restore(thrown(model, (0.0, 0.0, -0.1)))
    contact = np.pi * np.sqrt(effective / stiffness)
    assert engine.advance([], round((0.001 + 1.5 * contact) / engine.dt)).ok
    gained = engine.state.ball_velocity[0, 2] + 0.1
    assert gained == pytest.approx(2.0 * effective / 2.0 * 0.1, rel=0.01)


ODD: st.SearchStrategy[object] = st.one_of(
    st.floats(max_value=0.0, exclude_max=True), st.sampled_from([np.nan, np.inf, "1", None, True, [], 1j, (1.0, 2.0)])
)


@settings(deadline=None, max_examples=100)
@given(st.sampled_from(["radius", "mass", "stiffness", "damping", "friction"]), ODD)
def test_refused_numbers(name: str, value: object) -> None:
    """Each is named."""
    with pytest.raises(ValueError, match=rf"Ball\.{name}"):
        ball(1.0, **{name: value})


@settings(deadline=None, max_examples=50)
@given(
    st.sampled_from(["position", "force"]),
    st.sampled_from([(1.0, 2.0), np.nan, (0.0, np.inf, 0.0), "up", None, np.zeros((2, 3)), [True] * 3]),
)
def test_refused_vectors(name: str, value: object) -> None:
    """Each is named."""
    with pytest.raises(ValueError, match=rf"Ball\.{name}"):
        ball(1.0, **{name: value})


def test_refused_balls() -> None:
    """A size that no number can hold; anything but a ball; a state that does not fit."""
    with pytest.raises(ValueError, match=r"Ball\.radius, mass"):
        ball(1.0, radius=1e-200)
    rods = rails(0.0)["rods"]
    for other in (1, "ball", Ball()):
        with pytest.raises(ValueError, match="ball"):
            RodModel(rods=rods, ball=other)  # type: ignore[arg-type]
    plain, model = RodModel(rods=rods), RodModel(rods=rods, ball=ball(1.0))
    for name in ("ball_position", "ball_velocity", "ball_omega"):
        bad: tuple[Any, ...] = (np.zeros((0, 3)), np.zeros(3), np.full((1, 3), np.nan), np.zeros((2, 3)))
        for value in bad:
            with pytest.raises(ValueError, match=rf"RodState\.{name}"):
                replace(model.rest_state(), **{name: value}).check(model)
        extra: dict[str, Any] = {name: np.zeros((1, 3))}
        with pytest.raises(ValueError, match=rf"RodState\.{name}"):
            replace(plain.rest_state(), **extra).check(plain)


def test_why_not_pyelasticas_contact() -> None:
    """Its RodSphereContact lies half an element off, and its friction turns no ball.

    A ball rests on a rod from x = 0 to 1, 1 mm deep, with k = 100 N/m: 0.1 N wherever it lies above the rod. PyElastica
    gives nothing within half an element of its start.
    """
    found = {}
    for x in (0.05, 0.1, 0.13, 0.5):
        rod = CosseratRod.straight_rod(
            4, np.zeros(3), np.eye(3)[0], np.eye(3)[2], 1.0, 0.01, 1e3, youngs_modulus=1e6, shear_modulus=4e5
        )
        sphere = Sphere(np.array([x, 0.0, 0.059]), 0.05, 1e3)
        sphere.velocity_collection[:, 0] = [1.0, 0.0, 0.0]
        contact = RodSphereContact(k=100.0, nu=0.0, velocity_damping_coefficient=1e3, friction_coefficient=0.3)
        contact.apply_contact(rod, sphere)
        found[x] = sphere.external_forces[:, 0]
        assert not sphere.external_torques.any()
    assert found[0.5] == pytest.approx([-0.03, 0.0, 0.1])
    assert found[0.13] == pytest.approx([-0.03, 0.0, 0.1])
    assert not found[0.1].any()
    assert not found[0.05].any()
