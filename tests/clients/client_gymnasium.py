"""Its checker, and its wrappers to PyTorch around one worm and many; tests/test_wrappers.py has the others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import pytest
import torch
from gymnasium import wrappers
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import vector as vector_wrappers
from worm import EXTENSION, ID, N_STEP

import lattice_gym  # noqa: F401, registers the ids


def _are_tensors(values: Mapping[str, Any]) -> bool:
    return all(
        _are_tensors(value) if isinstance(value, Mapping) else isinstance(value, torch.Tensor)
        for value in values.values()
    )


@pytest.mark.parametrize("id", [ID, "LatticeWormReachGoal-v0"])
def test_the_checker_finds_nothing(id: str) -> None:
    """Of one worm, pictures among it."""
    check_env(gymnasium.make(id, render_mode="rgb_array", fidelity="fast").unwrapped)


def test_tensors_of_one_worm() -> None:
    """Observation, reward and whatever info has."""
    env: Any = wrappers.NumpyToTorch(gymnasium.make(ID, **EXTENSION))
    _, info = env.reset(seed=0)
    assert _are_tensors(info)
    observation, _, _, _, info = env.step(torch.rand(env.action_space.shape))
    assert isinstance(observation, torch.Tensor)
    assert _are_tensors(info)
    env.close()


@pytest.mark.parametrize("mode", ["NextStep", "Disabled"])
def test_tensors_of_many_worms(mode: str) -> None:
    """The same, masks among them, to the end of the episode."""
    env: Any = vector_wrappers.NumpyToTorch(gymnasium.make_vec(ID, num_envs=2, autoreset_mode=mode, **EXTENSION))
    assert _are_tensors(env.reset(seed=0)[1])
    for _ in range(N_STEP):
        observation, _, _, truncated, info = env.step(torch.rand(env.action_space.shape))
        assert isinstance(observation, torch.Tensor)
        assert _are_tensors(info)
    assert bool(truncated.all())
    env.close()
