"""Is every run that goes wrong caught? Many seeded runs against the same ones at an eighth of the step.

The truth about a run is its reference, the same run at dt/8. It has an end where

- the reference fails a check of its shape itself, or comes within a twentieth of its bound where the run fails: the
  mesh collapses, at any step. No step could tell where its nodes belong; what is asked of the run is that it is
  flagged, too, not later than one control step after the reference;
- the motion forks: a second reference, whose muscles pull by up to 0.1 % more or less, parts from the first by more
  than 1 % of the height (a rod that buckles this way or that). A state that depends on less than any muscle is known
  by has no true value to 1 %; its runs are compared until one control step before, when the fork is under way.

All checks are on. The energy check and the step check are judged by where a run goes: it goes on after their flag,
which counts from the moment it came. What the energy check says of a reference is ignored: in a snap the law itself
makes spurious energy, at any step (seed 20287: 42 % of the energy at stake at dt/8, 41 % at dt/32), and the check may
flag such a snap in a run, too, however right it is.

Up to that end, a run is right if no node is ever further than 1 % of the height from the reference's, wrong if any is
further than 10 %, and in between otherwise. The state that a check refuses counts; one not finite is infinitely far.
Where the fork is under way in the first or second control step there is nothing to compare: undecided.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lattice_gym.benchmarks.divergence.runs import N_CONTROL, Plan, plan
from lattice_gym.checks import FloatArray
from lattice_gym.engines.health import Health, Status, joint_gap_limits
from lattice_gym.engines.simulation import Simulation, simulate
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.elasticity import MAX_DILATATION, MIN_DILATATION
from lattice_gym.physics.measures import dilatation, muscle_strain

WRONG, RIGHT = 0.10, 0.01
"""Distance from the reference [height] beyond which a run is wrong, and up to which it is right."""
REFINEMENT = 8
"""Steps of the reference in one of the run's."""
NEAR = 1.05
"""A reference this near to the bound of a check decides nothing about a run that fails."""
PROVISIONAL = (Status.ENERGY, Status.INACCURATE)
"""Checks after which a run can go on: its state is one."""
FORK_TENSION = 1e-3
"""Relative change of each muscle's tension that must not decide where a run goes."""
OK = "ok"


@dataclass(frozen=True)
class Run:
    """One run beside its reference."""

    seed: int
    share: float
    """Time step over the predicted critical one."""
    tension: float
    """[N]"""
    splitting: str
    layout: str
    n_substeps: int
    verdict: str
    """right, between, wrong: as far as it was compared; collapsed: the reference failed; undecided: not compared."""
    forked: bool
    """Whether the truth ended in a fork, and the comparison with it."""
    n_compared: int
    """Control steps that were compared."""
    status: str
    """How the run ended, "ok" or the check that stopped it."""
    delay: int | None
    """Control steps from the first wrong state (or the reference's failure) to the flag; None: no flag."""
    deviation: float
    """Largest distance of a node from its reference's place [height], the refused state included."""
    residual: float
    """Most spurious energy in a control step over the energy at stake."""
    reference_status: str
    reference_residual: float
    step_error: float
    """Largest distance from the run at half the step that the step check saw [longest side]."""


def _advance_reference(reference: Simulation, ramp: FloatArray, n_substeps: int) -> Health:
    """Advance by a control step. The energy check, which is judged here, is ignored: only its ledger is read."""
    health = reference.advance(ramp, n_substeps)
    return Health() if health.status in PROVISIONAL else health


def _distance(a: FloatArray, b: FloatArray, height: float) -> float:
    """Largest distance between nodes at positions a and b [height]; infinite where a place is not finite."""
    with np.errstate(all="ignore"):
        apart = float(np.linalg.norm(a - b, axis=1).max()) / height
    return apart if math.isfinite(apart) else math.inf


@dataclass(frozen=True)
class Truth:
    """Where a reference goes, as far as that is decided."""

    positions: list[FloatArray]
    """Of its nodes after each control step that can be compared [m]."""
    forked: bool
    status: str
    """"ok", or the check that it failed in the control step after these."""
    residual: float
    """Most spurious energy in a control step over the energy at stake."""

    @property
    def collapsed(self) -> bool:
        """Whether the reference failed."""
        return self.status != OK


def find_truth(plan: Plan, refinement: int = REFINEMENT) -> Truth:
    """Take a reference as far as it neither fails nor forks; a fork is under way one control step before it shows."""
    model, height, n_substeps = plan.model, plan.design.height, refinement * plan.n_substeps
    dt, splitting = plan.dt / refinement, plan.splitting
    reference, other = (simulate("fused", model, dt, splitting, energy_check=True) for _ in range(2))
    noise = 1.0 + FORK_TENSION * np.random.default_rng((plan.seed, 2)).uniform(-1.0, 1.0, model.n_muscle)
    positions, residual = list[FloatArray](), 0.0
    for ramp in plan.ramps:
        health = _advance_reference(reference, ramp, n_substeps)
        other_health = _advance_reference(other, noise * ramp, n_substeps)
        if not health.ok:
            return Truth(positions, False, health.status.name.lower(), residual)
        position = reference.state.position
        if not other_health.ok or _distance(position, other.state.position, height) > RIGHT:
            return Truth(positions[:-1], True, OK, residual)
        positions.append(position)
        residual = max(residual, _spurious_share(reference))
    return Truth(positions, False, OK, residual)


def _spurious_share(engine: Simulation) -> float:
    """Spurious energy over the energy at stake, in the last control step."""
    ledger = engine.ledger
    return 0.0 if ledger is None else max(0.0, -ledger.residual) / ledger.scale if ledger.scale > 0.0 else 0.0


def compare(seed: int) -> Run:
    """Take one seeded run and its references as far as there is a truth."""
    planned = plan(seed)
    design, model, n_substeps, ramps = planned.design, planned.model, planned.n_substeps, planned.ramps
    truth = find_truth(planned)
    n_known = len(truth.positions)
    run = simulate("fused", model, planned.dt, planned.splitting, energy_check=True, step_check=True)
    health = Health()
    deviation = step_error = residual = 0.0
    collapsed, n_compared = False, 0
    wrong_at: int | None = None
    flagged_at: int | None = None
    for k in range(min(N_CONTROL, n_known + truth.collapsed)):
        now_health = run.advance(ramps[k], n_substeps)
        health = now_health if health.ok else health
        n_compared += 1
        if k < n_known:
            now = _distance(run.state.position, truth.positions[k], design.height)
            deviation = max(deviation, now)
        if wrong_at is None and (k == n_known or now > WRONG):
            wrong_at = k
        if not health.ok and flagged_at is None:
            flagged_at = k
        if not (now_health.ok or now_health.status in PROVISIONAL):
            # The reference may fail one step later, or be about to.
            collapsed = k + 1 >= n_known + (not truth.collapsed) or _near_a_bound(model, truth.positions[k])
            break
        residual = max(residual, _spurious_share(run))
        step_error = max(step_error, run.step_error or 0.0)
        if k == n_known:
            collapsed = True
            if health.ok and not (health := run.advance(ramps[k + 1], n_substeps)).ok:
                flagged_at = k + 1
            break
    if collapsed and deviation <= WRONG:
        verdict = "collapsed"
        wrong_at = flagged_at if wrong_at is None else wrong_at
    elif n_compared == 0:
        verdict = "undecided"
    else:
        verdict = "right" if deviation <= RIGHT else "between" if deviation <= WRONG else "wrong"
    return Run(
        seed=seed,
        share=planned.share,
        tension=design.max_tension,
        splitting=planned.splitting,
        layout=planned.layout,
        n_substeps=n_substeps,
        verdict=verdict,
        forked=truth.forked,
        n_compared=n_compared,
        status=OK if health.ok else health.status.name.lower(),
        delay=None if flagged_at is None or wrong_at is None else flagged_at - wrong_at,
        deviation=deviation,
        residual=residual,
        reference_status=truth.status,
        reference_residual=truth.residual,
        step_error=step_error,
    )


def _near_a_bound(model: RodModel, position: FloatArray) -> bool:
    """Whether an element, a line or a joint is close to failing; a muscle rod's own strain is within its elements'."""
    lengths = np.concatenate([dilatation(model, position), 1.0 + muscle_strain(model, position)])
    stretched = lengths.min() < NEAR * MIN_DILATATION or lengths.max() > MAX_DILATATION / NEAR
    a, b = model.tie_nodes(model.joints)
    gaps = np.linalg.norm(position[b] - position[a], axis=1) / joint_gap_limits(model)
    return bool(stretched or gaps.max() > 1.0 / NEAR)
