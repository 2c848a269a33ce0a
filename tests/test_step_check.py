"""Step doubling: a run astray is flagged though it is smooth, a right one is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from engine_scenes import FIELDS, mixed_assembly

from lattice_gym.benchmarks.divergence.runs import Plan, plan
from lattice_gym.engines.energy_audit import EnergyAudit
from lattice_gym.engines.health import Health, Status
from lattice_gym.engines.registry import EngineName, make_engine
from lattice_gym.engines.simulation import Simulation, simulate
from lattice_gym.engines.step_doubling import STEP_TOLERANCE
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.critical_step import critical_dt
from lattice_gym.physics.laws.ball import RigidBall
from lattice_gym.physics.rod import straight_rod

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def astray() -> Plan:
    """Run of the divergence report that goes 12 % of the height astray and passes every check but that of the step."""
    return plan(20_114)


N_ASTRAY = 5
"""Control steps up to the one in which its nodes part by more than `STEP_TOLERANCE` from the run at half the step."""


def made(run: Plan, *, share: float = 1.0, energy_check: bool = False, step_check: bool = False) -> Simulation:
    """Simulate a run at a share of its step."""
    return simulate("fused", run.model, share * run.dt, run.splitting, energy_check, step_check)


def test_a_smooth_run_astray_is_caught(astray: Plan) -> None:
    """Only by the step check, at the place furthest from the run at half the step; the run is not changed by it."""
    checked, energy, finer = made(astray, step_check=True), made(astray, energy_check=True), made(astray, share=0.5)
    for step, ramp in enumerate(astray.ramps[:N_ASTRAY], start=1):
        health = checked.advance(ramp, astray.n_substeps)
        assert energy.advance(ramp, astray.n_substeps).ok
        assert finer.advance(ramp, 2 * astray.n_substeps).ok
        apart = np.linalg.norm(energy.state.position - finer.state.position, axis=1)
        size = np.ptp(astray.model.rest_state().position, axis=0).max()
        assert checked.step_error is not None
        assert checked.step_error == pytest.approx(apart.max() / size, rel=1e-9)
        assert (checked.step_error > STEP_TOLERANCE) == (step == N_ASTRAY) == (not health.ok)
    for field in FIELDS:
        assert np.array_equal(getattr(checked.state, field), getattr(energy.state, field)), field
    rod = next(k for k in range(astray.model.n_rod) if np.argmax(apart) < astray.model.nodes(k).stop)
    node = int(np.argmax(apart)) - astray.model.nodes(rod).start
    element = min(node, astray.model.rods[rod].n_elem - 1)
    assert health == Health(Status.INACCURATE, rod, element)
    assert str(health) == f"inaccurate (rod {rod}, element {element})"


def test_a_right_run_is_not_flagged(astray: Plan) -> None:
    """The same at a quarter of the step, to the end of its ramps."""
    engine = made(astray, share=0.25, energy_check=True, step_check=True)
    for ramp in astray.ramps:
        assert engine.advance(ramp, 4 * astray.n_substeps).ok
        assert engine.step_error is not None
        assert 0.0 < engine.step_error < STEP_TOLERANCE


def test_restore_starts_the_comparison_anew(astray: Plan) -> None:
    """The engine at half the step takes over the state, too, be it the state that was flagged."""
    used, fresh = made(astray, step_check=True), made(astray, step_check=True)
    for ramp in astray.ramps[: N_ASTRAY - 1]:
        assert used.advance(ramp, astray.n_substeps).ok
    saved, before = used.state, used.step_error
    assert used.advance(astray.ramps[N_ASTRAY - 1], astray.n_substeps).status is Status.INACCURATE
    used.restore(saved)
    fresh.restore(saved)
    assert used.step_error is None
    ramp = astray.ramps[N_ASTRAY - 1] * 0.0
    assert used.advance(ramp, 1) == fresh.advance(ramp, 1) == Health()
    assert used.step_error == fresh.step_error
    assert used.step_error is not None
    assert before is not None
    assert 0.0 < used.step_error < 0.01 * before


def test_step_error(engine_name: EngineName) -> None:
    """A number after a call that ends in a state; None before the first, once restored, and where the run failed."""
    model = mixed_assembly()
    dt = 0.5 * critical_dt(model)
    engine, plain = (simulate(engine_name, model, dt, step_check=check) for check in (True, False))
    assert engine.step_error is None
    for ramp in ([0.0, 100.0], [100.0, 100.0], [100.0, 20.0]):
        tension = np.outer(ramp, np.ones(model.n_muscle))
        assert engine.advance(tension, 30).ok
        assert plain.advance(tension, 30).ok
        assert engine.step_error is not None
        assert 0.0 < engine.step_error < 1e-2
        assert plain.step_error is None
    assert np.array_equal(engine.state.position, plain.state.position)
    assert engine.advance(np.full(model.n_muscle, 1e9), 30).status not in (Status.OK, Status.ENERGY, Status.INACCURATE)
    assert engine.step_error is None
    engine.restore(model.rest_state())
    assert engine.step_error is None
    assert engine.advance(np.full(model.n_muscle, 100.0), 30).ok
    assert engine.step_error is not None
    engine.restore(model.rest_state())
    assert engine.step_error is None


def test_step_error_where_energy_comes_from_nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """That flag leaves a state, which is compared: the flag is the one, the number that of a run without it."""
    model = mixed_assembly()
    both = simulate("fused", model, 0.5 * critical_dt(model), energy_check=True, step_check=True)
    alone = simulate("fused", model, both.dt, step_check=True)
    monkeypatch.setattr(EnergyAudit, "close", lambda *arguments: Health(Status.ENERGY, 2, 1))
    for _ in range(2):
        assert both.advance(np.full(model.n_muscle, 100.0), 30) == Health(Status.ENERGY, 2, 1)
        assert alone.advance(np.full(model.n_muscle, 100.0), 30).ok
        assert both.step_error == alone.step_error is not None


def test_half_a_step_that_fails_flags_the_run(engine_name: EngineName) -> None:
    """The run is inaccurate where the run beside it fails, and has no distance from it."""
    model = mixed_assembly()
    dt = 0.5 * critical_dt(model)
    engine = simulate(engine_name, model, dt, step_check=True)
    assert engine.advance(np.full(model.n_muscle, 100.0), 30).ok
    engine.engine._half_step = make_engine(engine_name, [model], 10.0 * dt)
    health = engine.advance(np.full(model.n_muscle, 100.0), 30)
    failed = simulate(engine_name, model, 10.0 * dt).advance(np.full(model.n_muscle, 100.0), 60)
    assert not failed.ok
    assert health == replace(failed, status=Status.INACCURATE)
    assert engine.step_error is None
    assert simulate(engine_name, model, dt).advance(np.full(model.n_muscle, 100.0), 60).ok


def test_the_step_check_sees_the_ball(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ball that bounces off a held rod, which cannot differ, is compared too; too far off, it is named."""
    monkeypatch.setattr("lattice_gym.engines.step_doubling.STEP_TOLERANCE", 1e-6)
    shape = {"radius": 0.01, "density": 1e3, "youngs_modulus": 1e5, "shear_modulus": 3e4}
    rod = straight_rod((0.0, 0.0, 0.0), (0.3, 0.0, 0.0), 2, **shape)
    clamps = tuple(Clamp(0, node, node if node < 2 else None) for node in range(3))
    ball = RigidBall(
        position=np.array([0.15, 0.0, 0.05]), radius=0.03, mass=0.1, stiffness=100.0, force=(0.0, 0.0, -1.0)
    )
    engine = simulate("fused", RodModel(rods=(rod,), clamps=clamps, ball=ball), 2e-3, step_check=True)
    assert str(engine.advance([], 100)) == "inaccurate (ball)"
    assert engine.step_error is not None
    assert engine.step_error > 1e-6
