"""Training: run folders, checkpoints, resuming, files of designs and environments."""

from __future__ import annotations

import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runs import TINY
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from agents import run_folder
from agents.config import InputError
from agents.environments import make_env, make_vector_env
from agents.evaluation import evaluate, make_policy
from agents.rollouts import record
from agents.run_folder import Run
from agents.training import new_model, resume_settings, step_size, train
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.recording.files import replacing
from lattice_gym.tasks.registry import TASKS, design_for

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent


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
    assert {file.name for file in run.newest.iterdir()} == {"model.zip", "normalisation.npz"}
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
    return make_policy("policy", run)(observation)


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
    files = {"model.zip": lambda path: path.write_bytes(b"new"), "normalisation.npz": killed}
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
        ('{"wrold": {}}', r"wrold: unknown argument; known are action_range, .*, world$"),
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
