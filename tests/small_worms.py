"""Small environments that several files of tests use."""

from __future__ import annotations

import pickle
from typing import Any

import gymnasium

from lattice_gym.envs.env import LatticeWormEnv

SMALL: dict[str, Any] = {"n_pairs": 3, "period_ratio": 1.5, "elements_per_segment": 2}
"""A lattice of three sites on each of five levels: quick to build and to step."""
N_SMALL = 21
"""Its muscles."""
SMALL_WAVE = {"wavelength": 0.1, "speed": 0.1}


def bare_env(id: str, **kwargs: Any) -> LatticeWormEnv:
    """Environment without wrappers."""
    env = gymnasium.make(id, **kwargs).unwrapped
    assert isinstance(env, LatticeWormEnv)
    return env


def episode(env: gymnasium.Env[Any, Any], n_step: int, seed: int = 0) -> list[Any]:
    """Everything a seeded episode of random actions returns."""
    env.action_space.seed(seed)
    returned: list[Any] = [env.reset(seed=seed)]
    returned += [env.step(env.action_space.sample()) for _ in range(n_step)]
    return returned


def same(first: list[Any], second: list[Any]) -> bool:
    """Tell whether two episodes are the same to the last bit."""
    return pickle.dumps(first) == pickle.dumps(second)
