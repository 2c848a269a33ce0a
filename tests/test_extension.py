"""What the package promises to those who add to it from outside: the example task, in a folder of their own."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import SyncVectorEnv

import lattice_gym
from agents.config import InputError, TrainConfig
from agents.evaluation import evaluate
from agents.evaluation import main as evaluation_main
from agents.rollouts import export
from agents.rollouts import main as rollouts_main
from agents.run_folder import Run
from agents.training import train

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent
SOURCE = ROOT / "docs" / "examples" / "twist.py"
ID, TASK = "LatticeWorm-v0", "twist:Twist"
SHORT: dict[str, Any] = {"task": TASK, "fidelity": "fast", "max_episode_steps": 8}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Hold a copy of the example where Python finds it, and forget it afterwards."""
    (tmp_path / "twist.py").write_text(SOURCE.read_text())
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop("twist", None)
    gymnasium.registry.pop("Twist-v0", None)


GEARED = """

class Geared(Twist):
    @classmethod
    def gait(cls, lattice, layout, command):
        from lattice_gym.tasks.gait import constant_gait

        # Right-handed diagonals come first; they turn the top to the right, by 0.15 rad at full drive, others by 0.25.
        right, turn = np.arange(len(layout)) < len(layout) // 2, command["angle"]
        return constant_gait(np.where(right, max(-turn / 0.15, 0.0), max(turn / 0.23, 0.0)))
"""


def _play(env: gymnasium.Env[Any, Any], **options: float) -> tuple[float, dict[str, Any]]:
    """Return and last info of an episode in which one hand of the diagonals pulls, as commanded."""
    _, info = env.reset(seed=0, options=options)
    half, turn = np.arange(96) < 48, info["command"]["angle"]
    action = np.where(half, max(-turn / 0.15, 0.0), max(turn / 0.23, 0.0)).astype(np.float32)
    total, done = 0.0, False
    while not done:
        _, reward, terminated, truncated, info = env.step(action)
        total, done = total + float(reward), terminated or truncated
    return total, info


def test_the_example_is_short() -> None:
    """So that it is read at one look."""
    assert len(SOURCE.read_text().splitlines()) <= 40


@pytest.mark.parametrize("angle", [-0.12, 0.12])
def test_it_twists(folder: Path, angle: float) -> None:
    """The diagonals of one hand turn the top one way; nothing is earned by doing nothing."""
    env = gymnasium.make(ID, task=TASK, max_episode_steps=40)
    total, info = _play(env, angle=angle)
    assert info["outcome"]["angle"] == pytest.approx(angle, rel=0.1)
    assert total > 40.0
    env.reset(seed=0, options={"angle": angle})
    _, reward, *_ = env.step(np.zeros(env.action_space.shape))
    assert reward == pytest.approx(0.0, abs=1e-9)


def test_by_class_by_string_and_by_id(folder: Path) -> None:
    """The same worm, to the last bit, and with the task's own time limit under an id of its own."""
    from twist import Twist  # type: ignore[import-not-found]

    lattice_gym.register_task(TASK, "Twist-v0")
    spec = gymnasium.spec("Twist-v0")
    assert (spec.max_episode_steps, spec.kwargs) == (40, {"task": TASK})
    made = [gymnasium.make(ID, **SHORT | {"task": task}) for task in (TASK, Twist)]
    made.append(gymnasium.make("Twist-v0", fidelity="fast", max_episode_steps=8))
    results = [_play(env) for env in made]
    assert repr(results[0]) == repr(results[1]) == repr(results[2])


def test_registering(folder: Path) -> None:
    """Twice the same is fine; an id keeps what it is."""
    from twist import Twist

    for task in (TASK, Twist, TASK):
        lattice_gym.register_task(task, "Twist-v0")
    with pytest.raises(ValueError, match=r"^id = 'Twist-v0': is registered already, as EnvSpec\(id='Twist-v0'"):
        lattice_gym.register_task("bending", "Twist-v0")
    with pytest.raises(ValueError, match=r"^task = 'twist:Turn': cannot be imported: AttributeError"):
        lattice_gym.register_task("twist:Turn", "Turn-v0")
    with pytest.raises(ValueError, match=r"^goals = True: twist is no GoalTask"):
        lattice_gym.register_task(TASK, "TwistGoal-v0", goals=True)
    wrong: Any
    for wrong in (3, None):
        with pytest.raises(ValueError, match=rf"^id = {wrong}: must be a text"):
            lattice_gym.register_task(TASK, wrong)
        with pytest.raises(ValueError, match=rf"^goals = {wrong}: must be True or False"):
            lattice_gym.register_task(TASK, "Twist-v1", goals=wrong)
    with pytest.raises(ValueError, match=r"^task = .*: is a class of __main__, .*; put it in a module of its own"):
        lattice_gym.register_task(type("Main", (Twist,), {"__module__": "__main__"}), "Main-v0")
    lattice_gym.register_task("crawl", "LatticeWormCrawl-v0")


def test_many_are_as_many_alone(folder: Path) -> None:
    """To the last bit, over a reset."""
    many = gymnasium.make_vec(ID, 3, **SHORT)
    single = SyncVectorEnv([lambda: gymnasium.make(ID, **SHORT)] * 3)
    generator = np.random.default_rng(0)
    assert np.array_equal(many.reset(seed=5)[0], single.reset(seed=5)[0])
    for _ in range(12):
        actions = generator.random(many.action_space.shape or ()).astype(np.float32)
        for a, b in zip(many.step(actions)[:4], single.step(actions)[:4], strict=True):
            assert np.array_equal(a, b)
    many.close()


def test_it_observes_a_term_of_its_own(folder: Path) -> None:
    """By default, as the task says, and in its place."""
    env = gymnasium.make(ID, **SHORT)
    worm: Any = env.unwrapped
    env.reset(seed=0)
    seen, *_, info = env.step(np.eye(96, dtype=np.float32)[:2].sum(axis=0))
    place = worm.observation_slices["top_angle"]
    assert (place.start, place.stop) == (seen.size - 1, seen.size)
    assert seen[place] == pytest.approx([info["outcome"]["angle"]], rel=1e-6)
    assert abs(seen[place]) > 0.0
    assert worm.observation_space.high[place] == pytest.approx(np.pi)


def test_what_it_tells_of_its_command_is_checked(folder: Path) -> None:
    """Clipped and counted beyond its bounds; another shape is one clear error."""
    with (folder / "twist.py").open("a") as file:
        for name, told in (("Loud", "3.0 + super().observe(motion, time)"), ("Wide", "np.zeros((1, 2))")):
            file.write(f"\n\nclass {name}(Twist):\n    def observe(self, motion, time):\n        return {told}\n")
    env = gymnasium.make(ID, **SHORT | {"task": "twist:Loud"})
    worm: Any = env.unwrapped
    seen, _ = env.reset(seed=0)
    assert seen[worm.observation_slices["command"]] == [1.0]
    *_, info = env.step(np.zeros(96, dtype=np.float32))
    assert info["clipped_observations"] == 1
    with pytest.raises(ValueError, match=r"^Wide.observe gave shape \(1, 2\): must .* = \(1, 1\); bounds = \(1.0,\)$"):
        gymnasium.make(ID, **SHORT | {"task": "twist:Wide"}).reset(seed=0)


def test_specs_survive_json(folder: Path) -> None:
    """What is read back makes an equal worm."""
    env = gymnasium.make(ID, **SHORT, reward_weights={"effort": 0.02})
    assert env.spec is not None
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert repr(_play(env)) == repr(_play(again))
    worm: Any = again.unwrapped
    assert worm.task.weights == {"nearer": 10.0, "effort": 0.02}


def test_learning(folder: Path) -> None:
    """Train from the command line in the task's folder; then evaluation beside its gait, and a video."""
    with (folder / "twist.py").open("a") as file:
        file.write(GEARED)
    sizes = {"n-envs": 2, "n-steps": 40, "batch-size": 40, "total-steps": 80}
    options = [f"--{name}={value}" for name, value in sizes.items()] + ["--fidelity=fast", "--run-dir=run"]
    command = [sys.executable, str(ROOT / "train.py"), "--task", "twist:Geared", *options]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, env=os.environ)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("score it with: python -m agents.evaluation run --allow twist\n")
    with pytest.raises(InputError, match=r"config.json: task = 'twist:Geared': names code, .* import twist first"):
        Run.open(folder / "run")
    importlib.import_module("twist")
    run = Run.open(folder / "run")
    settings = json.loads((run.path / "config.json").read_text())
    assert (settings["task"], settings["control"], settings["gamma"]) == ("twist:Geared", "muscle", 0.8)
    assert run.env_arguments["max_episode_steps"] == 40
    scores = evaluate(run.path, episodes=1)
    assert scores["gait"].return_mean > 5.0 > abs(scores["nothing"].return_mean)
    assert scores["gait"].outcome_mean.keys() == {"angle"}
    files = export(run.path, "gait")
    assert files.video.stat().st_size > 10_000
    assert files.learning_curve is not None
    assert files.learning_curve.exists()


def test_a_task_without_a_gait_is_scored_without_one(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And its gait cannot be filmed; nor where it has a method for one that gives none."""
    config = TrainConfig(
        task=TASK, fidelity="fast", total_steps=40, n_envs=1, n_steps=40, batch_size=40, run_dir=folder / "run"
    )
    run = train(config)
    assert evaluate(run, episodes=1).keys() == {"policy", "nothing", "random"}
    with pytest.raises(InputError, match=r"^policy = 'gait': twist has no gait for"):
        export(run, "gait")
    from twist import Twist

    monkeypatch.setattr(Twist, "gait", classmethod(lambda cls, lattice, layout, command: None))
    assert evaluate(run, episodes=1).keys() == {"policy", "nothing", "random"}
    with pytest.raises(InputError, match=r"^policy = 'gait': twist has no gait for \{'angle': "):
        export(run, "gait")


def test_a_run_whose_task_is_elsewhere(tmp_path: Path) -> None:
    """Its files are sound, and the error says what to import; where it is not, where Python looks."""
    (tmp_path / "config.json").write_text('{"task": "nowhere:Twist"}')
    for use in (evaluate, export):
        with pytest.raises(InputError) as caught:
            use(tmp_path)
        assert str(caught.value) == (
            f"{tmp_path / 'config.json'}: task = 'nowhere:Twist': names code, and reading a file imports none; if you "
            "trust it, import nowhere first, or start the program with --allow nowhere"
        )
    for program in (evaluation_main, rollouts_main):
        with pytest.raises(InputError) as caught:
            program(tmp_path, allow=("nowhere",))
        assert str(caught.value) == (
            "allow = 'nowhere': cannot be imported: ModuleNotFoundError: No module named 'nowhere'; put the folder "
            "that holds it on PYTHONPATH, or run from there"
        )


def test_a_task_that_is_not_there() -> None:
    """One line says which, and where Python looks."""
    command = [sys.executable, "train.py", "--task", "nowhere:Twist"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    text = " ".join((done.stdout + done.stderr).replace("│", " ").split())
    assert "task = 'nowhere:Twist': cannot be imported: ModuleNotFoundError" in text
    assert "put the folder that holds it on PYTHONPATH, or run from there" in text
