"""Is every run that goes wrong caught? Many seeded runs against the same ones at an eighth of the step.

The truth about a run is its twin at dt/8. It has an end where

- the twin fails a check of its shape itself, or comes within a twentieth of its bound where the run fails: the mesh
  collapses, at any step. No step could tell where its nodes belong; what is asked of the run is that it is flagged,
  too, not later than one control step after the twin;
- the motion forks: a second twin, whose muscles pull by up to 0.1 % more or less, parts from the first by more than
  1 % of the height (a rod that buckles this way or that). A state that depends on less than any muscle is known by has
  no true value to 1 %; its runs are compared until one control step before, when the fork is under way.

All checks are on. The energy check and the step check are judged by where a run goes: it goes on after their flag,
which counts from the moment it came. What the energy check says of a twin is ignored: in a snap the law itself makes
energy from nowhere, at any step (seed 20287: 42 % of the energy at stake at dt/8, 41 % at dt/32), and the check may
flag such a snap in a run, too, however right it is.

Up to that end, a run is right if no node is ever further than 1 % of the height from the twin's, wrong if any is
further than 10 %, and in between otherwise. The state that a check refuses counts; one not finite is infinitely far.
Where the fork is under way in the first or second control step there is nothing to compare: undecided.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np

from lattice_gym.benchmarks.results_files import table, write
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import LAYOUTS, named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.base import STEP_TOLERANCE, Engine, Health, Status, joint_reach
from lattice_gym.engines.registry import make_engine
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.energy import ENERGY_TOLERANCE
from lattice_gym.physics.laws.activation import advance_activation
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.laws.elasticity import MAX_DILATATION, MIN_DILATATION
from lattice_gym.physics.measures import dilatation, muscle_strain
from lattice_gym.physics.stable_step import stable_dt
from lattice_gym.physics.worm import build_model
from lattice_gym.recording.provenance import provenance

WRONG, RIGHT = 0.10, 0.01
"""Distance from the twin [height] beyond which a run is wrong, and up to which it is right."""
TWIN = 8
"""Steps of the twin in one of the run's."""
FINER = 4
"""Steps in one of the twin's with which the twin that makes most energy from nowhere is taken again."""
NEAR = 1.05
"""A twin this near to the bound of a check decides nothing about a run that fails."""
PROVISIONAL = (Status.ENERGY, Status.INACCURATE)
"""Checks after which a run can go on: its state is one."""
FORK_TENSION = 1e-3
"""Relative change of each muscle's tension that must not decide where a run goes."""
N_CONTROL = 12
"""Control steps of a run."""
CONTROL_DT = 0.05
"""[s]"""
MAX_SUBSTEPS = 500
"""Where the step is so short that more of them make a control step, the control step is shortened."""
REPORT_EVERY = 10.0
"""Time between lines of progress [s]."""
FULL, QUICK = 400, 40
"""Runs of the report, and of its quick form."""
FIRST_SEED = 20_000
"""Seeds below were used while the checks were made; those of the report were not."""
OK = "ok"
VERDICTS = ("right", "between", "wrong", "collapsed", "undecided")


@dataclass(frozen=True)
class Run:
    """One run beside its twins."""

    seed: int
    share: float
    """Time step over the predicted stable one."""
    tension: float
    """[N]"""
    splitting: str
    layout: str
    n_substeps: int
    verdict: str
    """right, between, wrong: as far as it was compared; collapsed: the twin failed; undecided: nothing to compare."""
    forked: bool
    """Whether the truth ended in a fork, and the comparison with it."""
    n_compared: int
    """Control steps that were compared."""
    status: str
    """How the run ended, "ok" or the check that stopped it."""
    place: str
    delay: int | None
    """Control steps from the first wrong state (or the twin's failure) to the flag: 0 is the same; None: no flag."""
    deviation: float
    """Largest distance of a node from its twin's place [height], the refused state included."""
    delivered: float
    """The same, of the states that passed the checks."""
    twin_status: str
    residual: float
    """Most energy from nowhere in a control step over the energy at stake, in the run; and in its twin."""
    twin_residual: float
    step_error: float
    """Largest distance from the run at half the step that the step check saw [longest side]."""
    least_dilatation: float
    largest_gap: float
    """Over the gap at which a joint is torn."""


def draw(seed: int) -> tuple[LatticeDesign, str, Splitting, float]:
    """Design, layout, splitting, and step over the predicted stable one."""
    rng = np.random.default_rng(seed)
    while True:
        n_pairs, period_ratio = ((3, 1.5), (4, 2.0), (6, 1.5))[rng.integers(3)]
        values: dict[str, Any] = {
            "n_pairs": n_pairs,
            "period_ratio": period_ratio,
            "elements_per_segment": int(rng.integers(2, 7)),
            "structure_youngs_modulus": 70e3 * _log_uniform(rng, 0.3, 10.0),
            "muscle_youngs_modulus": 25e3 * _log_uniform(rng, 0.3, 10.0),
            "joint_stiffness": 100.0 * _log_uniform(rng, 0.3, 100.0),
            "structure_radius": 5e-3 * _log_uniform(rng, 0.5, 1.5),
            "muscle_radius": 5e-3 * _log_uniform(rng, 0.5, 1.5),
            "damping": 0.03 * _log_uniform(rng, 0.1, 10.0) if rng.random() < 0.8 else 0.0,
            "base": "clamped" if rng.random() < 0.7 else "free",
            "muscle_model": "rod" if rng.random() < 0.7 else "line",
            "max_tension": _log_uniform(rng, 0.1, 10.0),
        }
        layout = LAYOUTS[rng.integers(len(LAYOUTS))]
        splitting: Splitting = get_args(Splitting)[rng.integers(2)]
        share = float(rng.uniform(0.3, 2.0))
        try:
            return LatticeDesign(**values), layout, splitting, share
        except ValueError:  # too thick for its lattice: draw again
            continue


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def tensions(design: LatticeDesign, n_muscle: int, control_dt: float, seed: int) -> list[FloatArray]:
    """Ramps (2, n_muscle) of `N_CONTROL` + 1 control steps of random muscles switched fully on and off [N]."""
    rng = np.random.default_rng((seed, 1))
    activation, ramps = np.zeros(n_muscle), []
    for _ in range(N_CONTROL + 1):
        command = (rng.random(n_muscle) < 0.5).astype(float)
        after = advance_activation(activation, command, control_dt, design.rise_time, design.decay_time)
        ramps.append(design.max_tension * np.stack([activation, after]))
        activation = after
    return ramps


@dataclass(frozen=True)
class Plan:
    """All that a seed settles."""

    seed: int
    design: LatticeDesign
    layout: str
    splitting: Splitting
    share: float
    """Time step over the predicted stable one."""
    model: RodModel
    dt: float
    """[s]"""
    n_substeps: int
    ramps: list[FloatArray]
    """See `tensions`."""


def plan(seed: int) -> Plan:
    """Draw a run and set its time step, so that whole steps make a control step."""
    design, layout, splitting, share = draw(seed)
    lattice: Lattice = build_lattice(design)
    model: RodModel = build_model(lattice, named_layout(layout, lattice))
    stable = stable_dt(model, design.max_tension, splitting)
    n_substeps = min(max(1, math.ceil(CONTROL_DT / (share * stable))), MAX_SUBSTEPS)
    control_dt = min(CONTROL_DT, n_substeps * share * stable)
    dt, ramps = control_dt / n_substeps, tensions(design, model.n_muscle, control_dt, seed)
    return Plan(seed, design, layout, splitting, dt / stable, model, dt, n_substeps, ramps)


def _advance_twin(twin: Engine, ramp: FloatArray, n_substeps: int) -> Health:
    """Advance by a control step. The energy check, which is judged here, is ignored: only its ledger is read."""
    health = twin.advance(ramp, n_substeps)
    return Health() if health.status in PROVISIONAL else health


def _distance(a: FloatArray, b: FloatArray, height: float) -> float:
    """Largest distance between nodes at positions a and b [height]; infinite where a place is not finite."""
    with np.errstate(all="ignore"):
        apart = float(np.linalg.norm(a - b, axis=1).max()) / height
    return apart if math.isfinite(apart) else math.inf


@dataclass(frozen=True)
class Truth:
    """Where a twin goes, as far as that is decided."""

    positions: list[FloatArray]
    """Of its nodes after each control step that can be compared [m]."""
    forked: bool
    status: str
    """"ok", or the check that it failed in the control step after these."""
    residual: float
    """Most energy from nowhere in a control step over the energy at stake."""

    @property
    def collapsed(self) -> bool:
        """Whether the twin failed."""
        return self.status != OK


def _truth(plan: Plan, refinement: int) -> Truth:
    """Take a twin as far as it neither fails nor forks; a fork is under way one control step before it shows."""
    model, height, n_substeps = plan.model, plan.design.height, refinement * plan.n_substeps
    dt, splitting = plan.dt / refinement, plan.splitting
    twin, other = (make_engine("fused", model, dt, splitting, energy_check=True) for _ in range(2))
    noise = 1.0 + FORK_TENSION * np.random.default_rng((plan.seed, 2)).uniform(-1.0, 1.0, model.n_muscle)
    positions, residual = list[FloatArray](), 0.0
    for ramp in plan.ramps:
        health, other_health = _advance_twin(twin, ramp, n_substeps), _advance_twin(other, noise * ramp, n_substeps)
        if not health.ok:
            return Truth(positions, False, health.status.name.lower(), residual)
        position = twin.state.position
        if not other_health.ok or _distance(position, other.state.position, height) > RIGHT:
            return Truth(positions[:-1], True, OK, residual)
        positions.append(position)
        residual = max(residual, _share_from_nowhere(twin))
    return Truth(positions, False, OK, residual)


def _share_from_nowhere(engine: Engine) -> float:
    """Energy from nowhere over the energy at stake, in the last control step."""
    ledger = engine.ledger
    return 0.0 if ledger is None else max(0.0, -ledger.residual) / ledger.scale if ledger.scale > 0.0 else 0.0


def compare(seed: int) -> Run:
    """Take one seeded run and its twins as far as there is a truth."""
    planned = plan(seed)
    design, model, n_substeps, ramps = planned.design, planned.model, planned.n_substeps, planned.ramps
    truth = _truth(planned, TWIN)
    n_known = len(truth.positions)
    run = make_engine("fused", model, planned.dt, planned.splitting, energy_check=True, step_check=True)
    reach = joint_reach(model)

    health = Health()
    deviation = delivered = step_error = residual = largest_gap = 0.0
    least, collapsed, n_compared = math.inf, False, 0
    wrong_at: int | None = None
    flagged_at: int | None = None
    for k in range(min(N_CONTROL, n_known + truth.collapsed)):
        now_health = run.advance(ramps[k], n_substeps)
        health = now_health if health.ok else health
        n_compared += 1
        position = run.state.position
        if k < n_known:
            now = _distance(position, truth.positions[k], design.height)
            deviation = max(deviation, now)
            delivered = max(delivered, now) if health.ok else delivered
        if wrong_at is None and (k == n_known or now > WRONG):
            wrong_at = k
        if not health.ok and flagged_at is None:
            flagged_at = k
        if not (now_health.ok or now_health.status in PROVISIONAL):
            # The twin may fail one step later, or be about to.
            collapsed = k + 1 >= n_known + (not truth.collapsed) or _near_a_bound(model, truth.positions[k], reach)
            break
        residual = max(residual, _share_from_nowhere(run))
        step_error = max(step_error, run.step_error or 0.0)
        least = min(least, float(dilatation(model, position).min()))
        largest_gap = max(largest_gap, _gap_share(model, position, reach))
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
        place="" if health.ok else str(health),
        delay=None if flagged_at is None or wrong_at is None else flagged_at - wrong_at,
        deviation=deviation,
        delivered=delivered,
        twin_status=truth.status,
        residual=residual,
        twin_residual=truth.residual,
        step_error=step_error,
        least_dilatation=least,
        largest_gap=largest_gap,
    )


def _gap_share(model: RodModel, position: FloatArray, reach: FloatArray) -> float:
    a, b = model.tie_nodes(model.joints)
    return float((np.linalg.norm(position[b] - position[a], axis=1) / reach).max())


def _near_a_bound(model: RodModel, position: FloatArray, reach: FloatArray) -> bool:
    """Whether an element, a line or a joint is close to failing; a muscle rod's own strain is within its elements'."""
    lengths = np.concatenate([dilatation(model, position), 1.0 + muscle_strain(model, position)])
    stretched = lengths.min() < NEAR * MIN_DILATATION or lengths.max() > MAX_DILATATION / NEAR
    return bool(stretched or _gap_share(model, position, reach) > 1.0 / NEAR)


def count(runs: Sequence[Run]) -> dict[str, dict[str, int]]:
    """Count runs by verdict: flagged in the control step in which they go wrong, in the next, later or never."""
    rows = {}
    for verdict in VERDICTS:
        chosen = [run for run in runs if run.verdict == verdict]
        delays = [0 if verdict in ("right", "between") and run.status != OK else run.delay for run in chosen]
        rows[verdict] = {
            "runs": len(chosen),
            "forked": sum(run.forked for run in chosen),
            "flagged at once": sum(delay is not None and delay <= 0 for delay in delays),
            "one step later": sum(delay == 1 for delay in delays),
            "later": sum(delay is not None and delay > 1 for delay in delays),
            "not flagged": sum(delay is None for delay in delays),
        }
    return rows


def held(rows: dict[str, dict[str, int]]) -> bool:
    """Whether every wrong run and every collapse was flagged within one control step, and no right run ever."""
    caught = all(rows[v]["not flagged"] + rows[v]["later"] == 0 for v in ("wrong", "collapsed"))
    return caught and rows["right"]["not flagged"] == rows["right"]["runs"]


def report(folder: Path, *, command: str, quick: bool = False) -> bool:
    """Write divergence.md, divergence.json and divergence.png; returns whether all was as it should be."""
    total, start, said = QUICK if quick else FULL, time.perf_counter(), 0.0
    runs: list[Run] = []
    for k in range(total):
        runs.append(compare(FIRST_SEED + k))
        if (now := time.perf_counter() - start) - said > REPORT_EVERY:
            said = now
            sys.stderr.write(f"divergence: {k + 1} of {total} runs, {now:.0f} s\n")
    rows = count(runs)
    right = [run for run in runs if run.verdict == "right"]
    wrong = [run for run in runs if run.verdict == "wrong"]
    missed = [run for run in runs if run.verdict in ("wrong", "collapsed") and (run.delay is None or run.delay > 1)]
    missed += [run for run in right if run.status != OK]
    complete = [run for run in right if run.n_compared == N_CONTROL]
    strangest = max(runs, key=lambda run: run.twin_residual)
    stays = _truth(plan(strangest.seed), FINER * TWIN).residual
    made = provenance(command)
    result: dict[str, Any] = {
        "counts": rows,
        "counts_by_splitting": {name: count([r for r in runs if r.splitting == name]) for name in get_args(Splitting)},
        "held": held(rows),
        "checks": Counter(run.status for run in wrong),
        "largest_residual_of_right_runs": max((run.residual for run in right), default=0.0),
        "largest_step_error_of_right_runs": max((run.step_error for run in right), default=0.0),
        "right_runs_compared_to_the_end": len(complete),
        "largest_residual_of_twins": strangest.twin_residual,
        "seed_of_largest_residual_of_twins": strangest.seed,
        "the_same_with_finer_steps": {"refinement": FINER * TWIN, "residual": stays},
        "runs": [asdict(run) | {"deviation": min(run.deviation, 1e300)} for run in runs],
        "made": made,
    }
    names = {
        "right": f"right: never more than {RIGHT:.0%} of the height from the run at dt/{TWIN}",
        "between": f"between {RIGHT:.0%} and {WRONG:.0%}",
        "wrong": f"wrong: more than {WRONG:.0%}",
        "collapsed": f"collapsed: the run at dt/{TWIN} is flagged, too",
        "undecided": "undecided: forked before anything could be compared",
    }
    header = ["damping", "deviation", *next(iter(rows.values()))]
    split = {name: count([run for run in runs if run.splitting == name]) for name in get_args(Splitting)}
    checks = ", ".join(f"{name} {number}" for name, number in result["checks"].most_common())
    tables = [
        f"{total} random worms with random muscles switched on and off, at 0.3 to 2 of the predicted stable step and "
        f"0.1 to 10 N, beside themselves at dt/{TWIN}:",
        table(
            header,
            [
                [splitting, names[verdict], *map(str, row.values())]
                for splitting, of_splitting in split.items()
                for verdict, row in of_splitting.items()
            ],
        ),
        _compared(right, complete),
        f"What stopped the wrong runs: {checks or 'nothing, there were none'}. Forked runs are compared until a change "
        f"of {FORK_TENSION:.1%} in the tensions moves their twin by {RIGHT:.0%} of the height; undecided ones forked "
        "too early for that, and count neither as right nor as wrong.",
        f"Energy from nowhere in one control step, over the energy at stake: at most "
        f"{result['largest_residual_of_right_runs']:.1%} in right runs, "
        f"{float(np.median([run.residual for run in right] or [0.0])):.2%} in their median; flagged above "
        f"{ENERGY_TOLERANCE:.0%}. Distance from the run at dt/2: at most "
        f"{result['largest_step_error_of_right_runs']:.2%} in right runs, {_least_step_error(wrong)} in wrong runs "
        f"that no other check stopped; flagged above {STEP_TOLERANCE:.0%}.",
        f"Energy from nowhere in the runs at dt/{TWIN} themselves, whose energy check is ignored: at most "
        f"{strangest.twin_residual:.1%} (seed {strangest.seed}), and {stays:.1%} in the same run at dt/{FINER * TWIN}. "
        "What stays there is the law in a snap, not the step: the energy check may flag such a snap in a right run.",
    ]
    if missed:
        tables.append("Misjudged:")
        tables.append(
            table(
                ["seed", "damping", "step/predicted", "tension", "verdict", "status", "deviation", "residual"],
                [
                    [
                        *(str(run.seed), run.splitting, f"{run.share:.2f}", f"{run.tension:.2f} N"),
                        *(run.verdict, run.status, f"{run.deviation:.3f}", f"{run.residual:.1%}"),
                    ]
                    for run in missed
                ],
            )
        )  # fmt: skip
    write(folder, "divergence", result, tables)
    _draw(runs, folder / "divergence.png", command)
    return bool(result["held"])


def _compared(right: Sequence[Run], complete: Sequence[Run]) -> str:
    """How long right runs were compared."""
    said = f"Of {len(right)} right runs {len(complete)} were compared to the end, {N_CONTROL} control steps"
    others = [run.n_compared for run in right if run not in complete]
    if not others:
        return f"{said}."
    return f"{said}; the others over {min(others)} to {max(others)}, {float(np.median(others)):g} in their median."


def _least_step_error(runs: Sequence[Run]) -> str:
    least = min((run.step_error for run in runs if run.status == Status.INACCURATE.name.lower()), default=None)
    return "nothing to tell" if least is None else f"{least:.1%} or more"


def _draw(runs: Sequence[Run], path: Path, command: str) -> None:
    """Draw what was compared: deviation over step, and what two checks see over deviation; a colour for each end."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    colours = {OK: "#9aa5b1", "non_finite": "#1b1b1b", "overstretched": "#c1443c", "inverted": "#e39b3b",
               "torn": "#3b78b5", "energy": "#6a3d9a", "inaccurate": "#2f8f5b"}  # fmt: skip
    markers = {"right": "o", "between": "o", "wrong": "o", "collapsed": "s"}
    top, least = 10.0, 1e-7
    figure = Figure(figsize=(14.0, 4.6), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    edge = left.get_yaxis_transform()
    for run in (run for run in runs if run.verdict in markers):
        x = min(max(run.deviation, least), top)
        style: dict[str, Any] = {"marker": markers[run.verdict], "ms": 4.5, "mec": "white", "mew": 0.4}
        left.plot(run.share, x, color=colours[run.status], **style)
        middle.plot(x, min(max(run.residual, 1e-6), 1.0), color=colours[run.status], **style)
        right.plot(x, min(max(run.step_error, least), top), color=colours[run.status], **style)
    for level, text in ((RIGHT, "right below"), (WRONG, "wrong above")):
        left.axhline(level, color="#555555", lw=0.8, ls="--")
        left.annotate(text, (1.0, level), xycoords=edge, fontsize=8, va="bottom", ha="right", color="#555555")
        for axes in (middle, right):
            axes.axvline(level, color="#555555", lw=0.8, ls="--")
    for axes, name, level in ((middle, "energy", ENERGY_TOLERANCE), (right, "inaccurate", STEP_TOLERANCE)):
        axes.axhline(level, color=colours[name], lw=0.8, ls="--")
        axes.annotate("flagged above", (least, level), fontsize=8, va="bottom", color=colours[name])
        axes.set(xscale="log", yscale="log", xlim=(least / 2, 2.0 * top))
        axes.set_xlabel(f"largest distance from the run at dt/{TWIN} [height]")
    left.set(yscale="log", xlabel="time step over the predicted stable one", ylim=(least / 2, 2.0 * top))
    left.set_ylabel(f"largest distance from the run at dt/{TWIN} [height]\n(top: 10 and more, or not finite)")
    middle.set_ylim(5e-7, 2.0)
    middle.set_ylabel("energy check: energy from nowhere in a control step\nover the energy at stake")
    right.set_ylim(least / 2, 2.0 * top)
    right.set_ylabel("step check: largest distance from the run at dt/2\n[longest side]")
    ends = [status for status in colours if any(run.status == status for run in runs)]
    handles = [Line2D([], [], ls="", marker="o", color=colours[end], label=end.replace("_", " ")) for end in ends]
    handles.append(Line2D([], [], ls="", marker="s", color="#777777", label="dt/8 flagged, too"))
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), fontsize=9, frameon=False)
    for axes in (left, middle, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="#e6e6e6", lw=0.5)
        axes.set_axisbelow(True)
    figure.savefig(path, dpi=150, metadata={"Description": command})
