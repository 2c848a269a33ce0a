"""Exact cases on both engines, as the validation report defines them, and orders of convergence in the time step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lattice_gym.engines.registry import EngineName
from lattice_gym.engines.simulation import simulate
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.critical_step import critical_dt
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.rod import rotation_between
from lattice_gym.verification.bar import bar
from lattice_gym.verification.case import Case, Outcome, Reading, advance_by, difference, run
from lattice_gym.verification.cases import CASES
from lattice_gym.verification.ground import GROUND_CASES
from lattice_gym.verification.motion import PRECESSION_STEPS
from lattice_gym.verification.orders import STEP_SCENES, StepScene, slope, step_orders, step_trials

pytestmark = pytest.mark.slow

QUICK = [case for case in CASES if case.name not in ("michell_ring", "localised_buckle")]
HELD = [case for case in CASES if case not in QUICK]
ELASTIC = (
    "axial_stretch", "axial_vibration", "timoshenko_cantilever", "uniform_bend", "uniform_twist", "helical_spring",
)  # fmt: skip
"""Cases whose exact result depends on the stiffness of the rods alone, not on that of joints or on ratios."""


def case(name: str) -> Case:
    """Find a case by its name."""
    return next(case for case in CASES if case.name == name)


@pytest.mark.parametrize("case", QUICK, ids=lambda case: case.name)
def test_exact_case(case: Case, engine_pair: tuple[EngineName, EngineName]) -> None:
    """Both engines are within the tolerance on the coarse mesh, and agree to rounding."""
    outcomes = [run(case, name, case.coarse) for name in engine_pair]
    for outcome in outcomes:
        assert outcome.reading.error <= outcome.tolerance, outcome.engine
    assert difference(*outcomes) < 1e-9


@pytest.mark.parametrize("case", HELD, ids=lambda case: case.name)
def test_rods_held_out_of_their_own_shape(case: Case) -> None:
    """Buckling on the fused engine; the validation report runs it on PyElastica, too."""
    outcome = run(case, "fused", case.coarse)
    assert outcome.reading.error <= outcome.tolerance


@pytest.mark.parametrize("case", HELD, ids=lambda case: case.name)
def test_engines_agree_on_rods_held_out_of_their_own_shape(
    case: Case, engine_pair: tuple[EngineName, EngineName]
) -> None:
    """After 200 steps from the pre-stressed start."""
    scene = case.build(case.coarse)
    ends = []
    for name in engine_pair:
        engine = simulate(name, scene.model, scene.dt)
        engine.restore(scene.start)
        assert engine.advance([], 200).ok
        ends.append(engine.state)
    assert np.abs(ends[0].position - scene.start.position).max() > 1e-8
    assert np.abs(ends[0].position - ends[1].position).max() < 1e-13
    assert np.abs(ends[0].directors - ends[1].directors).max() < 1e-11


@pytest.mark.parametrize(
    ("name", "meshes"), [("axial_vibration", (6, 9, 14)), ("timoshenko_cantilever", None), ("helical_spring", None)]
)
def test_errors_fall_with_the_square_of_the_element_size(name: str, meshes: tuple[int, ...] | None) -> None:
    """On the fused engine and the case's own meshes, or coarser ones where those take many steps."""
    meshes = meshes or case(name).meshes
    errors = [run(case(name), "fused", n).reading.error for n in meshes]
    assert slope(meshes, errors) == pytest.approx(-2.0, abs=0.1)


@pytest.mark.parametrize(
    ("scene", "engine", "splitting"),
    [pytest.param(*trial, id="-".join((trial[0].name, *trial[1:]))) for trial in step_trials(quick=True)],
)
def test_order_in_the_time_step(scene: StepScene, engine: EngineName, splitting: Splitting) -> None:
    """Second order without damping and spin or split symmetrically, first order as PyElastica damps and spins."""
    orders = step_orders(scene, engine, splitting)
    assert orders.passed, orders
    assert max(orders.error) < 0.02


@pytest.mark.parametrize("case", GROUND_CASES, ids=lambda case: case.name)
def test_ground_in_the_symmetric_splitting(case: Case) -> None:
    """Within the tolerance, too; terminal speeds and slips are exact, however large the damping."""
    outcome = run(case, "fused", case.coarse, "symmetric")
    assert outcome.reading.error <= (1e-11 if case.name == "free_fall" else outcome.tolerance)


def test_precession_in_the_symmetric_splitting() -> None:
    """A turn by a step's mean spin, 2 atan(w dt / 2), lags by (w dt)^2 / 12: over one turn by 2 pi times that."""
    outcome = run(case("free_precession"), "fused", splitting="symmetric")
    lag = 2.0 * np.pi * (2.0 * np.pi / PRECESSION_STEPS) ** 2 / 12.0
    assert outcome.reading.error == pytest.approx(lag, rel=0.01)


@pytest.mark.parametrize("name", ELASTIC)
def test_errors_tell_wrong_from_right(name: str, engine_name: EngineName) -> None:
    """A tenth less stiffness fails every case that depends on it."""
    wrong = case(name)
    scene = wrong.build(wrong.coarse)
    soft = tuple(
        replace(rod, youngs_modulus=0.9 * rod.youngs_modulus, shear_modulus=0.9 * rod.shear_modulus)
        for rod in scene.model.rods
    )
    engine = simulate(engine_name, replace(scene.model, rods=soft), scene.dt)
    engine.restore(scene.start)
    assert scene.observe(engine).error > 2.0 * wrong.tolerance(wrong.coarse)


def test_a_straight_rod_takes_its_natural_curvature(engine_name: EngineName) -> None:
    """Built straight, left free, a rod settles where its curvature and twist are the natural ones."""
    rod = bar(12, rate=20.0)
    natural = np.tile((0.5, -0.3, 0.4), (11, 1))
    model = RodModel(rods=(replace(rod, natural_curvature=natural),))
    engine = simulate(engine_name, model, 0.5 * critical_dt(model))
    advance_by(engine, 4.0)
    directors = engine.state.directors
    assert np.abs(rotation_between(directors[:-1], directors[1:]) / rod.rest_voronoi[:, None] - natural).max() < 1e-7
    assert np.abs(directors[0] - directors[-1]).max() > 0.1


def test_a_nan_does_not_pass() -> None:
    """Nor does it hide behind a comparison."""
    good = run(case("drag_only"), "fused")
    wrong = Reading(good.reading.x, np.full_like(good.reading.exact, np.nan), good.reading.exact)
    assert good.passed
    assert not Outcome(good.case, "fused", 4, good.dt, wrong, good.state, 0.0).passed


def test_pyelastica_is_of_second_order_on_the_lattice() -> None:
    """Undamped, the default lattice follows its trajectory with an error that falls as dt^2."""
    scene = next(scene for scene in STEP_SCENES if scene.name == "default lattice, undamped")
    orders = step_orders(scene, "pyelastica", "pyelastica")
    assert orders.passed, orders
