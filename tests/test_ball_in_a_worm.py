"""A ball in a worm: both engines carry it alike, its books close, and its stiffness is in the predicted step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ball_scenes import RADIUS, REACH, ROD, SOFT, ball, momenta, rails, thrown, worm
from small_worms import SMALL

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import MuscleLayout, named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.health import Status
from lattice_gym.engines.registry import EngineName
from lattice_gym.engines.simulation import Simulation, simulate
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.critical_step import SAFETY, critical_dt, default_dt
from lattice_gym.physics.energy import EnergyMeter, Ledger
from lattice_gym.physics.laws.ball import Ball, RigidBall
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.loads import PointForce
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.rod import straight_rod
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model
from lattice_gym.tasks.registry import gait
from lattice_gym.tasks.transport import Transport

pytestmark = pytest.mark.slow

FIELDS = ("position", "velocity", "directors", "omega", "ball_position", "ball_velocity", "ball_omega")


def test_engines_agree(engine_pair: tuple[EngineName, EngineName]) -> None:
    """A squeeze of one second by random tensions: to rounding after a step, to 1e-9 m and more after all of them."""
    model, dt = worm(Medium(density=900.0), friction=0.4)
    engines = [simulate(name, model, dt) for name in engine_pair]
    start = replace(
        thrown(model, (0.03, -0.02, 0.05)),
        ball_position=model.rest_state().ball_position + np.array([1e-3, 2e-3, 0.0]),
        ball_omega=np.array([[1.0, -2.0, 0.5]]),
    )
    for engine in engines:
        engine.restore(start)
    rng = np.random.default_rng(0)
    pull = rng.uniform(0.0, 0.5, model.n_muscle)
    assert all(engine.advance(pull, 1).ok for engine in engines)
    a, b = engines[0].state, engines[1].state
    for field in ("ball_position", "ball_velocity", "position", "velocity"):
        scale = np.abs(getattr(b, field)).max()
        assert np.abs(getattr(a, field) - getattr(b, field)).max() < 2e-12 * scale, field
    for _ in range(20):
        ramp = rng.uniform(0.0, 0.5, (2, model.n_muscle))
        assert all(engine.advance(ramp, round(0.05 / dt)).ok for engine in engines)
    a, b = engines[0].state, engines[1].state
    assert np.linalg.norm(b.ball_position - start.ball_position) > 1e-3
    for field in FIELDS:
        scale = max(1.0, np.abs(getattr(b, field)).max())
        assert np.abs(getattr(a, field) - getattr(b, field)).max() < 1e-9 * scale, field


def test_engines_agree_with_all_around(engine_pair: tuple[EngineName, EngineName]) -> None:
    """A worm with a ball that lies on the ground in a medium: to rounding over a tenth of a second."""
    lattice = build_lattice(LatticeDesign(**SMALL, base="free"))
    ground = Ground(forward=0.4, backward=1.5)
    world = World(medium=Medium(density=900.0, drag=0.1), ground=ground, ball=Ball(level=1.5), lying=True)
    model = build_model(lattice, named_layout("all", lattice), world)
    dt, states = default_dt(model, 0.05, 0.5), []
    for name in engine_pair:
        engine = simulate(name, model, dt)
        assert engine.advance(np.full((2, model.n_muscle), 0.3), round(0.1 / dt)).ok
        states.append(engine.state)
    assert np.linalg.norm(states[0].ball_position - model.rest_state().ball_position) > 1e-6
    for field in FIELDS:
        scale = max(1.0, np.abs(getattr(states[1], field)).max())
        assert np.abs(getattr(states[0], field) - getattr(states[1], field)).max() < 1e-10 * scale, field


def carried(engines: list[Simulation], lattice: Lattice, layout: MuscleLayout, time: float) -> list[Ledger]:
    """Let the hand-made wave carry the ball; ledgers of all engines, in turn, every 50 ms."""
    wave, entries, pull = gait("transport", lattice, layout, {"direction": 1.0}), [], np.zeros(len(layout.active))
    for k in range(round(time / 0.05)):
        before, pull = pull, lattice.design.max_tension * wave(0.05 * (k + 1))
        for engine in engines:
            assert engine.advance(np.stack([before, pull]), round(0.05 / engine.dt)).ok
            assert engine.ledger is not None
            entries.append(engine.ledger)
    return entries


def test_a_wave_carries_alike(engine_pair: tuple[EngineName, EngineName]) -> None:
    """On both engines a wave carries the ball to the same place, and the books close."""
    lattice = build_lattice(LatticeDesign(**SMALL, max_tension=1.0))
    layout = named_layout("all", lattice)
    model = build_model(lattice, layout, Transport.world(lattice))
    dt = default_dt(model, 0.05, 1.0)
    engines = [simulate(name, model, dt, energy_check=True) for name in engine_pair]
    entries = carried(engines, lattice, layout, 0.5)
    a, b = (engine.state for engine in engines)
    assert np.linalg.norm(b.ball_position - model.rest_state().ball_position) > 1e-3
    for field in ("position", "ball_position"):
        assert np.abs(getattr(a, field) - getattr(b, field)).max() < 1e-6, field
    for one in (entries[::2], entries[1::2]):
        assert max(abs(entry.residual) / entry.scale for entry in one) < 0.02
        assert abs(sum(entry.residual for entry in one)) < 0.01 * sum(entry.muscle_work for entry in one)


def test_a_wave_keeps_momentum(engine_name: EngineName) -> None:
    """Free and undamped, worm and ball keep theirs: momentum to rounding, angular momentum as the rods' law does.

    That is exact to the cube of the angle between two elements, here 0.3 rad, of what it carries from end to end.
    """
    design = LatticeDesign(**SMALL, max_tension=1.0, base="free", damping=0.0, rotational_damping=0.0)
    lattice = build_lattice(design)
    layout = named_layout("all", lattice)
    ball = Transport.world(lattice).ball
    model = build_model(lattice, layout, World(ball=ball))
    engine = simulate(engine_name, model, default_dt(model, 0.05, 1.0), energy_check=True)
    carried([engine], lattice, layout, 0.2)
    state = engine.state
    moving = model.node_mass @ np.linalg.norm(state.velocity, axis=1)
    assert np.linalg.norm(state.ball_velocity) > 1e-3
    linear, angular = np.abs(momenta(model, state)).max(axis=1)
    assert linear < 1e-11 * moving
    assert angular < 0.3**3 * 0.1 * moving * design.height


def test_restart_is_exact(engine_name: EngineName) -> None:
    """The ball goes on to the last bit from a state, which shares no memory with the engine."""
    model, dt = worm(Medium(density=900.0))
    pull = np.random.default_rng(2).uniform(0.0, 0.5, model.n_muscle)
    first = simulate(engine_name, model, dt)
    first.restore(replace(model.rest_state(), ball_omega=np.array([[1.0, 2.0, 3.0]])))
    first.advance(pull, 20)
    saved = first.state
    kept = saved.copy()
    first.advance(pull, 20)
    second = simulate(engine_name, model, dt)
    second.restore(saved)
    second.advance(pull, 20)
    for field in FIELDS:
        assert np.array_equal(getattr(first.state, field), getattr(second.state, field)), field
        assert np.array_equal(getattr(saved, field), getattr(kept, field)), field
        assert not np.shares_memory(getattr(saved, field), getattr(kept, field)), field


def test_a_lost_ball_is_named(engine_name: EngineName) -> None:
    """One that is nowhere ends the run, though every rod is well."""
    model = RodModel(**rails(0.0), ball=ball(50.0))
    engine = simulate(engine_name, model, 10.0)
    engine.restore(thrown(model, (0.0, 0.0, 1e307)))
    assert engine.advance([], 1).ok
    assert engine.advance([], 10).status is Status.NON_FINITE


def test_energy_by_hand() -> None:
    """Kinetic energy of the ball and the spring of its contact."""
    model = RodModel(**rails(0.0), ball=ball(REACH - 0.003, mass=2.0))
    state = replace(thrown(model, (1.0, 2.0, 0.0)), ball_omega=np.array([[0.0, 0.0, 3.0]]))
    stored = EnergyMeter(model).stored(state)
    assert stored.parts["ball"] == pytest.approx([0.5 * 2.0 * 5.0 + 0.5 * 0.4 * 2.0 * RADIUS**2 * 9.0])
    assert stored.parts["ball_contact"] == pytest.approx([0.0, 0.5 * 1e4 * 0.003**2], abs=1e-15)
    assert stored.total == pytest.approx(stored.parts["ball"][0] + stored.parts["ball_contact"][1])


def test_the_ledger_balances(engine_name: EngineName) -> None:
    """Sliding, bouncing and damped on a rail, all that it loses is counted, but for (rate dt)^2 / 4 of its spring."""
    model = RodModel(
        **rails(0.0),
        ball=ball(REACH, damping=5.0, friction=0.3, force=(0.0, 0.0, -9.81)),
    )
    for dt in (2e-4, 1e-4, 5e-5):
        engine = simulate(engine_name, model, dt, energy_check=True)
        engine.restore(thrown(model, (1.0, 0.0, -0.5)))
        assert engine.advance([], round(0.1 / dt)).ok
        entry = engine.ledger
        assert entry is not None
        assert entry.dissipated > 0.1
        assert abs(entry.load_work) > 0.01
        assert abs(entry.residual) < 0.25 * (100.0 * dt) ** 2 * entry.scale


def test_a_worm_keeps_its_books(engine_pair: tuple[EngineName, EngineName]) -> None:
    """On both engines the same work, dissipation and energy of a squeezed ball; the ledger closes."""
    model, dt = worm(Medium(density=900.0))
    entries = []
    for name in engine_pair:
        engine = simulate(name, model, dt, energy_check=True)
        engine.restore(thrown(model, (0.0, 0.0, 0.1)))
        assert engine.advance(np.full((2, model.n_muscle), 0.3), 200).ok
        entry = engine.ledger
        assert entry is not None
        entries.append([entry.muscle_work, entry.load_work, entry.dissipated, entry.stored])
        assert abs(entry.residual) < 0.02 * entry.scale
    np.testing.assert_allclose(entries[0], entries[1], rtol=1e-6, atol=1e-9)


def test_books_close_where_a_ball_drags_what_the_ground_holds(engine_pair: tuple[EngineName, EngineName]) -> None:
    """Both frictions act on the same nodes: each works at the velocity that both leave, so the engines agree."""
    rod = straight_rod((0.0, 0.0, 0.01), (0.4, 0.0, 0.01), 4, **ROD)
    rider = RigidBall(
        position=np.array([0.15, 0.0, 0.02 + RADIUS]), radius=RADIUS, mass=0.3, stiffness=1e3, friction=0.5,
        force=(0.0, 0.0, -3.0),
    )  # fmt: skip
    ground = Ground(stiffness=2e3, static_friction=0.3, kinetic_friction=0.3)
    model = RodModel(rods=(rod,), ball=rider, gravity=np.array([0.0, 0.0, -9.81]), ground=ground)
    entries, moved = [], []
    for name in engine_pair:
        engine = simulate(name, model, 1e-4, energy_check=True)
        engine.restore(thrown(model, (1.0, 0.2, -0.1)))
        assert engine.advance([], 200).ok
        entry = engine.ledger
        assert entry is not None
        entries.append([entry.dissipated, entry.stored, entry.residual])
        moved.append(engine.state.velocity[:, 0].mean())
    assert min(moved) > 1e-3
    np.testing.assert_allclose(entries[0], entries[1], rtol=1e-9, atol=1e-9 * abs(entries[1][0]))


def cage(stiffness: float, mass: float, damping: float, friction: float, middle: bool) -> RodModel:
    """Ball held from six sides, at nodes or at the middles of elements, where forces balance its contacts."""
    depth, rods, forces, clamps = 1e-7, [], [], []
    for k in range(6):
        outward, along = np.eye(3)[k // 2] * (1.0 if k % 2 else -1.0), np.eye(3)[(k // 2 + 1) % 3]
        centre = outward * (0.25 - depth) + (0.25 * along if middle else 0.0)
        rods.append(straight_rod(centre - along, centre + along, 4, **SOFT))
        clamps += [Clamp(k, node=0), Clamp(k, node=4)]
        pull = (-stiffness * depth * outward).tolist()
        touched = (1, 2) if middle else (2, 2)
        forces += [PointForce(k, node, tuple(f * (0.5 if middle else 1.0) for f in pull)) for node in touched]
    held = RigidBall(
        position=np.zeros(3), radius=0.2, mass=mass, stiffness=stiffness, damping=damping, friction=friction,
    )  # fmt: skip
    return RodModel(rods=tuple(rods), clamps=tuple(clamps), forces=tuple(forces), ball=held)


def holds_still(model: RodModel, dt: float, splitting: Splitting) -> bool:
    """Whether 4,000 steps from a slightly shaken balance stay finite and small."""
    engine = simulate("fused", model, dt, splitting)
    shake = 1e-10 * np.random.default_rng(0).standard_normal((model.n_node, 3))
    for clamp in model.clamps:
        if clamp.node is not None:
            shake[model.node_offset[clamp.rod] + clamp.node] = 0.0
    engine.restore(replace(model.rest_state(), velocity=shake))
    health, state = engine.advance([], 4000), engine.state
    return health.ok and max(np.abs(state.velocity).max(), np.abs(state.ball_velocity).max()) < 1e-7


def measured_dt(model: RodModel, splitting: Splitting) -> float:
    """Largest step that holds still, by bisection to 1 %."""
    low = high = 0.5 * critical_dt(model, splitting=splitting)
    while holds_still(model, high, splitting):
        low, high = high, 1.5 * high
    while not holds_still(model, low, splitting):
        low, high = low / 1.5, low
    while high / low > 1.01:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if holds_still(model, middle, splitting) else (low, middle)
    return low


@pytest.mark.parametrize("splitting", ["pyelastica", "symmetric"])
@pytest.mark.parametrize("middle", [False, True])
@pytest.mark.parametrize(("mass", "damping"), [(1e4, 0.0), (1e4, 50.0), (1.0, 0.0), (1.0, 30.0), (0.01, 0.0)])
def test_never_above_the_measured_limit(mass: float, damping: float, middle: bool, splitting: Splitting) -> None:
    """A heavy ball on nodes is what is reckoned with; a light one bears a third of its contacts along one axis.

    Two rods of six press along it, which leaves the prediction 1 / sqrt(3) of the limit, a fifth to spare.
    """
    model = cage(1e4, mass, damping, 0.0, middle)
    measured, predicted = measured_dt(model, splitting), critical_dt(model, splitting=splitting)
    assert predicted <= measured
    assert middle or predicted / SAFETY > 0.8 / np.sqrt(3.0) * measured
    if mass == 1e4 and not middle:
        assert predicted / SAFETY == pytest.approx(measured, rel=0.02)


@pytest.mark.parametrize("mass", [1e4, 1.0, 0.01])
def test_friction_costs_no_step(mass: float) -> None:
    """However high, it never takes more of a slip than it can: the predicted step holds."""
    for friction in (0.3, 3.0, 100.0):
        model = cage(1e4, mass, 0.0, friction, False)
        for splitting in ("pyelastica", "symmetric"):
            assert holds_still(model, critical_dt(model, splitting=splitting), splitting)


def test_an_ordinary_ball_costs_no_step(lattice: Lattice) -> None:
    """The default one leaves the predicted step of the default lattice within 1 %."""
    layout = named_layout("all", lattice)
    with_ball = critical_dt(build_model(lattice, layout, World(ball=Ball())), 0.5)
    assert 0.99 < with_ball / critical_dt(build_model(lattice, layout), 0.5) <= 1.0


def test_the_world_has_it(lattice: Lattice) -> None:
    """Where it starts and what the medium leaves of its weight; none unless asked for."""
    layout = named_layout("extension", lattice)
    plain = build_model(lattice, layout)
    assert (plain.ball, plain.n_ball, plain.rest_state().ball_position.shape) == (None, 0, (0, 3))
    ball = Ball(radius=0.02, density=1200.0, level=2.5, stiffness=70.0, damping=0.2, friction=0.4)
    made = build_model(lattice, layout, World(ball=ball, medium=Medium(density=1000.0, gravity=9.0))).ball
    assert made is not None
    volume = 4.0 / 3.0 * np.pi * 0.02**3
    assert made.position == pytest.approx([0.0, 0.0, 2.5 * 0.0125])
    assert made.mass == pytest.approx(1200.0 * volume)
    assert made.force == pytest.approx((0.0, 0.0, -200.0 * volume * 9.0))
    assert (made.radius, made.stiffness, made.damping, made.friction) == (0.02, 70.0, 0.2, 0.4)
    still = build_model(lattice, layout, World(ball=ball)).ball
    assert still is not None
    assert still.force == (0.0, 0.0, 0.0)
    laid = build_model(lattice, layout, World(ball=ball, lying=True)).ball
    assert laid is not None
    assert laid.position == pytest.approx([2.5 * 0.0125, 0.0, 0.5 * 0.075 + 5e-3], abs=1e-12)
    with pytest.raises(ValueError, match=r"Ball\.level = 8\.5"):
        build_model(lattice, MuscleLayout(), World(ball=Ball(level=8.5)))


def swallowed(level: float, sign: float, time: float, back: float = 0.0) -> FloatArray:
    """Heights of the ball [m] every 50 ms in a wave of 50 mm and 10 mm/s, upward for sign 1; then run `back` [s].

    Ring muscles of 1.2 N, vertical ones at half drive in antiphase; the ball starts where the rings are at rest. Rods
    with a friction of 0.3 would hold it back.
    """
    lattice = build_lattice(LatticeDesign())
    layout = named_layout("all", lattice)
    model = build_model(lattice, layout, World(ball=Ball(level=level, friction=0.1)))
    ring = np.array([muscle.orientation == "horizontal" for muscle in layout.active])
    sites = np.array([(muscle.start, muscle.end) for muscle in layout.active])
    height = lattice.site_position[sites, 2].mean(axis=1)
    dt = default_dt(model, 0.05, 1.2)
    engine = simulate("fused", model, dt, "symmetric")
    found, before = [], np.zeros(model.n_muscle)
    for now in np.append(np.arange(0.0, time, 0.05), np.arange(time, time - back, -0.05)):
        wave = 0.5 * np.cos(2.0 * np.pi * (height / 0.05 - sign * 0.2 * now))
        pull = 1.2 * np.where(ring, 0.5 + wave, 0.5 * (0.5 - wave))
        assert engine.advance(np.stack([before, pull]), round(0.05 / dt)).ok
        found.append(engine.state.ball_position[0])
        before = pull
    assert np.abs(np.array(found)[:, :2]).max() < 1e-4
    return np.array(found)[:, 2]


@pytest.mark.parametrize(("level", "sign"), [(2.0, 1.0), (6.0, -1.0)])
def test_a_wave_swallows(level: float, sign: float) -> None:
    """It carries the ball by a third of the height, steadily and nearly as fast as it runs, and back when run back."""
    height = swallowed(level, sign, 4.5, 4.5)
    moved = sign * (height - 0.0125 * level)
    assert moved[89] > 0.1 / 3.0
    assert np.diff(moved[9:90:10]).min() > 0.0
    assert moved.max() < 0.06
    assert abs(moved[-1]) < 0.3 * moved[89]
