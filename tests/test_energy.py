"""Stored energy against the work of the forces, the ledger against time, and the checks that rest on them."""

from __future__ import annotations

from dataclasses import replace
from typing import cast, get_args

import numpy as np
import pytest
from small_worms import SMALL

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.health import Health, Status
from lattice_gym.engines.registry import ENGINES, EngineName
from lattice_gym.engines.simulation import Simulation, simulate
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.energy import ENERGY_TOLERANCE, EnergyMeter, Flow, ledger
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.joints import Joint
from lattice_gym.physics.laws.lines import Line
from lattice_gym.physics.laws.loads import PointForce, PointTorque
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.rod import straight_rod
from lattice_gym.physics.state import RodState
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model
from lattice_gym.verification.case import Case
from lattice_gym.verification.ground import incline, rest_penetration, sliding_block_by_direction
from lattice_gym.verification.orders import slope

pytestmark = pytest.mark.slow

ROD = {"radius": 0.05, "density": 1e3, "youngs_modulus": 1e5, "shear_modulus": 3e4}


def _moved(state: RodState, shift: FloatArray) -> RodState:
    return replace(state, position=state.position + shift)


@pytest.mark.parametrize("strain", [-0.6, -1e-4, 1e-6, 2e-3, 0.5, 2.0])
def test_stretch_is_the_integral_of_the_force(strain: float) -> None:
    """E A (e - 1) / e over the way, here by Gauss's rule; so for a line."""
    rod = straight_rod((0, 0, 0), (0, 0, 2), 2, **ROD)
    model = RodModel(rods=(rod,), lines=(Line(0, 0, 0, 2, 2.0, 7.0),))
    stored = EnergyMeter(model).stored(_moved(model.rest_state(), strain * model.rest_state().position))
    node, weight = np.polynomial.legendre.leggauss(40)
    share = 0.5 * strain * (node + 1.0)
    integral = 0.5 * strain * float(weight @ (share / (1.0 + share)))
    np.testing.assert_allclose(stored.parts["stretch"], rod.stretch_stiffness * integral, rtol=1e-9)
    np.testing.assert_allclose(stored.parts["line"], 7.0 * 2.0 * integral, rtol=1e-9)


def test_every_part_has_its_formula() -> None:
    """Speed, spin, bending and joints, by hand."""
    rods = tuple(straight_rod((x, 0, 0), (x, 0, 1), 2, **ROD) for x in (0.0, 1.0))
    model = RodModel(rods=rods, joints=(Joint(0, 0, 1, 0, 8.0),))
    rest, angle = model.rest_state(), 0.3
    directors = rest.directors.copy()
    directors[1] = (
        np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]) @ (directors[1])
    )
    state = replace(
        rest, directors=directors, velocity=rest.velocity + 2.0, omega=rest.omega + np.array([1.0, 2.0, 3.0])
    )
    stored = EnergyMeter(model).stored(state)
    np.testing.assert_allclose(stored.parts["translation"], 6.0 * model.node_mass)
    np.testing.assert_allclose(stored.parts["rotation"], np.tile(0.5 * rods[0].inertia * (1 + 4 + 18), 2))
    np.testing.assert_allclose(
        stored.parts["bend"], [0.5 * rods[0].bend_stiffness[0] * angle**2 / 0.5, 0.0], atol=1e-12
    )
    np.testing.assert_allclose(stored.parts["joint"], [4.0])
    assert stored.total == pytest.approx(sum(float(part.sum()) for part in stored.parts.values()))


def test_weight_and_ground_have_their_formulas() -> None:
    """Weight less buoyancy times height above rest, and k d^2 / 2 of the depth d."""
    model = RodModel(
        rods=(straight_rod((0, 0, 0.05), (0, 1, 0.05), 2, **ROD),),
        gravity=np.array([0.0, 0.0, -2.0]), medium_density=250.0, ground=Ground(stiffness=8.0),
    )  # fmt: skip
    stored = EnergyMeter(model).stored(_moved(model.rest_state(), np.array([[3, 1, 0.3], [0, 0, 0], [0, 0, -0.1]])))
    weight = 0.75 * 2.0 * model.node_mass
    np.testing.assert_allclose(stored.parts["weight"], weight * [0.3, 0.0, -0.1])
    np.testing.assert_allclose(stored.parts["ground"], [0.0, 0.0, 0.04], atol=1e-15)
    air = EnergyMeter(replace(model, gravity=None, ground=None)).stored(model.rest_state())
    assert not {"weight", "ground"} & air.parts.keys()


@pytest.mark.parametrize("case", [sliding_block_by_direction, incline, rest_penetration], ids=lambda case: case.name)
def test_the_ground_takes_what_motion_loses(case: Case, engine_name: EngineName) -> None:
    """Friction and dashpots of the ground are counted to rounding: blocks that slip, stop, and sink in."""
    scene = case.build(2)
    engine = simulate(engine_name, scene.model, scene.dt, energy_check=True)
    engine.restore(scene.start)
    assert engine.advance([], 1000).ok
    entry = engine.ledger
    assert entry is not None
    assert entry.dissipated > 0.2 * entry.scale
    assert entry.dissipated == pytest.approx(-entry.stored, rel=1e-12)


def test_a_worm_on_the_ground_keeps_its_books() -> None:
    """What random lines put in is stored or dissipated; the law leaves up to a fiftieth, as in the air.

    That of a worm with rods as muscles, which crawls, is in test_ground.
    """
    lattice = build_lattice(LatticeDesign(**SMALL, base="free", damping=1e-3, muscle_model="line"))
    world = World(medium=Medium(drag=0.1), ground=Ground(static_friction=0.8, forward=0.5), lying=True)
    model = build_model(lattice, named_layout("all", lattice), world)
    engine = simulate("fused", model, 1e-4, "symmetric", True)
    rng, residual, lost = np.random.default_rng(0), 0.0, 0.0
    for _ in range(10):
        assert engine.advance(rng.uniform(0.0, 0.1, (2, model.n_muscle)), 500).ok
        entry = engine.ledger
        assert entry is not None
        residual, lost = residual + entry.residual, lost + entry.dissipated
    assert lost > 0.0
    assert abs(residual) < 2e-2 * lost


def _assembly(*, smooth: bool = False) -> RodModel:
    """Join a rod to the tip of a clamped one with a dashpot, a muscle and a line across and loads on it.

    A smooth one has no dashpot, no damping of spin and no torque.
    """
    damped = {"damping": 0.02, "rotational_damping": 0.0 if smooth else 1e-3}
    rods = (
        straight_rod((0, 0, 0), (0, 0, 1), 4, **ROD, **damped),
        straight_rod((0, 0, 1), (1, 0, 1), 4, **ROD, **damped),
        straight_rod((0, 0, 0.5), (0.5, 0, 1), 2, **ROD),
    )
    joint = Joint(0, 4, 1, 0, 500.0, 0.0 if smooth else 0.5)
    return RodModel(
        rods=rods, joints=(joint, Joint(0, 2, 2, 0, 500.0), Joint(1, 2, 2, 2, 500.0)), muscles=(2,),
        lines=(Line(0, 2, 1, 2, np.sqrt(0.5), 300.0, 0.1, 0.1),), clamps=(Clamp(0, 0, 0),),
        forces=(PointForce(1, 4, (0.0, 3.0, -2.0)),), torques=() if smooth else (PointTorque(1, 2, (0.1, 0.2, 0.3)),),
    )  # fmt: skip


def _worked(engine: Simulation, time: float, n_call: int) -> tuple[FloatArray, float]:
    """Muscle work, load work, dissipation and stored energy of ramps up and down; and the residual."""
    ramps = [20.0 * np.tile([[k % 2], [(k + 1) % 2]], engine.model.n_muscle) for k in range(n_call)]
    total, residual = np.zeros(4), 0.0
    for ramp in ramps:
        assert engine.advance(ramp, round(time / n_call / engine.dt)).ok
        entry = engine.ledger
        assert entry is not None
        total += [entry.muscle_work, entry.load_work, entry.dissipated, entry.stored]
        residual += entry.residual
        assert entry.residual == pytest.approx(
            entry.muscle_work + entry.load_work - entry.dissipated - entry.stored, abs=1e-12
        )
    return total, residual


STEPS = (4e-4, 2e-4, 1e-4, 5e-5)
"""Each half the one before [s]."""


def _books(model: RodModel, splitting: Splitting) -> tuple[FloatArray, FloatArray]:
    """Parts of the ledger at each step, shape (n_step, 4), and residuals, over the sum of the parts at the finest."""
    results = [_worked(simulate("fused", model, dt, splitting, True), 0.4, 4) for dt in STEPS]
    parts, left = np.array([found for found, _ in results]), np.array([residual for _, residual in results])
    scale = np.abs(parts[-1]).sum()
    return parts / scale, left / scale


def _order(left: FloatArray) -> float:
    """Order at which residuals come to what the law itself leaves, from what each halving of the step changes."""
    return slope(STEPS[:-1], np.abs(np.diff(left)).tolist())


def test_the_ledger_balances() -> None:
    """Every part comes in; halving the step shrinks what it adds to the residual, down to what the law itself leaves.

    PyElastica's damping and the dashpots move the motion itself to first order, and what the law leaves with it. The
    residual at the finest step has a tenth to spare.
    """
    books = [_books(_assembly(), splitting) for splitting in get_args(Splitting)]
    for (parts, left), least in zip(books, (0.85, 1.9), strict=True):  # A part of second order still shows.
        assert np.all(np.abs(parts[-1]) > 1e-2)
        assert parts[-1, 2] > 0.0
        assert _order(left) > least
        assert abs(left[-1]) < 1.05e-4
        apart = np.abs(parts - books[-1][0][-1]).max(axis=1)
        assert np.all(apart < 2e-5 * np.array(STEPS) / STEPS[0])


def test_the_ledger_shows_the_order_of_the_splitting() -> None:
    """Without dashpots, halving the step quarters the residual's excess of a symmetric step.

    PyElastica's step differs from that by an amount that halves. What the law leaves has a tenth to spare.
    """
    model = _assembly(smooth=True)
    (_, explicit), (parts, symmetric) = _books(model, "pyelastica"), _books(model, "symmetric")
    assert _order(symmetric) == pytest.approx(2.0, abs=0.03)
    assert slope(STEPS, np.abs(explicit - symmetric).tolist()) == pytest.approx(1.0, abs=0.03)
    assert abs(symmetric[-1]) < 1.15e-3
    assert np.all(np.abs(parts - parts[-1]).max(axis=1) < 1e-6 * (np.array(STEPS) / STEPS[0]) ** 2)


@pytest.mark.parametrize("splitting", get_args(Splitting))
@pytest.mark.parametrize("decay", [0.1, 1.0, 5.0, 1000.0])
def test_a_pull_against_heavy_damping_balances(splitting: Splitting, decay: float) -> None:
    """However much a step damps, what a pull gives is what damping takes and motion keeps, to rounding."""
    soft = ROD | {"youngs_modulus": 1e-12, "shear_modulus": 1e-12}
    rod = straight_rod((0, 0, 0), (0, 0, 1), 2, **soft, damping=1.0)
    pulls = tuple(PointForce(0, n, (1e-3, 0.0, 0.0)) for n in range(3))
    engine = simulate("fused", RodModel(rods=(rod,), forces=pulls), decay * rod.mass[0], splitting, True)
    for _ in range(3):
        assert engine.advance([], 20).ok
        entry = engine.ledger
        assert entry is not None
        assert entry.dissipated > 0.0
        assert abs(entry.residual) < 1e-6 * entry.scale


@pytest.mark.parametrize("engine_name", tuple(ENGINES))
def test_nothing_is_left_of_a_run_that_failed(engine_name: EngineName, lattice: Lattice) -> None:
    """After a restore the books begin empty, whatever happened before: a failed run's work is not the next one's."""
    model = build_model(lattice, named_layout("all", lattice))
    engine, fresh = (simulate(engine_name, model, dt, energy_check=True) for dt in (2e-3, 2e-3))
    pull = np.full(model.n_muscle, 2.0)
    assert not engine.advance(pull, 200).ok
    assert engine.ledger is None
    engine.restore(model.rest_state())
    assert engine.advance(0.01 * pull, 1) == fresh.advance(0.01 * pull, 1)
    assert engine.ledger == fresh.ledger


def test_engines_keep_the_same_books(engine_pair: tuple[EngineName, EngineName]) -> None:
    """PyElastica's own steps, counted in numpy, give the same work, dissipation and energy."""
    books = [_worked(simulate(name, _assembly(), 2e-4, energy_check=True), 0.1, 2)[0]
             for name in engine_pair]  # fmt: skip
    np.testing.assert_allclose(books[0], books[1], rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("splitting", ["pyelastica", "symmetric"])
def test_dissipation_is_what_motion_loses(splitting: Splitting) -> None:
    """In a step from rest without forces damping alone takes the kinetic energy, to rounding; in spin as in speed."""
    rod = straight_rod((0, 0, 0), (0, 0, 1), 2, **ROD, damping=0.5, rotational_damping=0.02)
    model = RodModel(rods=(rod,))
    engine = simulate("fused", model, 1e-3, splitting, True)
    rest, meter = model.rest_state(), EnergyMeter(model)
    for velocity, omega in ((0.7, 0.0), (0.0, 0.5)):
        first = replace(rest, velocity=rest.velocity + velocity, omega=rest.omega + np.array([0.0, 0.0, omega]))
        engine.restore(first)
        engine.advance([], 1)
        before, after = meter.stored(first), meter.stored(engine.state)
        lost = float(
            (before.parts["translation"] - after.parts["translation"]).sum()
            + (before.parts["rotation"] - after.parts["rotation"]).sum()
        )
        entry = engine.ledger
        assert entry is not None
        assert lost > 0.0
        assert entry.dissipated == pytest.approx(lost, rel=1e-12)


def test_the_check_changes_nothing_else(engine_name: EngineName, lattice: Lattice) -> None:
    """With the books kept, the state is the same to the last bit; without them, there is no ledger."""
    model = build_model(lattice, named_layout("all", lattice))
    plain, checked = (simulate(engine_name, model, 2e-4, energy_check=on) for on in (False, True))
    pull = np.random.default_rng(0).uniform(0.0, 0.5, (2, model.n_muscle))
    for engine in (plain, checked):
        engine.advance(pull, 10)
    assert np.array_equal(plain.state.position, checked.state.position)
    assert plain.ledger is None
    assert checked.ledger is not None
    checked.restore(checked.state)
    assert checked.ledger is None


def test_energy_from_nowhere_is_flagged(monkeypatch: pytest.MonkeyPatch, lattice: Lattice) -> None:
    """An engine whose muscles claim more work than they did loses energy; claim less, and it came from nowhere."""
    model = build_model(lattice, named_layout("all", lattice))
    pull = np.full(model.n_muscle, 0.3)

    def health(share: float) -> Health:
        engine = simulate("fused", model, 2e-4, energy_check=True)
        flow = engine.engine._flow
        monkeypatch.setattr(engine.engine, "_flow", lambda k: replace(f := flow(k), muscle_work=share * f.muscle_work))
        return engine.advance(pull, 50)

    assert health(1.0).ok
    assert health(2.0).ok
    found = health(0.5)
    assert found.status is Status.ENERGY
    assert 0 <= found.rod < model.n_rod
    assert str(found).startswith("energy (rod ")


def test_the_place_is_where_the_energy_is() -> None:
    """The rod and element that hold most."""
    model = RodModel(rods=tuple(straight_rod((x, 0, 0), (x, 0, 1), 3, **ROD) for x in (0.0, 1.0)))
    rest, meter = model.rest_state(), EnergyMeter(model)
    velocity = rest.velocity.copy()
    velocity[6] = 1.0
    state = replace(rest, velocity=velocity, position=rest.position + np.where(np.arange(8) == 7, 0.3, 0.0)[:, None])
    assert meter.peak_element(meter.stored(state)) == (1, 2)


def test_rest_is_no_alarm() -> None:
    """Rounding at rest is no spurious energy, whatever its share of next to nothing."""
    model = RodModel(rods=(straight_rod((0, 0, 0), (0, 0, 1), 3, **ROD),))
    meter = EnergyMeter(model)
    rest = meter.stored(model.rest_state())
    nudge = meter.stored(_moved(model.rest_state(), 1e-9 * np.eye(4, 3)))
    entry = ledger(rest, nudge, Flow(), meter.negligible)
    assert -ENERGY_TOLERANCE * entry.scale < entry.residual < 0.0


@pytest.mark.parametrize("rest_gap", [0.0, 0.3])
def test_torn_joints_are_named(engine_name: EngineName, rest_gap: float) -> None:
    """A gap beyond both radii and the gap at rest, at the rod and element of its first node; one within is none."""
    rods = tuple(straight_rod((x, 0, 0), (x, 0, 1), 2, **ROD) for x in (0.0, 0.5, 0.5 + rest_gap))
    model = RodModel(rods=rods, joints=(Joint(0, 0, 1, 0, 1e-3), Joint(1, 2, 2, 2, 1e-3)))
    for apart, status in ((0.09, Status.OK), (0.11, Status.TORN)):
        engine, state = simulate(engine_name, model, 1e-6), model.rest_state()
        position = state.position.copy()
        position[model.nodes(2)] += [apart, 0.0, 0.0]
        engine.restore(replace(state, position=position))
        health = engine.advance([], 1)
        assert health.status is status
        if not health.ok:
            assert (health.rod, health.element, health.joint) == (1, 1, 1)
            assert str(health) == "torn (rod 1, element 1, joint 1)"


def test_the_environment_offers_the_check() -> None:
    """Off by default; on, an episode with a sound step runs as before; anything but True and False is refused."""
    with pytest.raises(ValueError, match="energy_check"):
        LatticeWormEnv("extension", design=SMALL, energy_check=cast(bool, 1))
    returned = []
    for check in (False, True):
        env = LatticeWormEnv("extension", design=SMALL, energy_check=check)
        env.reset(seed=0)
        returned.append([env.step(np.ones(env.action_space.shape))[1] for _ in range(5)])
    assert returned[0] == returned[1]


def test_line_muscles_keep_the_books_too() -> None:
    """A lattice with muscles as lines: what the muscles put in is found again."""
    lattice = build_lattice(LatticeDesign(**{**SMALL, "muscle_model": "line"}))
    model = build_model(lattice, named_layout("all", lattice))
    engine = simulate("fused", model, 5e-5, "symmetric", True)
    assert engine.advance(np.stack([np.zeros(model.n_muscle), np.full(model.n_muscle, 0.3)]), 1000).ok
    entry = engine.ledger
    assert entry is not None
    assert entry.muscle_work > 0.0
    assert abs(entry.residual) < 2e-3 * entry.scale
