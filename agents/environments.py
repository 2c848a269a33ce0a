"""The environment as training, evaluation and rollouts wrap it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecCheckNan, VecEnv

from agents.config import input_errors
from lattice_gym.sb3 import WormVecEnv

Env = gymnasium.Env[Any, Any]


def make_env(arguments: Mapping[str, Any]) -> Env:
    """Environment of one worm; raises InputError if it cannot be built."""
    with input_errors():
        return gymnasium.make(**arguments)


def make_vector_env(arguments: Mapping[str, Any], n_envs: int, num_threads: int | None = None) -> VecEnv:
    """Worms that step together on so many threads, by default one a core, as a `WormVecEnv`.

    Raises InputError if they cannot be built; NaN or infinity on the way between worms and learner raises ValueError.
    """
    batch: dict[str, Any] = {"num_envs": n_envs, "num_threads": num_threads, "autoreset_mode": AutoresetMode.SAME_STEP}
    with input_errors():
        envs = gymnasium.make_vec(**arguments, **batch)
    return VecCheckNan(WormVecEnv(envs), raise_exception=True)
