"""Exact cases on which both engines are judged: used by the validation report and by the tests.

Errors are relative to the largest exact value, or to a scale that the case names. Damped scenes settle: their damping
rate is the slowest angular frequency, so exp(-rate time / 2) is left of the start.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.simulation import Simulation
from lattice_gym.physics.assembly import Clamp, Joint, PointForce, PointTorque, RodModel
from lattice_gym.physics.rod import SHEAR_CORRECTION, Rod, rotation_between, straight_frames, straight_rod
from lattice_gym.physics.stable_step import stable_dt
from lattice_gym.physics.state import RodState
from lattice_gym.physics.worm import build_model
from lattice_gym.verification.ball import BALL_CASES
from lattice_gym.verification.buckling import localised_buckle, michell_ring
from lattice_gym.verification.ground import GROUND_CASES
from lattice_gym.verification.scene import SETTLING, Case, Reading, Scene, pass_time, with_velocity

E, G, RHO, RADIUS, LENGTH = 1e6, 4e5, 1000.0, 0.1, 1.0
AREA, SECOND_MOMENT = np.pi * RADIUS**2, np.pi / 4.0 * RADIUS**4
SPEED = np.sqrt(E / RHO)
"""Of sound along a bar [m/s]."""
STABLE_SHARE = 0.5
GAZZOLA = "Gazzola et al. 2018, R. Soc. Open Sci. 5:171628"


def bar(n_elem: int, *, length: float = LENGTH, rate: float = 0.0, youngs_modulus: float = E) -> Rod:
    """Straight rod along z centred at the origin; `rate` [1/s] damps an inner node and an element."""
    share = length / n_elem
    return straight_rod(
        (0.0, 0.0, -0.5 * length),
        (0.0, 0.0, 0.5 * length),
        n_elem,
        radius=RADIUS,
        density=RHO,
        youngs_modulus=youngs_modulus,
        shear_modulus=G / E * youngs_modulus,
        normal=(1.0, 0.0, 0.0),
        damping=rate * RHO * AREA * share,
        rotational_damping=rate * RHO * SECOND_MOMENT * share,
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
        pass_time(engine, 60.0 / slowest)
        z = rest.position[:, 2] + 0.5 * LENGTH
        moved = engine.state.position[:, 2] - rest.position[:, 2]
        return Reading(z, moved, z * force / (E * AREA - force))

    return Scene(model, rest, STABLE_SHARE * stable_dt(model), observe)


AXIAL_MODES = (1, 2, 3)


def axial_vibration(n_elem: int) -> Scene:
    """Undamped clamped-free bar, its first three modes set off at once; each is followed by its own projection."""
    model = RodModel(rods=(bar(n_elem),), clamps=(Clamp(0, node=0, element=0),))
    rest = model.rest_state()
    z, mass = rest.position[:, 2] + 0.5 * LENGTH, model.node_mass
    modes = np.array([np.sin((j - 0.5) * np.pi * z / LENGTH) for j in AXIAL_MODES])
    velocity = np.zeros_like(rest.velocity)
    velocity[:, 2] = 1e-6 * modes.sum(axis=0)
    exact = np.array([(2 * j - 1) / (4.0 * LENGTH) * SPEED for j in AXIAL_MODES])

    def observe(engine: Simulation) -> Reading:
        signal = []
        for _ in range(int(4.2 / exact[0] / engine.dt)):
            pass_time(engine, engine.dt)
            signal.append(modes @ (mass * (engine.state.position[:, 2] - rest.position[:, 2])))
        measured = np.array([_frequency(one, engine.dt) for one in np.array(signal).T])
        return Reading(np.array(AXIAL_MODES, float), measured / exact, np.ones(len(exact)))

    return Scene(model, with_velocity(rest, velocity), 0.1 * stable_dt(model), observe)


def _frequency(signal: FloatArray, dt: float) -> float:
    """Frequency [Hz] from the upward zero crossings."""
    k = np.flatnonzero((signal[:-1] < 0.0) & (signal[1:] >= 0.0))
    crossing = k + signal[k] / (signal[k] - signal[k + 1])
    return float(1.0 / (np.diff(crossing).mean() * dt))


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
        pass_time(engine, 30.0 / slowest)
        x = engine.state.position[:, 0]
        s = np.abs(np.linspace(-LENGTH, LENGTH, 2 * n_elem + 1))
        bend = force * (LENGTH * s**2 / 2.0 - s**3 / 6.0) / (E * SECOND_MOMENT)
        return Reading(
            np.linspace(-LENGTH, LENGTH, 2 * n_elem + 1),
            1e3 * x,
            1e3 * (force * s / (SHEAR_CORRECTION * G * AREA) + bend),
        )

    return Scene(model, model.rest_state(), STABLE_SHARE * stable_dt(model), observe)


def _turned_by_couples(n_elem: int, axis: int, stiffness: float, slowest: float, settling_time: float) -> Scene:
    """Free rod between opposite end couples that turn one end against the other by a radian over its length."""
    moment = np.zeros(3)
    moment[axis] = stiffness / LENGTH
    start, end = (-moment[0], -moment[1], -moment[2]), (moment[0], moment[1], moment[2])
    torques = (PointTorque(0, 0, start), PointTorque(0, n_elem - 1, end))
    model = RodModel(rods=(bar(n_elem, rate=SETTLING * slowest),), torques=torques)

    def observe(engine: Simulation) -> Reading:
        pass_time(engine, settling_time)
        directors = engine.state.directors
        turned = rotation_between(np.broadcast_to(directors[0], directors.shape), directors)
        exact = np.zeros((n_elem, 3))
        exact[:, axis] = np.arange(n_elem) / n_elem
        return Reading(exact[:, axis] * LENGTH, turned, exact)

    return Scene(model, model.rest_state(), STABLE_SHARE * stable_dt(model), observe)


def uniform_bend(n_elem: int) -> Scene:
    """Couples about d1."""
    slowest = 22.4 * SPEED * 0.5 * RADIUS / LENGTH**2
    return _turned_by_couples(n_elem, 0, E * SECOND_MOMENT, slowest, 50.0 / slowest)


def uniform_twist(n_elem: int) -> Scene:
    """Couples about the axis."""
    slowest = np.pi * np.sqrt(G / RHO) / LENGTH
    # The moment of inertia about the axis is twice that about d1, so the same damping takes twice as long.
    return _turned_by_couples(n_elem, 2, 2.0 * G * SECOND_MOMENT, slowest, 100.0 / slowest)


SPRING_RADIUS, SPRING_COILS, SPRING_PITCH_ANGLE = 0.5, 2.0, np.radians(25.0)


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
        pass_time(engine, 28.0 / slowest)
        state = engine.state
        turned = directors[-1].T @ rotation_between(directors[-1:], state.directors[-1:])[0]
        moved = 0.5 * (state.position[-2:] - position[-2:]).sum(axis=0)
        # The point of the axis beside the last element's middle moves with that element.
        deflection = moved[2] + np.cross(turned, -outward[-1])[2]
        return Reading(np.array([1.0, 2.0]), np.array([deflection, turned[2] * SPRING_RADIUS]), exact)

    return Scene(model, model.rest_state(), STABLE_SHARE * stable_dt(model), observe)


def drag_only(n_elem: int) -> Scene:
    """Free rod so soft that only drag acts, sliding and spinning along its axis so slowly that nothing else changes."""
    rod = bar(n_elem, rate=1.0, youngs_modulus=1e-7)
    model = RodModel(rods=(rod,))
    rest = model.rest_state()
    velocity, omega = np.zeros_like(rest.velocity), np.zeros_like(rest.omega)
    velocity[:, 2], omega[:, 2] = 1e-9, 1e-3

    def observe(engine: Simulation) -> Reading:
        times, measured = np.linspace(0.2, 3.0, 15), []
        for _ in times:
            pass_time(engine, 0.2)
            state = engine.state
            measured.append(np.concatenate([state.velocity[:, 2] / 1e-9, state.omega[:, 2] / 1e-3]))
        decay = np.concatenate([rod.damping / rod.mass, rod.rotational_damping / (2.0 * rod.inertia)])
        return Reading(times, np.array(measured), np.exp(-np.outer(times, decay)))

    return Scene(model, replace(rest, velocity=velocity, omega=omega), 0.01, observe)


def _momenta(engine: Simulation) -> tuple[FloatArray, FloatArray]:
    """Momentum, and angular momentum about the origin, each over the sum of what its nodes carry."""
    model, state = engine.model, engine.state
    carried = model.node_mass[:, None] * state.velocity
    lever = np.cross(state.position, carried)
    angular = lever.sum(axis=0)
    for index, rod in enumerate(model.rods):
        length = np.linalg.norm(np.diff(state.position[model.nodes(index)], axis=0), axis=1)
        inertia = (rod.inertia * rod.rest_length / length)[:, None] * np.array([1.0, 1.0, 2.0])
        elements = model.elements(index)
        angular += np.einsum("eji,ej->i", state.directors[elements], inertia * state.omega[elements])
    return carried.sum(axis=0) / np.abs(carried).sum(), angular / np.abs(lever).sum()


def _free_lattice(n_elem: int, which: int) -> Scene:
    design = LatticeDesign(base="free", damping=0.0, rotational_damping=0.0, elements_per_segment=n_elem)
    lattice = build_lattice(design)
    model = build_model(lattice, named_layout("all", lattice))

    def observe(engine: Simulation) -> Reading:
        tension = 0.3 * np.random.default_rng(1).random(model.n_muscle)
        times, measured = np.linspace(0.005, 0.02, 4), []
        for _ in times:
            health = engine.advance(tension, round(0.005 / engine.dt))
            if not health.ok:
                raise RuntimeError(f"exact case diverged: {health}")
            measured.append(np.linalg.norm(_momenta(engine)[which]))
        return Reading(1e3 * times, np.array(measured), np.zeros(len(times)), scale=1.0)

    return Scene(model, model.rest_state(), 2e-4, observe)


def linear_momentum(n_elem: int) -> Scene:
    """Free, undamped lattice of n_elem elements a segment under random tensions in all its muscles."""
    return _free_lattice(n_elem, 0)


def angular_momentum(n_elem: int) -> Scene:
    """Take the same lattice, and its angular momentum about the origin."""
    return _free_lattice(n_elem, 1)


ENERGY_ANGLE, ENERGY_TIME = 0.03, 40.0
"""Step and duration of the energy case, over the slowest mode's 1 / (angular frequency)."""


def energy(n_elem: int, angle: float = ENERGY_ANGLE) -> Scene:
    """Free bar ringing at 10 % strain in its slowest mode; the step is `angle` over that mode's angular frequency."""
    rod = bar(n_elem)
    model = RodModel(rods=(rod,))
    rest = model.rest_state()
    velocity = np.zeros_like(rest.velocity)
    velocity[:, 2] = 3.0 * np.sin(np.pi * rest.position[:, 2] / LENGTH)
    frequency = 2.0 * SPEED * n_elem / LENGTH * np.sin(0.5 * np.pi / n_elem)

    def total(engine: Simulation) -> float:
        """Kinetic energy plus E A l (e - 1 - ln e) [J], whose slope is the force E A (e - 1) / e of an element."""
        state = engine.state
        dilatation = np.diff(state.position[:, 2]) / rod.rest_length
        stored = rod.stretch_stiffness * rod.rest_length * (dilatation - 1.0 - np.log(dilatation))
        return float(0.5 * (rod.mass * state.velocity[:, 2] ** 2).sum() + stored.sum())

    def observe(engine: Simulation) -> Reading:
        start, times, measured = total(engine), [], []
        for _ in range(round(0.5 * ENERGY_TIME / angle)):
            pass_time(engine, 2.0 * engine.dt)
            times.append(engine.state.time)
            measured.append(total(engine) / start - 1.0)
        return Reading(np.array(times), np.array(measured), np.zeros(len(times)), scale=1.0)

    return Scene(model, with_velocity(rest, velocity), angle / frequency, observe)


PRECESSION_SPIN = (2.0, 0.0, 6.0)
"""Start of the precession in the material frame [rad/s]."""
PRECESSION_STEPS = 4000
"""Steps a turn."""


def free_precession(n_elem: int) -> Scene:
    """Rod so soft that each element is a free top of its own, over one turn of its spin about d3 in its own frame.

    Its angular momentum J1 (w0, w1, 2 w2) keeps its direction in the laboratory meanwhile.
    """
    model = RodModel(rods=(bar(n_elem, youngs_modulus=1e-7),))
    rest = model.rest_state()
    across, _, spin = PRECESSION_SPIN
    turn, n_sample = 2.0 * np.pi / spin, 16

    def axes(state: RodState) -> FloatArray:
        """Direction of every element's angular momentum in the laboratory, shape (n_elem, 3)."""
        carried = np.einsum("eji,ej->ei", state.directors, state.omega * np.array([1.0, 1.0, 2.0]))
        directions: FloatArray = carried / np.linalg.norm(carried, axis=1)[:, None]
        return directions

    def observe(engine: Simulation) -> Reading:
        times, measured = np.linspace(turn / n_sample, turn, n_sample), []
        start = axes(engine.state).ravel()
        for _ in times:
            pass_time(engine, turn / n_sample)
            state = engine.state
            measured.append(
                np.concatenate([state.omega[:, 0] / across, state.omega[:, 1] / across, axes(state).ravel()])
            )
        angle = np.repeat(spin * times[:, None], n_elem, axis=1)
        kept = np.tile(start, (n_sample, 1))
        return Reading(times, np.array(measured), np.concatenate([np.cos(angle), np.sin(angle), kept], axis=1))

    start = replace(rest, omega=np.tile(PRECESSION_SPIN, (n_elem, 1)))
    return Scene(model, start, turn / PRECESSION_STEPS, observe)


def soft_joint(n_elem: int) -> Scene:
    """Two free rods held together by one soft joint and moved apart: their middles swing about each other."""
    rods = (bar(n_elem), bar(n_elem))
    stiffness, middle = 0.1, n_elem // 2
    model = RodModel(rods=rods, joints=(Joint(0, middle, 1, middle, stiffness),))
    period = 2.0 * np.pi / np.sqrt(2.0 * stiffness / rods[0].mass.sum())
    rest = model.rest_state()
    position = rest.position.copy()
    position[model.nodes(1), 0] += 1e-3
    n_sample = 16
    steps = int(np.ceil(0.5 * period / n_sample / (STABLE_SHARE * stable_dt(model))))
    dt = 0.5 * period / n_sample / steps

    def observe(engine: Simulation) -> Reading:
        times, gap = [], []
        for _ in range(n_sample):
            pass_time(engine, steps * dt)
            state = engine.state
            middles = [state.position[model.nodes(k), 0] @ rod.mass / rod.mass.sum() for k, rod in enumerate(rods)]
            times.append(state.time)
            gap.append(middles[1] - middles[0])
        return Reading(np.array(times), 1e3 * np.array(gap), np.cos(2.0 * np.pi * np.array(times) / period))

    return Scene(model, replace(rest, position=position), dt, observe)


CASES = (
    Case(
        name="axial_stretch",
        title="Axial stretch",
        quantity="displacement [m]",
        abscissa="z [m]",
        exact="u(z) = F z / (E A - F)",
        source=f"{GAZZOLA}: force E A (e - 1) / e, as sections keep their volume",
        build=axial_stretch,
        n_elem=8,
        coarse=8,
        tolerance=lambda n: 1e-10,
        reason="exact on any mesh; e^-30 of the start is left, rounding dominates",
    ),
    Case(
        name="axial_vibration",
        title="Axial vibration, modes 1 to 3",
        quantity="frequency over exact",
        abscissa="mode",
        exact="f_j = (2 j - 1) / (4 L) sqrt(E / rho)",
        source="Rao 2007, Vibration of Continuous Systems, chapter 9",
        build=axial_vibration,
        n_elem=32,
        coarse=16,
        meshes=(8, 16, 32),
        tolerance=lambda n: 1.2 * (2.5 * np.pi / n) ** 2 / 24.0,
        reason="lumped masses lower mode j by (k dl)^2 / 24, here of mode 3; the step raises it by 1/100 of that; a "
        "fifth to spare",
    ),
    Case(
        name="timoshenko_cantilever",
        title="Timoshenko cantilever",
        quantity="deflection [mm]",
        abscissa="s [m]",
        exact="y(s) = F s / (27/28 G A) + F L s^2 / (2 E I) - F s^3 / (6 E I)",
        source=f"{GAZZOLA}, section 3.4.3",
        build=timoshenko_cantilever,
        n_elem=20,
        coarse=10,
        meshes=(5, 10, 20),
        tolerance=lambda n: 0.6 / n**2 + 1e-5,
        reason="mesh error dl^2 / (2 L^2) of the deflection, a fifth to spare; the tip turns by 5e-4 rad, "
        "squared terms stay below 1e-5",
    ),
    Case(
        name="uniform_bend",
        title="Uniform bend",
        quantity="rotation [rad]",
        abscissa="s [m]",
        exact="angle(s) = M s / (E I)",
        source="Love 1927, Mathematical Theory of Elasticity, chapter XVIII",
        build=uniform_bend,
        n_elem=10,
        coarse=10,
        tolerance=lambda n: 1e-9,
        reason="exact on any mesh; e^-25 of the start is left, rounding dominates",
    ),
    Case(
        name="uniform_twist",
        title="Uniform twist",
        quantity="rotation [rad]",
        abscissa="s [m]",
        exact="angle(s) = M s / (G J)",
        source="Love 1927, Mathematical Theory of Elasticity, chapter XVIII",
        build=uniform_twist,
        n_elem=10,
        coarse=10,
        tolerance=lambda n: 1e-9,
        reason="exact on any mesh; e^-25 of the start is left, rounding dominates",
    ),
    Case(
        name="helical_spring",
        title="Open-coiled helical spring",
        quantity="deflection, unwinding [m]",
        abscissa="1: deflection, 2: unwinding x radius",
        exact="F l (R^2 cos^2 a / (G J) + R^2 sin^2 a / (E I) + cos^2 a / (27/28 G A) + sin^2 a / (E A)); "
        "F R l sin a cos a (1 / (G J) - 1 / (E I))",
        source="Love 1927, Mathematical Theory of Elasticity, chapter XIX (spiral springs); "
        "stretch and shear by Castigliano",
        build=helical_spring,
        n_elem=48,
        coarse=24,
        meshes=(16, 32, 64),
        tolerance=lambda n: (2.0 * np.pi * SPRING_COILS / n) ** 2 / 8.0 + 1e-4,
        reason="with an angle p between elements their middles lie p^2 / 8 of the radius inside the helix; "
        "squared terms stay below 1e-4",
    ),
    Case(
        name="michell_ring",
        title="Michell's ring",
        quantity="critical twist [rad]",
        abscissa="exact critical twist [rad]",
        exact="2 pi sqrt(3) E I / (G J)",
        source="Michell 1889, Messenger Math. 11:181; Zajac 1962, J. Appl. Mech. 29:136; "
        "Goriely 2006, J. Elasticity 84:281",
        build=michell_ring,
        n_elem=32,
        coarse=16,
        meshes=(12, 16, 24),
        tolerance=lambda n: 3.0 / n**2 + 4e-3,
        reason="mesh error 2.5 / n^2 found by refinement; shear (radius over ring radius)^2 = 1e-3; the fitted zero "
        "moves by up to 3e-3 with the choice of twists",
    ),
    Case(
        name="localised_buckle",
        title="Localised helical buckling",
        quantity="tangent angle [rad]",
        abscissa="s [m]",
        exact="cos(angle) = 1 - a d sech^2(2 a s / L), with a from the ends' turn and slack",
        source=f"{GAZZOLA}, section 3.4.1; van der Heijden and Thompson 2000, Nonlinear Dyn. 21:71",
        build=localised_buckle,
        n_elem=100,
        coarse=50,
        meshes=(50, 100, 200),
        tolerance=lambda n: 200.0 / n**2 + 5e-3,
        reason="mesh error of order (angle between elements)^2, 160 / n^2; the stretch e = 8e-4 changes sections and "
        "arms by about 3 e; other starts move the result by 23 / n^2",
    ),
    Case(
        name="drag_only",
        title="Drag only",
        quantity="velocity over start",
        abscissa="t [s] (spin, inner nodes, end nodes)",
        exact="v(t) = v(0) exp(-c t)",
        source="linear drag; Naughton et al. 2021, RA-L 6:3389",
        build=drag_only,
        n_elem=4,
        coarse=4,
        tolerance=lambda n: 2e-9,
        reason="both dampers are exact in time; what is left is the stretch of an almost forceless rod",
    ),
    Case(
        name="linear_momentum",
        title="Momentum, free lattice",
        quantity="momentum over its parts' sum",
        abscissa="t [ms]",
        exact="0",
        source="Newton's third law",
        build=linear_momentum,
        n_elem=5,
        coarse=5,
        tolerance=lambda n: 1e-11,
        reason="rounding: internal forces cancel in pairs",
    ),
    Case(
        name="angular_momentum",
        title="Angular momentum, free lattice",
        quantity="momentum over its parts' sum",
        abscissa="t [ms]",
        exact="0",
        source="Newton's third law",
        build=angular_momentum,
        n_elem=5,
        coarse=5,
        tolerance=lambda n: 1e-6,
        reason="the couple's turn between two elements is a trapezoid sum: exact to the cube of their angle (0.1 rad)",
    ),
    Case(
        name="energy",
        title="Energy without damping",
        quantity="energy gained over energy",
        abscissa="t [s]",
        exact="0, bounded",
        source="symplectic integration: Hairer, Lubich and Wanner 2006, chapter IX",
        build=energy,
        n_elem=6,
        coarse=6,
        tolerance=lambda n: 0.3 * ENERGY_ANGLE**2,
        reason="Verlet keeps its own energy, which differs by (omega dt)^2 / 4 between a mode's rest and its greatest "
        "speed, with omega dt = 0.03; a fifth to spare, of which 10 % strain takes 8 %",
    ),
    Case(
        name="free_precession",
        title="Free precession",
        quantity="over start; direction",
        abscissa="t [s] (spin, angular momentum)",
        exact="w1 + i w2 = w1(0) exp(i w3 t), as J3 = 2 J1; direction of Q^T J w constant",
        source="Euler's equations: Landau and Lifshitz 1976, Mechanics, section 36",
        build=free_precession,
        n_elem=2,
        coarse=2,
        tolerance=lambda n: 1.2 * 2.0 * np.pi**2 / PRECESSION_STEPS,
        reason="PyElastica's explicit step lengthens (w1, w2) by (w3 dt)^2 / 2, over one turn by pi w3 dt; a fifth to "
        "spare",
    ),
    Case(
        name="soft_joint",
        title="Two rods on a soft joint",
        quantity="distance of middles [mm]",
        abscissa="t [s]",
        exact="x(t) = x(0) cos(sqrt(2 k / m) t)",
        source="two masses on a spring",
        build=soft_joint,
        n_elem=2,
        coarse=2,
        tolerance=lambda n: 4e-5,
        reason="the rods give: k over the stiffness of their middles, of order 4 E I / L^3, is 3e-4; half of it shows "
        "in the middles' distance",
    ),
    *GROUND_CASES,
    *BALL_CASES,
)
"""Every case, those with a ground or a ball last."""
