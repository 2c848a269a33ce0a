"""The ground under a whole body: friction along its own axis, and a crawl whose momentum and energy close."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.registry import EngineName
from lattice_gym.engines.simulation import simulate
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.activation import advance_activation
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.loads import PointForce
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.rod import straight_rod
from lattice_gym.physics.state import RodState
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model
from lattice_gym.tasks.registry import gait

pytestmark = pytest.mark.slow

BY_DIRECTION = Ground(forward=0.4, backward=1.5, sideways=0.8, static_friction=0.6)
SOFT = {"radius": 0.1, "density": 1000.0, "youngs_modulus": 1e-7, "shear_modulus": 4e-8}
"""So soft that each node is a block of its own."""


def turned(state: RodState, angle: float) -> RodState:
    """Turn a state without ball about z."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    of = {name: getattr(state, name) @ turn for name in ("position", "velocity", "directors")}
    return replace(state, **of)


@pytest.mark.parametrize("angle", [0.7, 2.5])
def test_a_turned_scene_moves_alike(engine_name: EngineName, angle: float) -> None:
    """A worm that slips and sticks on a ground with friction by direction: which way it lies makes no difference."""
    design = LatticeDesign(n_pairs=3, base="free", damping=1e-3, elements_per_segment=2, muscle_model="line")
    lattice = build_lattice(design)
    world = World(medium=Medium(), ground=BY_DIRECTION, lying=True)
    model = build_model(lattice, named_layout("all", lattice), world)
    start = model.rest_state()
    engines = [simulate(engine_name, model, 2e-4) for _ in range(2)]
    engines[1].restore(turned(start, angle))
    rng = np.random.default_rng(0)
    for _ in range(5):
        pull = rng.uniform(0.0, 0.1, (2, model.n_muscle))
        assert all(engine.advance(pull, 100).ok for engine in engines)
    straight, other = engines[0].state, engines[1].state
    assert np.abs(straight.position - start.position).max() > 1e-3
    expected = turned(straight, angle)
    np.testing.assert_allclose(other.position, expected.position, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(other.velocity, expected.velocity, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("tilt", [0.0, 45.0, 90.0])
@pytest.mark.parametrize("heading", [0.0, 60.0, 180.0])
def test_friction_fades_to_that_across_as_the_body_stands_up(
    engine_name: EngineName, heading: float, tilt: float
) -> None:
    """The deceleration of a block that slips, under an axis of some tilt: mu F / m times the factor of `Ground`.

    The axis is that of the block and of another, which hangs free and has the rest of the way from end to end. Both
    lie at an angle, so that no axis of the world is theirs.
    """
    yaw, dt, n_step = 0.5, 1e-3, 200
    level, share = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.cos(np.radians(tilt))
    axis = 3.0 * np.append(share * level[:2], np.sin(np.radians(tilt)))
    low, high = np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, 5.0])
    rods = straight_rod(low, low + level, 2, **SOFT), straight_rod(high, high + axis - level, 2, **SOFT)
    load = rods[0].mass * 5.0
    ground = replace(BY_DIRECTION, stiffness=4000.0)
    pressed = tuple(PointForce(0, node, (0.0, 0.0, -float(force))) for node, force in enumerate(load))
    model = RodModel(rods=rods, forces=pressed, ground=ground)
    course = yaw + np.radians(heading)
    way, rest = np.array([np.cos(course), np.sin(course), 0.0]), model.rest_state()
    position, velocity = rest.position.copy(), np.zeros((model.n_node, 3))
    position[:3, 2] -= load / ground.stiffness
    velocity[:3] = 3.0 * way
    engine = simulate(engine_name, model, dt)
    engine.restore(replace(rest, position=position, velocity=velocity))
    assert engine.advance([], n_step).ok
    along = share * np.cos(np.radians(heading))
    factor = np.hypot((ground.forward if along > 0.0 else ground.backward) * along, 0.8 * np.sqrt(1.0 - along**2))
    slowed = 3.0 - 0.5 * factor * 5.0 * n_step * dt
    assert slowed > 1.0
    np.testing.assert_allclose(engine.state.velocity[:3], slowed * np.tile(way, (3, 1)), rtol=0.0, atol=1e-12)


def test_the_axis_of_a_worm_runs_from_base_to_top() -> None:
    """First and last nodes of the structure rods; muscles count for nothing."""
    lattice = build_lattice(LatticeDesign(base="free"))
    model = build_model(lattice, named_layout("all", lattice), World(ground=BY_DIRECTION, lying=True))
    tail, head = model.rod_ends
    assert len(tail) == len(head) == lattice.n_rod
    place = model.rest_state().position
    way = place[head].mean(axis=0) - place[tail].mean(axis=0)
    np.testing.assert_allclose(way, [lattice.design.height, 0.0, 0.0], atol=1e-12)


def test_friction_by_direction_needs_an_axis() -> None:
    """Rods there and back have none, nor have muscles; with one friction for all directions none is asked for."""
    there, back = straight_rod((0, 0, 1), (1, 0, 1), 2, **SOFT), straight_rod((1, 0, 1), (0, 0, 1), 2, **SOFT)
    message = r"^ground: where friction differs by direction, rods that are no muscles must have a mean way"
    with pytest.raises(ValueError, match=message):
        RodModel(rods=(there, back), ground=BY_DIRECTION)
    with pytest.raises(ValueError, match=message):
        RodModel(rods=(there,), muscles=(0,), ground=BY_DIRECTION)
    alike = Ground(forward=0.5, backward=0.5, sideways=0.5)
    assert RodModel(rods=(there, back), ground=alike).ground == alike


CONTROL_DT = 0.05


def crawl(env: LatticeWormEnv, n_step: int) -> Iterator[FloatArray]:
    """Tensions of the hand-made gait over each control step, shape (2, n_muscle)."""
    env.reset(seed=0, options={"direction": 1.0})
    commands, design = gait("crawl", env.lattice, env.layout, env.task.command), env.design
    before = np.zeros(env.model.n_muscle)
    for step in range(n_step):
        after = advance_activation(before, commands(step * CONTROL_DT), CONTROL_DT, design.rise_time, design.decay_time)
        yield design.max_tension * np.stack([before, after])
        before = after


def test_engines_agree_on_a_crawl() -> None:
    """The task's own world, for a quarter of a second: 1e-6 m, and an energy that closes.

    The mesh is coarse, for the sake of time. What the law leaves, see `energy`, is up to a hundredth of what was
    dissipated, as in the air.
    """
    env = LatticeWormEnv("crawl", fidelity="fast", splitting="pyelastica")
    fused = simulate("fused", env.model, env.dt, energy_check=True)
    reference = simulate("pyelastica", env.model, env.dt)
    start, residual, dissipated = env.state, 0.0, 0.0
    for engine in (fused, reference):
        engine.restore(start)
    for pull in crawl(env, 5):
        assert fused.advance(pull, env.n_substeps).ok
        assert reference.advance(pull, env.n_substeps).ok
        entry = fused.ledger
        assert entry is not None
        residual, dissipated = residual + entry.residual, dissipated + entry.dissipated
    a, b = fused.state, reference.state
    assert np.abs(a.position - start.position).max() > 5e-3
    assert np.abs(a.position - b.position).max() < 1e-6
    assert np.abs(a.directors - b.directors).max() < 1e-4
    assert abs(residual) < 1e-2 * dissipated


def test_the_momentum_of_a_crawl_closes() -> None:
    """Weight less buoyancy, damping and the ground are all that changes momentum, in every step of a quarter second.

    The same step without friction tells what friction meets: a node's slip, of which Coulomb's law takes what it can.
    """
    env = LatticeWormEnv("crawl", fidelity="fast", splitting="pyelastica")
    model, dt, ground = env.model, env.dt, env.model.ground
    assert ground is not None
    slick = replace(model, ground=replace(ground, static_friction=0.0, kinetic_friction=0.0))
    engine, free = simulate("fused", model, dt), simulate("fused", slick, dt)
    mass, keep = model.node_mass, np.exp(-model.node_damping / model.node_mass * dt)
    weight = dt * model.node_weight.sum(axis=0)
    engine.restore(env.state)
    now, largest, error, sticks = env.state, np.zeros(3), np.zeros(3), 0
    for pull in crawl(env, 5):
        for step in range(env.n_substeps):
            tension = pull[0] + (pull[1] - pull[0]) * ((step + 0.5) / env.n_substeps)
            free.restore(now)
            assert engine.advance(tension, 1).ok
            assert free.advance(tension, 1).ok
            slip, after = free.state.velocity, engine.state
            depth = model.node_radius - (now.position + 0.5 * dt * now.velocity)[:, 2]
            push = ground.stiffness * depth - ground.damping * now.velocity[:, 2]
            normal = dt * np.where(depth > 0.0, np.maximum(push, 0.0), 0.0)
            speed, reach = np.hypot(slip[:, 0], slip[:, 1]), keep * normal / mass
            held = speed <= ground.static_friction * reach
            taken = np.where(held, 1.0, ground.kinetic_friction * reach / np.where(held, 1.0, speed))
            of_ground = np.append(-(mass * taken) @ slip[:, :2], normal.sum())
            of_damping = -(mass * (1.0 / keep - 1.0)) @ slip
            change = mass @ (after.velocity - now.velocity)
            error = np.maximum(error, np.abs(change - weight - of_ground - of_damping))
            largest = np.maximum(largest, np.abs(of_ground))
            now, sticks = after, sticks + int((held & (normal > 0.0)).sum())
    assert sticks > 0
    assert (largest > 0.0).all()
    assert (error < 1e-12 * largest.max()).all()
