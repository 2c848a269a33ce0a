"""The demo keeps its word, and the benchmark of training reports what it measured."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runs import TINY

from agents import demo as demo_module
from agents.benchmark import PARTS, BenchmarkConfig, Stopwatch, benchmark, format_runs
from agents.command_line import as_program
from agents.config import InputError
from agents.rollouts import Artefacts
from agents.run_folder import Run
from agents.training import TrainingLog
from lattice_gym.policies.evaluation import Score

pytestmark = pytest.mark.slow


def test_benchmark_report(tmp_path: Path) -> None:
    """Rates are positive, shares add up, every repeat and every number of worms is kept."""
    settings = replace(TINY, n_steps=40, fidelity="fast")
    config = BenchmarkConfig(train=settings, repeats=2, steps=5, updates=1, output=tmp_path / "b.json")
    report = benchmark(replace(config, throughput=True, worms=(1, 3)), "a command")
    assert json.loads(config.output.read_text()) == report
    assert report["made"]["command"] == "a command"
    assert report["one worm"]["median"] == pytest.approx(np.mean(report["one worm"]["measured"]))
    assert [run["n_envs"] for run in report["runs"]] == [1, 3]
    for run in report["runs"]:
        assert set(run["median"]) == {"worms together", "PPO", *PARTS, "rest"}
        assert all(value > 0.0 and len(run["measured"][name]) == 2 for name, value in run["median"].items())
        for repeat in range(2):
            assert sum(run["measured"][name][repeat] for name in (*PARTS, "rest")) == pytest.approx(1.0)
    title, *rows = format_runs(report).splitlines()
    assert len({len(line) for line in (title, *rows)}) == 1
    assert [row.split()[0] for row in rows] == ["1", "3"]
    assert [run["n_envs"] for run in benchmark(config)["runs"]] == [1]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"repeats": 0}, "repeats = 0: must be a whole number, at least 1"),
        ({"worms": ()}, "worms = .*: must name at least one"),
        ({"throughput": True, "worms": (1, 8)}, "batch_size = 256: must divide n_envs"),
    ],
)
def test_benchmark_refuses_bad_settings(settings: dict[str, Any], message: str) -> None:
    """Before anything is measured."""
    with pytest.raises(InputError, match=f"^{message}"):
        BenchmarkConfig(**settings)


def test_stopwatch_counts_what_is_inside_apart() -> None:
    """Parts add up to the whole, also where a call raises."""
    watch = Stopwatch()
    inner = watch.timed("inner", lambda: time.sleep(0.02))

    def fails() -> None:
        inner()
        time.sleep(0.01)
        inner()
        raise RuntimeError("late")

    began = time.perf_counter()
    with pytest.raises(RuntimeError, match="late"):
        watch.timed("outer", fails)()
    total = time.perf_counter() - began
    assert watch.seconds["inner"] >= 0.04
    assert watch.seconds["outer"] >= 0.01
    assert 0.05 <= sum(watch.seconds.values()) <= total


def test_demo_reuses_its_run(copy: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """A second demo does not train again unless asked to."""
    nothing = Artefacts(copy, copy, copy, copy)
    monkeypatch.setattr(demo_module, "export", lambda _path: nothing)
    model = (Run.open(copy).newest / "model.zip").read_bytes()
    learned = demo_module.demo(copy, TINY, episodes=1)
    means = {k: v["return_mean"] for k, v in json.loads((copy / "evaluation.json").read_text())["policies"].items()}
    assert learned == (means["policy"] > max(means["nothing"], means["random"]))
    told = capsys.readouterr().out
    assert ("DOES NOT beat" in told) == (not learned)
    assert told.startswith(f"{copy} is trained, 160 steps; make demo FRESH=1 starts over\n")
    assert f": {100.0 * means['policy'] / means['gait']:.0f} % of the hand-made gait after 160 steps (" in told
    assert (Run.open(copy).newest / "model.zip").read_bytes() == model
    with pytest.raises(InputError, match="other settings; discard it with"):
        demo_module.demo(copy, replace(TINY, seed=5))
    demo_module.demo(copy, replace(TINY, seed=5), fresh=True, episodes=1)
    assert Run.open(copy).config.seed == 5


def test_demo_says_that_it_continues(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The first line tells how to start over instead; without a video nothing is filmed. Threads are no setting."""
    config = replace(Run.open(copy).config, total_steps=240)
    (copy / "config.json").write_text(json.dumps(config.to_dict()))
    demo_module.demo(copy, replace(config, num_threads=1), episodes=1, video=False)
    assert capsys.readouterr().out.startswith(f"continuing {copy} at 160 steps; make demo FRESH=1 starts over\n")
    assert Run.open(copy).steps == 240
    assert not list(copy.glob("*.mp4"))


def test_demo_ends_with_the_training_on_a_signal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A checkpoint, no evaluation, and the command that continues."""
    step = TrainingLog._on_step

    def interrupted(log: TrainingLog) -> bool:
        if log.num_timesteps == 120:
            os.kill(os.getpid(), signal.SIGTERM)
        return step(log)

    monkeypatch.setattr(TrainingLog, "_on_step", interrupted)
    monkeypatch.setattr(demo_module, "demo", partial(demo_module.demo, tmp_path / "demo", TINY))
    with pytest.raises(SystemExit) as ended, as_program():
        demo_module.main(video=False)
    assert ended.value.code == 143
    told = capsys.readouterr()
    assert told.err == "stopped by SIGTERM; continue with: make demo\n"
    assert "evaluating" not in told.out
    assert 0 < Run.open(tmp_path / "demo").steps < 160


def test_demo_needs_what_films_before_it_trains(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not after minutes of training."""
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(InputError, match=r"need pyvista: pip install .*; or leave the video out with --no-video"):
        demo_module.demo(tmp_path / "demo", TINY)
    assert not (tmp_path / "demo").exists()


@pytest.mark.parametrize(("gait", "share"), [(162.6, ": 80 % of the hand-made gait after"), (-1.0, ": after")])
def test_verdict_gives_steps_and_share_of_the_gait(gait: float, share: str) -> None:
    """A share of a loss would mean nothing."""
    returns = {"policy": 130.1, "gait": gait, "nothing": 0.0, "random": -66.4}
    scores: Any = {name: Score((value,), {}, {}, 0) for name, value in returns.items()}
    beats = "the trained policy beats doing nothing and random actions"
    assert demo_module.verdict(scores, 43_016) == f"{beats}{share} 43,016 steps"
    scores["nothing"] = scores["policy"]
    assert "DOES NOT beat" in demo_module.verdict(scores, 43_016)


def test_demo_deletes_only_run_folders(tmp_path: Path) -> None:
    """Starting over never deletes something else."""
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(InputError, match="not a run folder, so not deleted"):
        demo_module.demo(tmp_path, TINY, fresh=True)
    assert (tmp_path / "thesis.txt").exists()


@pytest.mark.parametrize("better", [True, False])
def test_demo_exit_status_tells_whether_it_learned(monkeypatch: pytest.MonkeyPatch, better: bool) -> None:
    """A demo that learned nothing fails."""
    monkeypatch.setattr(demo_module, "demo", lambda fresh, video: better)
    if better:
        demo_module.main()
    else:
        with pytest.raises(SystemExit, match="1"):
            demo_module.main()
