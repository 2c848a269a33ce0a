"""The environments whose goals are observed apart, for hindsight replay."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from lattice_gym.checks import FloatArray, invalid_value
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.vector import LatticeWormVectorEnv
from lattice_gym.tasks.base import DIVERGENCE, GoalTask, Task


class LatticeWormGoalEnv(LatticeWormEnv):
    """A `LatticeWormEnv` whose goals are observed apart, as hindsight replay wants it; for tasks that have goals.

    Its observation is a Dict: "observation" is that of `LatticeWormEnv` without what the task commands, "achieved_goal"
    and "desired_goal" are Boxes. Goals of reach are the displacement of the top's centre from rest (x, y, z), in units
    of 0.2 body lengths, within +-10. All else is as in `LatticeWormEnv`; `LatticeWormReachGoal-v0` is its id.

    Give a `HerReplayBuffer` `copy_info_dict=True`: without the infos of its steps `compute_reward` knows neither effort
    nor divergence, and refuses to pay.
    """

    _goals_apart = True

    def compute_reward(
        self, achieved_goal: npt.NDArray[Any], desired_goal: npt.NDArray[Any], info: Any
    ) -> float | FloatArray:
        """Reward of a step with these goals: exactly that of `step` where they are its own.

        Goals of shape (n_goal,) and the `info` of the step give a float; (n, n_goal) and n infos, or one for all, give
        shape (n,). The terms that goals do not decide are taken from `reward_terms`. None in place of an info counts
        the goals alone.

        Raises
        ------
        ValueError
            An info without `reward_terms`, such as the empty ones of a replay buffer that keeps none: then a step that
            diverged would be paid its plain approach instead of the penalty. As many infos as there are no goals.
        """
        return _goal_reward(self.task, achieved_goal, desired_goal, info)


class LatticeWormGoalVectorEnv(LatticeWormVectorEnv):
    """A `LatticeWormVectorEnv` of `LatticeWormGoalEnv`s: goals are observed apart, in a dict of three arrays."""

    _goals_apart = True

    def compute_reward(
        self, achieved_goal: npt.NDArray[Any], desired_goal: npt.NDArray[Any], info: Any
    ) -> float | FloatArray:
        """Rewards of steps with these goals, as `LatticeWormGoalEnv.compute_reward` with infos of single worms."""
        return _goal_reward(self.worms.task, achieved_goal, desired_goal, info)


def _goal_reward(task: Task, achieved: npt.NDArray[Any], desired: npt.NDArray[Any], info: Any) -> float | FloatArray:
    """Reward of steps with these goals."""
    assert isinstance(task, GoalTask)  # The scene refuses any other.
    reward = task.weights[task.goal_term] * task.goal_reward(achieved, desired)
    terms = [{} if entry is None else entry["reward_terms"] for entry in _infos(info, np.size(reward))]
    others = np.array([float(sum(value for name, value in entry.items() if name != task.goal_term)) for entry in terms])
    diverged = np.array([entry.get(DIVERGENCE, 0.0) != 0.0 for entry in terms], dtype=bool)
    if len(terms) > 1:
        others, diverged = others.reshape(np.shape(reward)), diverged.reshape(np.shape(reward))
    total: FloatArray = np.where(diverged, others, reward + others)
    return float(total.item()) if np.ndim(reward) == 0 else total


def _infos(info: Any, count: int) -> list[Mapping[str, Any] | None]:
    """One info for each goal, or one for all; None is one that is known to say nothing."""
    try:
        infos = [info] if info is None or isinstance(info, Mapping) else list(info)
    except TypeError:
        infos = [info]
    if not all(isinstance(entry, Mapping | None) for entry in infos):
        raise invalid_value("info", info, "must be a mapping, None or a sequence of them")
    if any(entry is not None and "reward_terms" not in entry for entry in infos):
        raise ValueError(
            "info: has no reward_terms, so effort and divergence would not count: give the info of the step, a"
            " HerReplayBuffer copy_info_dict=True, or None to count the goals alone"
        )
    if len(infos) != count and not isinstance(info, Mapping | None):
        raise ValueError(f"info: must be one mapping, or as many as there are goals, {count}, got {len(infos)}")
    return infos
