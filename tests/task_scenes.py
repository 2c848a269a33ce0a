"""What tests of tasks share: the default worm in shapes made by hand."""

from __future__ import annotations

import numpy as np

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.physics.state import Motion, RodState
from lattice_gym.physics.worm import build_model
from lattice_gym.tasks.base import Task

LATTICE = build_lattice(LatticeDesign())
MODEL = build_model(LATTICE, named_layout("all", LATTICE))
SHAPE = LATTICE.position.reshape(-1, 3)


def shaped(position: FloatArray) -> RodState:
    """State at rest but for the positions of the structure rods."""
    state = MODEL.rest_state()
    state.position[: len(position)] = position
    return state


def terms_of(task: Task, state: RodState, activation: FloatArray, time: float) -> dict[str, float]:
    """Terms of the only worm."""
    step_end = Motion.of(state), activation[None], np.array([time])
    task.memory.update(task.remember(*step_end))
    terms = task.reward_terms(*step_end)
    return {name: value.item() for name, value in terms.items()}


def observed(task: Task, state: RodState, time: float) -> FloatArray:
    """Return what the only worm sees of its command."""
    seen: FloatArray = task.observe(Motion.of(state), np.array([time]))[0]
    return seen


REST = shaped(SHAPE)
CALM = np.zeros(90)


def tipped(angle: float, azimuth: float) -> RodState:
    """Rest positions turned about the horizontal axis that tips the z axis towards an azimuth."""
    across, up = np.array([np.cos(azimuth), np.sin(azimuth), 0.0]), np.array([0.0, 0.0, 1.0])
    x, z = SHAPE @ across, SHAPE @ up
    turned_x, turned_z = np.cos(angle) * x + np.sin(angle) * z, np.cos(angle) * z - np.sin(angle) * x
    return shaped(SHAPE + np.outer(turned_x - x, across) + np.outer(turned_z - z, up))
