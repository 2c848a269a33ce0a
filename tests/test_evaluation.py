"""Evaluation: fidelity, outcomes by command, seeds, and damaged files that are named."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runs import DAMAGE, TINY
from stable_baselines3 import PPO

from agents import run_folder
from agents.config import InputError, TrainConfig
from agents.environments import make_env
from agents.evaluation import POLICIES, evaluate, format_scores, make_policy
from agents.evaluation import main as evaluation_main
from agents.rollouts import evaluated_returns, export
from agents.run_folder import Run
from agents.training import resume_settings, train, worm_seeds
from lattice_gym.body.design import LatticeDesign
from lattice_gym.policies.base import EVALUATION_SEED, play
from lattice_gym.policies.baselines import GaitPolicy, RandomActions
from lattice_gym.policies.evaluation import evaluate as score
from lattice_gym.recording.trajectory import Trajectory
from lattice_gym.tasks.registry import TASKS, gait

pytestmark = pytest.mark.slow


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
    assert artefacts.learning_curve == path / "learning_curve-default.png"
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
        replace(run, env_arguments=run.env_arguments | {"observation": ["nodes", "command"]}).at("fast")
    with pytest.raises(InputError, match=r"^fidelity = 'fast': must be 'default'"):
        train(replace(resume_settings(copy), total_steps=240, fidelity="fast"))


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
    policy = RandomActions()
    policy.reset(env, 5)
    first = policy(None)[0]
    assert 0.5 * (first + 1.0) != pytest.approx(info["command"]["azimuth"] / (2.0 * np.pi), abs=1e-6)


def test_evaluation_report(copy: Path) -> None:
    """Scores are means over the seeds named, repeat, and order as they should."""
    normaliser = (Run.open(copy).newest / "normalisation.npz").read_bytes()
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
    assert (Run.open(copy).newest / "normalisation.npz").read_bytes() == normaliser
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
    act: Any = make_policy("policy", run)
    by_hand = []
    moments = np.load(run.newest / "normalisation.npz", allow_pickle=False)
    mean, variance = moments["observation_mean"], moments["observation_var"]
    model = PPO.load(run.newest / "model.zip", device="cpu")
    observation, _ = env.reset(seed=7)
    for _ in range(10):
        scaled = (observation - mean) / np.sqrt(variance + 1e-8)
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
    policy = GaitPolicy()
    policy.reset(env, 1)
    action = policy(None)
    np.testing.assert_allclose(0.5 * (action[worm.groups] + 1.0), expected, atol=1e-6)


def test_episodes_repeat_with_their_seed(finished: Path) -> None:
    """A seed fixes the episode, random actions included."""
    run = Run.open(finished)
    env = make_env(run.env_arguments)
    policy = make_policy("random", run)
    first = [step.reward for step in play(policy, env, 5)]
    assert [step.reward for step in play(policy, env, 5)] == first
    assert [step.reward for step in play(policy, env, 6)] != first
    assert score(policy, env, range(5, 6)).returns == (sum(first),)


@pytest.mark.parametrize(("argument", "value"), [("episodes", 0), ("seed", -1)])
def test_evaluation_refuses_bad_numbers(finished: Path, argument: str, value: Any) -> None:
    """No episode, no score."""
    with pytest.raises(InputError, match=f"^{argument} = {value}: must be"):
        evaluate(finished, **{argument: value})


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize(
    "name",
    [
        "config.json",
        "design.json",
        "muscles.json",
        "versions.json",
        "checkpoints/000000000160/model.zip",
        "checkpoints/000000000160/normalisation.npz",
    ],
)
def test_evaluation_names_a_damaged_file(copy: Path, name: str, damage: str) -> None:
    """Whatever happened to a file, the error names it."""
    DAMAGE[damage](copy / name)
    with pytest.raises(InputError, match=rf"^{re.escape(str(copy / name))}: (no such file|damaged)"):
        evaluate(copy, episodes=1)


def test_run_without_a_checkpoint_cannot_be_evaluated(copy: Path) -> None:
    """The error says what is missing."""
    shutil.rmtree(copy / "checkpoints")
    with pytest.raises(InputError, match=r"checkpoints: no checkpoint"):
        evaluate(copy, episodes=1)


def test_files_of_another_worm_are_refused(copy: Path, tmp_path: Path) -> None:
    """A model for another worm does not pass for this one's."""
    other = train(replace(TINY, task="compression", total_steps=80, run_dir=tmp_path / "other"))
    shutil.copy(Run.open(other).newest / "model.zip", Run.open(copy).newest / "model.zip")
    with pytest.raises(InputError, match=r"model\.zip: damaged or not of this kind: .*shift has shape"):
        evaluate(copy, episodes=1)
