"""Gymnasium's own wrappers around one worm and around many, each over the end of an episode."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as vector_wrappers

pytestmark = pytest.mark.slow

LOW: Any = np.float32(-1.0)
HIGH: Any = np.float32(1.0)
WORM: dict[str, Any] = {"id": "LatticeWormExtension-v0", "control": "ring", "fidelity": "fast", "max_episode_steps": 3}
WITH_GOALS = WORM | {"id": "LatticeWormReachGoal-v0", "control": "column"}

Wrap = Callable[[Any], Any]

ONE: dict[str, Wrap] = {
    "Autoreset": wrappers.Autoreset,
    "ClipAction": wrappers.ClipAction,
    "ClipReward": lambda env: wrappers.ClipReward(env, -1.0, 1.0),
    "DelayObservation": lambda env: wrappers.DelayObservation(env, 2),
    "FlattenObservation": wrappers.FlattenObservation,
    "FrameStackObservation": lambda env: wrappers.FrameStackObservation(env, 3),
    "MaxAndSkipObservation": lambda env: wrappers.MaxAndSkipObservation(env, 2),
    "NormalizeObservation": wrappers.NormalizeObservation,
    "NormalizeReward": wrappers.NormalizeReward,
    "PassiveEnvChecker": wrappers.PassiveEnvChecker,
    "RecordEpisodeStatistics": wrappers.RecordEpisodeStatistics,
    "RescaleAction": lambda env: wrappers.RescaleAction(env, LOW, HIGH),
    "RescaleObservation": lambda env: wrappers.RescaleObservation(env, LOW, HIGH),
    "StickyAction": lambda env: wrappers.StickyAction(env, 0.5),
    "TimeAwareObservation": wrappers.TimeAwareObservation,
    "TimeLimit": lambda env: wrappers.TimeLimit(env, 2),
}
MANY: dict[str, Wrap] = {
    "ClipAction": vector_wrappers.ClipAction,
    "ClipReward": lambda envs: vector_wrappers.ClipReward(envs, -1.0, 1.0),
    "DictInfoToList": vector_wrappers.DictInfoToList,
    "FlattenObservation": vector_wrappers.FlattenObservation,
    "NormalizeObservation": vector_wrappers.NormalizeObservation,
    "NormalizeReward": vector_wrappers.NormalizeReward,
    "RecordEpisodeStatistics": vector_wrappers.RecordEpisodeStatistics,
    "RescaleAction": lambda envs: vector_wrappers.RescaleAction(envs, LOW, HIGH),
    "RescaleObservation": lambda envs: vector_wrappers.RescaleObservation(envs, LOW, HIGH),
}
WITH_ONE_BOX = ("MaxAndSkip", "Normalize", "RescaleObservation")
"""Wrappers that gymnasium has for observations in one array only."""


def _takes(name: str, arguments: dict[str, Any]) -> bool:
    return arguments is WORM or name == "NormalizeReward" or not name.startswith(WITH_ONE_BOX)


@pytest.mark.parametrize("name", ONE)
@pytest.mark.parametrize("arguments", [WORM, WITH_GOALS])
def test_around_one_worm(name: str, arguments: dict[str, Any]) -> None:
    """Observations are within the wrapper's space, rewards are finite, and no warning is given."""
    if not _takes(name, arguments):
        return
    env = ONE[name](gymnasium.make(**arguments))
    env.action_space.seed(0)
    for seed in (0, None):
        observation, _ = env.reset(seed=seed)
        ended = False
        while not ended:
            assert observation in env.observation_space
            observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
            assert np.isfinite(reward)
            ended = terminated or truncated
    assert ("episode" in info) == (name == "RecordEpisodeStatistics")
    env.close()


@pytest.mark.parametrize("name", MANY)
@pytest.mark.parametrize("arguments", [WORM, WITH_GOALS])
def test_around_many_worms(name: str, arguments: dict[str, Any]) -> None:
    """The same, over the ends of two episodes."""
    if not _takes(name, arguments):
        return
    envs = MANY[name](gymnasium.make_vec(num_envs=2, **arguments))
    envs.action_space.seed(0)
    observation, _ = envs.reset(seed=0)
    n_ended = 0
    for _ in range(9):
        # Older releases of gymnasium leave the space as it was.
        assert name == "NormalizeObservation" or observation in envs.observation_space
        observation, reward, terminated, truncated, _ = envs.step(envs.action_space.sample())
        assert np.isfinite(reward).all()
        n_ended += int((terminated | truncated).sum())
    assert n_ended == 4
    envs.close()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_infos_as_a_list_are_those_of_single_worms(mode: AutoresetMode) -> None:
    """One dict a worm, with plain names and values; a new episode's where one has begun."""
    envs: Any = gymnasium.make_vec(num_envs=2, **WORM, autoreset_mode=mode)
    listed, single = vector_wrappers.DictInfoToList(envs), gymnasium.make(**WORM)
    starts, (_, start) = listed.reset(seed=0)[1], single.reset(seed=0)
    assert starts[0] == {name: value for name, value in start.items() if name != "outcome"}
    pull = np.ones(single.action_space.shape or (), np.float32)
    for _ in range(2):
        told, info = listed.step(np.stack([pull, pull]))[4], single.step(pull)[4]
        assert told[0] == {name: value for name, value in info.items() if name != "outcome"}
    listed.close()
    single.close()


def test_videos_have_the_frames_of_the_worm(tmp_path: Path) -> None:
    """Of one and of many: 20 a second, one for the start and one for every step."""
    single: Any = gymnasium.make(**WORM, render_mode="rgb_array")
    many: Any = gymnasium.make_vec(num_envs=2, **WORM, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*Overwriting existing videos.*")
        wrapped: list[Any] = [wrappers.RecordVideo(single, str(tmp_path / "one"), disable_logger=True)]
        if hasattr(vector_wrappers, "RecordVideo"):  # not in older releases of gymnasium
            wrapped.append(vector_wrappers.RecordVideo(many, str(tmp_path / "many"), disable_logger=True))
    for env in wrapped:
        assert env.metadata["render_fps"] == 20.0
        env.reset(seed=0)
        for _ in range(3):
            env.step(env.action_space.sample())
        env.close()
    assert len(list(tmp_path.glob("*/*.mp4"))) == len(wrapped)
