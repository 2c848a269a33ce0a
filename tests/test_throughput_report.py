"""Throughput: the quick form holds together, its parts measure what they say."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lattice_gym.benchmarks.__main__ import main
from lattice_gym.benchmarks.benchmark_scene import BENCHMARK_DT, benchmark_model
from lattice_gym.benchmarks.throughput import cold_start, report, study
from lattice_gym.benchmarks.throughput.features import FEATURES
from lattice_gym.benchmarks.throughput.growth import LEVELS_PER_PAIR, Growth, fit, record_bytes, second_level_cache
from lattice_gym.benchmarks.throughput.plain_pyelastica import PlainPyElastica
from lattice_gym.benchmarks.throughput.targets import Target, over_bare, variation
from lattice_gym.benchmarks.timing import allocated, digits, interleaved, seconds, spread
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.engines.fused.engine import FusedEngine
from lattice_gym.engines.simulation import simulate
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.worm import build_model

pytestmark = pytest.mark.slow

BRIEF = replace(
    study.QUICK,
    repeats=1,
    steps={"fused": 200, "pyelastica": 10, "plain": 10},
    meshes=(5, 10, 15),
    muscles=(0, 32),
    pairs=(4, 8),
    features=tuple(feature for feature in FEATURES if feature.name in ("bare", "ground", "adaptation", "step check")),
)
"""The quick form with less of each kind; these features need no more than a kernel or two to be compiled."""


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, dict[str, Any]]:
    """Text and figures of a brief report; speed is for the report to judge, the exit status is its verdict."""
    folder = tmp_path_factory.mktemp("reports")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "QUICK", BRIEF)
        patch.setattr(study, "EPISODE_STEPS", 4)
        starts = {"from nothing": [9.0], "cached": [1.0]}
        patch.setattr(report, "cold_starts", lambda repeats: starts)
        status = main(["--out", str(folder), "throughput", "--quick"])
    text = (folder / "throughput.md").read_text()
    result = json.loads((folder / "throughput.json").read_text(), parse_constant=pytest.fail)
    assert status == (0 if all(target["reached"] for target in result["targets"]) else 1)
    assert (folder / "throughput.png").read_bytes()[1:4] == b"PNG"
    assert str(folder) not in text
    return text, result


def middle(values: list[float]) -> float:
    """Median."""
    return float(np.median(values))


def test_the_verdicts_are_computed(quick: tuple[str, dict[str, Any]]) -> None:
    """Every target's number follows from the times in the file; the text has a line for each."""
    text, result = quick
    measured = {target["name"]: target["measured"] for target in result["targets"]}
    single, batches = result["single"]["times"], {(row["worms"], row["threads"]): row for row in result["batches"]}
    fast = measured["one worm on one core, times faster than PyElastica"]
    assert fast == pytest.approx(middle(single["plain"]) / middle(single["fused"]))
    if (16, 2) in batches:
        several = measured["16 worms on two threads, times faster than PyElastica"]
        own = middle(batches[16, 2]["seconds_per_worm_step"])
        assert several == pytest.approx(middle(result["pyelastica_beside_batches"]) / own)
    ratios = np.divide(result["features"]["ground"], result["features"]["bare"])
    assert measured["cost of a ground over the bare scene"] == pytest.approx(np.median(ratios) - 1.0)
    assert measured["first step from nothing"] == middle(result["cold_starts"]["from nothing"])
    for target in result["targets"]:
        line = next(line for line in text.splitlines() if line.startswith(f"| {target['name']} "))
        assert line.split("|")[4].strip() == ("reached" if target["reached"] else "NOT REACHED")


def test_physics_agrees(quick: tuple[str, dict[str, Any]]) -> None:
    """What is timed moves alike: the fused engine to its limit after a step, our reference engine to rounding."""
    single = quick[1]["single"]
    assert max(single["step_difference"].values()) < 1e-12
    assert single["course_difference"] < 1e-12


def test_everything_is_timed(quick: tuple[str, dict[str, Any]]) -> None:
    """All sizes on all threads, every feature, every count; times are positive and as many as rounds."""
    text, result = quick
    threads = study.thread_counts()
    assert [(row["worms"], row["threads"]) for row in result["batches"]] == [
        (n_worm, own) for n_worm in BRIEF.sizes for own in threads
    ]
    times = [row[key] for row in result["batches"] for key in ("seconds_per_worm_step", "seconds_per_control_step")]
    assert list(result["features"]) == [feature.name for feature in BRIEF.features]
    times += result["features"].values()
    times += [own for growth in result["growth"].values() for own in growth["times"]]
    assert {len(own) for own in times} == {BRIEF.repeats}
    assert min(min(own) for own in times) > 0.0
    assert result["growth"]["muscles"]["count"] == list(BRIEF.muscles)
    assert all(f"| {feature.name} " in text for feature in BRIEF.features)
    assert result["bytes_per_worm"] > record_bytes(benchmark_model()) / 2
    assert "`python -m lattice_gym.benchmarks throughput --quick`" in text


def parts(model: RodModel) -> str:
    """Write out all that a model was made of."""
    return repr(asdict(model))


def test_every_feature_changes_the_worm() -> None:
    """Its model differs from the bare one, or what goes along with it does; the names are its own."""
    bare = parts(FEATURES[0].build())
    assert len({feature.name for feature in FEATURES}) == len(FEATURES)
    for feature in FEATURES[1:]:
        changed = parts(feature.build()) != bare
        assert changed or feature.adaptation or feature.checks, feature.name


def test_a_missed_target_shows() -> None:
    """The limit itself is reached; what was not measured, or is no number, is not."""
    assert Target("a", 2.0, 2.0).reached
    assert not Target("a", 2.1, 2.0).reached
    assert Target("a", 2.0, 2.0, at_least=True).reached
    assert not Target("a", 1.9, 2.0, at_least=True).reached
    for measured in (None, float("nan")):
        assert not Target("a", measured, 2.0).reached
        assert not Target("a", measured, 2.0, at_least=True).reached
    assert Target("a", 0.2, 0.15, unit="%").row() == ["a", "at most 15 %", "20 %", "NOT REACHED"]
    assert Target("a", 1.5, 2.0, unit="s").row() == ["a", "at most 2 s", "1.5 s", "reached"]


def test_shares_over_what_they_are_of() -> None:
    """Greatest over least; every round over the bare scene of that round."""
    assert variation([2.0, 3.0, 2.5]) == pytest.approx(0.5)
    assert over_bare({"bare": [1.0, 2.0], "b": [2.0, 3.0]}, "b") == pytest.approx([1.0, 0.5])


# Growth


def test_a_line_is_found() -> None:
    """Exactly where there is one; else the largest relative distance from it shows."""
    count = [40, 80, 120, 200]
    line = fit(count, [3.0 + 0.5 * n for n in count])
    assert (line.start, line.slope) == pytest.approx((3.0, 0.5))
    assert line.departure < 1e-12
    bent = fit(count, [3.0 + 0.5 * n * (1.0 + (n > 160)) for n in count])
    weights = 1.0 / np.array([23.0, 43.0, 63.0, 203.0])
    slope, start = np.linalg.lstsq(
        np.stack([count * weights, weights], axis=1), np.ones(4), rcond=None
    )[0]  # fmt: skip
    assert (bent.start, bent.slope) == pytest.approx((start, slope))
    assert bent.departure == pytest.approx(np.abs((start + slope * np.array(count)) * weights - 1.0).max())


def test_growth_within_a_cache() -> None:
    """Points whose records fit with room to spare; too few of them make no line; slopes run from point to point."""
    growth = Growth([1, 2, 4, 8], [[1.0], [3.0, 2.0, 1.0], [4.0], [9.0]], [9, 18, 36, 72])
    assert growth.medians == [1.0, 2.0, 4.0, 9.0]
    assert growth.slopes == [1.0, 1.0, 1.25]
    assert growth.within(40) == Growth([1, 2, 4], [[1.0], [3.0, 2.0, 1.0], [4.0]], [9, 18, 36])
    assert growth.within(39) == growth.within(20) == Growth([1, 2], [[1.0], [3.0, 2.0, 1.0]], [9, 18])
    assert growth.within(None) == growth
    assert growth.within(20).line() is None
    line = growth.within(40).line()
    assert line is not None
    assert line.slope == pytest.approx(1.0)


@pytest.mark.parametrize("pairs", [4, 6, 10])
def test_record_bytes_are_those_of_the_engine(pairs: int) -> None:
    """With one block of rods and with two, and muscles beside them."""
    lattice = build_lattice(LatticeDesign(n_pairs=pairs, period_ratio=pairs / LEVELS_PER_PAIR))
    model = build_model(lattice, named_layout("all", lattice))
    engine = simulate("fused", model, 1e-5).engine
    assert isinstance(engine, FusedEngine)
    assert record_bytes(model) == engine.packs[0].blocks.cells.nbytes


# PyElastica


def test_plain_pyelastica_moves_as_the_reference_engine() -> None:
    """To rounding over 200 steps, in which the worm moves by a tenth of a millimetre and more."""
    model = benchmark_model()
    plain, engine = PlainPyElastica(model, 0.5, BENCHMARK_DT), simulate("pyelastica", model, BENCHMARK_DT)
    plain.advance(200)
    assert engine.advance(np.full(model.n_muscle, 0.5), 200).ok
    state = engine.state
    assert np.abs(plain.position - model.rest_state().position).max() > 1e-4
    assert np.abs(plain.position - state.position).max() < 1e-12 * np.abs(state.position).max()
    assert np.abs(plain.velocity - state.velocity).max() < 1e-11 * np.abs(state.velocity).max()


def test_plain_pyelastica_refuses_what_it_lacks() -> None:
    """One error, for weights, for drag and for lines."""
    heavy = replace(benchmark_model(), gravity=np.array([0.0, 0.0, -9.81]))
    dragged = replace(benchmark_model(), medium_drag=1.0)
    lattice = build_lattice(LatticeDesign(muscle_model="line"))
    lines = build_model(lattice, named_layout("extension", lattice))
    for model in (heavy, dragged, lines):
        with pytest.raises(ValueError, match="model"):
            PlainPyElastica(model, 0.5, BENCHMARK_DT)


def test_second_level_cache(tmp_path: Path) -> None:
    """Of what the machine says of its caches; None where it says nothing."""
    assert second_level_cache(tmp_path) is None
    for k, (level, size) in enumerate((("1", "48K"), ("1", "32K"), ("2", "1024K"), ("3", "32768K"))):
        (tmp_path / f"index{k}").mkdir()
        (tmp_path / f"index{k}" / "level").write_text(f"{level}\n")
        (tmp_path / f"index{k}" / "size").write_text(f"{size}\n")
    assert second_level_cache(tmp_path) == 2**20


# Timing


def test_rounds_are_interleaved() -> None:
    """Everything has its turn in every round; the first is not counted."""
    order: list[str] = []

    def task(name: str) -> float:
        order.append(name)
        return float(len(order))

    given = interleaved({"a": lambda: task("a"), "b": lambda: task("b")}, 2)
    assert order == ["a", "b"] * 3
    assert given == {"a": [3.0, 5.0], "b": [4.0, 6.0]}


def test_times_are_shown() -> None:
    """By the clock that is given; medians with both ends."""
    ticks = iter([1.0, 3.5])
    assert seconds(lambda: None, lambda: next(ticks)) == 2.5
    assert spread([1.0, 3.0, 2.0], 1e3) == "2000 (1000 to 3000)"
    assert [digits(value) for value in (0.12345, 12.345, 1234.5, 2e6)] == ["0.123", "12.3", "1234", "2e+06"]


def test_memory_is_measured() -> None:
    """That of an array, and not of what is gone again."""
    made, size = allocated(lambda: (np.ones(10**6), np.ones(10**6).sum())[0])
    assert made.nbytes <= size < 1.01 * made.nbytes


@pytest.mark.parametrize(("cores", "counts"), [(1, [1]), (2, [1, 2]), (6, [1, 2, 4, 6]), (8, [1, 2, 4, 8])])
def test_thread_counts(cores: int, counts: list[int]) -> None:
    """Powers of two, and all cores."""
    assert study.thread_counts(cores) == counts


def test_an_environment_that_hides_its_physics_is_refused() -> None:
    """Its share would come out as nothing."""
    silent: Any = SimpleNamespace(
        action_space=SimpleNamespace(sample=lambda: 0.0),
        reset=lambda seed: None,
        step=lambda action: None,
    )
    with pytest.raises(RuntimeError, match="advance"):
        study._time_overhead(silent)


def test_starts_are_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both in turn, from a folder that is empty at first."""
    monkeypatch.setattr(cold_start, "_FIRST_STEP", "print('stepped', flush=True)")
    times = cold_start.cold_starts(2)
    assert {kind: len(taken) for kind, taken in times.items()} == {"from nothing": 2, "cached": 2}
    assert min(map(min, times.values())) > 0.0


def test_the_first_step_is_one() -> None:
    """What is timed runs, here with what was compiled before."""
    assert cold_start.first_step(os.environ.get("NUMBA_CACHE_DIR", "")) > 0.0


def test_a_failed_start_says_why(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The reason is that of the process that was started."""
    monkeypatch.setattr(cold_start, "_FIRST_STEP", "raise SystemExit('no worm today')")
    with pytest.raises(RuntimeError, match="no worm today"):
        cold_start.first_step(str(tmp_path))
