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
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.laws.ball import RigidBall
from lattice_gym.physics.rod import straight_rod
from lattice_gym.physics.state import RodState
from lattice_gym.verification.case import Reading, Scene, advance_by, exact_case, sample
from lattice_gym.verification.ground import COULOMB
from lattice_gym.verification.momentum import NEWTON, momenta

RADIUS, ROD_RADIUS, ELEMENT = 0.1, 0.01, 4.0
"""Of the ball, the rods, and the length of an element of a rail [m]."""
CONTACT = RADIUS + ROD_RADIUS
"""Contact distance: of the ball's centre from the axis of a rod [m]."""
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
    return RodModel(rods=rods, clamps=clamps, ball=RigidBall(position=position, radius=RADIUS, mass=1.0, **ball))


@exact_case(
    "Ball at rest",
    quantity="depth [mm]",
    abscissa="t [s]",
    exact="m g / k",
    source="Hooke's law",
    n_elem=2,
    tolerance=1e-12,
    reason="critically damped: (1 + 38) e^-38 of the start is left, rounding dominates",
)
def ball_at_rest(n_elem: int) -> Scene:
    """Damped ball that starts on a rail, unloaded, and sinks in."""
    damping = 2.0 * np.sqrt(SOFT)
    model = _on_rails(n_elem, (0.0,), CONTACT, stiffness=SOFT, damping=damping, force=(0.0, 0.0, -GRAVITY))

    def observe(engine: Simulation) -> Reading:
        depth = CONTACT - advance_by(engine, 1.2).ball_position[:, 2]
        return Reading(np.array([1.2]), 1e3 * depth, np.array([1e3 * GRAVITY / SOFT]))

    return Scene(model, model.rest_state(), STEP, observe)


@exact_case(
    "Ball that slides, then rolls",
    quantity="speed; spin times arm [m/s]",
    abscissa="t [s]",
    exact="v0 - mu g t; mu g t a^2 / I; both at most v0 a^2 / (I + a^2), with the arm a",
    source=COULOMB,
    n_elem=2,
    tolerance=1e-10,
    reason="rounding: position Verlet takes a constant acceleration without error, and friction in the step in "
    "which the ball begins to roll takes what slip is left",
)
def ball_that_rolls(n_elem: int) -> Scene:
    """Ball thrown along a rail, which slides and spins up until it rolls; read before and after."""
    arm = CONTACT - GRAVITY / STIFF
    model = _on_rails(n_elem, (0.0,), arm, stiffness=STIFF, friction=FRICTION, force=(0.0, 0.0, -GRAVITY))
    assert model.ball is not None
    gain, rolling = FRICTION * GRAVITY * arm**2 / model.ball.inertia, arm**2 / (arm**2 + model.ball.inertia)

    def observe(engine: Simulation) -> Reading:
        times = np.linspace(0.02, 0.2, 10)
        measured = sample(engine, times, lambda s: np.array([s.ball_velocity[0, 0], arm * s.ball_omega[0, 1]]))
        exact = np.maximum(1.0 - FRICTION * GRAVITY * times, rolling), np.minimum(gain * times, rolling)
        return Reading(times, measured, np.stack(exact, axis=1))

    start = replace(model.rest_state(), ball_velocity=np.array([[1.0, 0.0, 0.0]]))
    return Scene(model, start, STEP, observe)


PRESS, BELOW, ABOVE = 1.0, 0.95, 1.5
"""Normal force of either rail that presses a ball [N], and loads on it over the largest friction of both."""


def _pressed(n_elem: int, load: float) -> Scene:
    """Ball between two rails that press it, loaded along them."""
    across, limit = CONTACT - PRESS / SOFT, 2.0 * FRICTION * PRESS
    force = (load * limit, 0.0, 0.0)
    model = _on_rails(n_elem, (-across, across), 0.0, stiffness=SOFT, friction=FRICTION, force=force)

    def observe(engine: Simulation) -> Reading:
        times = np.linspace(0.1, 0.5, 5)
        way = sample(engine, times, lambda state: state.ball_position[0, 0] - 0.5 * ELEMENT)
        exact = 0.5 * max(load - 1.0, 0.0) * limit * times**2
        return Reading(times, way, exact, scale=0.5 * load * limit * times[-1] ** 2)

    return Scene(model, model.rest_state(), STEP, observe)


def _creep_share() -> float:
    """Creep of a ball that friction holds, over its free displacement: the slip left after six symmetric sweeps.

    The entries of the Delassus matrix are 1 + a for a rail's own slip and 1 - a for that of the other rail, with
    a = arm^2 / (2/5 radius^2); each of the twelve updates after the first reduces the slip by their ratio.
    """
    turning = (CONTACT - PRESS / SOFT) ** 2 / (0.4 * RADIUS**2)
    return float(((turning - 1.0) / (turning + 1.0)) ** 12 * 2.0 * STEP / 0.5)


@exact_case(
    "Ball held by friction",
    quantity="way over that without friction",
    abscissa="t [s]",
    exact="0",
    source=COULOMB,
    n_elem=2,
    tolerance=_creep_share(),
    reason="what the sweeps leave of the speed that the load adds in a step",
)
def ball_that_is_held(n_elem: int) -> Scene:
    """Load below what friction bears."""
    return _pressed(n_elem, BELOW)


@exact_case(
    "Ball that friction cannot hold",
    quantity="way over that without friction",
    abscissa="t [s]",
    exact="(F - 2 mu N) t^2 / (2 m)",
    source=COULOMB,
    n_elem=2,
    tolerance=1e-10,
    reason="rounding, as for the ball that slides",
)
def ball_that_yields(n_elem: int) -> Scene:
    """Load above it."""
    return _pressed(n_elem, ABOVE)


HIT_STEP = 1e-5


@exact_case(
    "Momentum, ball that hits a rod",
    quantity="change of both momenta over the start",
    abscissa="t [ms]",
    exact="0",
    source=NEWTON,
    n_elem=4,
    tolerance=1e-7,
    reason="the couple's turn between two elements is a trapezoid sum: exact to the cube of their angle (5 mrad)",
)
def ball_hits_rod(n_elem: int) -> Scene:
    """Spinning ball that hits a free rod off its middle, with friction."""
    rod = straight_rod((-0.3, 0.01, 0.0), (0.3, 0.01, 0.0), n_elem, **ROD)
    hitting = RigidBall(
        position=np.array([0.15, 0.03, 0.105]), radius=RADIUS, mass=0.3, stiffness=1e4, damping=3.0, friction=0.5
    )
    model = RodModel(rods=(rod,), ball=hitting)
    velocity, omega = np.array([[0.3, -0.2, -1.0]]), np.array([[5.0, 3.0, -2.0]])
    start = replace(model.rest_state(), ball_velocity=velocity, ball_omega=omega)

    before = momenta(model, start)

    def gained(state: RodState) -> FloatArray:
        """Momentum, and angular momentum about the origin over the ball's radius, since the start [kg m/s]."""
        return np.array((momenta(model, state) - before) / [[1.0], [RADIUS]])

    def observe(engine: Simulation) -> Reading:
        times, scale = np.linspace(1e-3, 5e-3, 5), float(np.linalg.norm(before[0]))
        return Reading(1e3 * times, sample(engine, times, gained), np.zeros((5, 2, 3)), scale=scale)

    return Scene(model, start, HIT_STEP, observe)


BALL_CASES = (ball_at_rest, ball_that_rolls, ball_that_is_held, ball_that_yields, ball_hits_rod)
"""Every case of the ball."""
