"""Exact cases of loaded rods at rest. Scenes are damped, and settle."""

from __future__ import annotations

import numpy as np

from lattice_gym.engines.simulation import Simulation
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.critical_step import critical_dt
from lattice_gym.physics.laws.loads import PointForce, PointTorque
from lattice_gym.physics.rod import SHEAR_CORRECTION, Rod, rotation_between, straight_frames
from lattice_gym.verification.bar import AREA, GAZZOLA, LENGTH, RADIUS, RHO, SECOND_MOMENT, SPEED, E, G, bar
from lattice_gym.verification.case import CRITICAL_SHARE, SETTLING, Reading, Scene, advance_by, exact_case


@exact_case(
    "Axial stretch",
    quantity="displacement [m]",
    abscissa="z [m]",
    exact="u(z) = F z / (E A - F)",
    source=f"{GAZZOLA}: force E A (e - 1) / e, as sections keep their volume",
    n_elem=8,
    tolerance=1e-10,
    reason="exact on any mesh; e^-30 of the start is left, rounding dominates",
)
def axial_stretch(n_elem: int) -> Scene:
    """Clamped bar under an end force of a fifth of E A."""
    force, slowest = 0.2 * E * AREA, 0.5 * np.pi * SPEED / LENGTH
    model = RodModel(
        rods=(bar(n_elem, rate=SETTLING * slowest),),
        clamps=(Clamp(0, node=0, element=0),),
        forces=(PointForce(0, n_elem, (0.0, 0.0, force)),),
    )
    rest = model.rest_state()

    def observe(engine: Simulation) -> Reading:
        z = rest.position[:, 2] + 0.5 * LENGTH
        moved = advance_by(engine, 60.0 / slowest).position[:, 2] - rest.position[:, 2]
        return Reading(z, moved, z * force / (E * AREA - force))

    return Scene(model, rest, CRITICAL_SHARE * critical_dt(model), observe)


@exact_case(
    "Timoshenko cantilever",
    quantity="deflection [mm]",
    abscissa="s [m]",
    exact="y(s) = F s / (27/28 G A) + F L s^2 / (2 E I) - F s^3 / (6 E I)",
    source=f"{GAZZOLA}, section 3.4.3",
    n_elem=20,
    coarse=10,
    meshes=(5, 10, 20),
    tolerance=lambda n: 0.6 / n**2 + 1e-5,
    reason="mesh error dl^2 / (2 L^2) of the deflection, a fifth to spare; the tip turns by 5e-4 rad, "
    "squared terms stay below 1e-5",
)
def timoshenko_cantilever(n_elem: int) -> Scene:
    """Two cantilevers of n_elem elements back to back, so that the clamp itself makes no mesh error."""
    force = 0.001 * E * SECOND_MOMENT / LENGTH**2
    slowest = 3.2 * SPEED * 0.5 * RADIUS / LENGTH**2
    model = RodModel(
        rods=(bar(2 * n_elem, length=2.0 * LENGTH, rate=SETTLING * slowest),),
        clamps=(Clamp(0, node=n_elem),),
        forces=tuple(PointForce(0, node, (force, 0.0, 0.0)) for node in (0, 2 * n_elem)),
    )

    def observe(engine: Simulation) -> Reading:
        deflection = advance_by(engine, 30.0 / slowest).position[:, 0]
        place = np.linspace(-LENGTH, LENGTH, 2 * n_elem + 1)
        s = np.abs(place)
        bend = force * (LENGTH * s**2 / 2.0 - s**3 / 6.0) / (E * SECOND_MOMENT)
        return Reading(place, 1e3 * deflection, 1e3 * (force * s / (SHEAR_CORRECTION * G * AREA) + bend))

    return Scene(model, model.rest_state(), CRITICAL_SHARE * critical_dt(model), observe)


def _turned_by_couples(n_elem: int, axis: int, stiffness: float, slowest: float, settling_time: float) -> Scene:
    """Free rod between opposite end couples that turn one end against the other by a radian over its length."""
    moment = np.zeros(3)
    moment[axis] = stiffness / LENGTH
    start, end = (-moment[0], -moment[1], -moment[2]), (moment[0], moment[1], moment[2])
    torques = (PointTorque(0, 0, start), PointTorque(0, n_elem - 1, end))
    model = RodModel(rods=(bar(n_elem, rate=SETTLING * slowest),), torques=torques)

    def observe(engine: Simulation) -> Reading:
        directors = advance_by(engine, settling_time).directors
        turned = rotation_between(np.broadcast_to(directors[0], directors.shape), directors)
        exact = np.zeros((n_elem, 3))
        exact[:, axis] = np.arange(n_elem) / n_elem
        return Reading(exact[:, axis] * LENGTH, turned, exact)

    return Scene(model, model.rest_state(), CRITICAL_SHARE * critical_dt(model), observe)


LOVE = "Love 1927, Mathematical Theory of Elasticity"
SETTLED = "exact on any mesh; e^-25 of the start is left, rounding dominates"


@exact_case(
    "Uniform bend",
    quantity="rotation [rad]",
    abscissa="s [m]",
    exact="angle(s) = M s / (E I)",
    source=f"{LOVE}, chapter XVIII",
    n_elem=10,
    tolerance=1e-9,
    reason=SETTLED,
)
def uniform_bend(n_elem: int) -> Scene:
    """Couples about d1."""
    slowest = 22.4 * SPEED * 0.5 * RADIUS / LENGTH**2
    return _turned_by_couples(n_elem, 0, E * SECOND_MOMENT, slowest, 50.0 / slowest)


@exact_case(
    "Uniform twist",
    quantity="rotation [rad]",
    abscissa="s [m]",
    exact="angle(s) = M s / (G J)",
    source=f"{LOVE}, chapter XVIII",
    n_elem=10,
    tolerance=1e-9,
    reason=SETTLED,
)
def uniform_twist(n_elem: int) -> Scene:
    """Couples about the axis."""
    slowest = np.pi * np.sqrt(G / RHO) / LENGTH
    # The moment of inertia about the axis is twice that about d1, so the same damping takes twice as long.
    return _turned_by_couples(n_elem, 2, 2.0 * G * SECOND_MOMENT, slowest, 100.0 / slowest)


SPRING_RADIUS, SPRING_COILS, SPRING_PITCH_ANGLE = 0.5, 2.0, np.radians(25.0)


@exact_case(
    "Open-coiled helical spring",
    quantity="deflection, unwinding [m]",
    abscissa="1: deflection, 2: unwinding x radius",
    exact="F l (R^2 cos^2 a / (G J) + R^2 sin^2 a / (E I) + cos^2 a / (27/28 G A) + sin^2 a / (E A)); "
    "F R l sin a cos a (1 / (G J) - 1 / (E I))",
    source=f"{LOVE}, chapter XIX (spiral springs); stretch and shear by Castigliano",
    n_elem=48,
    coarse=24,
    meshes=(16, 32, 64),
    tolerance=lambda n: (2.0 * np.pi * SPRING_COILS / n) ** 2 / 8.0 + 1e-4,
    reason="with an angle p between elements their middles lie p^2 / 8 of the radius inside the helix; "
    "squared terms stay below 1e-4",
)
def helical_spring(n_elem: int) -> Scene:
    """One helical rod, free of stress, clamped at its foot and pulled along the helix's axis at its top.

    The load acts on the axis: a force on the last node and the couple that moves it there. Frames stand at the middles
    of elements, so the wire that gives is the one between the middles of the first and the last element.
    """
    sine, cosine = np.sin(SPRING_PITCH_ANGLE), np.cos(SPRING_PITCH_ANGLE)
    wire = 2.0 * np.pi * SPRING_COILS * SPRING_RADIUS / cosine
    angle = np.linspace(0.0, 2.0 * np.pi * SPRING_COILS, n_elem + 1)
    around = SPRING_RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    position = np.column_stack([around, SPRING_RADIUS * angle * sine / cosine])
    outward = 0.5 * (position[1:] + position[:-1]) * np.array([1.0, 1.0, 0.0])
    directors = straight_frames(position, outward)
    # Sway is slower than the first axial mode, pi / 2 sqrt(rate / mass), by about this share.
    slowest = 0.7 * 0.5 * np.pi * np.sqrt(G / (2.0 * RHO)) * RADIUS / (SPRING_RADIUS * wire)
    share, rate = wire / n_elem, SETTLING * slowest
    rod = Rod(
        position=position,
        directors=directors,
        radius=np.full(n_elem, RADIUS),
        density=RHO,
        youngs_modulus=E,
        shear_modulus=G,
        damping=rate * RHO * AREA * share,
        rotational_damping=rate * RHO * SECOND_MOMENT * share,
    )
    bend, twist = E * SECOND_MOMENT, 2.0 * G * SECOND_MOMENT
    free = wire * (1.0 - 1.0 / n_elem)
    rate_inverse = free * (
        SPRING_RADIUS**2 * (cosine**2 / twist + sine**2 / bend)
        + cosine**2 / (SHEAR_CORRECTION * G * AREA)
        + sine**2 / (E * AREA)
    )
    force = 1e-5 * position[-1, 2] / rate_inverse
    turn = force * SPRING_RADIUS * free * sine * cosine * (1.0 / twist - 1.0 / bend)
    exact = np.array([force * rate_inverse, turn * SPRING_RADIUS])
    to_axis = -position[-1] * np.array([1.0, 1.0, 0.0])
    couple = directors[-1] @ np.cross(to_axis, (0.0, 0.0, force))
    model = RodModel(
        rods=(rod,),
        clamps=(Clamp(0, node=0, element=0),),
        forces=(PointForce(0, n_elem, (0.0, 0.0, float(force))),),
        torques=(PointTorque(0, n_elem - 1, (float(couple[0]), float(couple[1]), float(couple[2]))),),
    )

    def observe(engine: Simulation) -> Reading:
        state = advance_by(engine, 28.0 / slowest)
        turned = directors[-1].T @ rotation_between(directors[-1:], state.directors[-1:])[0]
        moved = 0.5 * (state.position[-2:] - position[-2:]).sum(axis=0)
        # The point of the axis beside the last element's middle moves with that element.
        deflection = moved[2] + np.cross(turned, -outward[-1])[2]
        return Reading(np.array([1.0, 2.0]), np.array([deflection, turned[2] * SPRING_RADIUS]), exact)

    return Scene(model, model.rest_state(), CRITICAL_SHARE * critical_dt(model), observe)


STATIC_CASES = (axial_stretch, timoshenko_cantilever, uniform_bend, uniform_twist, helical_spring)
"""Every case of a loaded rod at rest."""
