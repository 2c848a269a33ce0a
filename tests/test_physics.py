"""Exact cases on both engines; each tolerance follows from the order of the scheme, the mesh or a decay time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lattice_gym.design import FloatArray, LatticeDesign
from lattice_gym.engines import Engine, EngineName, make_engine
from lattice_gym.lattice import build_lattice
from lattice_gym.model import (
    Clamp,
    Joint,
    PointForce,
    PointTorque,
    Rod,
    RodModel,
    build_model,
    rotation_between,
    stable_dt,
    straight_rod,
)
from lattice_gym.muscles import named_layout

E, G, RHO, RADIUS, LENGTH = 1e6, 4e5, 1000.0, 0.1, 1.0
AREA = np.pi * RADIUS**2
SECOND_MOMENT = np.pi / 4.0 * RADIUS**4


def bar(n_elem: int, *, damping: float = 0.0, rotational_damping: float = 0.0, youngs_modulus: float = E) -> Rod:
    """Straight rod along z; `damping` and `rotational_damping` are rates [1/s] of an inner node and an element."""
    share = LENGTH / n_elem
    return straight_rod(
        (0.0, 0.0, 0.0),
        (0.0, 0.0, LENGTH),
        n_elem,
        radius=RADIUS,
        density=RHO,
        youngs_modulus=youngs_modulus,
        shear_modulus=G / E * youngs_modulus,
        normal=(1.0, 0.0, 0.0),
        damping=damping * RHO * AREA * share,
        rotational_damping=rotational_damping * RHO * SECOND_MOMENT * share,
    )


def relax(name: EngineName, model: RodModel, duration: float) -> Engine:
    """Engine after `duration` seconds at half the predicted stable step."""
    dt = 0.5 * stable_dt(model)
    engine = make_engine(name, model, dt)
    assert engine.advance(np.zeros(model.n_muscle), round(duration / dt)).ok
    return engine


def test_axial_stretch(engine_name: EngineName) -> None:
    """A clamped bar under an end force F: dL = F L / (E A - F), exact for uniform stretch of constant volume."""
    force = 0.2 * E * AREA
    clamps, forces = (Clamp(0, node=0, element=0),), (PointForce(0, 8, (0.0, 0.0, force)),)
    model = RodModel(rods=(bar(8, damping=80.0),), clamps=clamps, forces=forces)
    tip = relax(engine_name, model, 1.5).state.position[-1, 2]
    # The slowest mode (49 rad/s, less in a stretched bar) decays at 20 per second or more: e^-30 is left.
    assert tip - LENGTH == pytest.approx(force * LENGTH / (E * AREA - force), rel=1e-10)


def test_axial_vibration(engine_name: EngineName) -> None:
    """A clamped-free bar rings at f = sqrt(E / rho) / (4 L)."""
    n_elem = 16
    model = RodModel(rods=(bar(n_elem),), clamps=(Clamp(0, node=0, element=0),))
    dt = 0.25 * stable_dt(model)
    engine = make_engine(engine_name, model, dt)
    rest = model.rest_state()
    velocity = np.zeros_like(rest.velocity)
    velocity[:, 2] = 1e-4 * np.sin(0.5 * np.pi * rest.position[:, 2] / LENGTH)
    engine.restore(replace(rest, velocity=velocity))
    frequency = np.sqrt(E / RHO) / (4.0 * LENGTH)
    tip = []
    for _ in range(int(4.2 / frequency / dt)):
        engine.advance([], 1)
        tip.append(engine.state.position[-1, 2] - LENGTH)
    signal = np.array(tip)
    k = np.flatnonzero((signal[:-1] < 0.0) & (signal[1:] >= 0.0))
    crossing = k + signal[k] / (signal[k] - signal[k + 1])
    measured = 1.0 / (np.diff(crossing).mean() * dt)
    # Lumped masses lower the frequency by (k dl)^2 / 24, the scheme raises it by (omega dt)^2 / 24.
    mesh, step = (0.5 * np.pi / n_elem) ** 2 / 24.0, (2.0 * np.pi * frequency * dt) ** 2 / 24.0
    assert measured / frequency == pytest.approx(1.0 - mesh + step, abs=1e-5 + mesh * 0.05)


def test_timoshenko_cantilever(engine_name: EngineName) -> None:
    """Bending and shear under an end load; two cantilevers back to back, so that the clamp itself has no mesh error."""
    n_half, force = 20, 0.01 * E * SECOND_MOMENT / LENGTH**2
    rod = straight_rod(
        (0.0, 0.0, -LENGTH),
        (0.0, 0.0, LENGTH),
        2 * n_half,
        radius=RADIUS,
        density=RHO,
        youngs_modulus=E,
        shear_modulus=G,
        normal=(1.0, 0.0, 0.0),
        damping=10.0 * RHO * AREA * LENGTH / n_half,
        rotational_damping=10.0 * RHO * SECOND_MOMENT * LENGTH / n_half,
    )
    forces = tuple(PointForce(0, node, (force, 0.0, 0.0)) for node in (0, 2 * n_half))
    model = RodModel(rods=(rod,), clamps=(Clamp(0, node=n_half),), forces=forces)
    state = relax(engine_name, model, 4.0).state
    s = np.linspace(0.0, LENGTH, n_half + 1)
    bend = force * (LENGTH * s**2 / 2.0 - s**3 / 6.0) / (E * SECOND_MOMENT)
    exact = force * s / (27.0 / 28.0 * G * AREA) + bend
    # Mesh error falls as 1 / n^2; the load turns the tip by 0.005 rad, so nonlinear terms are 1e-4 of the deflection.
    assert np.abs(state.position[n_half:, 0] - exact).max() < (0.5 / n_half**2 + 1e-4) * exact[-1]
    assert np.abs(state.position[n_half::-1, 0] - exact).max() < (0.5 / n_half**2 + 1e-4) * exact[-1]


@pytest.mark.parametrize(("axis", "stiffness"), [(0, E * SECOND_MOMENT), (2, 2.0 * G * SECOND_MOMENT)])
def test_uniform_bend_and_twist(engine_name: EngineName, axis: int, stiffness: float) -> None:
    """Opposite end couples bend (twist) a free rod by M / (E I) or M / (G J) per length, all along."""
    n_elem, angle = 10, 1.0
    moment = np.zeros(3)
    moment[axis] = angle * stiffness / LENGTH
    start, end = (-moment[0], -moment[1], -moment[2]), (moment[0], moment[1], moment[2])
    torques = (PointTorque(0, 0, start), PointTorque(0, n_elem - 1, end))
    model = RodModel(rods=(bar(n_elem, damping=20.0, rotational_damping=20.0),), torques=torques)
    state = relax(engine_name, model, 4.0).state
    first = np.broadcast_to(state.directors[0], (n_elem, 3, 3))
    turned = rotation_between(first, state.directors)
    expected = np.zeros((n_elem, 3))
    expected[:, axis] = angle * np.arange(n_elem) / n_elem
    assert np.abs(turned - expected).max() < 1e-7


def test_drag_only(engine_name: EngineName) -> None:
    """A free rod so soft that only drag acts: every node and every element slows by its own exact exponential."""
    rod = bar(4, damping=3.0, rotational_damping=2.0, youngs_modulus=1e-6)
    model = RodModel(rods=(rod,))
    engine = make_engine(engine_name, model, 0.01)
    rest = model.rest_state()
    # Along the rod only: stretch turns no element, and slow enough that it scales no inertia.
    velocity, omega = np.tile((0.0, 0.0, 1e-9), (5, 1)), np.tile((0.0, 0.0, 1e-3), (4, 1))
    engine.restore(replace(rest, velocity=velocity, omega=omega))
    engine.advance([], 100)
    state = engine.state
    rate = rod.damping / rod.mass
    assert state.velocity[:, 2] == pytest.approx(1e-9 * np.exp(-rate), rel=1e-9)
    spin_rate = rod.rotational_damping / (2.0 * rod.inertia)
    assert state.omega[:, 2] == pytest.approx(1e-3 * np.exp(-spin_rate), rel=1e-8)


def momenta(model: RodModel, engine: Engine) -> tuple[FloatArray, FloatArray]:
    """Linear [kg m/s] and angular momentum about the origin [kg m^2/s] of all rods."""
    state = engine.state
    mass = np.concatenate([rod.mass for rod in model.rods])[:, None]
    linear = (mass * state.velocity).sum(axis=0)
    angular = np.cross(state.position, mass * state.velocity).sum(axis=0)
    for index, rod in enumerate(model.rods):
        length = np.linalg.norm(np.diff(state.position[model.nodes(index)], axis=0), axis=1)
        inertia = (rod.inertia * rod.rest_length / length)[:, None] * np.array([1.0, 1.0, 2.0])
        elements = model.elements(index)
        angular += np.einsum("eji,ej->i", state.directors[elements], inertia * state.omega[elements])
    return linear, angular


def test_free_assembly_keeps_its_momentum(engine_name: EngineName) -> None:
    """Muscles and joints are internal: a free lattice without damping gains no momentum."""
    free = build_lattice(LatticeDesign(base="free", damping=0.0, rotational_damping=0.0))
    layout = named_layout("all", free)
    model = build_model(free, layout)
    engine = make_engine(engine_name, model, 2e-4)
    assert engine.advance(0.3 * np.random.default_rng(1).random(len(layout)), 100).ok
    linear, angular = momenta(model, engine)
    state, mass = engine.state, np.concatenate([rod.mass for rod in model.rods])[:, None]
    assert np.abs(linear).max() < 1e-11 * np.abs(mass * state.velocity).sum()
    # The couple's turn between two elements is a trapezoid sum: exact to the cube of their angle (0.1 rad).
    assert np.abs(angular).max() < 1e-6 * np.abs(np.cross(state.position, mass * state.velocity)).sum()


def axial_energy(rod: Rod, engine: Engine) -> float:
    """Kinetic energy plus E A l (e - 1 - ln e) [J], whose slope is the force E A (e - 1) / e of an element."""
    state = engine.state
    dilatation = np.diff(state.position[:, 2]) / rod.rest_length
    stored = rod.stretch_stiffness * rod.rest_length * (dilatation - 1.0 - np.log(dilatation))
    return float(0.5 * (rod.mass * state.velocity[:, 2] ** 2).sum() + stored.sum())


def test_undamped_energy_is_bounded_to_second_order(engine_name: EngineName) -> None:
    """A bar ringing at 10 % strain keeps its energy; what the scheme adds and takes back falls as dt^2."""
    model = RodModel(rods=(bar(6),))
    rest = model.rest_state()
    velocity = np.zeros_like(rest.velocity)
    velocity[:, 2] = 3.0 * np.cos(np.pi * rest.position[:, 2])
    errors = []
    for share in (0.4, 0.2, 0.1):
        dt = share * stable_dt(model)
        engine = make_engine(engine_name, model, dt)
        engine.restore(replace(rest, velocity=velocity))
        start = axial_energy(model.rods[0], engine)
        samples = []
        for _ in range(round(40 / share)):
            engine.advance([], 2)
            samples.append(axial_energy(model.rods[0], engine) / start - 1.0)
        errors.append(np.abs(samples).max())
    order = np.polyfit(np.log([4.0, 2.0, 1.0]), np.log(errors), 1)[0]
    assert order == pytest.approx(2.0, abs=0.15)
    assert errors[-1] < 1e-2


def test_two_joined_rods_swing_as_one_spring(engine_name: EngineName) -> None:
    """Two free rods moved apart at a soft joint oscillate about each other at sqrt(2 k / m)."""
    stiffness = 1.0
    a, b = bar(2), bar(2)
    model = RodModel(rods=(a, b), joints=(Joint(0, 1, 1, 1, stiffness),))
    mass = a.mass.sum()
    omega = np.sqrt(2.0 * stiffness / mass)
    rest = model.rest_state()
    position = rest.position.copy()
    position[3:, 0] += 1e-3
    # A half period in steps far below the rods' own periods.
    steps = int(np.ceil(np.pi / omega / (0.5 * stable_dt(model))))
    engine = make_engine(engine_name, model, np.pi / omega / steps)
    engine.restore(replace(rest, position=position))
    engine.advance([], steps)
    gap = engine.state.position[3:, 0].mean() - engine.state.position[:3, 0].mean()
    # The rods give: k over their shear stiffness 2 G A / L is 2e-5 of the motion.
    assert gap == pytest.approx(-1e-3, rel=2e-4)


def test_trajectory_converges_to_second_order() -> None:
    """Undamped and clamped, the lattice follows its own trajectory with an error that falls as dt^2."""
    lattice = build_lattice(LatticeDesign(damping=0.0, rotational_damping=0.0))
    model = build_model(lattice, named_layout("extension", lattice))
    tension = np.full(model.n_muscle, 0.2)
    end = []
    for steps in (80, 160, 320, 1280):
        engine = make_engine("fused", model, 0.02 / steps)
        assert engine.advance(tension, steps).ok
        end.append(engine.state.position)
    errors = [np.abs(position - end[-1]).max() for position in end[:-1]]
    order = np.polyfit(np.log([4.0, 2.0, 1.0]), np.log(errors), 1)[0]
    assert order == pytest.approx(2.0, abs=0.15)
