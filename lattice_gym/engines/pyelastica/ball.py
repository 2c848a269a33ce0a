"""The ball: its contact with rods, and the friction there."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
from elastica.dissipation import DamperBase
from elastica.external_forces import NoForces
from elastica.rigidbody.sphere import Sphere
from elastica.rod.cosserat_rod import CosseratRod

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.pyelastica.law import START, Bodies, Law, Simulator
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.laws.ball import BallLaw, RigidBall
from lattice_gym.physics.state import RodState

_SWEEPS, _TOLERANCE = 6, 1e-9
"""Largest number of symmetric projected Gauss-Seidel sweeps, and the relative change of friction at which they end."""


def make_sphere(ball: RigidBall | None) -> Sphere | None:
    """Rigid body of a ball, if there is one."""
    if ball is None:
        return None
    return Sphere(ball.position.copy(), ball.radius, ball.mass / (4.0 / 3.0 * np.pi * ball.radius**3))


def reset_frame(sphere: Sphere) -> None:
    """Reset the ball's frame to the laboratory's: the orientation of a uniform ball has no effect and is no state."""
    frame = sphere.director_collection[..., 0]
    sphere.omega_collection[:, 0] = frame.T @ sphere.omega_collection[:, 0]
    sphere.director_collection[..., 0] = np.eye(3)


class _Touches:
    """Where the ball touches elements in a step, n of them: written by its contact, read by its friction.

    `first` holds the row of each element's first node, `share` what its nodes bear by the lever rule, shape (2, n);
    `gap` [m] leads from the centre line to the ball's centre, along `normal`, and `early` is the slip before the kick
    [m/s], shape (n, 3); `max_friction` is the largest friction [N], shape (n,). `power` is what both dissipate [W].
    """

    def __init__(self, bodies: Bodies) -> None:
        self.bodies = bodies
        self.first = np.zeros(0, np.int64)
        self.share, self.gap, self.normal, self.early = np.zeros((2, 0)), *np.zeros((3, 0, 3))
        self.max_friction = np.zeros(0)
        self.power = 0.0

    def slip(self, ball: Sphere) -> tuple[FloatArray, FloatArray]:
        """Velocity of the ball over each element [m/s], along the surface, shape (n, 3), and off it, shape (n,)."""
        spin = ball.director_collection[..., 0].T @ ball.omega_collection[:, 0]
        speed = self.bodies.velocities()
        share_a, share_b = self.share[..., None]
        apart = ball.velocity_collection[:, 0] - np.cross(spin, self.gap)
        apart = apart - share_a * speed[self.first] - share_b * speed[self.first + 1]
        rate = np.sum(apart * self.normal, axis=1)
        return apart - rate[:, None] * self.normal, rate

    def on_nodes(self, force: FloatArray) -> FloatArray:
        """Share forces at the touches, shape (n, 3), between the nodes of their elements, shape (n_node, 3)."""
        shared = np.zeros((self.bodies.model.n_node, 3))
        for node, share in zip((self.first, self.first + 1), self.share, strict=True):
            np.add.at(shared, node, share[:, None] * force)
        return shared


class _NormalForce(NoForces[Sphere]):
    """Constant force on the ball, and the normal force of its contact with every rod, see `physics.laws.ball`.

    PyElastica's RodSphereContact takes the middles of elements for their starts, half an element off, and its friction
    turns no ball. All rods are here at once, as the friction of each touch depends on that of others.
    """

    def __init__(self, bodies: Bodies, ball: RigidBall, touches: _Touches) -> None:
        super().__init__()
        self.bodies, self.ball, self.touches = bodies, ball, touches
        self.distance = ball.radius + bodies.model.element_radius
        self.first = bodies.model.lower_node

    def apply_forces(self, system: Sphere, time: np.float64 = START) -> None:
        ball, touches = self.ball, self.touches
        system.external_forces[:, 0] += ball.force
        place = self.bodies.positions()
        start, side = place[self.first], place[self.first + 1] - place[self.first]
        gap = system.position_collection[:, 0] - start
        share_b = np.clip(np.sum(gap * side, axis=1) / np.sum(side * side, axis=1), 0.0, 1.0)
        gap = gap - share_b[:, None] * side
        distance = np.linalg.norm(gap, axis=1)
        hit = np.flatnonzero(distance < self.distance)
        touches.first, touches.share, touches.gap = (
            self.first[hit],
            np.stack([1.0 - share_b[hit], share_b[hit]]),
            gap[hit],
        )
        touches.normal = gap[hit] / np.where(distance > 0.0, distance, 1.0)[hit, None]
        touches.early, rate = touches.slip(system)
        spring = ball.stiffness * (self.distance - distance)[hit]
        push = np.maximum(spring - ball.damping * rate, 0.0)
        touches.max_friction = ball.friction * push
        system.external_forces[:, 0] += push @ touches.normal
        on_node = np.zeros_like(place)
        for node, share in zip((touches.first, touches.first + 1), touches.share, strict=True):
            np.subtract.at(on_node, node, (share * push)[:, None] * touches.normal)
        self.bodies.add_node_forces(on_node)
        touches.power = float(np.sum((spring - push) * rate))


class _Friction(DamperBase[Sphere]):
    """Coulomb friction of the ball: impulses against the slip that all else left, bounded by the normal ones.

    It comes last of all, see `ground`. A unit of force adds `node_kick`, shape (n_node,), to the velocity of a node in
    a step; `kick` are the two numbers of the ball, for force and torque.
    """

    def __init__(self, touches: _Touches, node_kick: FloatArray, kick: tuple[float, float], **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.touches, self.node_kick, self.kick = touches, node_kick, kick

    def dampen_rates(self, system: Sphere, time: np.float64 = START) -> None:
        touches, frictional = self.touches, np.flatnonzero(self.touches.max_friction > 0.0)
        if frictional.size == 0:
            return
        drag = np.zeros_like(touches.gap)
        slip, _ = touches.slip(system)
        drag[frictional] = self._solve_friction(slip[frictional], frictional)
        moment = np.cross(touches.gap, drag).sum(axis=0)
        system.velocity_collection[:, 0] += self.kick[0] * drag.sum(axis=0)
        system.omega_collection[:, 0] -= system.director_collection[..., 0] @ (self.kick[1] * moment)
        moved = self.node_kick[:, None] * touches.on_nodes(drag)
        for index, rod in enumerate(touches.bodies.rods):
            rod.velocity_collection -= moved[touches.bodies.model.nodes(index)].T
        slip, _ = touches.slip(system)
        touches.power -= 0.5 * float(np.sum(drag * (touches.early + slip)))

    def _solve_friction(self, slip: FloatArray, frictional: IntArray) -> FloatArray:
        """Friction [N] of the touches `frictional`, given the slip there without any [m/s], both of shape (n, 3).

        By projected Gauss-Seidel on the Delassus matrix, in the order of the elements and back.
        """
        own, delassus = self._delassus(frictional)
        max_friction, drag = self.touches.max_friction[frictional], np.zeros_like(slip)
        forth = range(len(frictional))
        for _ in range(_SWEEPS):
            change = 0.0
            for order in (forth, reversed(forth)):
                before = drag.copy()
                for k in order:
                    new = drag[k] - (slip[k] + delassus[k] @ drag.ravel()) / own[k]
                    size = math.sqrt(new @ new)
                    drag[k] = new if size <= max_friction[k] else max_friction[k] / size * new
                change = max(change, float(np.linalg.norm(drag - before, axis=1).max()))
            if not change > _TOLERANCE * max_friction.max():
                break
        return drag

    def _delassus(self, frictional: IntArray) -> tuple[FloatArray, FloatArray]:
        """Change of the slip of each touch in a step, per unit of its own friction and of that of any [m/(N s)].

        Of the shapes (n,) and (n, 3, 3 n): the former is one number in all directions along the surface.
        """
        gap, normal, n_touch = self.touches.gap[frictional], self.touches.normal[frictional], len(frictional)
        node = self.touches.first[frictional] + np.array([[0], [1]])
        alike = self.kick[0] + self.kick[1] * (gap @ gap.T)
        for one, share in zip(node, self.touches.share[:, frictional], strict=True):
            given = self.node_kick[one] * share
            for other, bears in zip(node, self.touches.share[:, frictional], strict=True):
                alike += np.where(one[:, None] == other, given[:, None] * bears, 0.0)
        matrix = alike[:, None, :, None] * np.eye(3)[:, None] - self.kick[1] * np.einsum("bi,aj->aibj", gap, gap)
        matrix -= normal[:, :, None, None] * np.einsum("ai,aibj->abj", normal, matrix)[:, None]
        return np.diag(alike), matrix.reshape(n_touch, 3, 3 * n_touch)


class Ball(Law):
    """A rigid ball among the rods."""

    law = BallLaw

    def __init__(self, bodies: Bodies) -> None:
        super().__init__(bodies)
        assert bodies.model.ball is not None
        self._law, self._touches = bodies.model.ball, _Touches(bodies)

    @property
    def _sphere(self) -> CosseratRod:
        return cast(CosseratRod, self.bodies.sphere)  # the simulator takes any system, annotated as rods

    def add_forces(self, simulator: Simulator) -> None:
        """Add the ball's constant force, and its contact with every rod."""
        simulator.add_forcing_to(self._sphere).using(_NormalForce, self.bodies, self._law, self._touches)

    def add_dampers(self, simulator: Simulator) -> None:
        """Add the friction of the ball, to which clamped nodes give way nowhere."""
        if self._law.friction == 0.0:
            return
        node_kick, dt = self.bodies.node_kick(), self.bodies.dt
        node_kick[self.bodies.model.clamped_nodes[0]] = 0.0
        kick = dt / self._law.mass, dt / self._law.inertia
        simulator.dampen(self._sphere).using(_Friction, self._touches, node_kick, kick)

    def flow(self, before: RodState) -> Flow:
        """Energy that dashpots and friction took."""
        return Flow(dissipated=self.bodies.dt * self._touches.power)
