"""Training, evaluation, rollouts, benchmark and demo, end to end with tiny runs."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from agents import demo as demo_module
from agents import run_folder
from agents.benchmark import PARTS, BenchmarkConfig, Stopwatch, benchmark, format_runs
from agents.command_line import as_program
from agents.config import InputError, TrainConfig
from agents.environments import make_env, make_vector_env
from agents.evaluation import (
    EVALUATION_SEED,
    POLICIES,
    Score,
    evaluate,
    format_scores,
    hand_made_gait,
    make_policy,
    play,
    random_actions,
    score,
)
from agents.evaluation import main as evaluation_main
from agents.rollouts import Artefacts, evaluated_returns, export, record
from agents.run_folder import Run
from agents.training import TrainingLog, new_model, resume_settings, step_size, train, worm_seeds
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.recording.files import replacing
from lattice_gym.recording.trajectory import Trajectory
from lattice_gym.rendering.extras import extra
from lattice_gym.tasks.registry import TASKS, design_for, gait

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent
TINY = TrainConfig(
    task="extension", total_steps=160, seed=3, n_envs=1, n_steps=80, batch_size=40, n_epochs=2, checkpoint_every=80
)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run folder of a tiny finished run; tests that change it copy it first."""
    return train(replace(TINY, run_dir=tmp_path_factory.mktemp("runs") / "tiny"))


@pytest.fixture
def copy(finished: Path, tmp_path: Path) -> Path:
    """Copy of the finished run that a test may damage."""
    return Path(shutil.copytree(finished, tmp_path / "copy"))


# Training


def test_run_folder_is_complete(finished: Path) -> None:
    """Everything needed to rebuild and judge the run is there, and no path of this machine."""
    assert {file.name for file in finished.iterdir()} >= {
        "config.json",
        "versions.json",
        "design.json",
        "muscles.json",
        "progress.csv",
        "checkpoints",
        "tensorboard",
    }
    run = Run.open(finished)
    assert run.config == replace(TINY, control="ring", gamma=0.8)
    assert json.loads((finished / "config.json").read_text())["control"] == "ring"
    assert run.steps == 160
    assert {file.name for file in run.newest.iterdir()} == {"model.zip", "vecnormalize.pkl"}
    assert [folder.name for folder in run.checkpoints()] == ["000000000160", "000000000080"]
    assert LatticeDesign.from_dict(json.loads((finished / "design.json").read_text())) == LatticeDesign()
    assert len(json.loads((finished / "muscles.json").read_text())["muscles"]) == 48
    (session,) = json.loads((finished / "versions.json").read_text())
    assert session["versions"]["torch"].startswith("2.")
    assert str(ROOT) not in json.dumps(session)
    assert list((finished / "tensorboard").glob("events*"))


def test_progress_is_logged(finished: Path) -> None:
    """One row an update, with what the worms achieved."""
    with (finished / "progress.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(float(row["time/total_timesteps"])) for row in rows] == [80, 160]
    assert float(rows[-1]["worm/diverged_episodes"]) == 0.0
    assert float(rows[-1]["worm/return_std"]) > 0.0
    assert float(rows[-1]["worm/outcome_strain"]) > 0.0


def test_every_update_learns(tmp_path: Path) -> None:
    """The step size falls from its first value, and even a run of one rollout moves the policy."""
    run = Run.open(train(replace(TINY, total_steps=240, run_dir=tmp_path / "three")))
    train(replace(resume_settings(run.path), total_steps=480))
    rates = [row.get("train/learning_rate") for row in run.rows()]  # a row has that of the update before
    assert rates == pytest.approx([None, 1e-3, 2e-3 / 3, None, 0.5e-3, 1e-3 / 3])
    run = Run.open(train(replace(TINY, total_steps=80, run_dir=tmp_path / "one")))
    before = new_model(run.config, make_vector_env(run.env_arguments, 1)).policy.state_dict()
    after = PPO.load(run.newest / "model.zip", device="cpu").policy.state_dict()
    assert max(float((after[name] - before[name]).abs().max()) for name in before) > 1e-3


def test_discount_goes_by_the_task() -> None:
    """The learner and its normalisation have it, unless another is given."""
    cases: list[tuple[str, float | None, float]] = [
        ("crawl", None, 0.95),
        ("extension", None, 0.8),
        ("crawl", 0.8, 0.8),
    ]
    for task, given, used in cases:
        config = replace(TINY, task=task, gamma=given)
        model = new_model(config, make_vector_env(run_folder.requested_arguments(config), 1))
        normaliser = model.get_env()
        assert isinstance(normaliser, VecNormalize)
        assert (model.gamma, normaliser.gamma, config.resolved().gamma) == (used, used, used)


@pytest.mark.parametrize(("total", "rates"), [(40, [1e-3]), (100, [1e-3, 2e-4]), (160, [1e-3, 5e-4])])
def test_step_size_of_runs_that_end_within_a_rollout(total: int, rates: list[float]) -> None:
    """It goes by the steps done before a rollout, whatever the total."""
    size: Any = step_size(replace(TINY, total_steps=total))
    assert [size(1.0 - done / total) for done in (80, 160)[: len(rates)]] == pytest.approx(rates)


def test_same_seed_gives_the_same_policy(finished: Path, tmp_path: Path) -> None:
    """Training repeats to the last bit with its seed, and only with it."""
    again = train(replace(TINY, run_dir=tmp_path / "again"))
    other = train(replace(TINY, run_dir=tmp_path / "other", seed=4))
    action = {path: _first_action(path) for path in (finished, again, other)}
    np.testing.assert_array_equal(action[finished], action[again])
    assert not np.array_equal(action[finished], action[other])


def _first_action(path: Path) -> Any:
    run = Run.open(path)
    env = make_env(run.env_arguments)
    observation, _ = env.reset(seed=0)
    return make_policy("policy", run, env)(env, 0)(observation)


def test_resume_continues_with_the_same_settings(copy: Path) -> None:
    """Steps, log and sessions go on where they stopped, be it on another number of threads."""
    before = (copy / "progress.csv").read_text().splitlines()
    train(replace(resume_settings(copy), total_steps=240, num_threads=1))
    run = Run.open(copy)
    assert run.steps == 240
    assert run.config == replace(TINY, total_steps=240, num_threads=1, control="ring", gamma=0.8)
    assert [row["time/total_timesteps"] for row in run.rows()] == [80, 160, 240]
    assert (copy / "progress.csv").read_text().splitlines()[1].split(",")[:5] == before[1].split(",")[:5]
    assert [session["from_step"] for session in json.loads((copy / "versions.json").read_text())] == [0, 160]


def test_resume_of_a_finished_run_changes_nothing(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """There is nothing left to do, and that is said."""
    before = {file: file.read_bytes() for file in sorted(copy.rglob("*")) if file.is_file()}
    train(resume_settings(copy))
    assert {file: file.read_bytes() for file in sorted(copy.rglob("*")) if file.is_file()} == before
    assert capsys.readouterr().out == f"{copy}: 160 of 160 steps done: nothing to do; raise --total-steps\n"


def test_a_checkpoint_cut_short_changes_nothing(copy: Path) -> None:
    """Whoever reads a run whose training was killed finds the last whole pair of model and normalisation."""

    def killed(_path: Path) -> None:
        raise KeyboardInterrupt

    model = (Run.open(copy).newest / "model.zip").read_bytes()
    files = {"model.zip": lambda path: path.write_bytes(b"new"), "vecnormalize.pkl": killed}
    with pytest.raises(KeyboardInterrupt):
        run_folder.save_checkpoint(copy, 240, files)
    assert Run.open(copy).steps == 160
    assert (Run.open(copy).newest / "model.zip").read_bytes() == model
    assert not (copy / "model.zip").exists()


@pytest.mark.parametrize("folder", [True, False])
def test_what_is_replaced_leaves_nothing_on_an_error(tmp_path: Path, folder: bool) -> None:
    """Neither a folder nor a file that was half written stays."""

    def write() -> None:
        with replacing(tmp_path / "target") as unfinished:
            if folder:
                unfinished.mkdir()
            (unfinished / "file" if folder else unfinished).write_text("half")
            raise RuntimeError("half way")

    with pytest.raises(RuntimeError, match="half way"):
        write()
    assert not list(tmp_path.iterdir())


def test_resume_falls_back_on_an_older_checkpoint(copy: Path) -> None:
    """A damaged checkpoint costs its own steps, and is kept for inspection."""
    model = copy / "checkpoints" / "000000000160" / "model.zip"
    model.write_bytes(model.read_bytes()[:1000])
    train(replace(resume_settings(copy), total_steps=240))
    assert [folder.name for folder in Run.open(copy).checkpoints()] == [f"{n:012d}" for n in (240, 160, 80)]
    assert (copy / "checkpoints" / "damaged-000000000160" / "model.zip").stat().st_size == 1000
    assert [row["time/total_timesteps"] for row in Run.open(copy).rows()] == [80, 160, 240]


def test_resume_without_a_sound_checkpoint_names_the_file(copy: Path) -> None:
    """With all damaged there is nothing to fall back on."""
    for model in (copy / "checkpoints").glob("*/model.zip"):
        model.write_bytes(b"no zip")
    settings = (copy / "config.json").read_bytes()
    with pytest.raises(InputError, match=rf"^{re.escape(str(copy))}/checkpoints/\d+/model.zip: damaged"):
        train(replace(resume_settings(copy), total_steps=240))
    assert (copy / "config.json").read_bytes() == settings


def test_run_killed_before_its_first_checkpoint_starts_over(copy: Path) -> None:
    """No checkpoint is no error."""
    shutil.rmtree(copy / "checkpoints")
    train(resume_settings(copy))
    assert [row["time/total_timesteps"] for row in Run.open(copy).rows()] == [80, 160]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seed": 9}, "seed = 9: must be 3"),
        ({"n_steps": 40}, "n_steps = 40: must be 80"),
        ({"design": Path("worm.json")}, "must not be given with --resume"),
        ({"environment": Path("environment.json")}, "must not be given with --resume"),
        ({"run_dir": Path("elsewhere")}, "must not be given with --resume"),
        ({"total_steps": 159}, "total_steps = 159: must be 160 or more"),
    ],
)
def test_resume_refuses_other_settings(copy: Path, changes: dict[str, Any], message: str) -> None:
    """A resumed run keeps its settings; nothing given is ignored, and nothing refused is written."""
    settings = (copy / "config.json").read_bytes()
    with pytest.raises(InputError, match=message):
        train(replace(resume_settings(copy), **changes))
    assert (copy / "config.json").read_bytes() == settings


def test_a_run_is_never_overwritten(finished: Path) -> None:
    """A new run needs a new folder."""
    with pytest.raises(InputError, match=r"run_dir = .*: must be a new or empty folder"):
        train(replace(TINY, run_dir=finished))


def test_a_worm_that_cannot_be_built_leaves_no_folder(tmp_path: Path) -> None:
    """Errors name what is wrong before anything is written."""
    (tmp_path / "design.json").write_text(json.dumps({"height": -1.0}))
    with pytest.raises(InputError, match=r"design\.json: .*height"):
        train(replace(TINY, design=tmp_path / "design.json", run_dir=tmp_path / "run"))
    with pytest.raises(InputError, match=r"absent\.json: no such file"):
        train(replace(TINY, muscles=str(tmp_path / "absent.json"), run_dir=tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def test_design_and_muscles_from_files(finished: Path, tmp_path: Path) -> None:
    """The run keeps the worm it was given."""
    (tmp_path / "design.json").write_text(LatticeDesign(max_tension=0.25).to_json())
    muscles = json.loads((finished / "muscles.json").read_text())
    (tmp_path / "muscles.json").write_text(json.dumps({"muscles": muscles["muscles"][:6]}))
    settings = replace(TINY, design=tmp_path / "design.json", muscles=str(tmp_path / "muscles.json"), total_steps=80)
    path = train(replace(settings, run_dir=tmp_path / "run"))
    worm: Any = make_env(Run.open(path).env_arguments).unwrapped
    assert worm.design.max_tension == 0.25
    assert len(worm.layout) == 6


FURTHER = {
    "world": {"medium": {"density": 900.0, "drag": 0.2}},
    "randomise": {"max_tension": [0.9, 1.1]},
    "command": {"azimuth": [0.0, 1.5]},
    "adaptation": {"carry": True, "strain_gain": 0.1},
}


def test_environment_from_a_file(tmp_path: Path) -> None:
    """Training, resuming, evaluation and rollouts have what it says, also once the file is gone."""
    file = tmp_path / "environment.json"
    file.write_text(json.dumps(FURTHER))
    path = train(replace(TINY, task="bending", environment=file, total_steps=80, run_dir=tmp_path / "run"))
    file.unlink()
    run = Run.open(path)
    assert run.config.environment is None
    assert {name: run.env_arguments[name] for name in FURTHER} == FURTHER
    train(replace(resume_settings(path), total_steps=160))
    scores = evaluate(path, episodes=1)
    evaluate(path, episodes=1)
    assert evaluate(path, episodes=1) == scores
    medium = record(run, "gait").world.medium
    assert medium is not None
    assert medium.density == 900.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1]", r"must hold a JSON object"),
        ('{"wrold": {}}', r"wrold: unknown argument; known are activation, .*, world$"),
        ('{"control_dt": 0.1}', r"control_dt: must be given by its own option, --control-dt$"),
        ("{", r"damaged"),
    ],
)
def test_environment_file_that_cannot_be_is_refused(tmp_path: Path, text: str, message: str) -> None:
    """Before anything is written, and in one line that names the file."""
    file = tmp_path / "environment.json"
    file.write_text(text)
    with pytest.raises(InputError, match=rf"^{re.escape(str(file))}: {message}"):
        train(replace(TINY, environment=file, run_dir=tmp_path / "run"))
    file.write_text('{"world": {"ground": {"static_friction": -1.0}}}')
    with pytest.raises(InputError, match="static_friction"):
        train(replace(TINY, environment=file, run_dir=tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def test_divergence_is_counted_and_learning_goes_on(tmp_path: Path) -> None:
    """Muscles far too strong blow the worm up, not the learner."""
    (tmp_path / "design.json").write_text(LatticeDesign(max_tension=50.0).to_json())
    path = train(replace(TINY, design=tmp_path / "design.json", run_dir=tmp_path / "run"))
    rows = Run.open(path).rows()
    assert rows[-1]["worm/diverged_episodes"] > rows[0]["worm/diverged_episodes"] > 0
    assert rows[-1]["worm/return_mean"] < 0
    assert np.isfinite(_first_action(path)).all()


def test_nan_never_reaches_the_learner(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """NaN stops the run on both ways between worm and learner."""
    venv = make_vector_env(Run.open(finished).env_arguments, 1)
    venv.reset()
    with pytest.raises(ValueError, match="nan"):
        venv.step(np.full((1, 8), np.nan, dtype=np.float32))
    inner: Any = venv.unwrapped
    step = inner.step_wait
    monkeypatch.setattr(inner, "step_wait", lambda: (step()[0] * np.nan, np.zeros(1), np.zeros(1, bool), [{}]))
    with pytest.raises(ValueError, match="nan"):
        venv.step(np.zeros((1, 8), dtype=np.float32))
    venv.close()


def test_time_limit_stops_with_a_checkpoint(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Running out of time loses nothing."""
    path = train(
        replace(TINY, total_steps=100_000, checkpoint_every=100_000, time_limit=1e-3, run_dir=tmp_path / "run")
    )
    assert 0 < Run.open(path).steps < 160
    assert "stopped by time limit" in capsys.readouterr().out


# Fidelity


@pytest.fixture(scope="module")
def fast(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run folder of a tiny run on the coarse worm."""
    return train(replace(TINY, fidelity="fast", total_steps=80, run_dir=tmp_path_factory.mktemp("runs") / "fast"))


def _mesh(run: Run) -> int:
    worm: Any = make_env(run.env_arguments).unwrapped
    mesh: int = worm.design.elements_per_segment
    return mesh


def test_fidelity_is_the_runs_until_another_is_asked_for(fast: Path) -> None:
    """The design stays as it was given, so that every fidelity can be had of it."""
    run = Run.open(fast)
    assert (run.config.fidelity, run.fidelity) == ("fast", "fast")
    assert LatticeDesign.from_dict(json.loads((fast / "design.json").read_text())) == LatticeDesign()
    assert [_mesh(run.at(name)) for name in (None, "fast", "default", "fine")] == [2, 2, 5, 16]


def test_policy_of_a_coarse_worm_is_scored_on_a_finer_one(fast: Path, tmp_path: Path) -> None:
    """Return and file names tell which worm it was."""
    path = Path(shutil.copytree(fast, tmp_path / "fast"))
    coarse = evaluate(path, episodes=1)
    assert set(evaluated_returns(Run.open(path))) == set(POLICIES.values())
    finer = evaluate(path, episodes=1, fidelity="default")
    files = {name: json.loads((path / name).read_text()) for name in ("evaluation.json", "evaluation-default.json")}
    assert [report["fidelity"] for report in files.values()] == ["fast", "default"]
    assert set(evaluated_returns(Run.open(path), "default")) == {f"{title} (default)" for title in POLICIES.values()}
    assert set(evaluated_returns(Run.open(path))) == set(POLICIES.values())
    assert finer["gait"].return_mean == pytest.approx(coarse["gait"].return_mean, rel=0.1)
    assert finer["gait"].return_mean != coarse["gait"].return_mean
    artefacts = export(path, "gait", fidelity="default")
    assert artefacts.video.name == f"gait-{EVALUATION_SEED}-default.mp4"
    assert artefacts.learning_curve.name == "learning_curve-default.png"
    assert Trajectory.load(artefacts.trajectory).design == LatticeDesign()


def test_table_tells_the_fidelity(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And the file, whose name has it where it was asked for."""
    evaluation_main(copy, episodes=1)
    assert f"over 1 episodes at fidelity default; written to {copy}/evaluation.json\n" in capsys.readouterr().out
    evaluation_main(copy, episodes=1, fidelity="fast")
    assert f"over 1 episodes at fidelity fast; written to {copy}/evaluation-fast.json\n" in capsys.readouterr().out


def test_folder_from_before_fidelity_loads(copy: Path) -> None:
    """It is a run at the default one."""
    settings = json.loads((copy / "config.json").read_text())
    assert settings.pop("fidelity") == "default"
    (copy / "config.json").write_text(json.dumps(settings))
    assert Run.open(copy).fidelity == "default"
    train(replace(resume_settings(copy), total_steps=240))
    assert json.loads((copy / "config.json").read_text())["fidelity"] == "default"


def test_fidelity_that_cannot_be_is_refused(copy: Path) -> None:
    """An unknown one, one under which the policy would see other numbers, and another one in the middle of a run."""
    run = Run.open(copy)
    unknown: Any = "coarse"
    with pytest.raises(InputError, match=r"^fidelity = 'coarse': must be one of fast, default, fine"):
        run.at(unknown)
    with pytest.raises(InputError, match=r"^fidelity = 'fast': must be 'default', as .* observes all nodes"):
        replace(run, config=replace(run.config, observation=("nodes", "command"))).at("fast")
    with pytest.raises(InputError, match=r"^fidelity = 'fast': must be 'default'"):
        train(replace(resume_settings(copy), total_steps=240, fidelity="fast"))


# Evaluation


@pytest.mark.parametrize(
    ("task", "command", "outcome", "expected"),
    [
        ("extension", {}, {"strain": 0.3}, {"strain": 0.3}),
        (
            "reach",
            {"azimuth": 0.0},
            {"distance": 1e-3, "reached": 1.0, "reach_time": 0.5},
            {"distance": 1e-3, "reached": 1.0, "reach_time": 0.5},
        ),
        (
            "crawl",
            {"direction": 1.0},
            {"speed": 5.0, "drift": np.radians(3.0), "cost_of_transport": 4.0},
            {"speed": 5.0, "drift_deg": 3.0, "cost_of_transport": 4.0},
        ),
        (
            "crawl",
            {"direction": 1.0},
            {"speed": 0.0, "drift": 0.0, "cost_of_transport": 0.0},
            {"speed": 0.0, "drift_deg": 0.0},
        ),
        ("reach", {}, {"distance": 0.01, "reached": 0.0, "reach_time": 0.0}, {"distance": 0.01, "reached": 0.0}),
        (
            "bending",
            {"azimuth": np.radians(350.0)},
            {"bend_angle": np.radians(20.0), "bend_direction": np.radians(15.0)},
            {"bend_deg": 20.0, "off_azimuth_deg": 25.0},
        ),
        (
            "bending",
            {"azimuth": np.radians(-10.0)},
            {"bend_angle": np.radians(20.0), "bend_direction": np.radians(170.0)},
            {"bend_deg": 20.0, "off_azimuth_deg": 180.0},
        ),
        ("bending", {"azimuth": 1.0}, {"bend_angle": 1e-4, "bend_direction": 0.0}, {"bend_deg": np.degrees(1e-4)}),
        (
            "peristalsis",
            {"speed": -0.1, "amplitude": 0.05},
            {"wave_index": 0.9, "wave_direction": -1.0, "wave_speed": 0.08, "wave_amplitude": 0.04},
            {"wave_index": 0.9, "speed_over_asked": 0.8, "amplitude_over_asked": 0.8},
        ),
        (
            "peristalsis",
            {"speed": 0.1, "amplitude": 0.05},
            {"wave_index": 0.9, "wave_direction": -1.0, "wave_speed": 0.1, "wave_amplitude": 0.05},
            {"wave_index": 0.9, "speed_over_asked": -1.0, "amplitude_over_asked": 1.0},
        ),
    ],
)
def test_outcomes_are_judged_by_what_was_asked(
    task: str, command: dict[str, float], outcome: dict[str, float], expected: dict[str, float]
) -> None:
    """Numbers that mean the same under every command, with nothing said of the azimuth of an upright worm."""
    assert TASKS[task].errors(outcome, command) == pytest.approx(expected)


def test_a_design_file_changes_the_tasks_own(tmp_path: Path) -> None:
    """Field by field; a file that holds them all replaces it, and what does not fit the task is refused."""
    file = tmp_path / "design.json"
    file.write_text(json.dumps({"diameter": 0.07}))
    arguments = run_folder.requested_arguments(replace(TINY, task="crawl", design=file))
    assert LatticeDesign(**arguments["design"]) == design_for("crawl", diameter=0.07)
    file.write_text(LatticeDesign().to_json())
    arguments = run_folder.requested_arguments(replace(TINY, task="crawl", design=file))
    assert LatticeDesign(**arguments["design"]) == LatticeDesign()
    with pytest.raises(InputError, match="needs a free base"):
        make_env(arguments)


@pytest.mark.parametrize("task", ["reach", "crawl", "transport"])
def test_new_worlds_are_learned_in(task: str, tmp_path: Path) -> None:
    """A short run learns, is evaluated beside the gait, and is filmed with what surrounds the worm."""
    config = replace(TINY, task=task, fidelity="fast", run_dir=tmp_path / task)
    run = Run.open(train(config))
    scores = evaluate(run.path, episodes=1)
    assert (
        scores["gait"].outcome_mean.keys()
        == {
            "reach": {"distance", "reached", "reach_time"},
            "crawl": {"speed", "drift_deg", "cost_of_transport"},
            "transport": {"distance", "speed", "held", "delivered"},
        }[task]
    )
    assert scores["gait"].return_mean > max(scores["nothing"].return_mean, 0.0)
    design = json.loads((run.path / "design.json").read_text())
    assert LatticeDesign.from_dict(design) == design_for(task)
    trajectory = record(run, "gait")
    assert trajectory.world == TASKS[task].world(build_lattice(trajectory.design))
    assert trajectory.ball is not None
    assert trajectory.ball.shape == (trajectory.n_frame, 1 if task == "transport" else 0, 3)
    assert trajectory.markers is not None
    assert trajectory.markers.shape == (1 if task == "reach" else 0, 3)


def test_judged_outcomes_reach_evaluation_and_log(tmp_path: Path) -> None:
    """Both average them, each over the episodes that have them."""
    config = replace(TINY, task="bending", total_steps=80, run_dir=tmp_path / "bend")
    run = Run.open(train(config))
    assert 0.0 <= run.rows()[-1]["worm/outcome_off_azimuth_deg"] <= 180.0
    scores = evaluate(run.path, episodes=2)
    assert scores["gait"].outcome_mean["off_azimuth_deg"] < 20.0
    assert set(scores["nothing"].outcome_mean) == {"bend_deg"}
    assert re.search(r"do nothing .* - +0 of 2", format_scores(scores))


def test_evaluation_never_uses_the_seeds_of_training(copy: Path) -> None:
    """Neither those of the first session nor those of a later one."""
    with pytest.raises(InputError, match=r"^seed = 2: .*training.* 3"):
        evaluate(copy, episodes=2, seed=2)
    train(replace(resume_settings(copy), total_steps=240))
    later = worm_seeds(TINY, 160)
    with pytest.raises(InputError, match=rf"^seed = {later[0]}: "):
        evaluate(copy, episodes=1, seed=later[0])
    assert EVALUATION_SEED >= 10**6


def test_random_actions_do_not_repeat_the_draws_of_the_command() -> None:
    """The baseline has a stream of its own."""
    env = make_env(run_folder.requested_arguments(TrainConfig(task="bending")))
    _, info = env.reset(seed=5)
    first = random_actions(env, 5)(None)[0]
    assert 0.5 * (first + 1.0) != pytest.approx(info["command"]["azimuth"] / (2.0 * np.pi), abs=1e-6)


def test_evaluation_report(copy: Path) -> None:
    """Scores are means over the seeds named, repeat, and order as they should."""
    normaliser = (Run.open(copy).newest / "vecnormalize.pkl").read_bytes()
    scores = evaluate(copy, episodes=2, seed=50, command="a command")
    report = json.loads((copy / "evaluation.json").read_text())
    assert report["made"]["command"] == "a command"
    assert report["seeds"] == [50, 51]
    assert report["steps"] == 160
    assert report["made"]["versions"]["numpy"] == np.__version__
    assert set(report["policies"]) == set(POLICIES)
    for name, result in scores.items():
        assert report["policies"][name]["return_mean"] == pytest.approx(np.mean(result.returns), rel=1e-12)
        assert set(report["policies"][name]["outcome_mean"]) == {"strain"}
    assert abs(scores["nothing"].return_mean) < 1e-6
    assert scores["gait"].return_mean > scores["random"].return_mean > 1.0
    assert scores["gait"].outcome_mean["strain"] == pytest.approx(0.31, abs=0.02)
    assert not any(result.by_command for result in scores.values())
    assert evaluate(copy, episodes=2, seed=50) == scores
    assert (Run.open(copy).newest / "vecnormalize.pkl").read_bytes() == normaliser
    text = format_scores(scores)
    assert len({len(line) for line in text.splitlines()}) == 1
    assert f"{scores['policy'].return_mean:.3f} +- {scores['policy'].return_std:.3f}" in text


def test_commands_drawn_from_a_few_are_scored_apart(tmp_path: Path) -> None:
    """A mean over both directions would hide that one fails."""
    path = train(replace(TINY, task="crawl", fidelity="fast", total_steps=80, run_dir=tmp_path / "run"))
    scores = evaluate(path, episodes=4)
    env = make_env(Run.open(path).env_arguments)
    drawn = [env.reset(seed=EVALUATION_SEED + episode)[1]["command"]["direction"] for episode in range(4)]
    assert set(drawn) == {-1.0, 1.0}
    told = iter(format_scores(scores).splitlines()[1:])
    report = json.loads((path / "evaluation.json").read_text())["policies"]
    for name, result in scores.items():
        assert POLICIES[name] in next(told)
        assert list(result.by_command) == ["direction -1", "direction 1"]
        for direction, part in zip((-1.0, 1.0), result.by_command.values(), strict=True):
            own = [gain for gain, way in zip(result.returns, drawn, strict=True) if way == direction]
            assert list(part.returns) == own
            row = next(told)
            assert f"direction {direction:g}  " in row
            assert row.endswith(f"{part.diverged_episodes} of {len(own)}")
            stored = report[name]["by_command"][f"direction {direction:g}"]
            assert (stored["returns"], stored["return_mean"]) == (own, part.return_mean)
            assert stored["outcome_mean"] == part.outcome_mean


def test_normalisation_matters_and_is_the_runs_own(finished: Path) -> None:
    """The policy sees observations as in training."""
    run = Run.open(finished)
    env = make_env(run.env_arguments)
    start = make_policy("policy", run, env)
    by_hand = []
    normaliser = VecNormalize.load(str(run.newest / "vecnormalize.pkl"), DummyVecEnv([lambda: env]))
    moments: Any = normaliser.obs_rms
    model = PPO.load(run.newest / "model.zip", device="cpu")
    observation, _ = env.reset(seed=7)
    act = start(env, 7)
    for _ in range(10):
        scaled = (observation - moments.mean) / np.sqrt(moments.var + normaliser.epsilon)
        by_hand.append(model.predict(np.clip(scaled, -10.0, 10.0).astype(np.float32), deterministic=True)[0])
        np.testing.assert_allclose(act(observation), by_hand[-1], atol=1e-5)
        observation, *_ = env.step(act(observation))
    assert not np.allclose(by_hand[-1], model.predict(observation, deterministic=True)[0], atol=1e-3)


def test_gait_drives_groups_with_their_mean() -> None:
    """What the gait asks of rings arrives in the rings."""
    env = make_env(run_folder.requested_arguments(TrainConfig(task="peristalsis", control="ring")))
    env.reset(seed=1)
    worm: Any = env.unwrapped
    expected = gait("peristalsis", worm.lattice, worm.layout, worm.task.command)(0.0)
    action = hand_made_gait(env, 1)(None)
    np.testing.assert_allclose(0.5 * (action[worm.groups] + 1.0), expected, atol=1e-6)


def test_episodes_repeat_with_their_seed(finished: Path) -> None:
    """A seed fixes the episode, random actions included."""
    run = Run.open(finished)
    env = make_env(run.env_arguments)
    start = make_policy("random", run, env)
    first = [step.reward for step in play(env, start, 5)]
    assert [step.reward for step in play(env, start, 5)] == first
    assert [step.reward for step in play(env, start, 6)] != first
    assert score(env, start, range(5, 6)).returns == (sum(first),)


@pytest.mark.parametrize(("argument", "value"), [("episodes", 0), ("seed", -1)])
def test_evaluation_refuses_bad_numbers(finished: Path, argument: str, value: Any) -> None:
    """No episode, no score."""
    with pytest.raises(InputError, match=f"^{argument} = {value}: must be"):
        evaluate(finished, **{argument: value})


DAMAGE: dict[str, Callable[[Path], object]] = {
    "missing": Path.unlink,
    "empty": lambda file: file.write_bytes(b""),
    "truncated": lambda file: file.write_bytes(file.read_bytes()[: file.stat().st_size // 2]),
    "foreign": lambda file: file.write_bytes(bytes(range(256)) * 8),
    "list": lambda file: file.write_text("[1, 2]"),
}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize(
    "name",
    [
        "config.json",
        "design.json",
        "muscles.json",
        "versions.json",
        "checkpoints/000000000160/model.zip",
        "checkpoints/000000000160/vecnormalize.pkl",
    ],
)
def test_evaluation_names_a_damaged_file(copy: Path, name: str, damage: str) -> None:
    """Whatever happened to a file, the error names it."""
    DAMAGE[damage](copy / name)
    with pytest.raises(InputError, match=rf"^{re.escape(str(copy / name))}: (no such file|damaged)"):
        evaluate(copy, episodes=1)


@pytest.mark.parametrize("damage", DAMAGE)
def test_rollout_names_a_damaged_progress_table(copy: Path, damage: str) -> None:
    """The learning curve needs a sound table."""
    DAMAGE[damage](copy / "progress.csv")
    with pytest.raises(InputError, match=rf"^{re.escape(str(copy / 'progress.csv'))}: (no such file|damaged)"):
        export(copy)


def test_rollout_names_a_damaged_evaluation(copy: Path) -> None:
    """Lines of baselines need a sound report."""
    (copy / "evaluation.json").write_text('{"policies": {}}')
    with pytest.raises(InputError, match=r"evaluation\.json: damaged"):
        export(copy)


def test_learning_curve_shows_no_score_of_an_older_model(copy: Path) -> None:
    """A score belongs to the checkpoint that earned it; baselines stay."""
    evaluate(copy, episodes=1)
    assert set(evaluated_returns(Run.open(copy))) == set(POLICIES.values())
    train(replace(resume_settings(copy), total_steps=240))
    assert set(evaluated_returns(Run.open(copy))) == set(POLICIES.values()) - {"trained policy"}


def test_run_without_a_checkpoint_cannot_be_evaluated(copy: Path) -> None:
    """The error says what is missing."""
    shutil.rmtree(copy / "checkpoints")
    with pytest.raises(InputError, match=r"checkpoints: no checkpoint"):
        evaluate(copy, episodes=1)


def test_files_of_another_worm_are_refused(copy: Path, tmp_path: Path) -> None:
    """A model for another worm does not pass for this one's."""
    other = train(replace(TINY, task="compression", total_steps=80, run_dir=tmp_path / "other"))
    shutil.copy(Run.open(other).newest / "model.zip", Run.open(copy).newest / "model.zip")
    with pytest.raises(InputError, match=r"model\.zip: damaged or not of this kind: .*spaces do not match"):
        evaluate(copy, episodes=1)


# Rollouts


def test_recorded_episode(finished: Path) -> None:
    """Frames run from the start at rest to the end of the last step."""
    trajectory = record(Run.open(finished), "gait", seed=2)
    assert trajectory.n_frame == 41
    assert trajectory.time[0] == 0.0
    assert trajectory.time[-1] == pytest.approx(2.0)
    assert trajectory.reward[0] == 0.0
    assert trajectory.task == "extension"
    assert np.all(trajectory.activation[0] == 0.0)
    assert np.all(trajectory.activation[-1] > 0.99)
    rise = trajectory.position[-1, :492, 2].max() - trajectory.position[0, :492, 2].max()
    assert rise == pytest.approx(0.031, abs=0.002)
    assert trajectory.outcome[-1] == f"return {trajectory.reward.sum():.2f}   strain {100.0 * rise / 0.1:+.1f} %"


def test_diverged_episode_is_recorded_to_its_end(tmp_path: Path) -> None:
    """The last frame says what went wrong."""
    (tmp_path / "design.json").write_text(LatticeDesign(max_tension=50.0).to_json())
    run = Run.open(train(replace(TINY, design=tmp_path / "design.json", total_steps=80, run_dir=tmp_path / "run")))
    trajectory = record(run, "gait", seed=2)
    assert trajectory.n_frame < 41
    assert trajectory.reward[-1] < -100.0
    assert re.fullmatch(r"return -\d+\.\d\d   strain \S+ %   \w+ \(rod \d+, element \d+\)", trajectory.outcome[-1])
    assert all("rod" not in line for line in trajectory.outcome[:-1])


def test_rollout_artefacts_open(copy: Path) -> None:
    """Every file can be read and shows something."""
    evaluate(copy, episodes=1)
    files = export(copy, "policy", seed=11, gif=(0.3, 0.6))
    trajectory = Trajectory.load(files.trajectory)
    ffmpeg = extra("imageio_ffmpeg").get_ffmpeg_exe()
    command = [ffmpeg, "-i", str(files.video), "-f", "rawvideo", "-pix_fmt", "gray", "-"]
    pixels = np.frombuffer(subprocess.run(command, capture_output=True, check=True).stdout, dtype=np.uint8)
    frames = pixels.reshape(trajectory.n_frame, -1).astype(np.float64)
    assert np.abs(frames[-1] - frames[0]).max() > 100.0
    for picture in (files.activation, files.learning_curve):
        assert iio.imread(picture).std() > 5.0
    assert files.gif == copy / "policy-11.gif"
    assert iio.imread(files.gif, index=None).shape == (7, 360, 480, 3)


@pytest.mark.parametrize("span", [(0.6, 0.3), (-1.0, 1.0), (1.0, 2.5), (np.nan, 1.0), (0.01, 0.02)])
def test_gif_of_no_part_of_the_episode_is_refused(copy: Path, span: tuple[float, float]) -> None:
    """The error names the span and the episode's."""
    with pytest.raises(InputError, match=r"^gif = \(.*\): must be .* 0 to 2 s"):
        export(copy, "gait", gif=span)


@pytest.mark.parametrize(("policy", "seed", "message"), [("swim", 1, "policy = 'swim'"), ("gait", -1, "seed = -1")])
def test_rollout_refuses_bad_input(finished: Path, policy: Any, seed: int, message: str) -> None:
    """Errors name the argument."""
    with pytest.raises(InputError, match=message):
        record(Run.open(finished), policy, seed)


# Benchmark and demo


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
