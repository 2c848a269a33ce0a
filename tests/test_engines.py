"""The engines against each other, and what each promises: exact restart, honest status, refused input."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from elastica.contact_forces import RodPlaneContact
from elastica.external_forces import GravityForces
from elastica.modules.base_system import BaseSystemCollection
from elastica.modules.contact import Contact
from elastica.modules.forcing import Forcing
from elastica.rod.cosserat_rod import CosseratRod
from elastica.surface.plane import Plane
from elastica.timestepper.symplectic_steppers import PositionVerlet
from engine_scenes import FIELDS, mixed_assembly

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.health import Status
from lattice_gym.engines.registry import EngineName
from lattice_gym.engines.simulation import simulate
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.critical_step import critical_dt, default_dt
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.rod import rotation_between, straight_rod
from lattice_gym.physics.state import RodState
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model

pytestmark = pytest.mark.slow


def largest_difference(a: RodState, b: RodState, field: str) -> float:
    """Largest absolute difference of a field of two states."""
    difference: float = np.abs(getattr(a, field) - getattr(b, field)).max()
    return difference


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"rotational_damping": 0.0},
        {"rotational_damping": 1e-3, "damping": 3.0},
        {"joint_damping": 0.01, "base": "free"},
        {"muscle_model": "line"},
        {"n_pairs": 4, "period_ratio": 1.6, "elements_per_segment": 3, "elements_per_muscle": 3},
    ],
)
def test_engines_agree(options: dict[str, Any]) -> None:
    """Random activations: 1e-12 of the scale after one step; 1e-9 m, and 1e-9 of the rest, after 0.2 s."""
    lattice = build_lattice(LatticeDesign(**options))
    model = build_model(lattice, named_layout("all", lattice))
    dt = default_dt(model, 0.05)
    fused, reference = simulate("fused", model, dt), simulate("pyelastica", model, dt)
    rng = np.random.default_rng(0)
    pull = rng.uniform(0.0, 0.5, model.n_muscle)
    assert fused.advance(pull, 1).ok
    assert reference.advance(pull, 1).ok
    a, b = fused.state, reference.state
    assert largest_difference(a, b, "position") < 1e-12 * np.abs(b.position).max()
    assert largest_difference(a, b, "velocity") < 1e-12 * np.abs(b.velocity).max()
    for _ in range(4):
        ramp = rng.uniform(0.0, 0.5, (2, model.n_muscle))
        assert fused.advance(ramp, round(0.05 / dt)).ok
        assert reference.advance(ramp, round(0.05 / dt)).ok
    a, b = fused.state, reference.state
    assert largest_difference(a, b, "position") < 1e-9
    for field in FIELDS:
        assert largest_difference(a, b, field) < 1e-9 * max(1.0, np.abs(getattr(b, field)).max()), field
    assert fused.state.time == pytest.approx(reference.state.time, rel=1e-12)


@pytest.mark.parametrize(
    ("kind", "ground"),
    [("rod", Ground()), ("line", Ground(forward=0.3, backward=1.5, sideways=0.7, static_friction=0.8))],
)
def test_engines_agree_on_the_ground(kind: str, ground: Ground, engine_pair: tuple[EngineName, EngineName]) -> None:
    """A worm in water that lies, slips and sticks: 1e-12 of the scale after one step; 1e-9 m after 0.4 s."""
    lattice = build_lattice(LatticeDesign(n_pairs=3, base="free", damping=1e-3, muscle_model=cast(Any, kind)))
    world = World(medium=Medium(drag=0.1), ground=ground, lying=True)
    model = build_model(lattice, named_layout("all", lattice), world)
    engines = [simulate(name, model, 2e-4) for name in engine_pair]
    rng = np.random.default_rng(0)
    largest, sticks, slips = [0.0, 0.0], False, False
    for n_step in (1, *[250] * 8):
        pull = rng.uniform(0.0, 0.1, (2, model.n_muscle))
        for engine in engines:
            assert engine.advance(pull, n_step).ok
        a, b = (engine.state for engine in engines)
        if n_step == 1:
            assert largest_difference(a, b, "position") < 1e-12 * np.abs(b.position).max()
            assert largest_difference(a, b, "velocity") < 1e-12 * np.abs(b.velocity).max()
        largest = [max(x, largest_difference(a, b, f)) for x, f in zip(largest, ("position", "velocity"), strict=True)]
        moves = a.velocity[a.position[:, 2] < model.node_radius, :2].any(axis=1)
        sticks, slips = sticks or not moves.all(), slips or bool(moves.any())
    assert sticks
    assert slips
    assert largest[0] < 1e-9
    assert largest[1] < 1e-6
    assert np.abs(a.position - model.rest_state().position).max() > 1e-3


@pytest.mark.parametrize(("gravity_first", "share"), [(True, 0.0), (False, 1.0)])
def test_pyelasticas_plane_rests_on_the_order_of_declaration(gravity_first: bool, share: float) -> None:
    """Why the ground of the reference is ours: PyElastica's own cancels the weight that was declared before it."""

    class Simulator(BaseSystemCollection, Contact, Forcing): ...

    stiffness, n_elem, weight = 1e4, 4, 1e3 * np.pi * 0.05**2 * 9.81
    rod = CosseratRod.straight_rod(
        n_elem, np.array([0.0, 0.0, 0.05]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), 1.0, 0.05, 1e3,
        youngs_modulus=1e5,
    )  # fmt: skip
    depth = weight / n_elem / stiffness
    rod.position_collection[2] -= 0.5 * depth
    plane, simulator = Plane(np.zeros(3), np.array([0.0, 0.0, 1.0])), Simulator()
    simulator.append(rod)
    simulator.append(plane)

    def declare(what: str) -> None:
        if what == "gravity":
            simulator.add_forcing_to(rod).using(GravityForces, acc_gravity=np.array([0.0, 0.0, -9.81]))
        else:
            simulator.detect_contact_between(rod, plane).using(RodPlaneContact, k=stiffness, nu=150.0)

    for what in ("gravity", "contact")[:: 1 if gravity_first else -1]:
        declare(what)
    simulator.finalize()
    stepper, time = PositionVerlet(), np.float64(0.0)
    for _ in range(8000):
        time = stepper.step(simulator, time, 2.5e-4)
    found = 0.05 - 0.5 * (rod.position_collection[2, 1:] + rod.position_collection[2, :-1])
    np.testing.assert_allclose(found.mean(), share * depth, atol=0.02 * depth)


def test_engines_agree_on_any_assembly(engine_pair: tuple[EngineName, EngineName]) -> None:
    """General rods: the same motion to rounding, clamps held exactly."""
    model = mixed_assembly()
    dt = 0.5 * critical_dt(model)
    engines = [simulate(name, model, dt) for name in engine_pair]
    for engine in engines:
        assert engine.advance([[0.0, 0.0], [100.0, 10.0]], 400).ok
    a, b = engines[0].state, engines[1].state
    assert np.abs(b.position - model.rest_state().position).max() > 0.02
    assert largest_difference(a, b, "position") < 1e-11
    assert largest_difference(a, b, "directors") < 1e-9
    for state in (a, b):
        assert np.array_equal(state.position[0], model.rods[0].position[0])
        assert np.array_equal(state.position[-1], model.rods[3].position[-1])
        assert np.array_equal(state.directors[0], model.rods[0].directors[0])


def spinning(omega: FloatArray) -> tuple[RodModel, RodState]:
    """Make a free rod of two elements that both turn at `omega` [rad/s]."""
    rod = straight_rod((0, 0, 0), (0, 0, 1), 2, radius=0.1, density=1e3, youngs_modulus=1e3, shear_modulus=1e3)
    model = RodModel(rods=(rod,))
    return model, replace(model.rest_state(), omega=np.tile(omega, (2, 1)))


@pytest.mark.parametrize("angle", [0.1, 0.499, 0.501, 2.0, 3.1])
def test_large_rotations_are_exact(engine_name: EngineName, angle: float) -> None:
    """One step turns the directors by exactly |omega| dt, however large: on either side of the series' reach."""
    dt = 1e-3
    model, start = spinning(np.array([0.0, 0.0, angle / dt]))
    engine = simulate(engine_name, model, dt)
    engine.restore(start)
    engine.advance([], 1)
    c, s = np.cos(angle), np.sin(angle)
    turned = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ model.rods[0].directors[0]
    assert np.abs(engine.state.directors[0] - turned).max() < 2e-15 * 4


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.3, 0.60, 0.62, 1.5, 3.0])
def test_large_bends_agree(angle: float, engine_pair: tuple[EngineName, EngineName]) -> None:
    """The couple between two elements at any angle: on either side of the series' reach, as PyElastica has it."""
    rod = straight_rod((0, 0, 0), (0, 0, 1), 2, radius=0.1, density=1e3, youngs_modulus=1e3, shear_modulus=1e3)
    model = RodModel(rods=(rod,))
    rest = model.rest_state()
    directors = rest.directors.copy()
    c, s = np.cos(angle), np.sin(angle)
    directors[1] = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]]) @ directors[1]
    omega = []
    for name in engine_pair:
        engine = simulate(name, model, 1e-4)
        engine.restore(replace(rest, directors=directors))
        engine.advance([], 1)
        omega.append(engine.state.omega)
    assert np.abs(omega[0] - omega[1]).max() <= 1e-11 * max(np.abs(omega[1]).max(), 1e-3)
    assert np.linalg.norm(rotation_between(directors[:1], directors[1:])) == pytest.approx(angle, abs=1e-14)


def test_restart_is_exact(engine_name: EngineName, lattice: Lattice) -> None:
    """A fresh engine that takes over a state goes on to the last bit; the state shares no memory with the engine."""
    model = build_model(lattice, named_layout("all", lattice))
    pull = np.random.default_rng(2).uniform(0.0, 0.5, model.n_muscle)
    first = simulate(engine_name, model, 2e-4)
    first.advance(pull, 20)
    saved = first.state
    kept = saved.copy()
    first.advance(pull, 20)
    second = simulate(engine_name, model, 2e-4)
    second.advance(0.5 * pull, 7)
    second.restore(saved)
    second.advance(pull, 20)
    for field in FIELDS:
        assert np.array_equal(getattr(first.state, field), getattr(second.state, field)), field
        assert np.array_equal(getattr(saved, field), getattr(kept, field)), field
    assert first.state.time == second.state.time == pytest.approx(40 * 2e-4)


def test_a_fresh_start_after_divergence(engine_name: EngineName, lattice: Lattice) -> None:
    """Nothing of a state that blew up is left once another is restored."""
    model = build_model(lattice, named_layout("extension", lattice))
    pull = np.full(model.n_muscle, 0.5)
    used, fresh = (simulate(engine_name, model, 2e-4) for _ in range(2))
    assert not used.advance(60.0 * pull, 300).ok
    used.restore(model.rest_state())
    for engine in (used, fresh):
        assert engine.advance(pull, 20).ok
    for field in FIELDS:
        assert np.array_equal(getattr(used.state, field), getattr(fresh.state, field)), field


def test_random_activation_pumps_no_twist(lattice: Lattice) -> None:
    """Ten seconds of tension that jumps 20 times a second: no muscle spins up, as all do with little damping."""
    model = build_model(lattice, named_layout("all", lattice))
    dt = default_dt(model, 0.05)
    engine = simulate("fused", model, dt)
    rng = np.random.default_rng(0)
    for _ in range(200):
        assert engine.advance(rng.uniform(0.0, 0.5, (2, model.n_muscle)), round(0.05 / dt)).ok
        assert np.abs(engine.state.omega[model.element_offset[12] :, 2]).max() < 10.0


def test_a_ramp_is_the_mean_of_its_ends(engine_name: EngineName, lattice: Lattice) -> None:
    """Over one step a ramp acts as its middle; over several it differs from the held mean."""
    model = build_model(lattice, named_layout("extension", lattice))
    ones = np.ones(model.n_muscle)
    positions = []
    for tension, steps in (([0.1 * ones, 0.3 * ones], 1), (0.2 * ones, 1), ([0.1 * ones, 0.3 * ones], 2)):
        engine = simulate(engine_name, model, 2e-4)
        engine.advance(tension, steps)
        positions.append(engine.state.velocity)
    assert np.abs(positions[0] - positions[1]).max() < 1e-15
    assert np.abs(positions[0] - positions[2]).max() > 1e-6


def test_divergence_has_a_status_and_a_place(engine_name: EngineName, lattice: Lattice) -> None:
    """A step far beyond the critical one ends in a named failure, not in an exception or silence."""
    model = build_model(lattice, named_layout("all", lattice))
    engine = simulate(engine_name, model, 2.0 * critical_dt(model))
    health = engine.advance(np.full(model.n_muscle, 0.5), 60)
    assert not health.ok
    assert 0 <= health.rod < model.n_rod
    assert 0 <= health.element < model.rods[health.rod].n_elem
    assert "rod" in str(health)


@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({"position": (0, (0.0, 0.0, -40.0))}, Status.OVERSTRETCHED),
        ({"position": (0, (0.0, 0.0, 0.95))}, Status.INVERTED),
        ({"velocity": (0, (0.0, 0.0, 1e200))}, Status.NON_FINITE),
    ],
)
def test_each_failure_is_named(
    engine_name: EngineName, change: dict[str, tuple[int, tuple[float, float, float]]], status: Status
) -> None:
    """Over-stretched, inverted and non-finite elements are told apart, at the rod and element where they are."""
    rods = tuple(
        straight_rod((x, 0, 0), (x, 0, 1), 2, radius=0.1, density=1e3, youngs_modulus=1e-3, shear_modulus=1e-3)
        for x in (0.0, 1.0)
    )
    model = RodModel(rods=rods)
    state = model.rest_state()
    for field, (node, value) in change.items():
        array = getattr(state, field).copy()
        array[3 + node] += value
        state = replace(state, **{field: array})
    engine = simulate(engine_name, model, 1e-6)
    engine.restore(state)
    health = engine.advance([], 1)
    assert (health.status, health.rod, health.element) == (status, 1, 0)


def test_refused_input(engine_name: EngineName, lattice: Lattice) -> None:
    """Each wrong argument gives one ValueError that names it."""
    model = build_model(lattice, named_layout("extension", lattice))
    for dt in (0.0, -1e-4, np.nan, np.inf):
        with pytest.raises(ValueError, match="dt = "):
            simulate(engine_name, model, dt)
    engine = simulate(engine_name, model, 1e-4)
    good = np.zeros(model.n_muscle)
    for tension in (good[1:], np.zeros((3, model.n_muscle)), good - 1.0, good * np.nan, good + np.inf, 0.5):
        with pytest.raises(ValueError, match="tension"):
            engine.advance(tension, 1)
    for steps in cast(list[int], [0, -3, 2.7, True, "3", np.nan]):
        with pytest.raises(ValueError, match="n_substeps"):
            engine.advance(good, steps)
    state = engine.state
    bad_states: dict[str, Any] = {
        "position": state.position[1:],
        "velocity": state.velocity * np.nan,
        "omega": np.zeros((3, 3)),
        "directors": np.roll(state.directors, 1, axis=1),
        "time": np.nan,
    }
    clamped = model.nodes(0).start, model.elements(0).start
    for name, row in zip(("velocity", "omega"), clamped, strict=True):
        bad_states[name + ": Clamp"] = getattr(state, name).copy()
        bad_states[name + ": Clamp"][row, 0] = 1.0
    bad_states["directors: must be orthonormal"] = 1.1 * state.directors
    for name, array in bad_states.items():
        with pytest.raises(ValueError, match=f"RodState.{name}"):
            engine.restore(replace(state, **{name.partition(":")[0]: array}))
    with pytest.raises(ValueError, match="must stay at rest"):
        engine.restore(replace(state, position=state.position + 1e-3))


def test_splittings_are_checked(lattice: Lattice) -> None:
    """The reference damps as PyElastica does and in no other way; an unknown splitting is refused."""
    model = build_model(lattice, named_layout("extension", lattice))
    with pytest.raises(ValueError, match="splitting"):
        simulate("pyelastica", model, 1e-4, "symmetric")
    with pytest.raises(ValueError, match="pyelastica, symmetric"):
        simulate("fused", model, 1e-4, cast(Splitting, "both"))


def test_unknown_engine(lattice: Lattice) -> None:
    """The error names the choices."""
    model, name = build_model(lattice, named_layout("extension", lattice)), "warp"
    with pytest.raises(ValueError, match="fused, pyelastica"):
        simulate(name, model, 1e-4)
