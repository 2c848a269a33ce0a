"""The environment as training, evaluation and rollouts wrap it."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.wrappers import RescaleAction
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecCheckNan, VecEnv

from agents.config import InputError

Env = gymnasium.Env[Any, Any]


def make_env(arguments: Mapping[str, Any]) -> Env:
    """Environment with actions in [-1, 1]; raises InputError if it cannot be built."""
    try:
        env = gymnasium.make(**arguments)
    except ValueError as error:
        raise InputError(str(error)) from error
    return RescaleAction(env, np.float32(-1.0), np.float32(1.0))


def make_vector_env(arguments: Mapping[str, Any], n_envs: int) -> VecEnv:
    """Worms side by side, each in its own process if more than one; NaN or infinity on the way raises ValueError."""
    worms: list[Callable[[], Env]] = [partial(_monitored, arguments)] * n_envs
    if n_envs == 1:
        return VecCheckNan(DummyVecEnv(worms), raise_exception=True)
    _compile(arguments)
    multiprocessing.set_forkserver_preload([__name__])  # imported once, not once a process
    return VecCheckNan(SubprocVecEnv(worms), raise_exception=True)


def _compile(arguments: Mapping[str, Any]) -> None:
    """Take one step, so that processes started later find compiled code on the disk instead of each compiling it."""
    env = make_env(arguments)
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape or (), dtype=np.float32))
    env.close()


def _monitored(arguments: Mapping[str, Any]) -> Env:
    """One worm; in a process of its own it leaves ctrl-C to the learner, which ends it in good order."""
    if multiprocessing.parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return Monitor(make_env(arguments))
