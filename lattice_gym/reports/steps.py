"""Orders of convergence in the time step: errors on an unchanging mesh, so that nothing but the step makes them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from lattice_gym.design import FloatArray, LatticeDesign
from lattice_gym.engines import Engine, EngineName, Splitting, make_engine
from lattice_gym.lattice import build_lattice
from lattice_gym.model import Clamp, RodModel, build_model
from lattice_gym.muscles import named_layout
from lattice_gym.reports.cases import LENGTH, SPEED, bar, energy
from lattice_gym.reports.scene import Reading, Scene, pass_time, with_velocity
from lattice_gym.stability import stable_dt

SECOND_ORDER_BAND, FIRST_ORDER_BAND = 0.15, 0.25
SHARES = (0.4, 0.2, 0.1)
"""Steps of the bars, over the stable one."""
VARIANTS: tuple[tuple[EngineName, Splitting], ...] = (
    ("fused", "pyelastica"),
    ("pyelastica", "pyelastica"),
    ("fused", "symmetric"),
)


@dataclass(frozen=True)
class Orders:
    """Errors of one scene over its steps, and the order that fits them."""

    scene: str
    engine: EngineName
    splitting: Splitting
    damped: bool
    dt: tuple[float, ...]
    """[s]"""
    error: tuple[float, ...]

    @property
    def expected(self) -> float:
        """Order 2, but 1 where velocities are damped once after the kick."""
        return 1.0 if self.damped and self.splitting == "pyelastica" else 2.0

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
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def ringing_bar(rate: float, share: float) -> Scene:
    """Clamped-free bar swinging along its axis, read against the exact motion of its very mesh.

    The mesh is a chain of masses, springs and dashpots, solved by its eigenvectors. Strains are 1e-7, and stretch is
    linear to as much. `rate` [1/s] damps an inner node; `share` is the step over the stable one.
    """
    n, n_sample = 8, 16
    model = RodModel(rods=(bar(n, rate=rate),), clamps=(Clamp(0, node=0, element=0),))
    rod, rest = model.rods[0], model.rest_state()
    stiffness = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    stiffness[-1, -1] = 1.0
    stiffness *= rod.stretch_stiffness[0] / rod.rest_length[0]
    mass = rod.mass[1:, None]
    flow = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness / mass, -rod.damping / mass * np.eye(n)]])
    value, vector = np.linalg.eig(flow)
    velocity = np.zeros_like(rest.velocity)
    velocity[:, 2] = 1e-7 * SPEED * np.sin(0.5 * np.pi * np.arange(n + 1) / n)
    weight = np.linalg.solve(vector, np.append(np.zeros(n), velocity[1:, 2]).astype(complex))
    interval = 3.0 * LENGTH / SPEED / n_sample
    dt = interval / int(np.ceil(interval / (share * stable_dt(model))))

    def observe(engine: Engine) -> Reading:
        times, measured = interval * np.arange(1, n_sample + 1), []
        for _ in times:
            pass_time(engine, interval)
            measured.append(engine.state.position[1:, 2] - rest.position[1:, 2])
        exact = (np.exp(np.outer(times, value)) * weight @ vector[:n].T).real
        return Reading(times, np.array(measured), exact)

    return Scene(model, with_velocity(rest, velocity), dt, observe)


RINGING_RATE = 0.3 * 0.5 * np.pi * SPEED / LENGTH
"""Damping rate of the damped bar [1/s]; a third of its slowest angular frequency."""


def _bar_orders(
    name: str, damped: bool, variants: Sequence[tuple[EngineName, Splitting]], build: Callable[[float], Scene]
) -> Iterator[Orders]:
    for engine_name, splitting in variants:
        scenes = [build(share) for share in SHARES]
        errors = []
        for scene in scenes:
            engine = make_engine(engine_name, scene.model, scene.dt, splitting)
            engine.restore(scene.start)
            errors.append(scene.observe(engine).error)
        yield Orders(name, engine_name, splitting, damped, tuple(scene.dt for scene in scenes), tuple(errors))


LATTICE_TIME, LATTICE_TENSION = 0.02, 0.2
LATTICE_STEPS = (80, 160, 320)
LATTICE_REFERENCE_STEPS = 2560


@cache
def _lattice(damped: bool) -> RodModel:
    design = LatticeDesign() if damped else replace(LatticeDesign(), damping=0.0)
    lattice = build_lattice(design)
    return build_model(lattice, named_layout("extension", lattice))


def _lattice_end(engine: EngineName, splitting: Splitting, damped: bool, steps: int) -> FloatArray:
    """Node positions after LATTICE_TIME under LATTICE_TENSION in every muscle [m]."""
    model = _lattice(damped)
    made = make_engine(engine, model, LATTICE_TIME / steps, splitting)
    health = made.advance(np.full(model.n_muscle, LATTICE_TENSION), steps)
    if not health.ok:
        raise RuntimeError(f"lattice diverged: {health}")
    return made.state.position


def lattice_orders(damped: bool, variants: Sequence[tuple[EngineName, Splitting]] = VARIANTS) -> Iterator[Orders]:
    """Default lattice extending; its reference is the fused engine, symmetric, at an eighth of the smallest step."""
    reference = _lattice_end("fused", "symmetric", damped, LATTICE_REFERENCE_STEPS)
    moved = np.abs(reference - _lattice(damped).rest_state().position).max()
    name = "default lattice, damped" if damped else "default lattice, undamped"
    for engine, splitting in variants:
        ends = [_lattice_end(engine, splitting, damped, steps) for steps in LATTICE_STEPS]
        errors = tuple(float(np.abs(end - reference).max() / moved) for end in ends)
        yield Orders(name, engine, splitting, damped, tuple(LATTICE_TIME / n for n in LATTICE_STEPS), errors)


def step_orders(*, quick: bool = False) -> Iterator[Orders]:
    """Every scene on every variant; the quick form leaves the lattice to the fused engine."""
    yield from _bar_orders("energy of a free bar", False, VARIANTS[:2], lambda share: energy(6, share))
    yield from _bar_orders("ringing bar, undamped", False, VARIANTS[:2], lambda share: ringing_bar(0.0, share))
    yield from _bar_orders("ringing bar, damped", True, VARIANTS, lambda share: ringing_bar(RINGING_RATE, share))
    on_lattice = [variant for variant in VARIANTS if not (quick and variant[0] == "pyelastica")]
    yield from lattice_orders(False, [variant for variant in on_lattice if variant[1] == "pyelastica"])
    yield from lattice_orders(True, on_lattice)
