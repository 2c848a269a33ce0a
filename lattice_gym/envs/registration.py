"""Gymnasium ids of tasks."""

from __future__ import annotations

import warnings

import gymnasium
from gymnasium.envs.registration import EnvSpec

from lattice_gym.checks import brief, flag, invalid_value
from lattice_gym.tasks.base import GoalTask, Task
from lattice_gym.tasks.registry import TASKS, resolve_task, task_label

_warned: set[tuple[str, type[Task]]] = set()

DEFAULT_TASK = "peristalsis"
"""Task of the id without a task's name."""


def register_task(task: str | type[Task], id: str, goals: bool = False) -> None:
    """Register an id for a task, with its time limit, for `gymnasium.make` and `gymnasium.make_vec`.

    Parameters
    ----------
    task
        As in `LatticeWormEnv`: a name, "module:Class", or a class that can be imported from its module, so that specs
        survive JSON.
    id
        Such as "Twist-v0".
    goals
        Whether goals are observed apart, as `LatticeWormGoalEnv` does; for a `GoalTask`.

    Raises
    ------
    ValueError
        What is no task, or a class of `__main__`; goals of a task that has none; an id that is no text, or already
        something else. The same again is fine.
    gymnasium.error.Error
        What is no id.

    """
    kind = resolve_task(task)
    if not isinstance(id, str):
        raise invalid_value("id", id, 'must be a text such as "Twist-v0"')
    if kind.__module__ == "__main__":
        must = "is a class of __main__, which no other process can import; put it in a module of its own"
        raise invalid_value("task", task, must)
    if flag("goals", goals) and not issubclass(kind, GoalTask):
        raise invalid_value("goals", goals, f"{kind.name} is no GoalTask")
    entry, vector = (
        ("goal:LatticeWormGoalEnv", "goal:LatticeWormGoalVectorEnv")
        if goals
        else ("env:LatticeWormEnv", "vector:LatticeWormVectorEnv")
    )
    spec = EnvSpec(
        id,
        entry_point=f"lattice_gym.envs.{entry}",
        max_episode_steps=kind.time_limit,
        kwargs={"task": task_label(kind)},
        vector_entry_point=f"lattice_gym.envs.{vector}",
    )
    known = gymnasium.registry.get(id)
    if known is None:
        gymnasium.register(
            id,
            entry_point=spec.entry_point,
            max_episode_steps=spec.max_episode_steps,
            kwargs=spec.kwargs,
            vector_entry_point=spec.vector_entry_point,
        )
    elif known != spec:
        raise invalid_value("id", id, f"is registered already, as {brief(known)}")


def register_builtin_tasks() -> None:
    """Register the ids of this package: one for each task, one more for each that has goals, and `LatticeWorm-v0`."""
    register_task(DEFAULT_TASK, "LatticeWorm-v0")
    for name, task in TASKS.items():
        register_task(task, f"LatticeWorm{name.title()}-v0")
        if issubclass(task, GoalTask):
            register_task(task, f"LatticeWorm{name.title()}Goal-v0", goals=True)


def warn_of_time_limit(spec: EnvSpec | None, task: type[Task], n_step: int) -> None:
    """Warn once of an id whose time limit is not its task's, where that ends episodes after so many steps.

    Many worms ask when `gymnasium.make_vec` tells them their id; it has told them the limit before. One worm is never
    told by `gymnasium.make`, which may have been given another than the registered one. It asks at its reset and its
    end, for by then it has seen after how many steps an episode was over.
    """
    registered = None if spec is None else gymnasium.registry.get(spec.id)
    if spec is None or registered is None or (spec.id, task) in _warned:
        return
    if n_step == registered.max_episode_steps != task.time_limit:
        _warned.add((spec.id, task))
        warnings.warn(
            f"{spec.id} ends episodes after {n_step} steps, {task.name} is made for {task.time_limit}: give "
            f"max_episode_steps={task.time_limit}, or an id of its own with lattice_gym.register_task",
            stacklevel=3,
        )
