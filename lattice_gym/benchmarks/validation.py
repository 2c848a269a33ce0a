"""Every exact case on both engines: error, tolerance, source, orders of convergence, and how far the engines differ."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lattice_gym.benchmarks.results_files import table, write
from lattice_gym.engines.registry import EngineName
from lattice_gym.recording.provenance import provenance
from lattice_gym.verification.cases import CASES
from lattice_gym.verification.case import Case, Outcome, difference, run
from lattice_gym.verification.orders import Orders, slope, step_orders, step_trials

ENGINES: tuple[EngineName, EngineName] = ("fused", "pyelastica")
MESH_ORDER, MESH_ORDER_BAND = 2.0, 0.35
"""Order expected in the element count, and by how much the fitted one may differ."""

NOTES = """\
Every error is the largest deviation from the exact result over the largest exact value (zero results: over what
"measured" names). "Engines differ" is the largest difference of their final states: node positions over the assembly's
extent, and directors.

- **Michell's ring** is an open rod of a full turn with both ends clamped at one place, in frames that differ by the
  twist. That is the closed ring: gluing the ends fixes the same relative position and frame, and holding one section of
  the glued ring costs no energy, because any shape of it can be moved rigidly so that the section is where it was.
  Element n lies on element 0 and is clamped like it. The rod is straight by nature (`Rod.natural_curvature`). The
  critical twist is where the seeded mode neither grows nor decays, found from its growth at 0.85, 0.95, 1.05 and 1.15
  times the exact value.
- **Localised buckling** prescribes slack and turn, as in the source, with other numbers: 6 % slack, 4.2 turns, length
  500 radii, C / B = 56 / 27. The source sets the stiffness of stretch apart from that of bending; here both follow from
  one section, so the rod stretches by T / (E A) = 8e-4, which the exact result takes into account to first order. The
  rod starts in a buckle 15 % narrower than the one it settles in.
- **The order in the element count** is fitted to the errors as they are; it falls short of 2 where what the tolerance's
  second term stands for begins to show (localised buckling).
- **The order in dt** is 2 where forces depend on positions alone, for either splitting of the step. Damping depends on
  velocities, and so do two terms of a spinning element: the gyroscopic one, J^-1 [(J w) x w], and the transport one (w
  grows as the element stretches). PyElastica takes all three once a step, damping after the kick and the terms of spin
  as they stand before it, and so do the engine of that name and the splitting "as PyElastica": order 1, as expected.
  The splitting "symmetric" of the fused engine centres them about the kick: order 2. The spinning rod is free; it
  tumbles at 2 rad/s, twists at 30 rad/s and rings from a stretch of 25 %, and is read in the midst of the first swing:
  over whole periods errors that go with the rate of stretch cancel. It is run undamped, and damped with a torque on
  every element. The dashpots of joints are of order 1 in both splittings; no scene here has any."""


@dataclass(frozen=True)
class MeshOrder:
    """Errors of one case on one engine over its meshes, and the order that fits them."""

    case: Case
    engine: EngineName
    n_elem: tuple[int, ...]
    error: tuple[float, ...]

    @property
    def fitted(self) -> float:
        """Slope of log(error) over log(element size)."""
        return -slope(self.n_elem, self.error)

    @property
    def passed(self) -> bool:
        """True if the fitted order is near enough to 2."""
        return abs(self.fitted - MESH_ORDER) <= MESH_ORDER_BAND


@dataclass(frozen=True)
class Validation:
    """All that the report shows."""

    outcomes: tuple[tuple[Outcome, Outcome], ...]
    """One pair, fused and pyelastica, a case."""
    meshes: tuple[MeshOrder, ...]
    steps: tuple[Orders, ...]

    @property
    def passed(self) -> bool:
        """True if every error and every order is within its tolerance."""
        errors = all(outcome.passed for pair in self.outcomes for outcome in pair)
        return errors and all(mesh.passed for mesh in self.meshes) and all(steps.passed for steps in self.steps)


class _Progress:
    """Lines on stderr: what is done, and when."""

    def __init__(self) -> None:
        self._began = time.perf_counter()

    def __call__(self, text: str) -> None:
        sys.stderr.write(f"{time.perf_counter() - self._began:6.1f} s  {text}\n")
        sys.stderr.flush()


def validate(cases: Sequence[Case] = CASES, *, quick: bool = False) -> Validation:
    """Run the cases; the quick form takes coarse meshes, and fits orders to two of them on the fused engine."""
    say, pairs, meshes = _Progress(), [], []
    for case in cases:
        n_elem = case.coarse if quick else case.n_elem
        known: dict[tuple[EngineName, int], Outcome] = {}
        for engine in ENGINES:
            known[engine, n_elem] = run(case, engine, n_elem)
            say(f"{case.name}, {engine}, {n_elem} elements: error {known[engine, n_elem].reading.error:.1e}")
        pairs.append((known["fused", n_elem], known["pyelastica", n_elem]))
        for engine in ENGINES[:1] if quick else ENGINES:
            if not case.meshes:
                continue
            counts = case.meshes[:2] if quick else case.meshes
            for mesh in counts:
                if (engine, mesh) not in known:
                    known[engine, mesh] = run(case, engine, mesh)
                    say(f"{case.name}, {engine}, {mesh} elements: error {known[engine, mesh].reading.error:.1e}")
            errors = tuple(known[engine, mesh].reading.error for mesh in counts)
            meshes.append(MeshOrder(case, engine, counts, errors))
    steps = []
    for trial in step_trials(quick=quick):
        orders = step_orders(*trial)
        steps.append(orders)
        say(f"{orders.scene}, {orders.engine}, splitting {orders.splitting}: order {orders.fitted:.2f} in dt")
    return Validation(tuple(pairs), tuple(meshes), tuple(steps))


def _verdict(passed: bool) -> str:
    return "pass" if passed else "**FAIL**"


def _case_rows(validation: Validation) -> list[list[str]]:
    rows = []
    for fused, reference in validation.outcomes:
        orders = [mesh for mesh in validation.meshes if mesh.case is fused.case]
        rows.append(
            [
                fused.case.title,
                str(fused.n_elem),
                f"{fused.reading.error:.1e}",
                f"{reference.reading.error:.1e}",
                f"{fused.tolerance:.1e}",
                f"{difference(fused, reference):.0e}",
                ", ".join(f"{mesh.fitted:.2f}" for mesh in orders) or "-",
                _verdict(fused.passed and reference.passed and all(mesh.passed for mesh in orders)),
            ]
        )
    return rows


def _tables(validation: Validation) -> list[str]:
    cases = [fused.case for fused, _ in validation.outcomes]
    engines = " and ".join(dict.fromkeys(mesh.engine for mesh in validation.meshes))
    header = ["case", "elements", "error, fused", "error, pyelastica", "tolerance", "engines differ"]
    return [
        "Exact cases: relative errors on both engines.",
        table([*header, f"order in elements ({engines})", "verdict"], _case_rows(validation)),
        "What is measured, against what, and why the tolerance is what it is:",
        table(
            ["case", "measured", "exact", "tolerance", "source"],
            [[case.title, case.quantity, f"`{case.exact}`", case.reason, case.source] for case in cases],
        ),
        "Order of convergence in dt, on an unchanging mesh:",
        table(
            ["scene", "engine", "splitting", "dt [ms]", "errors", "order", "expected", "verdict"],
            [
                [
                    steps.scene,
                    steps.engine,
                    ("symmetric" if steps.splitting == "symmetric" else "as PyElastica") if steps.split else "either",
                    ", ".join(f"{1e3 * dt:.3g}" for dt in steps.dt),
                    ", ".join(f"{error:.1e}" for error in steps.error),
                    f"{steps.fitted:.3f}",
                    f"{steps.expected:g} +- {steps.band:g}",
                    _verdict(steps.passed),
                ]
                for steps in validation.steps
            ],
        ),
        NOTES,
    ]


def _as_dict(validation: Validation) -> dict[str, Any]:
    return {
        "passed": validation.passed,
        "cases": [
            {
                "case": fused.case.name,
                "elements": fused.n_elem,
                "dt": fused.dt,
                "tolerance": fused.tolerance,
                "difference": difference(fused, reference),
                "engines": {
                    outcome.engine: {
                        "error": outcome.reading.error,
                        "passed": outcome.passed,
                        "seconds": outcome.seconds,
                    }
                    for outcome in (fused, reference)
                },
            }
            for fused, reference in validation.outcomes
        ],
        "meshes": [
            {
                "case": mesh.case.name,
                "engine": mesh.engine,
                "elements": mesh.n_elem,
                "error": mesh.error,
                "order": mesh.fitted,
                "passed": mesh.passed,
            }
            for mesh in validation.meshes
        ],
        "steps": [asdict(steps) | {"order": steps.fitted, "passed": steps.passed} for steps in validation.steps],
    }


def report(folder: Path, *, quick: bool, pictures: bool, command: str, cases: Sequence[Case] = CASES) -> bool:
    """Write validation.md and validation.json, and validation.png where pictures are wanted.

    Returns whether everything passed.
    """
    began = time.perf_counter()
    validation = validate(cases, quick=quick)
    seconds = time.perf_counter() - began
    result = _as_dict(validation) | {"seconds": seconds, "made": provenance(command)}
    failed = [row[0] for row in _case_rows(validation) if row[-1] != "pass"]
    failed += [f"{steps.scene} ({steps.engine}, {steps.splitting})" for steps in validation.steps if not steps.passed]
    summary = "Everything passed" if validation.passed else f"Failed: {', '.join(failed)}"
    write(folder, "validation", result, [*_tables(validation), f"{summary}; {seconds:.0f} s."])
    if pictures:
        from lattice_gym.benchmarks.validation_figure import draw

        draw(validation, folder / "validation.png")
    return validation.passed
