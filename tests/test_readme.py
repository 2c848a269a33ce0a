"""What README.md shows exists: files, names and figures."""

from __future__ import annotations

import re
from pathlib import Path

import gymnasium
import pytest

import lattice_gym

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def test_linked_files_exist() -> None:
    """Every picture and file that is linked is in the repository."""
    linked = [path for path in re.findall(r"\]\(([^)]+)\)", README) if "://" not in path]
    assert linked
    assert [path for path in linked if not (ROOT / path).is_file()] == []


def test_the_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    """The first Python block does what it says, from start to picture."""
    block = re.search(r"```python\n(.*?)```", README, re.DOTALL)
    assert block is not None
    names: dict[str, object] = {}
    exec(block.group(1), names)
    assert "wave_index" in capsys.readouterr().out
    assert getattr(names["picture"], "shape", None) == (480, 640, 3)


def test_the_gait_runs(capsys: pytest.CaptureFixture[str]) -> None:
    """The block with the hand-made gait, after the imports of the first one, comes to an outcome."""
    block = next(text for text in re.findall(r"```python\n(.*?)```", README, re.DOTALL) if "lattice_gym.gait(" in text)
    exec(block, {"gymnasium": gymnasium, "lattice_gym": lattice_gym})
    assert "'speed': " in capsys.readouterr().out


def test_named_ids_and_names_exist() -> None:
    """Every id is registered, every name of the text is exported."""
    for name in set(re.findall(r"LatticeWorm\w*-v\d", README)):
        gymnasium.spec(name)
    for name in ("LatticeDesign", "horizontal", "vertical", "tie", "LatticeWormEnv"):
        assert name in README
        assert hasattr(lattice_gym, name)


@pytest.mark.parametrize("report", ["paper", "engines"])
def test_results_are_those_of_the_reports(report: str) -> None:
    """The tables in the text are the ones the reports wrote."""
    assert (ROOT / f"lattice_gym/benchmarks/results/{report}.md").read_text().strip() in README


def test_targets_are_those_of_the_throughput_report() -> None:
    """The table of targets in the text is the one that the report wrote."""
    tables = (ROOT / "lattice_gym/benchmarks/results/throughput.md").read_text().split("\n\n")
    assert tables[1].startswith("| target")
    assert tables[1] in README
