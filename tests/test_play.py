"""Any callable from observation to action is scored, recorded and filmed, with no run folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import imageio.v3 as iio
import numpy as np
import pytest
import torch
from gymnasium.wrappers import FlattenObservation, RescaleAction, TimeLimit, TransformObservation
from stable_baselines3 import PPO, SAC

import lattice_gym
from lattice_gym import LatticeWormEnv, evaluate, film, record
from lattice_gym.policies.base import play
from lattice_gym.policies.baselines import DoNothing, GaitPolicy, NoGaitError, RandomActions

pytestmark = pytest.mark.slow

ID = "LatticeWormExtension-v0"
FAST: dict[str, Any] = {"control": "ring", "fidelity": "fast"}
SHORT: dict[str, Any] = {"id": ID, **FAST, "max_episode_steps": 6}
GOAL: dict[str, Any] = {"id": "LatticeWormReachGoal-v0", **FAST, "control": "column", "max_episode_steps": 4}


def _full(_: Any) -> Any:
    return np.ones(8)


def test_score_is_that_of_a_loop_by_hand() -> None:
    """Returns and outcome of each seed, whatever way the environment is given."""
    env = gymnasium.make(**SHORT)
    returns, strains = [], []
    for seed in (4, 9):
        env.reset(seed=seed)
        rewards = []
        done = False
        while not done:
            _, reward, _, done, info = env.step(_full(None))
            rewards.append(float(reward))
        returns.append(sum(rewards))
        strains.append(info["outcome"]["strain"])
    given: list[Any] = [env, SHORT, FlattenObservation(env)]
    for one in given:
        score = evaluate(_full, one, seeds=np.array([4, 9]))
        assert list(score.returns) == returns
        assert score.outcome_mean == {"strain": np.mean(strains)}
        assert score.diverged_episodes == 0
    assert evaluate(_full, SHORT).returns == (returns[0],) * 10  # nothing is drawn in this task
    env.reset()  # it was not closed
    assert record(_full, SHORT, seed=4).reward.sum() == returns[0]


def test_an_id_is_an_environment() -> None:
    """With all its defaults, and the package's name before it or not."""
    for name in (ID, f"lattice_gym:{ID}"):
        assert len(evaluate(DoNothing(), name, seeds=[1]).returns) == 1


class Remembering:
    """A policy with a state, as a recurrent one has: it counts its calls."""

    def __init__(self) -> None:
        self.began: list[tuple[Any, int]] = []
        self.count = -100

    def reset(self, env: Any, seed: int) -> None:
        """Forget."""
        self.began.append((env.unwrapped.time, seed))
        self.count = 0

    def __call__(self, observation: Any) -> Any:
        """Act by how often that was done."""
        self.count += 1
        return np.full(8, 0.1 * self.count)


def test_a_policy_with_a_state_is_reset() -> None:
    """At the start of every episode, with the environment just reset and the seed."""
    policy = Remembering()
    score = evaluate(policy, SHORT, seeds=[5, 6])
    assert policy.began == [(0.0, 5), (0.0, 6)]
    assert policy.count == 6
    assert score.returns[0] == score.returns[1]


def test_a_gait_is_a_policy() -> None:
    """The task's own, one made by hand, and a function of time."""
    env: Any = gymnasium.make("LatticeWormBending-v0", fidelity="fast", control="column", max_episode_steps=10)
    env.reset(seed=2)
    worm = env.unwrapped
    gait = lattice_gym.gait("bending", worm.lattice, worm.layout, worm.task.command)
    own = evaluate(GaitPolicy(), env, seeds=[2])
    assert own.returns[0] > 0.5
    assert evaluate(gait, env, seeds=[2]) == own
    assert evaluate(GaitPolicy(gait), env, seeds=[2]) == own
    assert evaluate(GaitPolicy(lambda time: gait(time)), env, seeds=[2]) == own
    mirrored = gymnasium.make(
        "LatticeWormBending-v0", fidelity="fast", control="column", max_episode_steps=10, action_range=(-1, 1)
    )
    assert evaluate(GaitPolicy(), mirrored, seeds=[2]).returns[0] == pytest.approx(own.returns[0], rel=1e-6)


def test_a_task_without_a_gait_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error has a class of its own."""
    from lattice_gym.tasks.extension import Extension

    monkeypatch.setattr(Extension, "gait", classmethod(lambda cls, lattice, layout, command: None))
    with pytest.raises(NoGaitError, match=r"extension has no gait for \{\}"):
        evaluate(GaitPolicy(), SHORT, seeds=[1])


def test_random_actions_begin_with_their_seed() -> None:
    """And cover the space, whichever it is."""
    for ends in ((0, 1), (-2, 3)):
        env = gymnasium.make(**SHORT, action_range=ends)
        policy, drawn = RandomActions(), []
        for seed in (1, 2, 1):
            policy.reset(env, seed)
            drawn.append(np.array([policy(None) for _ in range(50)]))
        np.testing.assert_array_equal(drawn[0], drawn[2])
        assert not np.array_equal(drawn[0], drawn[1])
        assert ends[0] <= drawn[0].min() < ends[0] + 0.1
        assert ends[1] - 0.1 < drawn[0].max() <= ends[1]


def test_models_of_other_libraries() -> None:
    """Stable-Baselines3 by its predict, a module of torch, a policy of batches, one of goals."""
    env = gymnasium.make(**SHORT)
    rescaled = RescaleAction(env, np.float32(-1.0), np.float32(1.0))
    model = PPO("MlpPolicy", rescaled, n_steps=8, batch_size=8, device="cpu")
    first = evaluate(lambda seen: model.predict(seen, deterministic=True)[0], rescaled, seeds=[1])
    exported = evaluate(lattice_gym.network_policy(model), {**SHORT, "action_range": (-1, 1)}, [1])
    assert exported.returns == pytest.approx(first.returns, rel=1e-5)
    network = torch.nn.Sequential(torch.nn.Linear(296, 8), torch.nn.Sigmoid())

    def act(seen: Any) -> Any:
        with torch.no_grad():
            return network(torch.as_tensor(seen)).numpy()

    assert evaluate(act, env, seeds=[1]) == evaluate(lambda seen: act(seen[None])[0], env, seeds=[1])
    goal = SAC("MultiInputPolicy", gymnasium.make(**GOAL), buffer_size=10, device="cpu")
    seen_keys = set()

    def reach(seen: Any) -> Any:
        seen_keys.update(seen)
        return goal.predict(seen, deterministic=True)[0]

    assert len(evaluate(reach, GOAL, seeds=[1, 2]).returns) == 2
    assert seen_keys == {"observation", "achieved_goal", "desired_goal"}


def test_an_environment_without_a_time_limit_ends() -> None:
    """After the task's, unless a wrapper has another."""
    bare = LatticeWormEnv("extension", **FAST)
    unlimited = gymnasium.make(ID, **FAST, max_episode_steps=-1)
    for env, steps in ((bare, 40), (unlimited, 40), (TimeLimit(bare, 3), 3), (gymnasium.make(ID, **FAST), 40)):
        assert len(list(play(DoNothing(), env, 1))) == steps + 1
    long = gymnasium.make(ID, **FAST, max_episode_steps=50)
    assert len(list(play(DoNothing(), long, 1))) == 51


def test_what_diverges_is_recorded_and_counted() -> None:
    """To its end, with its status in the last line."""
    violent = {"id": ID, "control": "ring", "fidelity": "fast", "design": {"max_tension": 50.0}}
    trajectory = record(_full, violent, seed=1)
    assert "element" in trajectory.outcome[-1]
    assert all("element" not in line for line in trajectory.outcome[:-1])
    assert evaluate(_full, violent, seeds=[1, 2]).diverged_episodes == 2


def test_commands_of_a_few_are_scored_apart() -> None:
    """As in the evaluation of a run."""
    bend = {"id": "LatticeWormBending-v0", "control": "column", "fidelity": "fast", "max_episode_steps": 3}
    score = evaluate(GaitPolicy(), {**bend, "command": {"azimuth": [0.0, 1.5]}}, seeds=range(6))
    assert list(score.by_command) == ["azimuth 0", "azimuth 1.5"]
    assert sum(len(part.returns) for part in score.by_command.values()) == 6


def test_film_is_of_the_episode(tmp_path: Path) -> None:
    """A GIF and its trajectory, which is that of `record`."""
    trajectory = film(_full, SHORT, tmp_path / "extension.gif", seed=3, size=(160, 120))
    again = record(_full, SHORT, seed=3)
    np.testing.assert_array_equal(trajectory.position, again.position)
    assert trajectory.activation[-1] == pytest.approx(1.0, abs=1e-3)  # of what was asked for, all of it
    assert iio.imread(tmp_path / "extension.gif", index=None).shape == (7, 120, 160, 3)


def test_a_film_takes_an_array_for_its_size(tmp_path: Path) -> None:
    """As every list argument does."""
    film(_full, SHORT, tmp_path / "extension.gif", size=np.array([160, 120]))
    assert iio.imread(tmp_path / "extension.gif", index=0).shape == (120, 160, 3)


@pytest.mark.parametrize(
    ("policy", "env", "seeds", "message"),
    [
        (None, SHORT, [1], r"^policy = None: must be callable, from an observation to an action$"),
        (PPO, SHORT, [], r"^seeds = \(\): must name at least one episode"),
        (_full, SHORT, [-1], r"^seeds\[0\] = -1"),
        (_full, SHORT, 3, r"^seeds = 3: must be a sequence of seeds"),
        (_full, "CartPole-v1", [1], r"^env = .*: must be an environment of one worm"),
        (_full, {"control": "ring"}, [1], r"^env = .*: must be an environment of one worm, its id, or a dict"),
        (_full, 7, [1], r"^env = 7: must be an environment of one worm, its id"),
        (_full, {**SHORT, "wings": 2}, [1], "got an unexpected keyword argument 'wings'"),
        (lambda seen: np.ones(7), SHORT, [1], r"^action: shape must be \(8,\), got \(7,\)"),
        (lambda seen: np.ones((1, 8)), SHORT, [1], r"^action: shape must be \(8,\), got \(1, 8\)"),
        (lambda seen: None, SHORT, [1], r"^action: must hold real numbers, got object"),
        (lambda seen: np.full(8, np.nan), SHORT, [1], r"^action: must not be NaN"),
    ],
)
def test_what_cannot_be_played_is_refused(policy: Any, env: Any, seeds: Any, message: str) -> None:
    """By the name of the argument."""
    with pytest.raises(ValueError, match=message):
        evaluate(policy, env, seeds)


def test_a_reset_of_another_kind_is_refused() -> None:
    """As of a recurrent policy of another library; nothing is reset in silence, or not at all."""

    class Foreign(Remembering):
        def reset(self) -> None:  # type: ignore[override]
            raise AssertionError

    with pytest.raises(ValueError, match=r"^policy\.reset: must take \(env, seed\)"):
        evaluate(Foreign(), SHORT, seeds=[1])


def test_a_model_is_no_policy_by_itself() -> None:
    """The error says how to make one of it."""
    model = PPO("MlpPolicy", gymnasium.make(**SHORT), n_steps=8, batch_size=8, device="cpu")
    with pytest.raises(ValueError, match=r"^policy = .*: must be callable.*lambda seen: model\.predict\(seen"):
        record(model, SHORT)  # type: ignore[arg-type]


def test_many_worms_are_no_environment_of_one() -> None:
    """Nor a wrapper of them."""
    many: Any = gymnasium.make_vec(**SHORT, num_envs=2)
    for use in (evaluate, record):
        with pytest.raises(ValueError, match=r"^env = .*: must be an environment of one worm"):
            use(_full, many)


def test_wrapped_observations_reach_the_policy() -> None:
    """What the wrapper gives, not what the worm does."""
    env = gymnasium.make(**SHORT)
    halved = TransformObservation(env, lambda seen: 0.5 * seen, env.observation_space)
    seen: list[Any] = []

    def act(observation: Any) -> Any:
        seen.append(observation)
        return np.zeros(8)

    evaluate(act, env, seeds=[1])
    evaluate(act, halved, seeds=[1])
    np.testing.assert_array_equal(seen[6], 0.5 * seen[0])
