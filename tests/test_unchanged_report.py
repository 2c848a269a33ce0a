"""The report on what a change left as it was: it finds what differs, and speaks with a checkout."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from lattice_gym.benchmarks.unchanged import report as unchanged
from lattice_gym.benchmarks.unchanged.report import HERE, TIMED, compare, first_difference

pytestmark = pytest.mark.slow

REST, MOVED = {"reward": "a", "observation": "b"}, {"reward": "c", "observation": "d"}


def test_the_first_difference_is_named() -> None:
    """By its control step and what differs; what only one commit names is none, a shorter episode is one."""
    assert first_difference([REST, MOVED], [REST, MOVED]) == ""
    assert first_difference([REST, MOVED], [REST, MOVED | {"reward": "x"}]) == "control step 1: reward"
    assert first_difference([REST], [REST | {"state.new": "x"}]) == ""
    assert first_difference([REST, MOVED], [REST]) == "1 control steps became 0"


def test_an_environment_that_is_gone_differs() -> None:
    """One that is new does not."""

    def asked(*names: str) -> Any:
        return lambda what, *_: list(names) if what == "ids" else [REST]

    same = {"random": "", "zero": ""}
    assert compare(asked("A"), asked("A", "B"), 1) == {"A": same}
    assert compare(asked("A", "B"), asked("A"), 1) == {"A": same, "B": dict.fromkeys(same, "no longer registered")}


def test_a_checkout_answers() -> None:
    """With every registered id, the digests of an episode's start, and times."""
    with unchanged._checkout(HERE) as ask:
        assert "LatticeWorm-v0" in ask("ids")
        records = [ask("record", "LatticeWormExtension-v0", actions, 2) for actions in ("random", "random", "zero")]
        times = [ask("time", what) for what in ("one", "many", "env")]
    assert [len(record) for record in records] == [3, 3, 3]
    assert first_difference(records[0], records[1]) == ""
    assert first_difference(records[0], records[2]).startswith("control step 1: observation, reward, state.position")
    assert min(times) > 0.0


def test_a_failed_checkout_says_so(tmp_path: Path) -> None:
    """One with no package in it, or another one's."""
    with pytest.raises(RuntimeError, match="ended"), unchanged._checkout(tmp_path) as ask:
        ask("ids")


@pytest.mark.parametrize(("difference", "slower", "good"), [("", 1.0, True), ("reward", 1.0, False), ("", 1.5, False)])
def test_the_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, difference: str, slower: float, good: bool
) -> None:
    """A difference or a slowdown fails; both are in the table."""
    times = {what: {"old": [1.0, 2.0], "new": [slower, 2.0 * slower]} for what in TIMED}
    monkeypatch.setattr(unchanged, "compare", lambda *_: {"A": {"random": difference, "zero": ""}})
    monkeypatch.setattr(unchanged, "measure", lambda *_: times)
    assert unchanged.report(tmp_path, command="test", old=HERE, quick=True) == good
    result = json.loads((tmp_path / "unchanged.json").read_text())
    assert result["passed"] == good
    assert ("FAIL" in (tmp_path / "unchanged.md").read_text()) != good
