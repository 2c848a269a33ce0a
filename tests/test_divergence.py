"""The divergence report: what it counts, and that it judges runs as it says."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from lattice_gym.benchmarks.__main__ import main
from lattice_gym.benchmarks.divergence import judge, report, runs
from lattice_gym.benchmarks.divergence.judge import WRONG, Run, Truth, compare
from lattice_gym.benchmarks.divergence.report import all_caught, count
from lattice_gym.benchmarks.divergence.runs import FIRST_SEED, N_CONTROL
from lattice_gym.engines.energy_audit import EnergyAudit
from lattice_gym.engines.health import Health, Status

pytestmark = pytest.mark.slow


def _run(verdict: str, status: str, delay: int | None) -> Run:
    return Run(
        seed=0,
        share=1.0,
        tension=0.5,
        splitting="symmetric",
        layout="all",
        n_substeps=1,
        verdict=verdict,
        forked=False,
        n_compared=N_CONTROL,
        status=status,
        delay=delay,
        deviation=0.0,
        residual=0.0,
        reference_status="ok",
        reference_residual=0.0,
        step_error=0.0,
    )


def test_counting() -> None:
    """A missed wrong run, a late flag and a false alarm each spoil the result; a flag before the harm does not."""
    good = [_run("right", "ok", None), _run("wrong", "energy", -1), _run("wrong", "torn", 1)]
    good += [_run("collapsed", "inverted", 0), _run("between", "inverted", None), _run("between", "ok", None)]
    rows = count(good)
    assert all_caught(rows)
    assert rows["wrong"] == {
        "runs": 2, "forked": 0, "flagged at once": 1, "one step later": 1, "later": 0, "not flagged": 0,
    }  # fmt: skip
    assert all_caught(count([*good, _run("undecided", "ok", None)]))
    assert count([_run("undecided", "ok", None)])["right"]["runs"] == 0
    for bad in (("right", "torn", None), ("wrong", "ok", None), ("wrong", "torn", 2), ("collapsed", "ok", None)):
        assert not all_caught(count([*good, _run(*bad)]))


@pytest.mark.parametrize(("share", "verdict"), [(0.4, "right"), (3.0, "wrong")])
def test_runs_are_judged_by_their_references(monkeypatch: pytest.MonkeyPatch, share: float, verdict: str) -> None:
    """One worm with a fine step and with one far too large."""
    design, layout, splitting, _ = runs.draw(FIRST_SEED)
    monkeypatch.setattr(runs, "draw", lambda seed: (replace(design, max_tension=0.2), layout, splitting, share))
    run = compare(FIRST_SEED)
    assert run.verdict == verdict
    assert (run.status == "ok") == (verdict == "right")
    assert run.delay == (None if verdict == "right" else 0)
    assert (run.deviation > WRONG) == (verdict == "wrong")


def test_a_run_with_nothing_to_compare_is_undecided(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the references fork at once, it is not taken for right."""
    monkeypatch.setattr(judge, "find_truth", lambda plan: Truth([], True, "ok", 0.0))
    run = compare(FIRST_SEED)
    assert (run.verdict, run.n_compared, run.status) == ("undecided", 0, "ok")
    rows = count([run])
    assert {verdict: row["runs"] for verdict, row in rows.items()} == dict.fromkeys(rows, 0) | {"undecided": 1}


def test_the_references_ignore_their_energy_check(monkeypatch: pytest.MonkeyPatch) -> None:
    """What it flags is no failure of theirs; its ledger is read."""
    monkeypatch.setattr(runs, "N_CONTROL", 2)
    monkeypatch.setattr(EnergyAudit, "close", flagged(EnergyAudit.close))
    truth = judge.find_truth(runs.plan(FIRST_SEED))
    assert (truth.status, len(truth.positions), truth.residual > 0.0) == ("ok", 3, True)


def flagged(audit: Callable[..., Health]) -> Callable[..., Health]:
    """Make an audit that always finds spurious energy."""

    def wrong(*arguments: Any) -> Health:
        audit(*arguments)
        return Health(Status.ENERGY, 0, 0)

    return wrong


def test_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """It writes table, numbers and figure, and its exit status says what they show."""
    monkeypatch.setattr(report, "QUICK", 2)
    status = main(["--out", str(tmp_path), "divergence", "--quick"])
    result = json.loads((tmp_path / "divergence.json").read_text())
    assert status == (0 if result["all_caught"] else 1)
    assert [run["seed"] for run in result["runs"]] == [FIRST_SEED + k for k in range(2)]
    assert sum(row["runs"] for row in result["counts"].values()) == 2
    assert result["seed_of_largest_residual_of_references"] in [run["seed"] for run in result["runs"]]
    complete = [run for run in result["runs"] if run["verdict"] == "right" and run["n_compared"] == N_CONTROL]
    assert result["right_runs_compared_to_the_end"] == len(complete)
    assert f"{len(complete)} were compared to the end" in (tmp_path / "divergence.md").read_text()
    assert capsys.readouterr().out == (tmp_path / "divergence.md").read_text()
    assert (tmp_path / "divergence.png").read_bytes()[1:4] == b"PNG"
