"""The reports: the paper's motions are reached, figures say where they come from, bad options are refused."""

from __future__ import annotations

import json
from inspect import signature
from pathlib import Path
from pkgutil import resolve_name

import pytest

from lattice_gym.benchmarks import engine_comparison, paper
from lattice_gym.benchmarks.__main__ import MODULES, Options, main, parse
from lattice_gym.benchmarks.benchmark_scene import ENGINES
from lattice_gym.benchmarks.results_files import table
from lattice_gym.engines.fused.engine import FusedEngine

pytestmark = pytest.mark.slow


def test_the_papers_motions_at_one_newton(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Extension within 10 %, compression and bending within 5 % of Table 2, with every joint and rod whole."""
    assert main(["--out", str(tmp_path), "paper", "--tension", "1", "--no-pictures"]) == 0
    result = json.loads((tmp_path / "paper.json").read_text())
    allowed = {"extension": 0.10, "compression": 0.05, "bending": 0.05}
    assert {
        row["motion"]: abs(row["deviation"]) < allowed[row["motion"]] for row in result["outcomes"]
    } == dict.fromkeys(allowed, True)
    assert {row["verdict"] for row in result["outcomes"]} == {"held"}
    assert result["made"]["command"] == "python -m lattice_gym.benchmarks paper --tension 1.0 --no-pictures"
    printed = capsys.readouterr().out
    assert printed == (tmp_path / "paper.md").read_text()
    assert str(tmp_path) not in printed
    assert not (tmp_path / "paper.png").exists()


def test_both_engines_reach_the_same_bend() -> None:
    """The report's value does not depend on the engine."""
    bending = paper.TABLE_2[2]
    values = [paper.run_motion(bending, 1.0, name)[0].value for name in ENGINES]
    assert values[0] == pytest.approx(values[1], abs=1e-6)


def test_a_lattice_that_fails_is_reported(tmp_path: Path) -> None:
    """Far too much tension: the values are left out, the verdict says why, the exit status is 1, the JSON is JSON."""
    assert main(["--out", str(tmp_path), "paper", "--tension", "20", "--no-pictures"]) == 1
    row = json.loads((tmp_path / "paper.json").read_text(), parse_constant=pytest.fail)["outcomes"][0]
    assert row["value"] is None
    assert "rod" in row["verdict"]
    assert "nan" not in (tmp_path / "paper.md").read_text()


def test_a_strip_of_final_shapes(tmp_path: Path) -> None:
    """One PNG holds the pictures."""
    assert paper.report(tmp_path, command="test", engine="fused", tension=[0.5], pictures=True)
    assert (tmp_path / "paper.png").read_bytes()[1:4] == b"PNG"


def test_engines_report(tmp_path: Path) -> None:
    """It finds the engines in agreement and writes both medians."""
    engine_comparison.report(tmp_path, command="test", repeats=1, n_control=1)
    result = json.loads((tmp_path / "engines.json").read_text())
    assert result["agree"]
    assert min(result["median_seconds_per_step"].values()) > 0.0


def test_engines_report_finds_disagreement(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A fused engine that pulls too hard by a billionth is found out."""
    advance = FusedEngine._advance
    monkeypatch.setattr(FusedEngine, "_advance", lambda engine, a, b, n: advance(engine, a * (1.0 + 1e-9), b, n))
    assert not engine_comparison.report(tmp_path, command="test", repeats=1, n_control=1)
    assert "DO NOT AGREE" in (tmp_path / "engines.md").read_text()


@pytest.mark.parametrize(
    "words",
    [
        ["nothing"],
        ["paper", "--engine", "warp"],
        ["paper", "--tension", "-1"],
        ["paper", "--tension", "nan"],
        [],
        ["stability", "--jobs", "0"],
        ["stability", "--seed", "-1"],
        ["unchanged"],
    ],
)
def test_bad_options(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """It is said what is wrong; nothing runs."""
    with pytest.raises(SystemExit) as raised:
        main(words)
    assert raised.value.code == 2
    assert "--help" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "report", "named"),
    [
        (
            ["stability", "--seed", "7", "--quick", "--jobs", "2"],
            "stability.report.report",
            "stability --quick --seed 7",
        ),
        (["stability", "--jobs", "3"], "stability.report.report", "stability --jobs 3"),
        (["validation", "--no-pictures"], "validation.report.report", "validation --no-pictures"),
        (["paper"], "paper.report", "paper"),
        (["paper", "--tension", "0.1", "2"], "paper.report", "paper --tension 0.1 2.0"),
        (["paper", "--engine", "pyelastica"], "paper.report", "paper --engine pyelastica"),
        (["engines"], "engine_comparison.report", "engines"),
        (["work-precision", "--quick"], "work_precision.report.report", "work-precision --quick"),
        (["unchanged", "--old", "there"], "unchanged.report.report", "unchanged"),
        (["throughput", "--quick"], "throughput.report.report", "throughput --quick"),
    ],
)
def test_the_command_makes_the_result_again(
    words: list[str], report: str, named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The footer's command has every option that is not its default, and no folder."""
    commands: list[str] = []

    def listen(*_: object, command: str, **__: object) -> bool:
        commands.append(command)
        return True

    monkeypatch.setattr(f"lattice_gym.benchmarks.{report}", listen)
    assert main(["--out", "somewhere", *words]) == 0
    assert commands == [f"python -m lattice_gym.benchmarks {named}"]


@pytest.mark.parametrize("name", ["paper", "engines", "validation", "work-precision", "stability", "divergence",
                                  "throughput", "unchanged"])  # fmt: skip
def test_every_report_takes_its_options(name: str) -> None:
    """The function behind a name has a parameter for each option; the folder may stand before the name or after it."""
    old = ["--old", "there"] if name == "unchanged" else []
    before, after = parse(["--out", "somewhere", name, *old]), parse([name, "--out", "somewhere", *old])
    assert isinstance(before, Options)
    assert (before, before.out) == (after, Path("somewhere"))
    report = resolve_name(f"lattice_gym.benchmarks.{MODULES[type(before.report)]}:report")
    signature(report).bind(before.out, command="test", **vars(before.report))


def test_table_columns_line_up() -> None:
    """Every line has the same width."""
    lines = table(["a", "bcd"], [["12345", "6"], ["7", "8"]]).splitlines()
    assert len({len(line) for line in lines}) == 1
