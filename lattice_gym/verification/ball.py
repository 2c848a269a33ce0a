"""Exact cases of the rigid ball: on rails, which are rods that hold still, and in flight against a rod that is free.

Balls start at the depth of their load over the contact's stiffness, above the middle of an element. So the normal force
stays, and with it a friction that slips: what it does, position Verlet takes without error.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from lattice_gym.checks import FloatArray
from lattice_gym.engines.simulation import Simulation
from lattice_gym.physics.assembly import Ball, Clamp, RodModel
from lattice_gym.physics.rod import straight_rod
from lattice_gym.physics.state import RodState
from lattice_gym.verification.ground import COULOMB
from lattice_gym.verification.scene import Case, Reading, Scene, pass_time

RADIUS, ROD_RADIUS, ELEMENT = 0.1, 0.01, 4.0
"""Of the ball, the rods, and the length of an element of a rail [m]."""
REACH = RADIUS + ROD_RADIUS
GRAVITY, FRICTION = 9.81, 0.3
SOFT, STIFF = 1e3, 1e5
STEP = 1e-3
ROD: dict[str, Any] = {"radius": ROD_RADIUS, "density": 1000.0, "youngs_modulus": 1e7, "shear_modulus": 4e6}


def _on_rails(n_elem: int, across: tuple[float, ...], height: float, **ball: Any) -> RodModel:
    """Ball of 1 kg above the middle of the second element of rails along x, at places across."""
    start, end = -ELEMENT, (n_elem - 1) * ELEMENT
    rods = tuple(straight_rod((start, y, 0.0), (end, y, 0.0), n_elem, **ROD) for y in across)
    clamps = tuple(Clamp(k, n, min(n, n_elem - 1)) for k in range(len(rods)) for n in range(n_elem + 1))
    position = np.array([0.5 * ELEMENT, 0.0, height])
    return RodModel(rods=rods, clamps=clamps, bolus=Ball(position=position, radius=RADIUS, mass=1.0, **ball))


def ball_at_rest(n_elem: int) -> Scene:
    """Damped ball that starts on a rail, unloaded, and sinks in."""
    damping = 2.0 * np.sqrt(SOFT)
    model = _on_rails(n_elem, (0.0,), REACH, stiffness=SOFT, damping=damping, force=(0.0, 0.0, -GRAVITY))

    def observe(engine: Simulation) -> Reading:
        pass_time(engine, 1.2)
        depth = REACH - engine.state.bolus_position[:, 2]
        return Reading(np.array([1.2]), 1e3 * depth, np.array([1e3 * GRAVITY / SOFT]))

    return Scene(model, model.rest_state(), STEP, observe)


def ball_that_rolls(n_elem: int) -> Scene:
    """Ball thrown along a rail, which slides and spins up until it rolls; read before and after."""
    arm = REACH - GRAVITY / STIFF
    model = _on_rails(n_elem, (0.0,), arm, stiffness=STIFF, friction=FRICTION, force=(0.0, 0.0, -GRAVITY))
    assert model.bolus is not None
    gain, rolling = FRICTION * GRAVITY * arm**2 / model.bolus.inertia, arm**2 / (arm**2 + model.bolus.inertia)

    def observe(engine: Simulation) -> Reading:
        times, measured = np.linspace(0.02, 0.2, 10), []
        for _ in times:
            pass_time(engine, 0.02)
            state = engine.state
            measured.append([state.bolus_velocity[0, 0], arm * state.bolus_omega[0, 1]])
        exact = np.maximum(1.0 - FRICTION * GRAVITY * times, rolling), np.minimum(gain * times, rolling)
        return Reading(times, np.array(measured), np.stack(exact, axis=1))

    start = replace(model.rest_state(), bolus_velocity=np.array([[1.0, 0.0, 0.0]]))
    return Scene(model, start, STEP, observe)


PRESS, HELD, YIELDING = 1.0, 0.95, 1.5
"""Normal force of either rail that presses a ball [N], and loads on it over the largest friction of both."""


def _pressed(n_elem: int, load: float) -> Scene:
    """Ball between two rails that press it, loaded along them."""
    across, limit = REACH - PRESS / SOFT, 2.0 * FRICTION * PRESS
    force = (load * limit, 0.0, 0.0)
    model = _on_rails(n_elem, (-across, across), 0.0, stiffness=SOFT, friction=FRICTION, force=force)

    def observe(engine: Simulation) -> Reading:
        times, measured = np.linspace(0.1, 0.5, 5), []
        for _ in times:
            pass_time(engine, 0.1)
            measured.append(engine.state.bolus_position[0, 0] - 0.5 * ELEMENT)
        exact = 0.5 * max(load - 1.0, 0.0) * limit * times**2
        return Reading(times, np.array(measured), exact, scale=0.5 * load * limit * times[-1] ** 2)

    return Scene(model, model.rest_state(), STEP, observe)


def ball_that_is_held(n_elem: int) -> Scene:
    """Load below what friction bears."""
    return _pressed(n_elem, HELD)


def ball_that_yields(n_elem: int) -> Scene:
    """Load above it."""
    return _pressed(n_elem, YIELDING)


def _held_share() -> float:
    """Share of its free way that a held ball may creep: what six sweeps forth and back leave of a step's speed.

    Friction of one rail adds 1 + a to its own slip and 1 - a to that of the other, with a = arm^2 / (2/5 radius^2); in
    turns, twelve after the first, they take it down by the ratio of both.
    """
    turning = (REACH - PRESS / SOFT) ** 2 / (0.4 * RADIUS**2)
    return float(((turning - 1.0) / (turning + 1.0)) ** 12 * 2.0 * STEP / 0.5)


HIT_STEP = 1e-5


def ball_hits_rod(n_elem: int) -> Scene:
    """Spinning ball that hits a free rod off its middle and rubs on it."""
    rod = straight_rod((-0.3, 0.01, 0.0), (0.3, 0.01, 0.0), n_elem, **ROD)
    hitting = Ball(
        position=np.array([0.15, 0.03, 0.105]), radius=RADIUS, mass=0.3, stiffness=1e4, damping=3.0, friction=0.5
    )
    model = RodModel(rods=(rod,), bolus=hitting)
    velocity, omega = np.array([[0.3, -0.2, -1.0]]), np.array([[5.0, 3.0, -2.0]])
    start = replace(model.rest_state(), bolus_velocity=velocity, bolus_omega=omega)

    def momenta(state: RodState) -> FloatArray:
        """Momentum, and angular momentum about the origin over the ball's radius [kg m/s], shape (6,)."""
        carried = np.concatenate([model.node_mass[:, None] * state.velocity, hitting.mass * state.bolus_velocity])
        angular = np.cross(np.concatenate([state.position, state.bolus_position]), carried).sum(axis=0)
        length = np.linalg.norm(np.diff(state.position, axis=0), axis=1)
        inertia = (rod.inertia * rod.rest_length / length)[:, None] * np.array([1.0, 1.0, 2.0])
        angular += np.einsum("eji,ej->i", state.directors, inertia * state.omega)
        angular += hitting.inertia * state.bolus_omega[0]
        return np.concatenate([carried.sum(axis=0), angular / RADIUS])

    def observe(engine: Simulation) -> Reading:
        before, times, measured = momenta(start), np.linspace(1e-3, 5e-3, 5), []
        for _ in times:
            pass_time(engine, 1e-3)
            measured.append(momenta(engine.state) - before)
        scale = float(np.linalg.norm(before[:3]))
        return Reading(1e3 * times, np.array(measured), np.zeros((5, 6)), scale=scale)

    return Scene(model, start, HIT_STEP, observe)


BALL_CASES = (
    Case(
        name="ball_at_rest",
        title="Ball at rest",
        quantity="depth [mm]",
        abscissa="t [s]",
        exact="m g / k",
        source="Hooke's law",
        build=ball_at_rest,
        n_elem=2,
        coarse=2,
        tolerance=lambda n: 1e-12,
        reason="critically damped: (1 + 38) e^-38 of the start is left, rounding dominates",
    ),
    Case(
        name="ball_that_rolls",
        title="Ball that slides, then rolls",
        quantity="speed; spin times arm [m/s]",
        abscissa="t [s]",
        exact="v0 - mu g t; mu g t a^2 / I; both at most v0 a^2 / (I + a^2), with the arm a",
        source=COULOMB,
        build=ball_that_rolls,
        n_elem=2,
        coarse=2,
        tolerance=lambda n: 1e-10,
        reason="rounding: position Verlet takes a constant acceleration without error, and friction in the step in "
        "which the ball begins to roll takes what slip is left",
    ),
    Case(
        name="ball_that_is_held",
        title="Ball held by friction",
        quantity="way over that without friction",
        abscissa="t [s]",
        exact="0",
        source=COULOMB,
        build=ball_that_is_held,
        n_elem=2,
        coarse=2,
        tolerance=lambda n: _held_share(),
        reason="what the sweeps leave of the speed that the load adds in a step",
    ),
    Case(
        name="ball_that_yields",
        title="Ball that friction cannot hold",
        quantity="way over that without friction",
        abscissa="t [s]",
        exact="(F - 2 mu N) t^2 / (2 m)",
        source=COULOMB,
        build=ball_that_yields,
        n_elem=2,
        coarse=2,
        tolerance=lambda n: 1e-10,
        reason="rounding, as for the ball that slides",
    ),
    Case(
        name="ball_hits_rod",
        title="Momentum, ball that hits a rod",
        quantity="change of both momenta over the start",
        abscissa="t [ms]",
        exact="0",
        source="Newton's third law",
        build=ball_hits_rod,
        n_elem=4,
        coarse=4,
        tolerance=lambda n: 1e-7,
        reason="the couple's turn between two elements is a trapezoid sum: exact to the cube of their angle (5 mrad)",
    ),
)
"""Every case of the ball."""
