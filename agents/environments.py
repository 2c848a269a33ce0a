"""The environment as training, evaluation and rollouts wrap it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import RescaleAction
from stable_baselines3.common.vec_env import VecCheckNan, VecEnv

from agents.config import InputError
from agents.outcomes import Judged
from agents.vector_adapter import WormVecEnv

Env = gymnasium.Env[Any, Any]


def make_env(arguments: Mapping[str, Any]) -> Env:
    """Environment with actions in [-1, 1] and `outcome_errors` in info; raises InputError if it cannot be built."""
    try:
        env = gymnasium.make(**arguments)
    except ValueError as error:
        raise InputError(str(error)) from error
    return Judged(RescaleAction(env, np.float32(-1.0), np.float32(1.0)))


def make_vector_env(arguments: Mapping[str, Any], n_envs: int, num_threads: int | None = None) -> VecEnv:
    """Worms that step together on so many threads, by default one a core, as a `WormVecEnv`.

    Raises InputError if they cannot be built; NaN or infinity on the way between worms and learner raises ValueError.
    """
    batch: dict[str, Any] = {"num_envs": n_envs, "num_threads": num_threads, "autoreset_mode": AutoresetMode.SAME_STEP}
    try:
        envs = gymnasium.make_vec(**arguments, **batch)
    except ValueError as error:
        raise InputError(str(error)) from error
    return VecCheckNan(WormVecEnv(envs), raise_exception=True)
