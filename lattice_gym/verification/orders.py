"""Orders of convergence in the time step: errors on an unchanging mesh, so that nothing but the step makes them.

Position Verlet is of second order while forces depend on the positions alone. Damping does not, nor do two terms of a
spinning element: the gyroscopic one, J^-1 [(J w) x w], and the transport one, w times the rate of stretch. The
splitting "pyelastica" takes all three once a step as PyElastica does, damping after the kick and the terms of spin as
they stand before it: first order. The splitting "symmetric" centres them about the kick: second order. Dashpots of
joints are of first order in both; no scene here has any.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from scipy.linalg import expm
from scipy.stats import linregress

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.registry import EngineName
from lattice_gym.engines.simulation import Simulation, simulate
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.critical_step import critical_dt
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.laws.loads import PointTorque
from lattice_gym.physics.state import RodState
from lattice_gym.physics.worm import build_model
from lattice_gym.verification.bar import LENGTH, SPEED, bar
from lattice_gym.verification.case import Reading, Scene, advance_by, sample
from lattice_gym.verification.motion import ringing_free_bar

SECOND_ORDER_BAND, FIRST_ORDER_BAND = 0.15, 0.25
SHARES = (0.4, 0.2, 0.1)
"""Steps of the ringing bars, over the critical one."""
ENERGY_ANGLES = (0.12, 0.06, 0.03)
"""Steps of the bar whose energy is watched, as `motion.ringing_free_bar` takes them."""
VARIANTS: tuple[tuple[EngineName, Splitting], ...] = (
    ("fused", "pyelastica"),
    ("pyelastica", "pyelastica"),
    ("fused", "symmetric"),
)


@dataclass(frozen=True)
class Errors:
    """Steps [s], and the relative error at each."""

    dt: tuple[float, ...]
    error: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class StepScene:
    """What is run at several steps on an engine with a splitting."""

    name: str
    measure: Callable[[EngineName, Splitting], Errors]
    damped: bool = False
    spinning: bool = False
    heavy: bool = False
    """Left to the fused engine in the quick form."""

    @property
    def split(self) -> bool:
        """Whether forces depend on velocities; where they do not, or hardly, the splittings do the same."""
        return self.damped or self.spinning


@dataclass(frozen=True)
class Orders:
    """Errors of one scene over its steps, and the order that fits them."""

    scene: str
    engine: EngineName
    splitting: Splitting
    split: bool
    """Whether the splitting matters, see `StepScene`."""
    dt: tuple[float, ...]
    """[s]"""
    error: tuple[float, ...]

    @property
    def expected(self) -> float:
        """Order 2, but 1 where PyElastica's explicit step takes damping or the terms of spin."""
        return 1.0 if self.split and self.splitting == "pyelastica" else 2.0

    @property
    def band(self) -> float:
        """By how much the fitted order may differ."""
        return SECOND_ORDER_BAND if self.expected == 2.0 else FIRST_ORDER_BAND

    @property
    def fitted(self) -> float:
        """Slope of log(error) over log(dt)."""
        return slope(self.dt, self.error)

    @property
    def passed(self) -> bool:
        """True if the fitted order is within its band of the expected one."""
        return abs(self.fitted - self.expected) <= self.band


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Exponent of the power law that fits best."""
    return float(linregress(np.log(x), np.log(y)).slope)


def ringing_bar(rate: float, share: float) -> Scene:
    """Clamped-free bar swinging along its axis, read against the exact motion of its very mesh.

    The mesh is a chain of masses, springs and dashpots, solved by its matrix exponential. Strains are 1e-7, and stretch
    is linear to as much. `rate` [1/s] damps an inner node; `share` is the step over the critical one.
    """
    n, n_sample = 8, 16
    model = RodModel(rods=(bar(n, rate=rate),), clamps=(Clamp(0, node=0, element=0),))
    rod, rest = model.rods[0], model.rest_state()
    stiffness = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    stiffness[-1, -1] = 1.0
    stiffness *= rod.stretch_stiffness[0] / rod.rest_length[0]
    mass = rod.mass[1:, None]
    flow = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness / mass, -rod.damping / mass * np.eye(n)]])
    velocity = np.zeros_like(rest.velocity)
    velocity[:, 2] = 1e-7 * SPEED * np.sin(0.5 * np.pi * np.arange(n + 1) / n)
    start = np.append(np.zeros(n), velocity[1:, 2])
    interval = 3.0 * LENGTH / SPEED / n_sample
    dt = interval / int(np.ceil(interval / (share * critical_dt(model))))

    def observe(engine: Simulation) -> Reading:
        times = interval * np.arange(1, n_sample + 1)
        measured = sample(engine, times, lambda state: state.position[1:, 2] - rest.position[1:, 2])
        return Reading(times, measured, np.array([expm(time * flow)[:n] @ start for time in times]))

    return Scene(model, replace(rest, velocity=velocity), dt, observe)


RINGING_RATE = 0.3 * 0.5 * np.pi * SPEED / LENGTH
"""Damping rate of the damped bar [1/s]; a third of its slowest angular frequency."""


def _bar_errors(build: Callable[[float], Scene], sizes: Sequence[float], engine: EngineName, how: Splitting) -> Errors:
    """Errors of the scenes that `build` makes of the `sizes` of their steps."""
    scenes = [build(size) for size in sizes]
    return Errors(tuple(scene.dt for scene in scenes), tuple(scene.run(engine, how)[0].error for scene in scenes))


SPINNING_TIME, SPINNING_STRETCH = 0.1, 1.25
"""Time [s], a sixth of the period in which the stretch rings: over whole periods errors that go with the rate of
stretch cancel."""
SPINNING_STEPS = (160, 320, 640)
SPINNING_SPIN = (2.0, 0.0, 30.0)
"""Angular velocity at the start, in the frame of the rod [rad/s]."""
SPINNING_RATE, SPINNING_TORQUE = 5.0, (0.5, 0.2, 3.0)
"""Damping rate [1/s], and torque on every element in its own frame [N m], of the damped rod."""
REFERENCE_SHARE = 8
"""Steps of the reference run in the smallest step that is judged."""


@cache
def _spinning_rod(damped: bool) -> tuple[RodModel, RodState]:
    """Free, soft rod that tumbles and twists as a whole, evenly stretched: it rings. Torques drive the damped one."""
    rod = bar(6, rate=SPINNING_RATE if damped else 0.0, youngs_modulus=1e4)
    torques = tuple(PointTorque(0, element, SPINNING_TORQUE) for element in range(rod.n_elem)) if damped else ()
    model = RodModel(rods=(rod,), torques=torques)
    rest = model.rest_state()
    position = SPINNING_STRETCH * rest.position
    velocity = np.cross(rest.directors[0].T @ SPINNING_SPIN, position)
    return model, replace(rest, position=position, velocity=velocity, omega=np.tile(SPINNING_SPIN, (rod.n_elem, 1)))


@cache
def _spinning_end(engine: EngineName, splitting: Splitting, damped: bool, steps: int) -> RodState:
    """State after SPINNING_TIME."""
    model, start = _spinning_rod(damped)
    made = simulate(engine, model, SPINNING_TIME / steps, splitting)
    made.restore(start)
    return advance_by(made, SPINNING_TIME)


SPINNING_SCALES = {"position": LENGTH, "directors": 1.0, "omega": float(np.linalg.norm(SPINNING_SPIN))}
"""What errors of a field are relative to."""


def _spinning_errors(field: str, damped: bool, engine: EngineName, splitting: Splitting) -> Errors:
    """Errors of a field over its scale; the reference is fused and symmetric."""
    reference = getattr(_spinning_end("fused", "symmetric", damped, REFERENCE_SHARE * SPINNING_STEPS[-1]), field)
    ends = [getattr(_spinning_end(engine, splitting, damped, steps), field) for steps in SPINNING_STEPS]
    errors = tuple(float(np.abs(end - reference).max() / SPINNING_SCALES[field]) for end in ends)
    return Errors(tuple(SPINNING_TIME / steps for steps in SPINNING_STEPS), errors)


def _spinning_scenes() -> Iterator[StepScene]:
    for damped, name in ((False, "spinning rod"), (True, "spinning rod, damped and driven")):
        for field, shown in (("position", "positions"), ("directors", "directors"), ("omega", "spin")):
            measure = partial(_spinning_errors, field, damped)
            yield StepScene(name=f"{name}, {shown}", measure=measure, damped=damped, spinning=True)


LATTICE_TIME, LATTICE_TENSION = 0.02, 0.2
LATTICE_STEPS = (80, 160, 320)


@cache
def _lattice(damped: bool) -> RodModel:
    design = LatticeDesign() if damped else replace(LatticeDesign(), damping=0.0, rotational_damping=0.0)
    lattice = build_lattice(design)
    return build_model(lattice, named_layout("extension", lattice))


@cache
def _lattice_end(engine: EngineName, splitting: Splitting, damped: bool, steps: int) -> FloatArray:
    """Node positions after LATTICE_TIME under LATTICE_TENSION in every muscle [m]."""
    model = _lattice(damped)
    made = simulate(engine, model, LATTICE_TIME / steps, splitting)
    return advance_by(made, LATTICE_TIME, np.full(model.n_muscle, LATTICE_TENSION)).position


def _lattice_errors(damped: bool, engine: EngineName, splitting: Splitting) -> Errors:
    """Errors of the default lattice extending, over the way of its nodes; the reference is fused and symmetric."""
    reference = _lattice_end("fused", "symmetric", damped, REFERENCE_SHARE * LATTICE_STEPS[-1])
    moved = np.abs(reference - _lattice(damped).rest_state().position).max()
    ends = [_lattice_end(engine, splitting, damped, steps) for steps in LATTICE_STEPS]
    errors = tuple(float(np.abs(end - reference).max() / moved) for end in ends)
    return Errors(tuple(LATTICE_TIME / steps for steps in LATTICE_STEPS), errors)


STEP_SCENES = (
    StepScene(name="energy of a free bar", measure=partial(_bar_errors, partial(ringing_free_bar, 6), ENERGY_ANGLES)),
    StepScene(name="ringing bar, undamped", measure=partial(_bar_errors, partial(ringing_bar, 0.0), SHARES)),
    StepScene(
        name="ringing bar, damped",
        measure=partial(_bar_errors, partial(ringing_bar, RINGING_RATE), SHARES),
        damped=True,
    ),
    *_spinning_scenes(),
    StepScene(name="default lattice, undamped", measure=partial(_lattice_errors, False), heavy=True),
    StepScene(name="default lattice, damped", measure=partial(_lattice_errors, True), damped=True, heavy=True),
)


def step_trials(*, quick: bool = False) -> Iterator[tuple[StepScene, EngineName, Splitting]]:
    """Every scene on every variant that differs; the quick form leaves the lattice to the fused engine."""
    for scene in STEP_SCENES:
        for engine, splitting in VARIANTS:
            same = splitting == "symmetric" and not scene.split
            if not same and not (quick and scene.heavy and engine == "pyelastica"):
                yield scene, engine, splitting


def step_orders(scene: StepScene, engine: EngineName, splitting: Splitting) -> Orders:
    """Run one scene on one variant."""
    errors = scene.measure(engine, splitting)
    return Orders(scene.name, engine, splitting, scene.split, errors.dt, errors.error)
