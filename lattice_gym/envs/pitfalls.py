"""Warnings of arguments that are legal and cost or change more than one would think, with the figures."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from typing import Any

from lattice_gym.body.design import LatticeDesign
from lattice_gym.envs.scene import Scene

WORTH_A_WARNING = 10.0
"""So many times shorter, or softer."""
SHORT_DT = 5e-5
"""No longer step is looked at [s]: the tasks' own scenes have longer ones at any fidelity."""
OPTIONS = ("hill", "world", "adaptation", "randomise")
"""Arguments of a scene, beside the design, that may shorten its step."""


def warn_of_pitfalls(scene: Scene, arguments: Mapping[str, Any]) -> None:
    """Warn of the pitfalls among the arguments that a scene was made of."""
    for text in (_short_step(scene, arguments), _soft_joints(scene)):
        if text:
            warnings.warn(text, stacklevel=4)


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
    own = {**vars(LatticeDesign()), **scene.task.design}
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
