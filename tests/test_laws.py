"""Every law's plain formula against one step of both engines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.registry import EngineName
from lattice_gym.engines.simulation import simulate
from lattice_gym.physics.assembly import LAWS, RodModel
from lattice_gym.physics.laws.ball import BallLaw, RigidBall
from lattice_gym.physics.laws.base import Generalised, Law
from lattice_gym.physics.laws.contact import Contact, ContactLaw
from lattice_gym.physics.laws.damping import DampingLaw, coefficients
from lattice_gym.physics.laws.elasticity import ElasticityLaw
from lattice_gym.physics.laws.ground import Ground, GroundLaw
from lattice_gym.physics.laws.hill import Hill, HillLaw
from lattice_gym.physics.laws.joints import Joint, JointLaw
from lattice_gym.physics.laws.lines import Line, LineLaw
from lattice_gym.physics.laws.loads import LoadLaw, PointForce, PointTorque
from lattice_gym.physics.laws.medium import MediumLaw
from lattice_gym.physics.laws.muscles import MuscleLaw
from lattice_gym.physics.rod import straight_rod
from lattice_gym.physics.state import RodState

pytestmark = pytest.mark.slow

DT = 1e-4
SOFT: dict[str, Any] = {"radius": 0.02, "density": 800.0, "youngs_modulus": 3e3, "shear_modulus": 1e3}
LOADS: dict[str, Any] = {
    "forces": (PointForce(1, 2, (0.1, 0.2, -0.3)),),
    "torques": (PointTorque(0, 1, (1e-3, 2e-3, 3e-3)),),
}
PARTS: dict[type[Law], dict[str, Any]] = {
    ElasticityLaw: {},
    JointLaw: {"joints": (Joint(0, 3, 1, 0, 40.0, 0.3), Joint(1, 2, 2, 0, 30.0))},
    MuscleLaw: {"muscles": (2,)},
    LineLaw: {"lines": (Line(0, 1, 1, 2, 0.2, 5.0, 0.01), Line(0, 3, 2, 1, 0.3, 4.0))},
    HillLaw: {"muscles": (2,), "lines": (Line(0, 1, 1, 2, 0.2, 5.0),), "hill": Hill(optimal_length=1.1, max_speed=4.0)},
    MediumLaw: LOADS | {"gravity": np.array([1.0, -2.0, -9.0]), "medium_density": 300.0,
                        "lines": (Line(0, 1, 1, 2, 0.2, 1.0, 0.1),)},
    LoadLaw: LOADS | {"lines": (Line(0, 1, 1, 2, 0.2, 1.0),)},
    GroundLaw: {"ground": Ground(stiffness=50.0, damping=0.5, static_friction=0.0, kinetic_friction=0.0),
                "forces": LOADS["forces"]},
    BallLaw: {"ball": RigidBall(position=np.array([0.12, 0.03, 0.02]), radius=0.05, mass=0.3, stiffness=60.0,
                                damping=0.8, force=(0.1, -0.2, 0.3))},
    ContactLaw: {"contact": Contact(stiffness=70.0, damping=0.6)},
    DampingLaw: {"medium_drag": 0.4},
}  # fmt: skip
"""What a model needs for each law to act. Laws that share a scene share its compiled code."""


def _model(**parts: Any) -> RodModel:
    """Three rods near each other and near the ground, of which the last may be a muscle."""
    damped = {"damping": 0.05, "rotational_damping": 2e-5} if "medium_drag" in parts else {}
    rods = (
        straight_rod((0, 0, 0.01), (0.4, 0, 0.01), 4, **SOFT, **damped),
        straight_rod((0.31, 0.05, 0.045), (0.31, -0.25, 0.045), 3, **SOFT | {"radius": 0.015}, **damped),
        straight_rod((0.1, -0.2, 0.05), (0.1, 0.2, 0.05), 3, **SOFT, **damped),
    )
    return RodModel(rods=rods, **parts)


def _turned(directors: FloatArray, angle: FloatArray) -> FloatArray:
    """Directors turned by rotation vectors [rad], in the material frame (Rodrigues)."""
    size = np.linalg.norm(angle, axis=1)[:, None, None]
    k = np.cross(np.eye(3)[None], angle[:, None, :])
    turn = np.eye(3) + np.sinc(size / np.pi) * k + 0.5 * np.sinc(size / (2.0 * np.pi)) ** 2 * k @ k
    turned: FloatArray = turn.transpose(0, 2, 1) @ directors
    return turned


def _shaken(model: RodModel, seed: int) -> RodState:
    """State around rest in which all is strained, turned and moves."""
    rng, rest = np.random.default_rng(seed), model.rest_state()
    return replace(
        rest,
        position=rest.position + 0.005 * rng.standard_normal(rest.position.shape),
        velocity=0.5 * rng.standard_normal(rest.velocity.shape),
        directors=_turned(rest.directors, 0.2 * rng.standard_normal(rest.omega.shape)),
        omega=3.0 * rng.standard_normal(rest.omega.shape),
        ball_velocity=0.5 * rng.standard_normal(rest.ball_velocity.shape),
        ball_omega=3.0 * rng.standard_normal(rest.ball_omega.shape),
    )


def _drifted(state: RodState) -> RodState:
    """Half a step on at its speed: where forces are taken."""
    return replace(
        state,
        position=state.position + 0.5 * DT * state.velocity,
        directors=_turned(state.directors, 0.5 * DT * state.omega),
        ball_position=state.ball_position + 0.5 * DT * state.ball_velocity,
    )


def _changes(engine_name: EngineName, model: RodModel, state: RodState, tension: FloatArray) -> Generalised:
    """Find the forces and couples that make what a step changes, damping left out."""
    engine = simulate(engine_name, model, DT)
    engine.restore(state)
    engine.advance(tension, 1)
    after = engine.state
    side = _drifted(state).position
    length = np.linalg.norm(side[model.lower_node + 1] - side[model.lower_node], axis=1)
    inertia = (model.rod_array("inertia") * model.rod_array("rest_length") / length)[:, None] * [1.0, 1.0, 2.0]
    mass = model.node_mass[:, None], inertia, np.reshape([ball.mass for ball in model.balls], (-1, 1))
    moved = zip(mass, Generalised.split(model, coefficients(model)),
                ((state.velocity, after.velocity), (state.omega, after.omega),
                 (state.ball_velocity, after.ball_velocity)), strict=True)  # fmt: skip
    return Generalised(*(m * (new * np.exp(c * DT / m) - old) / DT for m, c, (old, new) in moved))


def test_every_law_is_tried() -> None:
    """No law without its formula tried, and each acts in its model."""
    assert set(PARTS) == set(LAWS)
    for law, parts in PARTS.items():
        assert law in [type(found) for found in _model(**parts).laws]
    assert [type(law) for law in _model().laws] == [ElasticityLaw]


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("law", LAWS)
def test_a_step_follows_the_formula(law: type[Law], seed: int, engine_name: EngineName) -> None:
    """Nodes, elements and ball: the sum of all laws' forces half a step on, of which the law's own is no small part.

    Damping acts on what the kick leaves, exactly. PyElastica adds 1e-10 to cosines of angles, which bends by 1e-7.
    """
    model = _model(**PARTS[law])
    state, tension = _shaken(model, seed), np.linspace(0.3, 0.5, model.n_muscle)
    own = next(found for found in model.laws if type(found) is law)
    middle = _drifted(state)
    assert max(np.abs(part).max(initial=0.0) for part in own.force(middle, tension)) > 1e-3
    total = [found.force(middle, tension) for found in model.laws if not isinstance(found, DampingLaw)]
    for found, *expected in zip(_changes(engine_name, model, state, tension), *total, strict=True):
        np.testing.assert_allclose(found, sum(expected), rtol=1e-6, atol=1e-6 * np.abs(found).max(initial=0.0))


def test_damping_is_its_formula_in_a_small_step(engine_name: EngineName) -> None:
    """A rod that moves as a whole loses what -c v takes."""
    model = RodModel(rods=(straight_rod((0, 0, 0), (1, 0, 0), 3, **SOFT, damping=0.05),), medium_drag=0.4)
    state = replace(model.rest_state(), velocity=np.tile((0.3, -0.2, 0.1), (4, 1)))
    engine = simulate(engine_name, model, 1e-6)
    engine.restore(state)
    engine.advance([], 1)
    found = model.node_mass[:, None] * (engine.state.velocity - state.velocity) / 1e-6
    law = next(law for law in model.laws if isinstance(law, DampingLaw))
    np.testing.assert_allclose(found, law.force(state, np.zeros(0)).node, rtol=1e-5)


@pytest.mark.parametrize("direction", [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.6, -0.8)])
@pytest.mark.parametrize("speed", [1e-6, 0.3])
def test_friction_of_the_ground_follows_the_formula(
    direction: tuple[float, float], speed: float, engine_name: EngineName
) -> None:
    """What slip it leaves, in every direction of a body, stuck or not; rods that slide whole."""
    ground = Ground(stiffness=50.0, static_friction=0.6, kinetic_friction=0.4, forward=0.5, backward=2.0, sideways=0.8)
    model = RodModel(rods=(straight_rod((0, 0, 0.018), (1, 0, 0.018), 3, **SOFT),), ground=ground)
    state = model.rest_state()
    state = replace(state, velocity=state.velocity + speed * np.array([*direction, 0.0]))
    law = next(law for law in model.laws if isinstance(law, GroundLaw))
    normal = law.force(_drifted(state), np.zeros(0)).node[:, 2]
    expected = ground.apply_friction(state.velocity[:, :2], normal, DT / model.node_mass, np.array([1.0, 0.0, 0.0]))
    engine = simulate(engine_name, model, DT)
    engine.restore(state)
    engine.advance([], 1)
    np.testing.assert_allclose(engine.state.velocity[:, :2], expected, rtol=1e-9, atol=1e-15)
    assert (speed > 1e-3) == bool(expected.any())


def _rubbed(engine_name: EngineName, model: RodModel, pace: float) -> tuple[float, IntArray]:
    """Largest error of what friction changes in a step, over the change, and which touches of the ball it stops."""
    rest, shaken = model.rest_state(), _shaken(model, 0)
    state = replace(
        rest, **{name: pace * getattr(shaken, name) for name in ("velocity", "ball_velocity", "ball_omega")}
    )
    middle, push = _drifted(state), DT / model.node_mass
    law = next(law for law in model.laws if isinstance(law, BallLaw))
    forces, normal = [found.force(middle, np.zeros(0)) for found in model.laws], law.normal_force(middle)
    kicked = replace(
        middle,
        velocity=state.velocity + push[:, None] * sum(force.node for force in forces),
        ball_velocity=state.ball_velocity + DT / law.ball.mass * sum(force.ball for force in forces),
    )
    formula = law.apply_friction(kicked, normal, push, DT)
    engine = simulate(engine_name, model, DT)
    engine.restore(state)
    engine.advance([], 1)
    errors = []
    for name in ("velocity", "ball_velocity", "ball_omega"):
        found, left, before = (getattr(of, name) for of in (engine.state, formula, kicked))
        errors.append(np.abs(found - left).max() / np.abs(left - before).max())
    slip = np.linalg.norm(law.slip(formula), axis=1)
    return max(errors), np.flatnonzero((normal > 0.0) & (slip < 1e-12))


@pytest.mark.parametrize(("friction", "pace"), [(0.02, 1.0), (0.3, 0.003)])
def test_slip_against_the_ball_follows_the_formula(friction: float, pace: float, engine_name: EngineName) -> None:
    """Of four touches at once, two on each of two rods, fast and slow."""
    error, stopped = _rubbed(engine_name, _model(ball=replace(PARTS[BallLaw]["ball"], friction=friction)), pace)
    assert error < 1e-7
    assert stopped.size == 0


def test_a_touch_that_sticks_follows_the_formula(engine_name: EngineName) -> None:
    """Friction takes all its slip, to rounding."""
    place = np.array([0.15, 0.03, 0.05])
    model = _model(ball=replace(PARTS[BallLaw]["ball"], position=place, friction=50.0))
    error, stopped = _rubbed(engine_name, replace(model, rods=model.rods[:1]), 0.003)
    assert error < 1e-9
    assert stopped.tolist() == [1]


@pytest.mark.parametrize(("friction", "stick"), [(1.0, 1), (3.0, 2), (30.0, 4)])
def test_touches_that_stick_together_follow_the_formula(
    friction: float, stick: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where sweeps may go on: six leave some of the slip, and take it in the steps that follow."""
    monkeypatch.setattr("lattice_gym.engines.pyelastica.ball._SWEEPS", 1000)
    error, stopped = _rubbed("pyelastica", _model(ball=replace(PARTS[BallLaw]["ball"], friction=friction)), 0.003)
    assert error < 1e-6
    assert len(stopped) == stick


@pytest.mark.parametrize("law", [JointLaw, LineLaw, MediumLaw, GroundLaw, BallLaw, ContactLaw])
def test_springs_are_the_slope_of_the_energy(law: type[Law]) -> None:
    """Where nothing moves or pulls, a law's force is minus the slope of what it stores."""
    model = _model(**PARTS[law])
    own = next(found for found in model.laws if type(found) is law)
    still = replace(model.rest_state(), position=_shaken(model, 2).position)

    def energy(shift: FloatArray) -> float:
        stored = own.energy(replace(still, position=still.position + shift))
        return sum(float(part.sum()) for part in stored.values())

    force = own.force(still, np.zeros(model.n_muscle)).node
    for node, axis in ((0, 2), (3, 0), (6, 1), (8, 2), (10, 0)):
        shift = np.zeros_like(force)
        shift[node, axis] = 1e-6
        assert -(energy(shift) - energy(-shift)) / 2e-6 == pytest.approx(force[node, axis], rel=1e-5, abs=1e-7)


@pytest.mark.parametrize("law", LAWS)
def test_laws_store_and_work_by_place(law: type[Law]) -> None:
    """Energies are arrays of finite numbers; only weights count from anywhere."""
    model = _model(**PARTS[law])
    own = next(found for found in model.laws if type(found) is law)
    stored = own.energy(_shaken(model, 3))
    assert all(np.isfinite(part).all() and part.ndim == 1 for part in stored.values())
    assert own.gauge is (law is MediumLaw)
    assert all((part >= 0.0).all() for part in stored.values()) or own.gauge


@pytest.mark.parametrize(
    ("shown", "part"),
    [
        (lambda model: repr(model), "RodModel(3 rods, 13 nodes, 0 muscles, 0 joints; ElasticityLaw)"),
        (lambda model: repr(model.rest_state()), "RodState(13 nodes, 10 elements, 0 balls, time 0 s)"),
        (lambda model: repr(model.rods[1]), "Rod(3 elements, length 0.3 m)"),
    ],
)
def test_large_things_are_shown_in_a_line(shown: Callable[[RodModel], str], part: str) -> None:
    """Counts instead of arrays."""
    assert shown(_model()) == part


def test_a_scaled_model_has_its_own_laws() -> None:
    """The laws of a model are not those of the one that it was scaled from."""
    model = _model(**PARTS[JointLaw])
    softer, rest = model.scaled(0.5, 1.0, 1.0), model.rest_state()
    state = replace(rest, position=1.1 * rest.position)
    one, other = (next(iter(of.laws)).energy(state)["stretch"] for of in (model, softer))
    np.testing.assert_allclose(other, 0.5 * one)
