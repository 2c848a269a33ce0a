"""Policies, and the episodes that they play.

A policy is any callable that takes the observation of one worm, as its environment gives it (an array, or a dict of
three where goals are observed apart), and returns the action, in the environment's space. One that belongs to an
episode, as it counts time, remembers or draws, has a method `reset(env, seed)`: it is called at the start of every
episode, with the environment as it was just reset and the seed of that episode.

So of a model of Stable-Baselines3 `lambda seen: model.predict(seen, deterministic=True)[0]`, and of one that takes
batches alone `lambda seen: policy(seen[None])[0]`. A `Gait`, which goes by time, is taken too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from inspect import signature
from typing import Any

import gymnasium
import numpy.typing as npt
from gymnasium.wrappers import TimeLimit

from lattice_gym.checks import invalid_value, whole
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.policies.baselines import GaitPolicy
from lattice_gym.tasks.gait import Gait

Env = gymnasium.Env[Any, Any]
Policy = Callable[[Any], npt.ArrayLike]
"""Observation of one worm to its action; may have `reset(env, seed)`."""
EnvLike = Env | str | Mapping[str, Any]
"""An environment of one worm, wrapped or not; its id; or all arguments of `gymnasium.make`, "id" among them."""

EVALUATION_SEED = 1_000_000
"""Seed of a first episode unless given: far above those that training usually starts from."""


@dataclass(frozen=True)
class Step:
    """What the reset (reward 0) or one control step gave."""

    reward: float
    info: Mapping[str, Any]


@contextmanager
def opened(env: EnvLike) -> Iterator[tuple[Env, LatticeWormEnv]]:
    """Environment, and the worm in it; what is made from an id or arguments is closed in the end.

    Raises
    ------
    ValueError
        What is no environment of one worm, and whatever its arguments raise.
    """
    if isinstance(env, gymnasium.Env):
        yield env, _worm(env)
        return
    arguments = {"id": env} if isinstance(env, str) else env
    if not isinstance(arguments, Mapping) or not isinstance(arguments.get("id"), str):
        raise invalid_value("env", env, 'must be an environment of one worm, its id, or a dict of arguments with "id"')
    made: Env = gymnasium.make(**arguments)
    try:
        yield made, _worm(made)
    finally:
        made.close()


def play(policy: Policy, env: Env, seed: int) -> Iterator[Step]:
    """Play one seeded episode: its start, then step by step.

    An environment without a time limit is left after as many steps as its task is made for.

    Raises
    ------
    ValueError
        What is no policy, no environment of one worm, no seed or no action.
    """
    if not callable(policy):
        hint = "; of a model: lambda seen: model.predict(seen, deterministic=True)[0]" * hasattr(policy, "predict")
        raise invalid_value("policy", policy, f"must be callable, from an observation to an action{hint}")
    act = GaitPolicy(policy) if isinstance(policy, Gait) else policy
    left = -1 if _has_limit(env) else _worm(env).task.time_limit
    observation, info = env.reset(seed=whole("seed", seed, 0))
    if (reset := getattr(act, "reset", None)) is not None:
        try:
            signature(reset).bind(env, seed)
        except TypeError as error:
            raise ValueError(f"policy.reset: must take (env, seed), see lattice_gym.policies.base: {error}") from None
        reset(env, seed)
    yield Step(0.0, info)
    done = False
    while not done:
        observation, reward, terminated, truncated, info = env.step(act(observation))
        left -= 1
        done = terminated or truncated or left == 0
        yield Step(float(reward), info)


def _worm(env: Env) -> LatticeWormEnv:
    """Worm inside all wrappers."""
    if not isinstance(env.unwrapped, LatticeWormEnv):
        raise invalid_value("env", env, "must be an environment of one worm, as gymnasium.make gives")
    return env.unwrapped


def _has_limit(env: Env) -> bool:
    """Tell whether a wrapper ends its episodes after some steps."""
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, TimeLimit):
            return True
        env = env.env
    return False
