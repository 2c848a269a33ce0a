"""Exact cases of weight, buoyancy, drag and the ground.

Rods are so soft that each of their nodes is a block of its own. The normal force on a node that starts at the depth of
its weight over the ground's stiffness stays its weight, so slip has a constant deceleration, which position Verlet
takes without error.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lattice_gym.checks import FloatArray
from lattice_gym.engines.simulation import Simulation
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.rod import Rod, straight_rod
from lattice_gym.physics.state import RodState
from lattice_gym.physics.world import Ground
from lattice_gym.verification.scene import Case, Reading, Scene, pass_time

RHO, RADIUS, LENGTH = 1000.0, 0.1, 1.0
MEDIUM, GRAVITY = 400.0, 9.81
AREA = np.pi * RADIUS**2
NET_GRAVITY = (1.0 - MEDIUM / RHO) * GRAVITY
"""What a rod of density RHO falls with in the medium [m/s^2]."""
STIFFNESS, DAMPING = 4000.0, 350.0
COULOMB = "Coulomb's law of dry friction: Goldstein, Poole and Safko 2002, Classical Mechanics, chapter 1"


def block(n_elem: int, density: float = RHO) -> Rod:
    """Soft rod along y on the ground."""
    return straight_rod(
        (0.0, 0.0, RADIUS), (0.0, LENGTH, RADIUS), n_elem,
        radius=RADIUS, density=density, youngs_modulus=1e-7, shear_modulus=4e-8,
    )  # fmt: skip


def _weight(n_elem: int, gravity: float = GRAVITY) -> FloatArray:
    """Weight of each node of a block in the medium [N], shape (n_elem + 1,)."""
    weight = np.full(n_elem + 1, (RHO - MEDIUM) * AREA * LENGTH / n_elem * gravity)
    weight[[0, -1]] *= 0.5
    return weight


def rest_penetration(n_elem: int) -> Scene:
    """Block that starts with its surface on the ground, unloaded, and sinks in."""
    model = RodModel(
        rods=(block(n_elem),),
        gravity=np.array([0.0, 0.0, -GRAVITY]),
        medium_density=MEDIUM,
        ground=Ground(stiffness=STIFFNESS, damping=DAMPING),
    )

    def observe(engine: Simulation) -> Reading:
        pass_time(engine, 3.0)
        depth = RADIUS - engine.state.position[:, 2]
        return Reading(np.linspace(0.0, LENGTH, n_elem + 1), 1e3 * depth, 1e3 * _weight(n_elem) / STIFFNESS)

    return Scene(model, model.rest_state(), 1e-3, observe)


DRAG, FALL_STEP = 60.0, 2.5e-4
FALL_DENSITIES = (2000.0, 200.0)


def free_fall(n_elem: int) -> Scene:
    """Two rods in the medium, one heavier and one lighter than it, let go at rest."""
    model = RodModel(
        rods=tuple(block(n_elem, density) for density in FALL_DENSITIES),
        gravity=np.array([0.0, 0.0, -GRAVITY]),
        medium_density=MEDIUM,
        medium_drag=DRAG,
    )
    density = np.repeat(FALL_DENSITIES, n_elem + 1)
    terminal, rate = (MEDIUM - density) * AREA * GRAVITY / DRAG, DRAG / (density * AREA)

    def observe(engine: Simulation) -> Reading:
        times, measured = np.linspace(0.2, 2.0, 10), []
        for _ in times:
            pass_time(engine, 0.2)
            measured.append(engine.state.velocity[:, 2] / terminal)
        return Reading(times, np.array(measured), -np.expm1(-np.outer(times, rate)))

    return Scene(model, model.rest_state(), FALL_STEP, observe)


SLIP_SPEED, FRICTION, SLIP_STEPS = 1.0, 0.5, 400.5
"""Start of the sliding blocks [m/s], their coefficient, and the steps in which the one that is held most stops."""
HEADINGS = np.radians([0.0, 180.0, 90.0, 45.0, 210.0])
"""Of the sliding blocks, from the axis that they have in common."""
YAW = 0.3
"""How far they have turned from where they lie at rest [rad]."""


def _start(model: RodModel, weight: FloatArray, velocity: FloatArray, yaw: float = 0.0) -> RodState:
    """Blocks at the depth of the given normal forces [N], shape (n_node,), at velocities, shape (n_block, 3)."""
    rest, cosine, sine = model.rest_state(), np.cos(yaw), np.sin(yaw)
    turn = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    position = rest.position @ turn
    position[:, 2] -= np.tile(weight, model.n_rod) / STIFFNESS
    velocity = np.repeat(velocity, len(weight), axis=0)
    return replace(rest, position=position, directors=rest.directors @ turn, velocity=velocity)


def _track(engine: Simulation, times: FloatArray, direction: FloatArray) -> FloatArray:
    """Way of every node along its block's direction, shape (n_block, 3), at even times: (n_time, n_node)."""
    model, start, way = engine.model, engine.state.position, []
    along = np.repeat(direction, model.n_node // model.n_rod, axis=0)
    for _ in times:
        pass_time(engine, times[0])
        way.append(np.sum((engine.state.position - start) * along, axis=1))
    return np.array(way)


def _until_rest(times: FloatArray, speed: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Way of what starts at a speed and is held by an acceleration until it stops, shape (n_time, n_block)."""
    moving = np.minimum(times[:, None], speed / acceleration)
    way: FloatArray = speed * moving - 0.5 * acceleration * moving**2
    return way


def _slide(n_elem: int, forward: float, backward: float, sideways: float) -> Scene:
    ground = Ground(
        stiffness=STIFFNESS, damping=DAMPING, static_friction=FRICTION, kinetic_friction=FRICTION,
        forward=forward, backward=backward, sideways=sideways,
    )  # fmt: skip
    model = RodModel(
        rods=(block(n_elem),) * len(HEADINGS),
        gravity=np.array([0.0, 0.0, -GRAVITY]),
        medium_density=MEDIUM,
        ground=ground,
    )
    course = 0.5 * np.pi + YAW + HEADINGS
    heading = np.stack([np.cos(course), np.sin(course), np.zeros_like(course)], axis=1)
    along = np.where(np.cos(HEADINGS) > 0.0, forward, backward) * np.cos(HEADINGS)
    held = FRICTION * np.hypot(along, sideways * np.sin(HEADINGS)) * NET_GRAVITY
    slowest = SLIP_SPEED / held.min()

    def observe(engine: Simulation) -> Reading:
        times = engine.dt * np.round(np.arange(1, 21) * round(1.1 * slowest / 20.0 / engine.dt))
        exact = _until_rest(times, np.full(len(held), SLIP_SPEED), held)
        return Reading(times, _track(engine, times, heading), np.repeat(exact, n_elem + 1, axis=1))

    dt = SLIP_SPEED / held.max() / SLIP_STEPS
    return Scene(model, _start(model, _weight(n_elem), SLIP_SPEED * heading, YAW), float(dt), observe)


def sliding_block(n_elem: int) -> Scene:
    """Blocks that slide off in five directions, with one friction."""
    return _slide(n_elem, 1.0, 1.0, 1.0)


def sliding_block_by_direction(n_elem: int) -> Scene:
    """Take the same, with other friction forwards, backwards and sideways of how they lie."""
    return _slide(n_elem, 0.5, 1.5, 0.8)


STATIC, KINETIC = 0.6, 0.4
MODERATE, STEEP = 0.5, 0.8
"""Tangents of slopes: between the coefficients, and above both."""
INCLINE_STEP = 1e-3


def _incline(n_elem: int, slope: float, speed: FloatArray, acceleration: FloatArray) -> Scene:
    """Blocks on a slope, which is tilted gravity: their speed down it at the start and acceleration while they slip."""
    model = RodModel(
        rods=(block(n_elem),) * len(speed),
        gravity=GRAVITY * np.array([slope, 0.0, -1.0]) / np.hypot(slope, 1.0),
        medium_density=MEDIUM,
        ground=Ground(stiffness=STIFFNESS, damping=DAMPING, static_friction=STATIC, kinetic_friction=KINETIC),
    )
    down = np.tile([1.0, 0.0, 0.0], (len(speed), 1))
    start = _start(model, _weight(n_elem) / np.hypot(slope, 1.0), speed[:, None] * down)

    def observe(engine: Simulation) -> Reading:
        times = np.linspace(0.05, 0.5, 10)
        stop = np.divide(-speed, acceleration, out=np.full(len(speed), np.inf), where=speed * acceleration < 0.0)
        moving = np.minimum(times[:, None], stop)
        exact = speed * moving + 0.5 * acceleration * moving**2
        return Reading(times, _track(engine, times, down), np.repeat(exact, n_elem + 1, axis=1))

    return Scene(model, start, INCLINE_STEP, observe)


def incline(n_elem: int) -> Scene:
    """Blocks at rest, on their way down and on their way up, where a block at rest holds and one that slips goes on."""
    sine, cosine = NET_GRAVITY * np.array([MODERATE, 1.0]) / np.hypot(MODERATE, 1.0)
    acceleration = np.array([0.0, sine - KINETIC * cosine, sine + KINETIC * cosine])
    return _incline(n_elem, MODERATE, np.array([0.0, 0.5, -0.5]), acceleration)


def steep_incline(n_elem: int) -> Scene:
    """Block at rest on a slope that does not hold it."""
    sine, cosine = NET_GRAVITY * np.array([STEEP, 1.0]) / np.hypot(STEEP, 1.0)
    return _incline(n_elem, STEEP, np.zeros(1), np.array([sine - KINETIC * cosine]))


GROUND_CASES = (
    Case(
        name="rest_penetration",
        title="Rest on the ground",
        quantity="depth [mm]",
        abscissa="y [m]",
        exact="m g (1 - rho_medium / rho) / k",
        source="Archimedes' principle; Hooke's law",
        build=rest_penetration,
        n_elem=4,
        coarse=4,
        tolerance=lambda n: 1e-8,
        reason="e^-20 of the start is left at the slowest node; the rod itself bears 1e-9 of it",
    ),
    Case(
        name="free_fall",
        title="Fall and rise in a medium",
        quantity="speed over terminal speed",
        abscissa="t [s]",
        exact="v(t) = g (rho_medium - rho) A / c (1 - exp(-c t / (rho A)))",
        source="linear drag c per length; Archimedes' principle",
        build=free_fall,
        n_elem=4,
        coarse=4,
        tolerance=lambda n: 0.6 * FALL_STEP * DRAG / (min(FALL_DENSITIES) * AREA),
        reason="damped after the kick, the terminal speed is x / (e^x - 1) of the true one, with x = c dt / (rho A); a "
        "fifth to spare",
    ),
    Case(
        name="sliding_block",
        title="Sliding block",
        quantity="way along the start [m]",
        abscissa="t [s]",
        exact="v0 t - mu g' t^2 / 2, at most v0^2 / (2 mu g')",
        source=COULOMB,
        build=sliding_block,
        n_elem=2,
        coarse=2,
        tolerance=lambda n: 1.0 / SLIP_STEPS**2,
        reason="the step in which a block stops takes what speed is left, at most mu g' dt",
    ),
    Case(
        name="sliding_block_by_direction",
        title="Sliding block, friction by direction",
        quantity="way along the start [m]",
        abscissa="t [s]",
        exact="v0 t - mu g' t^2 / 2, with mu = mu0 sqrt((f e_along)^2 + (f_s e_across)^2)",
        source=COULOMB,
        build=sliding_block_by_direction,
        n_elem=2,
        coarse=2,
        tolerance=lambda n: 1.0 / SLIP_STEPS**2,
        reason="as for one friction",
    ),
    Case(
        name="incline",
        title="Incline between both frictions",
        quantity="way down [m]",
        abscissa="t [s]",
        exact="0 from rest; v0 t + g' (sin a -+ mu_k cos a) t^2 / 2 on the way down or up, where it stops for good",
        source=COULOMB,
        build=incline,
        n_elem=2,
        coarse=2,
        tolerance=lambda n: 2e-5,
        reason="the step in which a block stops takes what speed is left: g' dt^2 / 2 of 0.3 m",
    ),
    Case(
        name="steep_incline",
        title="Incline above both frictions",
        quantity="way down [m]",
        abscissa="t [s]",
        exact="g' (sin a - mu_k cos a) t^2 / 2",
        source=COULOMB,
        build=steep_incline,
        n_elem=2,
        coarse=2,
        tolerance=lambda n: 1e-9,
        reason="rounding: position Verlet takes a constant acceleration without error",
    ),
)
"""Every case of weight, drag and ground."""
