"""The validation report: tables of errors, tolerances, sources and orders."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lattice_gym.benchmarks.results_files import table, write
from lattice_gym.benchmarks.validation.figure import draw
from lattice_gym.benchmarks.validation.study import Validation, validate
from lattice_gym.verification.case import Case, difference
from lattice_gym.verification.cases import CASES

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
    result = _as_dict(validation) | {"seconds": seconds}
    failed = [row[0] for row in _case_rows(validation) if row[-1] != "pass"]
    failed += [f"{steps.scene} ({steps.engine}, {steps.splitting})" for steps in validation.steps if not steps.passed]
    summary = "Everything passed" if validation.passed else f"Failed: {', '.join(failed)}"
    write(folder, "validation", result, [*_tables(validation), f"{summary}; {seconds:.0f} s."], command)
    if pictures:
        draw(validation, folder / "validation.png")
    return validation.passed
