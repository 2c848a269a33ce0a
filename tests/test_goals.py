"""Environments with goals: what hindsight replay relies on."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RescaleAction
from small_worms import bare_env, episode
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.env_checker import check_env as check_env_sb3

from lattice_gym.envs.goal import LatticeWormGoalEnv
from lattice_gym.tasks.base import EFFORT_WEIGHT, MIN_PENALTY

pytestmark = pytest.mark.slow


def _of(rows: list[Any], name: str) -> Any:
    return np.array([row[0][name] for row in rows])


def test_goals() -> None:
    """A Dict that both checkers take; any goals are rewarded as the task would, its own to the last bit."""
    env = bare_env("LatticeWormReachGoal-v0", control="column")
    assert isinstance(env, LatticeWormGoalEnv)
    check_env(env, skip_render_check=True)
    check_env_sb3(env, warn=False)
    steps = episode(env, 5)
    assert all(step[0] in env.observation_space for step in steps)
    assert steps[0][0]["observation"].shape == (6 * 48 + 24,)
    np.testing.assert_allclose(steps[0][0]["achieved_goal"], 0.0, atol=1e-6)
    achieved, desired, infos = (
        _of(steps[1:], "achieved_goal"),
        _of(steps[1:], "desired_goal"),
        [s[4] for s in steps[1:]],
    )
    rewards = [step[1] for step in steps[1:]]
    np.testing.assert_array_equal(env.compute_reward(achieved, desired, infos), rewards)
    assert [env.compute_reward(a, d, i) for a, d, i in zip(achieved, desired, infos, strict=True)] == rewards
    # Of what was reached itself the reward is its distance from rest; None leaves the effort out.
    hindsight = env.compute_reward(achieved, achieved, [None] * 5)
    np.testing.assert_allclose(hindsight, 0.2 * np.linalg.norm(achieved, axis=1), rtol=1e-6)
    diverged = {"reward_terms": {"approach": 0.0, "effort": 0.0, "divergence": -MIN_PENALTY}}
    assert env.compute_reward(achieved[0], desired[0], diverged) == -MIN_PENALTY
    # One info counts for all goals, None for none, and their number must fit.
    plain = env.compute_reward(achieved, desired, None)
    np.testing.assert_array_equal(plain, env.compute_reward(achieved, desired, [None] * 5))
    np.testing.assert_array_equal(
        env.compute_reward(achieved, desired, infos[2]), env.compute_reward(achieved, desired, [infos[2]] * 5)
    )
    np.testing.assert_array_equal(env.compute_reward(achieved[:1], desired[:1], infos[:1]), rewards[:1])
    assert env.compute_reward(achieved[0], desired[0], None) == np.asarray(plain)[0]
    assert np.shape(env.compute_reward(achieved[:0], desired[:0], [])) == (0,)
    hostile: list[Any] = [infos[:4], infos[:1], [], 7, ["ok"] * 5, "infos"]
    for wrong in hostile:
        with pytest.raises(ValueError, match=r"^info\b"):
            env.compute_reward(achieved, desired, wrong)
    with pytest.raises(ValueError, match=r"^info: must be one mapping"):
        env.compute_reward(achieved[0], desired[0], infos)
    with pytest.raises(ValueError, match=r"^task = 'bending': has no goals; those that do: reach"):
        LatticeWormGoalEnv("bending")
    with pytest.raises(ValueError, match=r"^task = 'swimming': must be one of"):
        LatticeWormGoalEnv("swimming")


def test_hindsight_replay() -> None:
    """SAC learns from relabelled goals, wrapped as in training."""
    env = gymnasium.make("LatticeWormReachGoal-v0", control="column", fidelity="fast", max_episode_steps=5)
    model = SAC(
        "MultiInputPolicy",
        RescaleAction(env, np.float32(-1.0), np.float32(1.0)),
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"copy_info_dict": True},
        learning_starts=10,
        batch_size=8,
        policy_kwargs={"net_arch": [8]},
        buffer_size=100,
        seed=0,
    )
    model.learn(20)
    assert isinstance(model.replay_buffer, HerReplayBuffer)
    sample = model.replay_buffer.sample(32, env=model.get_vec_normalize_env())
    assert np.isfinite(sample.rewards.numpy()).all()
    goals = {name: sample.next_observations[name].numpy() for name in ("achieved_goal", "desired_goal")}
    worm = env.unwrapped
    assert isinstance(worm, LatticeWormGoalEnv)
    again = worm.compute_reward(**goals, info=[None] * 32)
    # Effort, at most a hundredth, is not in a sample.
    np.testing.assert_allclose(sample.rewards.numpy()[:, 0], again, atol=EFFORT_WEIGHT + 1e-6)
