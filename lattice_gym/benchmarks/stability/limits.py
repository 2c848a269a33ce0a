"""The predicted critical step against the measured one, over a grid and over random designs.

A case is a lattice worm with every muscle, driven by random bang-bang commands: each muscle fully on or off, drawn anew
every control period. A step holds if over 2,000 steps, and no shorter a time than 2,000 predicted steps, the run stays
finite with no element inverted or over-stretched, and its nodes stay within 1 % of the height of a run at dt/8. Dampers
act symmetrically, as they do by default.

A run that deviates is either too strong or only inaccurate: a bounded run whose kinetic energy of translation never
doubles that of the finer run is not unstable, however far its phase lags. Both limits are measured.
A case that fails at a sixteenth of the prediction as well, over the same time, is one that no step can hold; so is one
whose finer run comes within a fifth of the bounds of over-stretching.

Two things are looked at twice. Where 1 % would need a shorter step than predicted, the finer run is repeated with
tensions changed by at most 0.1 %: if that alone moves a node by more than 1 % of the height, or decides whether and how
the run fails, the case has no place to 1 % to be compared with (it buckles, or is undamped and chaotic), and is listed
apart under that criterion. Where the limit is more than 2.5 predictions, it is measured again over ten times as long:
heavily damped muscles have not shortened after 2,000 steps, and not met what limits them.

With a ball inside, and with rods that touch, the prediction is for all that may touch at once; as less does, it is held
only to be no longer than the limit.
"""

from __future__ import annotations

import math
import multiprocessing
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from tqdm import tqdm

from lattice_gym.benchmarks.stability.cases import BOUNDS, Case
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.simulation import simulate
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.critical_step import critical_dt
from lattice_gym.physics.laws.activation import advance_activation
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.laws.elasticity import MAX_DILATATION, MIN_DILATATION
from lattice_gym.physics.measures import dilatation
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model

MIN_RATIO = 0.4
"""What predicted over measured should be at least."""
N_STEPS = 2000
SPLITTING: Splitting = "symmetric"
"""PyElastica's is first order: near the critical step its dampers alone cost more than 1 % of the height."""
CONTROL_DT = 0.05
"""Time between commands [s]; no step can be longer."""
REFINEMENT = 8
TOLERANCE = 0.01
"""Deviation from the finer run that a step may cause, over the height."""
ENERGY_GAIN = 2.0
"""A run whose kinetic energy exceeds that of the finer run by this factor is unstable."""
FORK_TENSION = 1e-3
"""Relative change of each muscle's tension that must not decide where a run goes."""
LONGER = 10
"""Times as long that a case is run whose limit seems far above the prediction."""
RESOLUTION = 1.04
"""Ratio to which a limit is bisected."""
FINEST = 16
"""Share of the prediction, its inverse, below which no step is tried."""
NEAR = 1.25
"""A finer run with an element this near to the bounds of over-stretching decides nothing: the case has collapsed."""
NEAR_FAULT = "near over-stretching"
N_LOOKS = 100
"""Times in a run at which positions are compared."""


@dataclass(frozen=True)
class Limit:
    """What one case came to; steps in s."""

    case: Case
    predicted: float
    stable: float | None
    """Largest step that holds or is merely inaccurate; None where there is none."""
    accurate: float | None
    """Largest step that holds, with the 1 % and all; None where there is none down to 1 / FINEST of the prediction."""
    reason: str
    """What happens first above `stable`."""
    beyond: str
    """Why a case is listed apart: "collapse", "no limit" or "" for none."""
    forks: bool
    """Whether a change of 0.1 % in the tensions moves the finer run by more than 1 %, or decides how it fails; only
    looked for where it matters."""
    seconds: float

    @property
    def ratio(self) -> float:
        """Predicted over measured limit of stability."""
        return math.nan if self.beyond or not self.stable else self.usable / self.stable

    @property
    def usable(self) -> float:
        """Predicted step, at most the control period [s]."""
        return min(self.predicted, CONTROL_DT)


class Trial:
    """One design, run at any step."""

    def __init__(self, design: LatticeDesign, world: World) -> None:
        lattice = build_lattice(design)
        self.design = design
        self.model: RodModel = build_model(lattice, named_layout("all", lattice), world)
        self.predicted = critical_dt(self.model, design.max_tension, SPLITTING)

    def fault(self, dt: float, n_steps: int) -> str:
        """Name what goes wrong at a step: "" if nothing, "inaccurate", "too strong" or an engine's status."""
        status, seen, energy = self._run(dt, n_steps, 1)
        if status:
            return status
        status, finer, finer_energy = self._run(dt, n_steps, REFINEMENT)
        if status:
            return f"{status} at dt/{REFINEMENT}"
        lengths = [dilatation(self.model, position) for position in finer]
        if min(map(np.min, lengths)) < MIN_DILATATION * NEAR or max(map(np.max, lengths)) > MAX_DILATATION / NEAR:
            return NEAR_FAULT
        if self._apart(seen, finer) < TOLERANCE:
            return ""
        return "too strong" if energy > ENERGY_GAIN * finer_energy else "inaccurate"

    def forks(self, dt: float, n_steps: int) -> bool:
        """Whether the run at dt/8 goes elsewhere when tensions change by up to `FORK_TENSION`.

        It does, too, where only one of the two fails, or each in its own way; before the same failure they are compared
        as far as both go.
        """
        (one, seen, _), (other, moved, _) = (self._run(dt, n_steps, REFINEMENT, noise) for noise in (0.0, FORK_TENSION))
        return one != other or self._apart(seen, moved) > TOLERANCE

    def _apart(self, one: list[FloatArray], other: list[FloatArray]) -> float:
        """Largest distance of a node in one run from its place in the other [height], as far as both go."""
        pairs = zip(one, other, strict=False)
        return max((float(np.linalg.norm(a - b, axis=1).max()) for a, b in pairs), default=0.0) / self.design.height

    def _run(self, dt: float, n_steps: int, refinement: int, noise: float = 0.0) -> tuple[str, list[FloatArray], float]:
        """Run n_steps * dt: engine's status ("" if well), positions at some times, largest kinetic energy [J]."""
        engine = simulate("fused", self.model, dt / refinement, SPLITTING)
        rng = np.random.default_rng(1)
        strength = self.design.max_tension * (
            1.0 + noise * np.random.default_rng(2).uniform(-1.0, 1.0, self.model.n_muscle)
        )
        n_hold = max(1, round(CONTROL_DT / dt))
        look = max(1, n_steps // N_LOOKS)
        activation, seen, energy, done = np.zeros(self.model.n_muscle), list[FloatArray](), 0.0, 0
        while done < n_steps:
            command = rng.integers(0, 2, self.model.n_muscle).astype(np.float64)
            after = advance_activation(activation, command, n_hold * dt, self.design.rise_time, self.design.decay_time)
            for start in range(0, min(n_hold, n_steps - done), look):
                stop = min(start + look, n_hold, n_steps - done)
                share = np.array([[start], [stop]]) / n_hold
                tension = strength * (activation + share * (after - activation))
                health = engine.advance(tension, (stop - start) * refinement)
                if not health.ok:
                    return health.status.name.lower().replace("_", "-"), seen, energy
                state = engine.state
                seen.append(state.position)
                energy = max(energy, 0.5 * float(self.model.node_mass @ np.sum(state.velocity**2, axis=1)))
            activation, done = after, done + n_hold
        return "", seen, energy


def measure(case: Case) -> Limit:
    """Bisect the limits of one case."""
    begin = time.perf_counter()
    trial = Trial(LatticeDesign(**case.design), World.from_dict(case.world))
    limit = _bisect(case, trial, 1)
    if limit.ratio < MIN_RATIO and case.group not in BOUNDS:
        limit = _bisect(case, trial, LONGER)
    return replace(limit, seconds=time.perf_counter() - begin)


def _bisect(case: Case, trial: Trial, longer: int) -> Limit:
    """Limits of one case over `longer` times the usual time."""
    predicted = min(trial.predicted, CONTROL_DT)
    faults: dict[float, str] = {}

    def steps(dt: float) -> int:
        return longer * max(N_STEPS, math.ceil(N_STEPS * predicted / dt))

    def fault(dt: float) -> str:
        if dt not in faults:
            faults[dt] = trial.fault(dt, steps(dt))
        return faults[dt]

    def stands(dt: float) -> bool:
        return fault(dt) in ("", "inaccurate")

    stable = _largest(stands, predicted)
    accurate = _largest(lambda dt: fault(dt) == "", predicted)
    near = any(what == NEAR_FAULT for dt, what in faults.items() if dt <= predicted)
    beyond = "collapse" if stable is None or near else ""
    if stable is not None and stable >= CONTROL_DT <= trial.predicted:
        beyond = "no limit"
    failed = [dt for dt in faults if not stands(dt)]
    short = not beyond and (accurate is None or accurate < predicted)
    return Limit(
        case=case,
        predicted=trial.predicted,
        stable=stable,
        accurate=accurate,
        reason=faults[min(failed)] if failed else "",
        beyond=beyond,
        forks=short and trial.forks(predicted, steps(predicted)),
        seconds=0.0,
    )


def _largest(good: Callable[[float], bool], start: float) -> float | None:
    """Largest good step near start, to `RESOLUTION`: upwards to the control period, downwards to start / FINEST."""
    low, high, factor = start, start, 1.2
    if good(start):
        while low < CONTROL_DT:
            high = min(low * factor, CONTROL_DT)
            if not good(high):
                break
            low, factor = high, 1.5 * factor
        else:
            return low
    else:
        while True:
            low = max(low / 2.0, start / FINEST)
            if good(low):
                break
            if low <= start / FINEST:
                return None
            high = low
    while high / low > RESOLUTION:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if good(middle) else (low, middle)
    return low


def measure_all(cases: list[Case], jobs: int) -> list[Limit]:
    """Measure every case, in order."""
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        limits = map(measure, cases) if jobs == 1 else pool.map(measure, cases)
        return list(tqdm(limits, desc="stability", total=len(cases), unit="case"))
