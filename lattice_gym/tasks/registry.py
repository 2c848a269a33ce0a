"""Every task of this package by name, and those of anybody else by class or "module:Class"."""

from __future__ import annotations

import pkgutil
import warnings
from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache
from inspect import get_annotations
from typing import Any

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import MuscleLayout
from lattice_gym.checks import instance, invalid_value, names, subclass
from lattice_gym.tasks.base import GoalTask, RewardTerm, Task
from lattice_gym.tasks.bending import Bending
from lattice_gym.tasks.compression import Compression
from lattice_gym.tasks.crawl import Crawl
from lattice_gym.tasks.extension import Extension
from lattice_gym.tasks.gait import Gait
from lattice_gym.tasks.peristalsis import Peristalsis
from lattice_gym.tasks.reach import Reach
from lattice_gym.tasks.transport import Transport

TASKS: dict[str, type[Task]] = {
    task.name: task for task in (Extension, Compression, Bending, Peristalsis, Reach, Crawl, Transport)
}
"""Every task of this package by name."""
NEEDED = ("name", "time_limit", "rewards")
"""What a task must state beside its methods."""
DECIDED = "_decided"
"""Attribute of what `design_for` makes: the fields that its caller gave."""
OTHER_NAMES = {
    "blank_memory": "initial_memory",
    "over": "terminated",
    "reset": "initial_memory",
    "surroundings": "world",
}
"""Names that parts of a task once had, or have elsewhere, and those that they have here."""


def resolve_task(task: object) -> type[Task]:
    """Return the task of a name in TASKS, of a string "module:Class", or that is given as a class.

    Raises
    ------
    ValueError
        Something else, a module that cannot be imported, or a class that lacks what a task must have.

    Warns
    -----
    UserWarning
        Once for each name of a class that is nearly a part of `Task`, but none.
    """
    kind = subclass("task", task, Task, TASKS)  # type: ignore[type-abstract]
    missing = [name for name in NEEDED if not hasattr(kind, name)] + sorted(kind.__abstractmethods__)
    if missing:
        raise invalid_value("task", task, f"lacks {', '.join(missing)}")
    _check_class(kind)
    return kind


@cache
def _check_class(kind: type[Task]) -> None:
    """Refuse values that cannot be those of a task, and warn of misspelt names; once for each class."""
    label, limit = kind.__name__, kind.time_limit
    if not isinstance(kind.name, str) or not kind.name:
        raise invalid_value(f"{label}.name", kind.name, "must be a text of at least one character")
    if not isinstance(limit, int) or isinstance(limit, bool) or limit < 1:
        raise invalid_value(f"{label}.time_limit", limit, "must be a whole number of control steps, such as 40")
    for name, term in names(f"{label}.rewards", kind.rewards, kind.rewards, "RewardTerm").items():
        instance(f"{label}.rewards[{name!r}]", term, RewardTerm, "; use RewardTerm(weight, low, high)")
    parts = {part for base in (Task, GoalTask) for part in {**vars(base), **get_annotations(base)} if part[0] != "_"}
    for part in sorted(parts):
        if callable(getattr(Task, part, None)) and not callable(found := getattr(kind, part)):
            raise invalid_value(f"{label}.{part}", found, "must be a method; leave it out for the default")
    own = [name for base in kind.__mro__ if issubclass(base, Task) for name in vars(base) if name[0] != "_"]
    for name in dict.fromkeys(name for name in own if name not in parts):
        near = [OTHER_NAMES[name]] if name in OTHER_NAMES else get_close_matches(name, parts, 1, 0.85)
        if near:
            warnings.warn(
                f"{label}.{name} is no part of Task, so nothing uses it by itself: if {near[0]} is meant, rename it",
                stacklevel=4,
            )


def task_label(task: type[Task]) -> str:
    """Return the string of which `resolve_task` makes this task again; a ValueError if there is none."""
    if TASKS.get(task.name) is task:
        return task.name
    label = f"{task.__module__}:{task.__qualname__}"
    try:
        found = pkgutil.resolve_name(label)
    except (ImportError, AttributeError, ValueError):
        found = None
    if found is not task:
        raise invalid_value("task", task, f"cannot be imported as {label!r}; define it at the top of a module")
    return label


def design_for(task: str | type[Task], **changes: Any) -> LatticeDesign:
    """Return the design that a task is meant for, with changes by field: `design_for("crawl", height=0.2)`."""
    design = LatticeDesign.from_dict({**resolve_task(task).design, **changes})
    object.__setattr__(design, DECIDED, frozenset(changes))
    return design


def gait(task: str | type[Task], lattice: Lattice, layout: MuscleLayout, command: Mapping[str, float]) -> Gait:
    """Return the open-loop gait of a task, given what it commands; muscles of no use to it rest.

    A command is the task's own (`env.unwrapped.task.command`): bending needs `azimuth`, reach `azimuth`,
    `radius` and `rise`, crawl and transport `direction`, peristalsis `speed`, `wavelength`, `amplitude` and `phase`.

    Raises
    ------
    ValueError
        A task that has none, or a command that lacks what it needs.
    """
    kind = resolve_task(task)
    found = kind.gait(lattice, layout, command)
    if found is None:
        raise invalid_value("task", task, f"{kind.name} has no gait")
    return found
