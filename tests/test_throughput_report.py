"""Throughput: the quick form holds together, its parts measure what they say."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lattice_gym.benchmarks import cold_start, machine, operations, scaling, throughput, throughput_study
from lattice_gym.benchmarks.__main__ import main
from lattice_gym.benchmarks.engines import BENCHMARK_DT, benchmark_model
from lattice_gym.benchmarks.operations import Counting
from lattice_gym.benchmarks.plain_pyelastica import PlainPyElastica
from lattice_gym.benchmarks.scaling import Growth, fit, record_bytes
from lattice_gym.benchmarks.scene_costs import SCENES
from lattice_gym.benchmarks.throughput import Target
from lattice_gym.benchmarks.timing import allocated, digits, interleaved, seconds, spread
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.engines.fused.engine import FusedEngine
from lattice_gym.engines.simulation import simulate
from lattice_gym.physics.worm import build_model


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, dict[str, Any]]:
    """Text and figures of the quick report; speed is for the report to judge, the exit status is its verdict."""
    folder = tmp_path_factory.mktemp("reports")
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
    ratios = np.divide(result["scenes"]["ground"], result["scenes"]["bare"])
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
    """All sizes on all threads, every scene, every count; times are positive and as many as rounds."""
    text, result = quick
    plan = throughput_study.QUICK
    threads = throughput_study.thread_counts()
    assert [(row["worms"], row["threads"]) for row in result["batches"]] == [
        (n_worm, own) for n_worm in plan.sizes for own in threads
    ]
    times = [row[key] for row in result["batches"] for key in ("seconds_per_worm_step", "seconds_per_control_step")]
    assert list(result["scenes"]) == [scene.name for scene in SCENES]
    times += result["scenes"].values()
    times += [own for growth in result["scaling"].values() for own in growth["times"]]
    assert {len(own) for own in times} == {plan.repeats}
    assert min(min(own) for own in times) > 0.0
    assert result["scaling"]["muscles"]["count"] == list(plan.muscles)
    assert all(f"| {scene.name} " in text for scene in SCENES)
    assert result["bytes_per_worm"] > record_bytes(benchmark_model()) / 2
    assert "`python -m lattice_gym.benchmarks throughput --quick`" in text


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
    assert throughput.variation([2.0, 3.0, 2.5]) == pytest.approx(0.5)
    assert throughput.over_bare({"bare": [1.0, 2.0], "b": [2.0, 3.0]}, "b") == pytest.approx([1.0, 0.5])


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
    lattice = build_lattice(LatticeDesign(n_pairs=pairs, period_ratio=pairs / scaling.LEVELS_PER_PAIR))
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


# Operations and the machine


def test_counting_numbers_count() -> None:
    """Signs and comparisons are free, division by a constant is a multiplication; values are right."""
    operations._done.clear()
    x: Any = Counting(4.0)
    y: Any = Counting(2.0)
    result = -(1.0 - x / 2.0) * y + 3.0 * np.sqrt(x) / y - 1.0 / x + (y - 1.0)
    assert result.value == pytest.approx(2.0 + 3.0 - 0.25 + 1.0)
    assert (x > y, x < y, x > 5.0) == (True, False, False)
    assert dict(operations._done) == {"add": 5, "multiply": 3, "divide": 2, "root": 1}


def test_operations_of_a_step() -> None:
    """One root an element, for its length; every element is found, and no lane is taken for one."""
    work, model = operations.count_operations(), benchmark_model()
    assert work.elements == work.operations["root"] == model.n_elem
    assert work.lane_elements * work.bytes_per_element < record_bytes(model)
    assert work.operations["multiply"] > work.operations["add"] > 9 * model.n_elem
    assert work.total == sum(work.operations.values())


def test_a_failed_count_says_why(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The reason is that of the process that counts, here a Python without its library."""
    monkeypatch.setenv("PYTHONHOME", str(tmp_path))
    with pytest.raises(RuntimeError, match=r"(?s)counting operations failed: .*encodings"):
        operations.count_operations()


def test_second_level_cache(tmp_path: Path) -> None:
    """Of what the machine says of its caches; None where it says nothing."""
    assert machine.second_level_cache(tmp_path) is None
    for k, (level, size) in enumerate((("1", "48K"), ("1", "32K"), ("2", "1024K"), ("3", "32768K"))):
        (tmp_path / f"index{k}").mkdir()
        (tmp_path / f"index{k}" / "level").write_text(f"{level}\n")
        (tmp_path / f"index{k}" / "size").write_text(f"{size}\n")
    assert machine.second_level_cache(tmp_path) == 2**20


def test_multiply_adds_are_done() -> None:
    """Every number goes through the whole chain in every round."""
    numbers = np.arange(4.0)
    machine._multiply_add(numbers, 2.0, 1.0, 1)
    np.testing.assert_array_equal(numbers, (np.arange(4.0) + 1.0) * 2.0**machine.CHAIN - 1.0)


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
    assert throughput_study.thread_counts(cores) == counts


def test_an_environment_that_hides_its_physics_is_refused() -> None:
    """Its share would come out as nothing."""
    silent: Any = SimpleNamespace(
        action_space=SimpleNamespace(sample=lambda: 0.0),
        reset=lambda seed: None,
        step=lambda action: None,
    )
    with pytest.raises(RuntimeError, match="advance"):
        throughput_study._time_overhead(silent)


def test_a_failed_start_says_why(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The reason is that of the process that was started."""
    monkeypatch.setattr(cold_start, "_FIRST_STEP", "raise SystemExit('no worm today')")
    with pytest.raises(RuntimeError, match="no worm today"):
        cold_start.first_step(str(tmp_path))
