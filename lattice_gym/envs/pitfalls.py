"""Warnings of arguments that are legal and cost or change more than one would think, with the figures."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any

from lattice_gym.body.design import LatticeDesign
from lattice_gym.checks import Parameters, names
from lattice_gym.envs.scene import Scene
from lattice_gym.physics.world import World
from lattice_gym.tasks.base import Task
from lattice_gym.tasks.registry import DECIDED, TASKS

WORTH_A_WARNING = 10.0
"""So many times shorter, or softer."""
SHORT_DT = 5e-5
"""No longer step is looked at [s]: the tasks' own scenes have longer ones at any fidelity."""
OPTIONS = ("hill", "world", "adaptation", "randomise")
"""Arguments of a scene, beside the design, that may shorten its step."""


def warn_of_pitfalls(scene: Scene, arguments: Mapping[str, Any]) -> None:
    """Warn of the pitfalls among the arguments that a scene was made of."""
    found = (
        _dropped_design(scene.task_class, arguments.get("design")),
        _dropped_world(scene, arguments.get("world")),
        _short_step(scene, arguments),
        _soft_joints(scene),
    )
    for text in found:
        if text:
            warnings.warn(text, stacklevel=4)


def _dropped_design(task: type[Task], given: object) -> str:
    """Name the fields of a design that have the default where the task has something else, and nobody decided that."""
    if not isinstance(given, LatticeDesign):
        return ""
    own = names(f"{task.__name__}.design", task.design, [item.name for item in fields(LatticeDesign)], "values")
    decided, label = getattr(given, DECIDED, ()), repr(task.name) if TASKS.get(task.name) is task else task.__name__
    dropped = {name: values for name, values in _dropped(given, own).items() if name not in decided}
    return _told("design: this LatticeDesign", dropped, task, f"lattice_gym.design_for({label}, ...)")


def _dropped_world(scene: Scene, given: World | Mapping[str, Any] | None) -> str:
    """Name likewise the fields of a world that is an object, and of parts that are objects in a dict."""
    whole, parts = isinstance(given, World), vars(given) if isinstance(given, World) else given or {}
    objects = {name: part for name, part in parts.items() if whole or isinstance(part, Parameters)}
    if not objects:
        return ""
    try:
        own = vars(scene.task_class.world(scene.lattice))
    except ValueError:  # It has none that fits this body.
        return ""
    dropped = _dropped(World(**objects), {name: own[name] for name in objects})
    return _told("world: this world", dropped, scene.task_class, "the task's own by a dict of what differs")


def _dropped(given: Parameters, own: Mapping[str, object]) -> dict[str, tuple[object, object]]:
    """Where an object has the default and a task something else: both values by field, those of parts dotted."""
    found, default = dict[str, tuple[object, object]](), type(given)()
    for name, value in own.items():
        has = getattr(given, name)
        if isinstance(value, Parameters) and type(has) is type(value):
            found |= {f"{name}.{field}": values for field, values in _dropped(has, vars(value)).items()}
        elif has == getattr(default, name) != value:
            found[name] = has, value
    return found


def _told(what: str, dropped: Mapping[str, tuple[object, object]], task: type[Task], start: str) -> str:
    """Tell of all that is dropped, if anything is; `start` says what to start from instead."""
    if not dropped:
        return ""
    has, own = (", ".join(f"{name} = {values[side]!r}" for name, values in dropped.items()) for side in (0, 1))
    return (
        f"{what} has the default {has} where {task.name} has {own}: start from {start}; where the default is meant, "
        "give to_dict() of it"
    )


def _short_step(scene: Scene, arguments: Mapping[str, Any]) -> str:
    """Name the argument without which the physics step would be many times longer."""
    if arguments.get("dt") is not None or scene.dt > SHORT_DT:
        return ""
    longer = {}
    for name, others in _without_one(scene, arguments):
        try:
            longer[name] = Scene(**others).dt
        except ValueError:  # what is left cannot be built
            continue
    name = max(longer, key=lambda name: longer[name], default="")
    if not name or longer[name] < WORTH_A_WARNING * scene.dt:
        return ""
    return (
        f"{name}: the physics step is {scene.dt:.3g} s, {longer[name]:.3g} s without it: everything takes "
        f"{longer[name] / scene.dt:.0f} times as long"
    )


def _without_one(scene: Scene, arguments: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Arguments of the same scene without one option, or with one field of the design as the task has it."""
    for name in OPTIONS:
        if arguments.get(name) is not None:
            yield name, {**arguments, name: None}
    own = {**vars(LatticeDesign()), **scene.task_class.design}
    given = scene.design.to_dict()
    for name, value in given.items():
        if value != own[name]:
            yield f"design.{name} = {value!r}", {**arguments, "design": {**given, name: own[name]}}


def _soft_joints(scene: Scene) -> str:
    """Name the stiffness of joints that give way far more, beside the rods, than those of the paper's body."""
    design = scene.design
    softer = _rods_over_joints(design) / _rods_over_joints(LatticeDesign())
    if softer < WORTH_A_WARNING:
        return ""
    return (
        f"design.joint_stiffness = {design.joint_stiffness!r} N/m: beside the rods, joints give way {softer:.0f} times "
        f"as much as in the default design, and the body follows its muscles the less; "
        f"{softer * design.joint_stiffness:.3g} N/m has its proportion"
    )


def _rods_over_joints(design: LatticeDesign) -> float:
    """Stiffness of a structure rod in stretch, over the height of a segment, beside that of a joint."""
    stretch = design.structure_youngs_modulus * math.pi * design.structure_radius**2
    return stretch * design.n_segment / design.height / design.joint_stiffness
