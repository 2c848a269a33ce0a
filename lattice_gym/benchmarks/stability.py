"""The predicted stable step against the measured one, over a grid and over random designs.

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
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lattice_gym.benchmarks.results_files import table, write
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.registry import make_engine
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.activation import advance_activation
from lattice_gym.physics.laws.ball import Bolus
from lattice_gym.physics.laws.contact import Contact
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.laws.elasticity import MAX_DILATATION, MIN_DILATATION
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.measures import dilatation
from lattice_gym.physics.stable_step import stable_dt
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model
from lattice_gym.recording.provenance import provenance

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEAST_RATIO, MEDIAN_RATIO = 0.4, 0.7
"""What predicted over measured should be at least, everywhere and in the median; nowhere above 1."""
N_STEPS = 2000
SPLITTING: Splitting = "symmetric"
"""PyElastica's is first order: near the stable limit its dampers alone cost more than 1 % of the height."""
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
PAIRS_AND_PERIODS = ((2, 1.0), (2, 2 / 3), (3, 2.0), (3, 1.5), (3, 1.0), (4, 2.0), (4, 1.6), (6, 1.5))
"""Pairs of rods and period ratios that close, with 2 to 8 segments on a rod, for random designs."""
GRID: dict[str, dict[str, tuple[float, ...]]] = {
    "stiffness": {"modulus": (0.01, 0.1, 1, 10, 100, 1000), "connection": (1, 10, 100, 1e3, 1e4, 1e5)},
    "mesh": {"radius": (0.2, 0.4, 0.7, 1, 1.4, 2), "elements": (1, 2, 4, 8, 16, 25)},
    "load": {"tension": (0, 0.5, 1, 2, 4), "modulus": (0.01, 0.1, 1, 10, 100, 1000)},
    "damping": {"damping": (0, 1, 10, 100, 1000), "connection": (1, 10, 100, 1e3, 1e4, 1e5)},
    "ground": {"ground": (1, 10, 100, 1e3, 1e4, 1e5), "dashpot": (0, 0.5, 1, 2)},
    "ball": {"ball": (0.1, 1, 10), "density": (0.1, 1, 10)},
    "contact": {"contact": (0.1, 1, 10), "tension": (2, 4)},
}
BALL_RADIUS, BALL_LEVEL = 0.016, 2.0
"""Of a ball [m] that just fits into a ring of three pairs of rods, which closes on it as its muscles pull."""
LABELS = {
    "modulus": "Young's moduli / default",
    "connection": "connection stiffness / default",
    "radius": "radii / default",
    "elements": "elements per segment",
    "tension": "tension / default",
    "damping": "damping / default",
    "ground": "ground's stiffness / default",
    "dashpot": "ground's damping ratio / default",
    "ball": "stiffness of the ball / default",
    "density": "its density / default",
    "contact": "stiffness of rods that touch / default",
}


@dataclass(frozen=True)
class Case:
    """A design by its factors, and where it stands in the report."""

    group: str
    design: dict[str, Any]
    factors: dict[str, float] = field(default_factory=dict)
    world: dict[str, Any] = field(default_factory=dict)
    """What surrounds it, in dict form."""


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


def grid_cases(quick: bool) -> Iterator[Case]:
    """Every pair of values of each pair of parameters; every other value of each in the quick form."""
    for group, axes in GRID.items():
        (x, xs), (y, ys) = axes.items()
        for b in ys[:: 2 if quick else 1]:
            for a in xs[:: 2 if quick else 1]:
                factors = {x: a, y: b}
                base = "free" if group == "ground" else "clamped"
                world = WORLDS[group](a, b).to_dict() if group in WORLDS else {}
                yield Case(group, _scaled(factors, n_pairs=3, base=base), factors, world)


def lying(stiffness: float, damping_ratio: float) -> World:
    """Lie in water on a ground with factors on the default's stiffness and its ratio of damping to critical."""
    default = Ground()
    damping = damping_ratio * math.sqrt(stiffness) * default.damping
    ground = replace(default, stiffness=stiffness * default.stiffness, damping=damping)
    return World(medium=Medium(), ground=ground, lying=True)


def swallowing(stiffness: float, density: float) -> World:
    """Have a ball inside, with factors on the default's stiffness and density and its ratio of damping to critical."""
    default = Bolus()
    damping = math.sqrt(stiffness * density) * default.damping
    ball = replace(default, stiffness=stiffness * default.stiffness, density=density * default.density, damping=damping)
    return World(bolus=replace(ball, radius=BALL_RADIUS, level=BALL_LEVEL))


def touching(stiffness: float, tension: float) -> World:
    """Let rods touch, with a factor on the default's stiffness and its ratio of damping to critical."""
    default = Contact()
    return World(
        contact=Contact(stiffness=stiffness * default.stiffness, damping=math.sqrt(stiffness) * default.damping)
    )


WORLDS: dict[str, Callable[[float, float], World]] = {"ground": lying, "ball": swallowing, "contact": touching}
"""What surrounds the worms of a group, given the factors on its two axes."""
BOUNDS = ("ball", "contact")
"""Groups whose prediction is for all that may touch, not for what does: it may well be far too small."""


def _scaled(factors: dict[str, float], **changes: Any) -> dict[str, Any]:
    """Fields of the default design with factors on them."""
    default = LatticeDesign()
    fields_of = {
        "modulus": ("structure_youngs_modulus", "muscle_youngs_modulus"),
        "connection": ("joint_stiffness",),
        "radius": ("structure_radius", "muscle_radius"),
        "tension": ("max_tension",),
        "damping": ("damping", "rotational_damping"),
    }
    values = {name: getattr(default, name) * f for key, f in factors.items() for name in fields_of.get(key, ())}
    if "elements" in factors:
        values["elements_per_segment"] = int(factors["elements"])
    return values | changes


def random_cases(number: int, seed: int = 0) -> Iterator[Case]:
    """Random designs over the whole range, structure and muscles apart; what has no room is drawn again."""
    rng = np.random.default_rng(seed)
    default = LatticeDesign()
    made = 0
    while made < number:
        n_pairs, period_ratio = PAIRS_AND_PERIODS[rng.integers(len(PAIRS_AND_PERIODS))]
        damping = 0.0 if rng.random() < 0.2 else _spread(rng, 0.1, 1e3)
        design: dict[str, Any] = {
            "n_pairs": n_pairs,
            "period_ratio": period_ratio,
            "base": ("clamped", "free")[rng.integers(2)],
            "muscle_model": ("rod", "rod", "line")[rng.integers(3)],
            "elements_per_segment": round(_spread(rng, 1.0, 25.0)),
            "structure_youngs_modulus": default.structure_youngs_modulus * _spread(rng, 1e-2, 1e3),
            "muscle_youngs_modulus": default.muscle_youngs_modulus * _spread(rng, 1e-2, 1e3),
            "structure_radius": default.structure_radius * _spread(rng, 0.2, 2.0),
            "muscle_radius": default.muscle_radius * _spread(rng, 0.2, 2.0),
            "joint_stiffness": default.joint_stiffness * _spread(rng, 1.0, 1e5),
            "joint_damping": 0.0 if rng.random() < 0.7 else _spread(rng, 1e-3, 1.0),
            "max_tension": default.max_tension * _spread(rng, 0.1, 4.0),
            "damping": default.damping * damping,
            "rotational_damping": default.rotational_damping * damping * float(rng.integers(2)),
        }
        try:
            LatticeDesign(**design)
        except ValueError:
            continue
        made += 1
        yield Case("random", design)


def _spread(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


class Trial:
    """One design, run at any step."""

    def __init__(self, design: LatticeDesign, world: World) -> None:
        lattice = build_lattice(design)
        self.design = design
        self.model: RodModel = build_model(lattice, named_layout("all", lattice), world)
        self.predicted = stable_dt(self.model, design.max_tension, SPLITTING)

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
        engine = make_engine("fused", self.model, dt / refinement, SPLITTING)
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
    if limit.ratio < LEAST_RATIO and case.group not in BOUNDS:
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
    """Measure every case, in order, with a line on stderr every ten seconds."""
    if jobs == 1:
        return list(_watched(map(measure, cases), len(cases)))
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        return list(_watched(pool.map(measure, cases), len(cases)))


def _watched(limits: Iterable[Limit], number: int) -> Iterator[Limit]:
    begin = said = time.monotonic()
    for done, limit in enumerate(limits, 1):
        yield limit
        if time.monotonic() - said > 10.0 or done == number:
            said = time.monotonic()
            sys.stderr.write(f"stability: {done} of {number} cases, {said - begin:.0f} s\n")


def report(
    folder: Path, *, command: str, quick: bool = False, jobs: int = 2, seed: int = 0, n_random: int | None = None
) -> bool:
    """Write stability.json, .md and .png; True if no prediction is above a limit, and all aims are met within 1 %."""
    number = (20 if quick else 120) if n_random is None else n_random
    cases = [*grid_cases(quick), *random_cases(number, seed)]
    limits = measure_all(cases, jobs)
    summary = summarise(limits)
    result = {
        "summary": summary,
        "cases": [asdict(limit) | {"ratio": None if math.isnan(limit.ratio) else limit.ratio} for limit in limits],
        "made": provenance(command),
    }
    write(folder, "stability", result, _tables(limits, summary))
    _figure(limits).savefig(folder / "stability.png", dpi=130)
    return bool(summary["stable"]["n_above_1"] == 0 and summary["within_1_percent"]["holds"])


def summarise(limits: list[Limit]) -> dict[str, Any]:
    """Figures of the whole under either criterion, each with its own cases apart."""
    return {
        "n_case": len(limits),
        "n_no_limit": sum(limit.beyond == "no limit" for limit in limits),
        "stable": _judge(limits, "stable"),
        "within_1_percent": _judge(limits, "accurate"),
        "seconds": sum(limit.seconds for limit in limits),
    }


def _judge(limits: list[Limit], criterion: str) -> dict[str, Any]:
    """Predicted over measured limit of one criterion; apart are the cases in which no step meets it, or none can."""
    whole = [limit for limit in limits if not limit.beyond]
    decided = [limit for limit in whole if criterion == "stable" or not limit.forks]
    counted = [limit for limit in decided if getattr(limit, criterion)]
    ratios = np.array([limit.usable / getattr(limit, criterion) for limit in counted])
    near = ratios[[limit.case.group not in BOUNDS for limit in counted]]
    designs = {LatticeDesign(**limit.case.design): limit.case.group for limit in counted}
    low, median, high = float(near.min()), float(np.median(near)), float(ratios.max())
    return {
        "n_counted": len(counted),
        "n_design": len(designs),
        "n_random": sum(group == "random" for group in designs.values()),
        "n_collapse": sum(limit.beyond == "collapse" for limit in limits) + len(decided) - len(counted),
        "n_forked": len(whole) - len(decided),
        "min": low,
        "median": median,
        "max": high,
        "n_above_1": int(np.sum(ratios > 1.0)),
        "n_below_0.4": int(np.sum(near < LEAST_RATIO)),
        "holds": high <= 1.0 and low >= LEAST_RATIO and median >= MEDIAN_RATIO,
    }


def _tables(limits: list[Limit], summary: dict[str, Any]) -> list[str]:
    rows = []
    for group in dict.fromkeys(limit.case.group for limit in limits):
        members = [limit for limit in limits if limit.case.group == group]
        ratios = [limit.ratio for limit in members if not math.isnan(limit.ratio)]
        steps = [limit.stable for limit in members if limit.stable and not limit.beyond]
        apart = [sum(limit.beyond == kind for limit in members) for kind in ("collapse", "no limit")]
        rows.append(
            [group, str(len(members)), *map(str, apart)]
            + [f"{value:.2f}" for value in (min(ratios), float(np.median(ratios)), max(ratios))]
            + [f"{1e6 * min(steps):.3g} to {1e6 * max(steps):.3g}"]
        )
    header = ["cases", "number", "no step holds", "no step fails", "min", "median", "max", "limit [us]"]
    above = [limit for limit in limits if not limit.beyond and limit.usable > (limit.accurate or 0.0)]
    judged = [
        [label, *(str(found[key]) for key in ("n_counted", "n_design", "n_random", "n_collapse", "n_forked"))]
        + [f"{found[key]:.2f}" for key in ("min", "median", "max")]
        + [str(found[key]) for key in ("n_above_1", "n_below_0.4")]
        for label, found in (
            ("finite, not inverted, motion no stronger than at dt/8", summary["stable"]),
            ("and within 1 % of the height of the run at dt/8", summary["within_1_percent"]),
        )
    ]
    criteria = ["a step holds if", "counted", "distinct designs", "of them random", "no step holds", "forks"]
    criteria += ["min", "median", "max", "above 1", "below 0.4"]
    text = (
        "Distinct designs: the grids share some. The groups "
        f"{' and '.join(BOUNDS)} count for what is above 1 only: their prediction is for all that may touch. "
        f"Apart under both: {summary['n_no_limit']} cases that hold at one step a command, the longest there is. No "
        f"step holds: none down to 1/{FINEST} of the prediction over the same time. Forks: a change of "
        f"{FORK_TENSION:.1%} in the tensions moves the run at dt/{REFINEMENT} by more than {TOLERANCE:.0%}, or decides "
        "whether and how it fails, so that no run could be compared with it."
    )
    accuracy = "Cases whose predicted step is too long for the 1 %:"
    listed = [
        [
            _name(limit.case),
            f"{1e6 * limit.usable:.3g}",
            f"{1e6 * (limit.stable or 0.0):.3g}",
            f"{1e6 * (limit.accurate or 0.0):.3g}",
            f"{limit.case.design.get('damping', LatticeDesign().damping) / LatticeDesign().damping:.3g}",
            "yes" if limit.forks else "no",
        ]
        for limit in above
    ]
    names = ["case", "predicted [us]", "stable [us]", "within 1 % [us]", "damping / default", "forks"]
    first = Counter(limit.reason.removesuffix(f" at dt/{REFINEMENT}") for limit in limits if not limit.beyond)
    reasons = "First fault above the limit: " + ", ".join(f"{name} {n}" for name, n in first.most_common()) + "."
    over = [f"{_name(limit.case)} ({limit.ratio:.2f})" for limit in limits if limit.ratio > 1.0]
    misses = "Predicted above the limit of stability: " + ("; ".join(over) or "none") + "."
    tables = ["Predicted over measured largest step:", table(criteria, judged), text]
    tables += ["By group, first criterion:", table(header, rows), misses, reasons]
    return [*tables, accuracy, table(names, listed)] if listed else tables


def _name(case: Case) -> str:
    """Group and factors of a case of the grid; what tells a random one."""
    if case.factors:
        return f"{case.group}: " + ", ".join(f"{name} {value:g}" for name, value in case.factors.items())
    kind = f"{case.design['n_pairs']} pairs, {case.design['elements_per_segment']} elements"
    return f"{case.group}: {kind}, {case.design['base']}, {case.design['muscle_model']}s"


def _figure(limits: list[Limit]) -> Figure:
    """Heat maps of ratio and limit for each pair of parameters, and predicted over measured for every case."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(max(18.0, 3.6 * len(GRID)), 11.5), layout="constrained")
    columns = max(len(GRID), 2)
    grid = figure.add_gridspec(3, columns, height_ratios=[1.0, 1.0, 1.35])
    for column, group in enumerate(GRID):
        members = [limit for limit in limits if limit.case.group == group]
        for row, kind in enumerate(("ratio", "limit")):
            _heat_map(figure, figure.add_subplot(grid[row, column]), members, kind)
    _scatter(figure.add_subplot(grid[2, : columns // 2]), limits)
    _histogram(figure.add_subplot(grid[2, columns // 2 :]), limits)
    return figure


def _heat_map(figure: Figure, axes: Axes, members: list[Limit], kind: str) -> None:
    from matplotlib import colormaps

    x, y = members[0].case.factors
    xs, ys = (sorted({limit.case.factors[name] for limit in members}) for name in (x, y))
    values = np.full((len(ys), len(xs)), np.nan)
    for limit in members:
        at = ys.index(limit.case.factors[y]), xs.index(limit.case.factors[x])
        value = limit.ratio if kind == "ratio" else (math.nan if limit.beyond else 1e6 * (limit.stable or math.nan))
        values[at] = value
        mark = {"collapse": "none\nholds", "no limit": "none\nfails"}.get(limit.beyond)
        text = mark or (f"{value:.2f}" if kind == "ratio" else f"{value:.0f}" if value >= 100.0 else f"{value:.3g}")
        axes.text(at[1], at[0], text, ha="center", va="center", fontsize=7.5, color="0.35" if mark else "black")
    shown = values if kind == "ratio" else np.log10(values)
    low, high = (0.4, 1.0) if kind == "ratio" else (0.0, 4.5)
    colours = colormaps["YlGn"].with_extremes(under="gold", over="tomato")
    image = axes.imshow(shown, origin="lower", aspect="auto", vmin=low, vmax=high, cmap=colours, alpha=0.85)
    axes.set_facecolor("0.9")
    axes.set_xticks(range(len(xs)), [f"{value:g}" for value in xs])
    axes.set_yticks(range(len(ys)), [f"{value:g}" for value in ys])
    axes.set_xlabel(LABELS[x])
    axes.set_ylabel(LABELS[y])
    axes.set_title("predicted / measured" if kind == "ratio" else "measured stable step [us]", fontsize=10)
    if kind == "ratio":
        figure.colorbar(image, ax=axes, pad=0.01, extend="both")


def _scatter(axes: Axes, limits: list[Limit]) -> None:
    counted = [limit for limit in limits if not math.isnan(limit.ratio)]
    for group, colour in (("random", "tab:blue"), ("grid", "tab:orange")):
        members = [limit for limit in counted if (limit.case.group == "random") == (group == "random")]
        axes.loglog(
            [1e6 * (limit.stable or math.nan) for limit in members],
            [1e6 * limit.usable for limit in members],
            "o",
            color=colour,
            markersize=4.5,
            alpha=0.7,
            label=f"{group}, {len(members)} cases",
        )
    span = np.array([0.7, 1.4]) * [f(1e6 * (limit.stable or math.nan) for limit in counted) for f in (min, max)]
    for share, style in ((1.0, "-"), (0.7, "--"), (0.4, ":")):
        axes.loglog(span, share * span, style, color="0.3", linewidth=1, label=f"predicted = {share:g} measured")
    axes.set_xlabel("measured largest stable step [us]")
    axes.set_ylabel("predicted [us]")
    axes.legend(fontsize=9)
    axes.set_title("Every counted case", fontsize=10)


def _histogram(axes: Axes, limits: list[Limit]) -> None:
    groups = [[limit.ratio for limit in limits if limit.case.group == name] for name in (*GRID, "random")]
    ratios = [[ratio for ratio in group if not math.isnan(ratio)] for group in groups]
    edges = np.arange(0.2, 1.525, 0.025)
    axes.hist([np.clip(group, 0.2, 1.499) for group in ratios], edges.tolist(), stacked=True, label=[*GRID, "random"])
    for share, style in ((1.0, "-"), (0.7, "--"), (0.4, ":")):
        axes.axvline(share, linestyle=style, color="0.3", linewidth=1)
    axes.set_xlabel("predicted / measured")
    axes.set_ylabel("cases")
    axes.legend(fontsize=9, loc="upper left")
    axes.set_title("Aims: none above 1, half above 0.7, all above 0.4 (limit of stability)", fontsize=10)
