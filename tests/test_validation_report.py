"""The validation report, in its quick form and on few cases."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from lattice_gym.benchmarks.__main__ import Validation, parse
from lattice_gym.benchmarks.benchmark_scene import ENGINES
from lattice_gym.benchmarks.validation import report as validation
from lattice_gym.verification.cases import CASES

pytestmark = pytest.mark.slow

FEW = tuple(
    case for case in CASES if case.name in ("timoshenko_cantilever", "uniform_twist", "energy", "helical_spring")
)


def test_the_quick_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It passes, shows each case on both engines, its source and the orders, and says how far it is."""
    assert validation.report(tmp_path, quick=True, pictures=True, command="test", cases=FEW)
    result = json.loads((tmp_path / "validation.json").read_text())
    assert [row["case"] for row in result["cases"]] == [case.name for case in FEW]
    assert all(row["engines"][name]["passed"] for row in result["cases"] for name in ENGINES)
    assert max(row["difference"] for row in result["cases"]) < 1e-9
    assert {row["case"] for row in result["meshes"]} == {"timoshenko_cantilever", "helical_spring"}
    for scene in ("ringing bar, damped", "spinning rod, positions", "spinning rod, directors"):
        rows = [row for row in result["steps"] if row["scene"] == scene and row["engine"] == "fused"]
        found = {row["splitting"]: row["order"] for row in rows}
        assert found == {"pyelastica": pytest.approx(1.0, abs=0.25), "symmetric": pytest.approx(2.0, abs=0.15)}
    shown = capsys.readouterr()
    assert all(case.title in shown.out and case.source in shown.out for case in FEW)
    assert "Everything passed" in shown.out
    assert "exact cases: 100%" in shown.err
    assert (tmp_path / "validation.png").read_bytes()[1:4] == b"PNG"


def test_a_failure_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A tolerance that is missed fails the report, in words."""
    strict = replace(FEW[0], tolerance=lambda n: 1e-6)
    assert not validation.report(tmp_path, quick=True, pictures=False, command="test", cases=(strict,))
    assert f"Failed: {strict.title}" in capsys.readouterr().out
    assert not (tmp_path / "validation.png").exists()


def test_options() -> None:
    """The subcommand takes --quick and --no-pictures."""
    assert parse(["validation", "--quick"]).report == Validation(quick=True, pictures=True)
    assert parse(["validation", "--no-pictures"]).report == Validation(quick=False, pictures=False)


def test_every_case_says_what_it_needs() -> None:
    """Names are unique; each case has a source, a reason and a positive tolerance on both its meshes."""
    assert len({case.name for case in CASES}) == len(CASES)
    for case in CASES:
        assert case.source
        assert case.reason
        assert 0.0 < case.tolerance(case.n_elem) <= case.tolerance(case.coarse) < 0.1
