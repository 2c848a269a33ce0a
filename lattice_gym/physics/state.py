"""What moves: the state of an assembly, and what is seen of many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from lattice_gym.checks import FloatArray, IntArray, array, number, require
from lattice_gym.physics.rod import FRAME_TOLERANCE

if TYPE_CHECKING:
    from lattice_gym.physics.assembly import Clamp, RodModel


_DRIFT_TOLERANCE = 1e-6
"""Frames are turned step by step and never mended: a million steps leave about 1e-10."""


def _no_ball() -> FloatArray:
    return np.zeros((0, 3))


@dataclass(frozen=True, kw_only=True, eq=False)
class RodState:
    """What moves: all that is needed to go on exactly."""

    position: FloatArray
    """Node positions [m], shape (n_node, 3)."""
    velocity: FloatArray
    """Node velocities [m/s], shape (n_node, 3)."""
    directors: FloatArray
    """Rows d1, d2, d3 of each element, shape (n_elem, 3, 3)."""
    omega: FloatArray
    """Angular velocities in the material frame [rad/s], shape (n_elem, 3)."""
    ball_position: FloatArray = field(default_factory=_no_ball)
    """Position of the ball's centre [m], shape (n_ball, 3)."""
    ball_velocity: FloatArray = field(default_factory=_no_ball)
    """[m/s], shape (n_ball, 3)"""
    ball_omega: FloatArray = field(default_factory=_no_ball)
    """Angular velocity in the laboratory frame [rad/s], shape (n_ball, 3)."""
    time: float = 0.0
    """[s]"""

    def __repr__(self) -> str:
        n_node, n_elem, n_ball = map(len, (self.position, self.directors, self.ball_position))
        return f"RodState({n_node} nodes, {n_elem} elements, {n_ball} balls, time {self.time:.6g} s)"

    def copy(self) -> RodState:
        """Return a state that shares no memory with this one."""
        arrays = {name: value.copy() for name, value in vars(self).items() if name != "time"}
        return replace(self, **arrays)

    def check(self, model: RodModel) -> None:
        """Raise ValueError unless shapes fit `model`, all is finite, frames are frames and what is clamped rests."""
        shapes = {
            "position": (model.n_node, 3),
            "velocity": (model.n_node, 3),
            "directors": (model.n_elem, 3, 3),
            "omega": (model.n_elem, 3),
            "ball_position": (model.n_ball, 3),
            "ball_velocity": (model.n_ball, 3),
            "ball_omega": (model.n_ball, 3),
        }
        for name, shape in shapes.items():
            array(f"RodState.{name}", getattr(self, name), shape)
        number("RodState.time", self.time, unit="s")
        d1, d2, d3 = (self.directors[:, row] for row in range(3))
        skew = np.abs(self.directors @ self.directors.transpose(0, 2, 1) - np.eye(3)).max()
        require(bool(skew < _DRIFT_TOLERANCE), "RodState.directors: must be orthonormal")
        right_handed = bool((np.sum(np.cross(d1, d2) * d3, axis=1) > 0.0).all())
        require(right_handed, "RodState.directors: must be right-handed")
        (nodes, place, tolerance), (elements, frames) = model.clamped_nodes, model.clamped_elements
        clamped = [clamp for clamp in model.clamps if clamp.node is not None]
        gap = np.abs(self.position[nodes] - place)
        _refuse_any(~(gap < tolerance[:, None]), clamped, "RodState.position: {} must stay at rest")
        _refuse_any(self.velocity[nodes] != 0.0, clamped, "RodState.velocity: {} moves")
        clamped = [clamp for clamp in model.clamps if clamp.element is not None]
        turn = np.abs(self.directors[elements] - frames).reshape(-1, 9)
        _refuse_any(~(turn < FRAME_TOLERANCE), clamped, "RodState.directors: {} must stay at rest")
        _refuse_any(self.omega[elements] != 0.0, clamped, "RodState.omega: {} turns")


def _refuse_any(wrong: npt.NDArray[np.bool_], clamps: Sequence[Clamp], message: str) -> None:
    """Raise ValueError that names the first clamp with something wrong in its row."""
    if wrong.any():
        raise ValueError(message.format(clamps[int(np.argmax(wrong.any(axis=1)))]))


class Motion(NamedTuple):
    """What is seen of worms that move side by side: one row a worm."""

    position: FloatArray
    """Node positions [m], shape (n_worm, n_node, 3)."""
    velocity: FloatArray
    """Node velocities [m/s], shape (n_worm, n_node, 3)."""
    ball_position: FloatArray
    """Positions of the balls' centres [m], shape (n_worm, n_ball, 3)."""
    ball_velocity: FloatArray
    """[m/s], shape (n_worm, n_ball, 3)"""

    def __repr__(self) -> str:
        return f"Motion({len(self.position)} worms, {self.position.shape[-2]} nodes)"

    @classmethod
    def of(cls, state: RodState) -> Motion:
        """Motion of a single worm."""
        return cls(state.position[None], state.velocity[None], state.ball_position[None], state.ball_velocity[None])

    def rows(self, worms: IntArray) -> Motion:
        """Motion of some of the worms, shape (n,) of their rows."""
        return Motion(*(part[worms] for part in self))
