"""Policies that need no learning: a gait, random actions, and nothing at all."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from lattice_gym.checks import FloatArray
from lattice_gym.tasks.gait import group_means

Env = gymnasium.Env[Any, Any]
Action = npt.NDArray[np.float32]


class NoGaitError(ValueError):
    """A task makes no gait for what is commanded."""


class GaitPolicy:
    """Plays a gait, by the time of the worm; muscles that share an action get the mean over them.

    Parameters
    ----------
    gait
        Time [s] to the command of every active muscle, shape (n_muscle,), in [0, 1]; None: in every episode the task's
        own for what is commanded, of which there may be none: NoGaitError.
    """

    def __init__(self, gait: Callable[[float], FloatArray] | None = None) -> None:
        self._given = gait

    def reset(self, env: Env, seed: int) -> None:
        """Make the gait of an episode."""
        worm: Any = env.unwrapped
        gait = self._given or worm.task.gait(worm.lattice, worm.layout, worm.task.command)
        if gait is None:
            raise NoGaitError(f"policy = 'gait': {worm.task.name} has no gait for {worm.task.command}")
        self._worm, self._gait = worm, gait

    def __call__(self, observation: Any) -> Action:
        """Look up the action of the time that it is, shape (n_action,)."""
        worm = self._worm
        action: Action = worm.action_of(group_means(self._gait(worm.time), worm.groups)).astype(np.float32)
        return action


class DoNothing:
    """Leaves every muscle off."""

    def reset(self, env: Env, seed: int) -> None:
        """Look up the action of no command."""
        space: Any = env.action_space
        self._action: Action = space.low.copy()

    def __call__(self, observation: Any) -> Action:
        """Give the action of no command, shape (n_action,)."""
        return self._action


class RandomActions:
    """Draws every action uniformly and independently, also of what the environment draws from the same seed."""

    def reset(self, env: Env, seed: int) -> None:
        """Begin the stream of an episode."""
        self._generator = np.random.default_rng([seed, 1])
        self._space: Any = env.action_space

    def __call__(self, observation: Any) -> Action:
        """Draw an action, shape (n_action,)."""
        action: Action = self._generator.uniform(self._space.low, self._space.high).astype(np.float32)
        return action
