"""The reports: the paper's motions are reached, figures say where they come from, bad options are refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lattice_gym.reports import engines, paper
from lattice_gym.reports.__main__ import main
from lattice_gym.reports.provenance import table


def test_the_papers_motions_at_one_newton(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Extension within 10 %, compression and bending within 5 % of Table 2, with every joint and rod whole."""
    assert main(["--out", str(tmp_path), "paper", "--tension", "1", "--no-pictures"]) == 0
    result = json.loads((tmp_path / "paper.json").read_text())
    allowed = {"extension": 0.10, "compression": 0.05, "bending": 0.05}
    assert {
        row["motion"]: abs(row["deviation"]) < allowed[row["motion"]] for row in result["outcomes"]
    } == dict.fromkeys(allowed, True)
    assert {row["verdict"] for row in result["outcomes"]} == {"held"}
    assert result["made"]["command"] == "python -m lattice_gym.reports paper --tension 1 --no-pictures"
    printed = capsys.readouterr().out
    assert printed == (tmp_path / "paper.md").read_text()
    assert str(tmp_path) not in printed
    assert not (tmp_path / "paper.png").exists()


def test_both_engines_reach_the_same_bend() -> None:
    """The report's value does not depend on the engine."""
    bending = paper.TABLE_2[2]
    values = [paper.run_motion(bending, 1.0, name)[0].value for name in engines.ENGINES]
    assert values[0] == pytest.approx(values[1], abs=1e-6)


def test_a_lattice_that_fails_is_reported() -> None:
    """Far too much tension: the value is left out, and the verdict says why; exit status 1."""
    outcome = paper.run_motion(paper.TABLE_2[0], 20.0, "fused")[0]
    assert outcome.value != outcome.value
    assert "rod" in outcome.verdict
    assert outcome.verdict != "held"


def test_a_strip_of_final_shapes(tmp_path: Path) -> None:
    """One PNG holds the pictures."""
    assert paper.report("fused", [0.5], tmp_path, pictures=True, command="test")
    assert (tmp_path / "paper.png").read_bytes()[1:4] == b"PNG"


def test_engines_report(tmp_path: Path) -> None:
    """It finds the engines in agreement and writes both medians."""
    engines.report(tmp_path, command="test", repeats=1, n_control=1)
    result = json.loads((tmp_path / "engines.json").read_text())
    assert all(row["position"] < 1e-9 for row in result["differences"])
    assert min(result["median_seconds_per_step"].values()) > 0.0


@pytest.mark.parametrize(
    "words",
    [["nothing"], ["paper", "--engine", "warp"], ["paper", "--tension", "-1"], ["paper", "--tension", "nan"], []],
)
def test_bad_options(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """One line says what is wrong; nothing runs."""
    with pytest.raises(SystemExit) as raised:
        main(words)
    assert raised.value.code == 2
    assert "error:" in capsys.readouterr().err


def test_table_columns_line_up() -> None:
    """Every line has the same width."""
    lines = table(["a", "bcd"], [["12345", "6"], ["7", "8"]]).splitlines()
    assert len({len(line) for line in lines}) == 1
