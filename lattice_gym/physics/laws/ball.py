"""A rigid ball that pushes at rods.

An element is a cylinder of its rest radius with round ends. Let d be the depth to which the ball overlaps it, and u the
velocity of the ball's material relative to the centre line at the nearest point of that line. The normal force is

    N = max(0, stiffness d - damping u_n)

The lever rule shares the push between the element's two nodes, and the ball has the opposite force. Stored is
stiffness d^2 / 2. Friction, at most friction N, comes after all forces and damping of a step: it takes all slip u_t
that these leave, or acts against it in full (Coulomb). Which touches stick depends on all of them: with W the Delassus
matrix of the touches, the slip that all frictions F together add, they are the least of

    F.W F / 2 + F.u_t   over all F that are along the surface and |F| <= friction N at each touch

The plain formula finds them by projected gradient descent, to rounding; the engines by six symmetric sweeps at most of
projected Gauss-Seidel iteration. Where touches stick together these leave some of their slip to the steps that follow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from lattice_gym.checks import REQUIRED, FloatArray, Parameters, array, checked, real, require
from lattice_gym.physics.laws.base import Generalised, Law, Linearised, Shortened, one_or_none, vector

if TYPE_CHECKING:
    from lattice_gym.physics.assembly import RodModel
    from lattice_gym.physics.state import RodState

_MAX_DESCENTS, _DESCENDED = 100_000, 1e-15
"""Steps of gradient descent at most, and the change in one, over the largest friction, at which they end."""

N_CENTRES = 256
"""Largest number of elements at whose middles the ball is placed to count what it touches there."""


@dataclass(frozen=True, kw_only=True)
class Ball(Parameters):
    """A rigid ball inside the lattice, whose muscles must then be rods: lines touch nothing.

    A medium carries its share of the ball's weight, but neither the medium's drag nor the ground acts on it.
    """

    radius: float = real(0.03, 1e-4, 10.0, "m")
    """[m]"""
    density: float = real(1000.0, 1e-3, 1e5, "kg/m^3")
    """[kg/m^3]"""
    level: float = real(1.0, 0.0, 1e4, "levels")
    """Where its centre starts, on the axis, in levels from the base."""
    stiffness: float = real(50.0, 1e-6, 1e9, "N/m")
    """Of its contact with an element [N/m]."""
    damping: float = real(0.05, 0.0, 1e6, "N s/m")
    """Of that contact, along the normal [N s/m]."""
    friction: float = real(0.3, 0.0, 100.0, "1")
    """Friction over normal force."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RigidBall(Parameters):
    """Rigid uniform ball that pushes at elements of rods, with friction.

    Its forces act on the centre lines, the opposite ones and their moments on the ball, so that momentum and angular
    momentum close; rods are not twisted.
    """

    position: FloatArray = checked(REQUIRED, array, shape=(3,), unit="m", read_only=True)
    """Where its centre starts [m], shape (3,)."""
    radius: float = real(REQUIRED, 0.0, math.inf, "m", above=True)
    """[m]"""
    mass: float = real(REQUIRED, 0.0, math.inf, "kg", above=True)
    """[kg]"""
    stiffness: float = real(REQUIRED, 0.0, math.inf, "N/m")
    """Of the contact with an element [N/m]."""
    damping: float = real(0.0, 0.0, math.inf, "N s/m")
    """Of that contact, along the normal [N s/m]."""
    friction: float = real(0.0, 0.0, math.inf, "1")
    """Friction over normal force."""
    force: tuple[float, float, float] = checked((0.0, 0.0, 0.0), vector, unit="N")
    """Constant force, as its weight less what the medium carries [N]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        sound = self.inertia > 0.0 and math.isfinite(self.inertia) and math.isfinite(1.0 / self.inertia)
        require(
            sound, "RigidBall.radius, mass: inertia leaves the range of numbers; they are far too large or too small"
        )

    @property
    def inertia(self) -> float:
        """Moment of inertia about any diameter [kg m^2]."""
        return 0.4 * self.mass * self.radius**2


class BallLaw(Law):
    """Weight of the ball, its push at rods, and the friction there."""

    fields: ClassVar = {"ball": one_or_none(RigidBall)}

    @classmethod
    def present(cls, model: RodModel) -> bool:
        """Tell whether there is a ball."""
        return model.ball is not None

    @cached_property
    def ball(self) -> RigidBall:
        """What pushes at rods."""
        assert self.model.ball is not None
        return self.model.ball

    def _gaps(self, state: RodState) -> tuple[FloatArray, FloatArray]:
        """Ways to the centre from the nearest points of all elements [m], shape (n_elem, 3), and their shares."""
        low = self.model.lower_node
        start = state.position[low]
        side, centre = state.position[low + 1] - start, state.ball_position - start
        share = np.clip(np.sum(centre * side, axis=1) / np.sum(side**2, axis=1), 0.0, 1.0)
        return centre - share[:, None] * side, share

    def energy(self, state: RodState) -> Mapping[str, FloatArray]:
        """Kinetic energy of the ball, shape (1,), and of the spring between it and every element, shape (n_elem,)."""
        ball, (gap, _) = self.ball, self._gaps(state)
        square = [np.sum(moving**2, axis=1) for moving in (state.ball_velocity, state.ball_omega)]
        depth = np.maximum(ball.radius + self.model.element_radius - np.linalg.norm(gap, axis=1), 0.0)
        return {
            "ball": 0.5 * ball.mass * square[0] + 0.5 * ball.inertia * square[1],
            "ball_contact": 0.5 * ball.stiffness * depth**2,
        }

    def work(self, before: RodState, after: RodState) -> float:
        """Work of its constant force [J]."""
        return float((after.ball_position - before.ball_position)[0] @ self.ball.force)

    def linearised(self, shortened: Shortened) -> Linearised:
        """Springs and dashpots of all that it may touch."""
        ball = self.ball
        springs, dashpots = (_BallSprings.of(self.model, ball, size) for size in (ball.stiffness, ball.damping))
        return Linearised(
            [springs] if ball.stiffness > 0.0 else [],
            [dashpots] if ball.damping > 0.0 else [],
        )

    def normal_force(self, state: RodState) -> FloatArray:
        """Return the normal force of every element [N], shape (n_elem,)."""
        ball, gap = self.ball, self._gaps(state)[0]
        distance = np.linalg.norm(gap, axis=1)
        depth = ball.radius + self.model.element_radius - distance
        push = ball.stiffness * depth - ball.damping * np.sum(self._velocity(state) * gap, axis=1) / distance
        return np.where(depth > 0.0, np.maximum(push, 0.0), 0.0)

    def slip(self, state: RodState) -> FloatArray:
        """Return the velocity of the ball over every element along the surface [m/s], shape (n_elem, 3)."""
        gap, velocity = self._gaps(state)[0], self._velocity(state)
        off: FloatArray = np.sum(velocity * gap, axis=1)[:, None] * gap / np.sum(gap**2, axis=1)[:, None]
        return velocity - off

    def _velocity(self, state: RodState) -> FloatArray:
        """Velocity of the ball's material over the nearest point of every element [m/s], shape (n_elem, 3)."""
        low, (gap, share) = self.model.lower_node, self._gaps(state)
        own = state.ball_velocity - np.cross(state.ball_omega, gap)
        line = (1.0 - share)[:, None] * state.velocity[low] + share[:, None] * state.velocity[low + 1]
        velocity: FloatArray = own - line
        return velocity

    def force(self, state: RodState, tension: FloatArray) -> Generalised:
        """Constant force and pushes; for friction see `apply_friction`."""
        force, low, (gap, share) = Generalised.zeros(self.model), self.model.lower_node, self._gaps(state)
        on_ball = (self.normal_force(state) / np.linalg.norm(gap, axis=1))[:, None] * gap
        force.ball[:] = self.ball.force + on_ball.sum(axis=0)
        for node, part in ((low, 1.0 - share), (low + 1, share)):
            np.subtract.at(force.node, node, part[:, None] * on_ball)
        return force

    def apply_friction(self, state: RodState, normal: FloatArray, push: FloatArray, dt: float) -> RodState:
        """Return the state with the velocities that friction leaves.

        Parameters
        ----------
        state
            Places at which forces are taken, and velocities that all else leaves.
        normal
            Normal forces [N], shape (n_elem,).
        push
            What a unit force adds to the velocity of a node in a step [s/kg], shape (n_node,).
        dt
            Time step [s].
        """
        ball, n_node, (gap, share) = self.ball, self.model.n_node, self._gaps(state)
        touching = np.flatnonzero(normal > 0.0)
        # Slip of each touch by the velocities of all nodes, of the ball, and its spin.
        slip = np.zeros((len(touching), 3, n_node + 2, 3))
        for own, element in zip(slip, touching, strict=True):
            n, low = gap[element] / np.linalg.norm(gap[element]), self.model.lower_node[element]
            along = np.eye(3) - np.outer(n, n)
            own[:, low], own[:, low + 1] = (share[element] - 1.0) * along, -share[element] * along
            own[:, n_node], own[:, n_node + 1] = along, along @ np.cross(gap[element], np.eye(3)).T
        slips = slip.reshape(-1, 3 * (n_node + 2))
        speed = np.concatenate([state.velocity, state.ball_velocity, state.ball_omega]).ravel()
        pushes = np.repeat([*push, dt / ball.mass, dt / ball.inertia], 3)
        friction = _least(slips * pushes @ slips.T, slips @ speed, ball.friction * normal[touching])
        after = (speed + pushes * (slips.T @ friction)).reshape(-1, 3)
        return replace(
            state, velocity=after[:n_node], ball_velocity=after[n_node : n_node + 1], ball_omega=after[n_node + 1 :]
        )


def _least(delassus: FloatArray, slip: FloatArray, most: FloatArray) -> FloatArray:
    """Least F.W F / 2 + F.u with a size of at most `most` [N] at each of n touches, shape (3 n,)."""
    if not most.any():
        return np.zeros_like(slip)
    friction, step = np.zeros((len(most), 3)), 1.0 / float(np.linalg.eigvalsh(delassus)[-1])
    for _ in range(_MAX_DESCENTS):
        before = friction
        friction = before - step * (delassus @ before.ravel() + slip).reshape(-1, 3)
        friction *= np.minimum(1.0, most / np.maximum(np.linalg.norm(friction, axis=1), np.finfo(float).tiny))[:, None]
        if np.abs(friction - before).max() <= _DESCENDED * most.max():
            break
    return friction.ravel()


@dataclass(frozen=True)
class _BallSprings:
    """Springs (dashpots) between a ball and the elements that it touches.

    What it touches changes. By the lever rule a contact between the shares p and q bears, for any s > 0, no more than
    p (1 + 1/s) and q (1 + 1/s) of its stiffness at either node and 1 + s at the ball, whatever the normal. Here every
    node bears both its elements in full, and the ball all that it may touch; s makes its rate and that of the lightest
    node alike, the sum of both alone.
    """

    size: float
    """Of one contact [N/m] ([N s/m])."""
    on_node: FloatArray
    """Contacts that every node bears, shape (n_node,)."""
    on_ball: float
    """Contacts that the ball bears."""
    coupled = True

    @classmethod
    def of(cls, model: RodModel, ball: RigidBall, size: float) -> _BallSprings:
        on_ball, on_node = _max_touching(model, ball), np.full(model.n_node, 2.0)
        on_node[model.node_offset[:-1]] = on_node[model.node_offset[1:] - 1] = 1.0
        free = np.ones(model.n_node, dtype=np.bool_)
        free[model.clamped_nodes[0]] = False
        given, taken = (on_node / model.node_mass)[free].max(initial=0.0), on_ball / ball.mass
        on_node *= (given + taken) / given if given > 0.0 else 1.0
        return cls(size, on_node, on_ball * ((given + taken) / taken if taken > 0.0 else 1.0))

    def __call__(self, moved: Generalised, against: Generalised) -> None:
        """Add the forces against displacements, in place."""
        against.node[:] += self.size * self.on_node[:, None] * moved.node
        against.ball[:] += self.size * self.on_ball * moved.ball


def _max_touching(model: RodModel, ball: RigidBall) -> float:
    """Largest number of elements that a ball touches at once: those at rest, wherever its centre is on a rod.

    An assumption, no bound: elements come closer to each other where rods are squeezed.
    """
    place, low = model.rest_state().position, model.lower_node
    start = place[low]
    side = place[low + 1] - start
    square, touching = np.sum(side**2, axis=1), (1.0 + 1e-6) * (ball.radius + model.element_radius)
    most = 0
    for centre in [ball.position, *(start + 0.5 * side)[:: math.ceil(model.n_elem / N_CENTRES)]]:
        gap = centre - start
        share = np.clip(np.sum(gap * side, axis=1) / square, 0.0, 1.0)
        most = max(most, int(np.sum(np.sum((gap - share[:, None] * side) ** 2, axis=1) < touching**2)))
    return float(most)
