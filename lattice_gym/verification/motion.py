"""Exact cases of moving rods: vibration, damping, energy, precession, and two rods on a joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lattice_gym.checks import FloatArray
from lattice_gym.engines.simulation import Simulation
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.critical_step import critical_dt
from lattice_gym.physics.laws.joints import Joint
from lattice_gym.physics.state import RodState
from lattice_gym.verification.bar import LENGTH, SPEED, bar
from lattice_gym.verification.case import CRITICAL_SHARE, Reading, Scene, exact_case, sample

AXIAL_MODES = np.array([1.0, 2.0, 3.0])


@exact_case(
    "Axial vibration, modes 1 to 3",
    quantity="frequency over exact",
    abscissa="mode",
    exact="f_j = (2 j - 1) / (4 L) sqrt(E / rho)",
    source="Rao 2007, Vibration of Continuous Systems, chapter 9",
    n_elem=32,
    coarse=16,
    meshes=(8, 16, 32),
    tolerance=lambda n: 1.2 * (2.5 * np.pi / n) ** 2 / 24.0,
    reason="lumped masses lower mode j by (k dl)^2 / 24, here of mode 3; the step raises it by 1/100 of that; a fifth "
    "to spare",
)
def axial_vibration(n_elem: int) -> Scene:
    """Undamped clamped-free bar, its first three modes set off at once; each is followed by its own projection."""
    model = RodModel(rods=(bar(n_elem),), clamps=(Clamp(0, node=0, element=0),))
    rest = model.rest_state()
    z = rest.position[:, 2] + 0.5 * LENGTH
    modes = np.sin(np.outer(AXIAL_MODES - 0.5, np.pi * z / LENGTH))
    velocity = np.zeros_like(rest.velocity)
    velocity[:, 2] = 1e-6 * modes.sum(axis=0)
    exact = (2.0 * AXIAL_MODES - 1.0) / (4.0 * LENGTH) * SPEED

    def projections(state: RodState) -> FloatArray:
        projected: FloatArray = modes @ (model.node_mass * (state.position[:, 2] - rest.position[:, 2]))
        return projected

    def observe(engine: Simulation) -> Reading:
        signals = sample(engine, engine.dt * np.arange(1, int(4.2 / exact[0] / engine.dt) + 1), projections).T
        measured = np.array([_frequency(signal, engine.dt) for signal in signals])
        return Reading(AXIAL_MODES, measured / exact, np.ones(len(exact)))

    return Scene(model, replace(rest, velocity=velocity), 0.1 * critical_dt(model), observe)


def _frequency(signal: FloatArray, dt: float) -> float:
    """Frequency [Hz] from the upward zero crossings."""
    k = np.flatnonzero((signal[:-1] < 0.0) & (signal[1:] >= 0.0))
    crossing = k + signal[k] / (signal[k] - signal[k + 1])
    return float(1.0 / (np.diff(crossing).mean() * dt))


@exact_case(
    "Drag only",
    quantity="velocity over start",
    abscissa="t [s] (spin, inner nodes, end nodes)",
    exact="v(t) = v(0) exp(-c t)",
    source="linear drag; Naughton et al. 2021, RA-L 6:3389",
    n_elem=4,
    tolerance=2e-9,
    reason="both dampers are exact in time; what is left is the stretch of an almost forceless rod",
)
def drag_only(n_elem: int) -> Scene:
    """Free rod so soft that only drag acts, sliding and spinning along its axis so slowly that nothing else changes."""
    rod = bar(n_elem, rate=1.0, youngs_modulus=1e-7)
    model = RodModel(rods=(rod,))
    rest = model.rest_state()
    velocity, omega = np.zeros_like(rest.velocity), np.zeros_like(rest.omega)
    velocity[:, 2], omega[:, 2] = 1e-9, 1e-3

    def observe(engine: Simulation) -> Reading:
        times = np.linspace(0.2, 3.0, 15)
        measured = sample(engine, times, lambda s: np.concatenate([s.velocity[:, 2] / 1e-9, s.omega[:, 2] / 1e-3]))
        decay = np.concatenate([rod.damping / rod.mass, rod.rotational_damping / (2.0 * rod.inertia)])
        return Reading(times, measured, np.exp(-np.outer(times, decay)))

    return Scene(model, replace(rest, velocity=velocity, omega=omega), 0.01, observe)


ENERGY_ANGLE, ENERGY_TIME = 0.03, 40.0
"""Step and duration of the energy case, over the slowest mode's 1 / (angular frequency)."""


def ringing_free_bar(n_elem: int, angle: float) -> Scene:
    """Free bar ringing at 10 % strain in its slowest mode; the step is `angle` over that mode's angular frequency.

    Reads the energy gained, over the energy at the start.
    """
    rod = bar(n_elem)
    model = RodModel(rods=(rod,))
    rest = model.rest_state()
    velocity = np.zeros_like(rest.velocity)
    velocity[:, 2] = 3.0 * np.sin(np.pi * rest.position[:, 2] / LENGTH)
    frequency = 2.0 * SPEED * n_elem / LENGTH * np.sin(0.5 * np.pi / n_elem)

    def total(state: RodState) -> float:
        """Kinetic energy plus E A l (e - 1 - ln e) [J], whose slope is the force E A (e - 1) / e of an element."""
        dilatation = np.diff(state.position[:, 2]) / rod.rest_length
        stored = rod.stretch_stiffness * rod.rest_length * (dilatation - 1.0 - np.log(dilatation))
        return float(0.5 * (rod.mass * state.velocity[:, 2] ** 2).sum() + stored.sum())

    def observe(engine: Simulation) -> Reading:
        start, n_sample = total(engine.state), round(0.5 * ENERGY_TIME / angle)
        times = np.arange(1, n_sample + 1, dtype=np.float64) * 2.0 * engine.dt
        return Reading(times, sample(engine, times, total) / start - 1.0, np.zeros(len(times)), scale=1.0)

    return Scene(model, replace(rest, velocity=velocity), angle / frequency, observe)


@exact_case(
    "Energy without damping",
    quantity="energy gained over energy",
    abscissa="t [s]",
    exact="0, bounded",
    source="symplectic integration: Hairer, Lubich and Wanner 2006, chapter IX",
    n_elem=6,
    tolerance=0.3 * ENERGY_ANGLE**2,
    reason="Verlet keeps its own energy, which differs by (omega dt)^2 / 4 between a mode's rest and its greatest "
    "speed, with omega dt = 0.03; a fifth to spare, of which 10 % strain takes 8 %",
)
def energy(n_elem: int) -> Scene:
    """Of the free bar."""
    return ringing_free_bar(n_elem, ENERGY_ANGLE)


PRECESSION_SPIN = (2.0, 0.0, 6.0)
"""Start of the precession in the material frame [rad/s]."""
PRECESSION_STEPS = 4000
"""Steps a turn."""


@exact_case(
    "Free precession",
    quantity="over start; direction",
    abscissa="t [s] (spin, angular momentum)",
    exact="w1 + i w2 = w1(0) exp(i w3 t), as J3 = 2 J1; direction of Q^T J w constant",
    source="Euler's equations: Landau and Lifshitz 1976, Mechanics, section 36",
    n_elem=2,
    tolerance=1.2 * 2.0 * np.pi**2 / PRECESSION_STEPS,
    reason="PyElastica's explicit step lengthens (w1, w2) by (w3 dt)^2 / 2, over one turn by pi w3 dt; a fifth to "
    "spare",
)
def free_precession(n_elem: int) -> Scene:
    """Rod so soft that each element is a free top of its own, over one turn of its spin about d3 in its own frame.

    Its angular momentum J1 (w0, w1, 2 w2) keeps its direction in the laboratory meanwhile.
    """
    model = RodModel(rods=(bar(n_elem, youngs_modulus=1e-7),))
    across, _, spin = PRECESSION_SPIN
    turn, n_sample = 2.0 * np.pi / spin, 16

    def axes(state: RodState) -> FloatArray:
        """Direction of every element's angular momentum in the laboratory, shape (3 n_elem,)."""
        carried = np.einsum("eji,ej->ei", state.directors, state.omega * np.array([1.0, 1.0, 2.0]))
        directions: FloatArray = carried / np.linalg.norm(carried, axis=1)[:, None]
        return directions.ravel()

    def spin_and_axes(state: RodState) -> FloatArray:
        return np.concatenate([state.omega[:, 0] / across, state.omega[:, 1] / across, axes(state)])

    def observe(engine: Simulation) -> Reading:
        times, kept = np.linspace(turn / n_sample, turn, n_sample), np.tile(axes(engine.state), (n_sample, 1))
        angle = np.repeat(spin * times[:, None], n_elem, axis=1)
        exact = np.concatenate([np.cos(angle), np.sin(angle), kept], axis=1)
        return Reading(times, sample(engine, times, spin_and_axes), exact)

    start = replace(model.rest_state(), omega=np.tile(PRECESSION_SPIN, (n_elem, 1)))
    return Scene(model, start, turn / PRECESSION_STEPS, observe)


@exact_case(
    "Two rods on a soft joint",
    quantity="distance of middles [mm]",
    abscissa="t [s]",
    exact="x(t) = x(0) cos(sqrt(2 k / m) t)",
    source="two masses on a spring",
    n_elem=2,
    tolerance=4e-5,
    reason="the rods give: k over the stiffness of their middles, of order 4 E I / L^3, is 3e-4; half of it shows in "
    "the middles' distance",
)
def soft_joint(n_elem: int) -> Scene:
    """Two free rods held together by one soft joint and moved apart: their middles swing about each other."""
    rods = (bar(n_elem), bar(n_elem))
    stiffness, middle = 0.1, n_elem // 2
    model = RodModel(rods=rods, joints=(Joint(0, middle, 1, middle, stiffness),))
    period = 2.0 * np.pi / np.sqrt(2.0 * stiffness / rods[0].mass.sum())
    rest = model.rest_state()
    position = rest.position.copy()
    position[model.nodes(1), 0] += 1e-3
    times = 0.5 * period / 16 * np.arange(1, 17)

    def gap(state: RodState) -> float:
        """Distance of the centres of mass [m]."""
        first, second = (state.position[model.nodes(k), 0] @ rod.mass / rod.mass.sum() for k, rod in enumerate(rods))
        return float(second - first)

    def observe(engine: Simulation) -> Reading:
        return Reading(times, 1e3 * sample(engine, times, gap), np.cos(2.0 * np.pi * times / period))

    dt = times[0] / int(np.ceil(times[0] / (CRITICAL_SHARE * critical_dt(model))))
    return Scene(model, replace(rest, position=position), dt, observe)


MOTION_CASES = (axial_vibration, drag_only, energy, free_precession, soft_joint)
"""Every case of a moving rod."""
