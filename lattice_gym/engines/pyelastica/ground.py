"""The ground: normal contact and Coulomb friction.

It is ours: PyElastica's `RodPlaneContact` cancels what forces were summed on a node before it came, so that a rod rests
at the depth of its weight over the stiffness or at none at all, as gravity is declared after it or before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from elastica.dissipation import DamperBase
from elastica.external_forces import NoForces
from elastica.rod.cosserat_rod import CosseratRod

from lattice_gym.checks import FloatArray
from lattice_gym.engines.pyelastica.law import START, Bodies, Law, Simulator
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.laws import ground as physics
from lattice_gym.physics.state import RodState


@dataclass(frozen=True, eq=False)
class _Reaction:
    """Reaction of the ground on the nodes of one rod in a step: the normal force writes it, then friction.

    `normal` is the normal force [N] and `dashpot` the dashpot's part of it, shape (n_node,); `friction` is in the plane
    [N], shape (2, n_node).
    """

    normal: FloatArray
    dashpot: FloatArray
    friction: FloatArray


class _NormalForce(NoForces[CosseratRod]):
    """Normal force of the plane z = 0 on the nodes of one rod, whose radii there are given [m], shape (n_node,)."""

    def __init__(self, ground: physics.Ground, radius: FloatArray, reaction: _Reaction) -> None:
        super().__init__()
        self.ground, self.radius, self.reaction = ground, radius, reaction

    def apply_forces(self, system: CosseratRod, time: np.float64 = START) -> None:
        depth = np.maximum(self.radius - system.position_collection[2], 0.0)
        spring = self.ground.stiffness * depth
        dashpot = np.where(depth > 0.0, -self.ground.damping * system.velocity_collection[2], 0.0)
        self.reaction.normal[:] = np.maximum(spring + dashpot, 0.0)
        self.reaction.dashpot[:] = self.reaction.normal - spring
        system.external_forces[2] += self.reaction.normal


class _BodyAxis(NoForces[CosseratRod]):
    """No force: writes the unit vector from the mean first to the mean last node of the given rods, shape (3,)."""

    def __init__(self, rods: list[CosseratRod], axis: FloatArray) -> None:
        super().__init__()
        self.rods, self.axis = rods, axis

    def apply_forces(self, system: CosseratRod, time: np.float64 = START) -> None:
        chord = np.mean([rod.position_collection[:, -1] - rod.position_collection[:, 0] for rod in self.rods], axis=0)
        self.axis[:] = chord / np.linalg.norm(chord)


class _Friction(DamperBase[CosseratRod]):
    """Coulomb friction: an impulse against the slip that all else left, at most its coefficient times the normal one.

    PyElastica damps in the order in which dampers are declared, after all kicks and constraints: this comes last.
    `kick` is what a unit force adds to a node's velocity in a step, shape (n_node,); `axis` is the body's, shape (3,),
    None where friction is the same in all directions.
    """

    def __init__(
        self, ground: physics.Ground, kick: FloatArray, reaction: _Reaction, axis: FloatArray | None, **kwargs: Any
    ) -> None:
        super().__init__(**kwargs)
        self.ground, self.kick, self.reaction, self.axis = ground, kick, reaction, axis

    def dampen_rates(self, system: CosseratRod, time: np.float64 = START) -> None:
        slip, ground = system.velocity_collection[:2], self.ground
        speed = np.hypot(slip[0], slip[1])
        direction = np.divide(slip, speed, out=np.zeros_like(slip), where=speed > 0.0)
        bound = self.reaction.normal * self._factor(direction)
        sticks = speed <= ground.static_friction * bound * self.kick
        kinetic = -ground.kinetic_friction * bound * direction
        # A node that damping stops within a step needs no friction.
        stopping = np.divide(-slip, self.kick, out=np.zeros_like(slip), where=self.kick > 0.0)
        self.reaction.friction[:] = np.where(sticks, stopping, kinetic)
        slip[:] = np.where(sticks, 0.0, slip + kinetic * self.kick)

    def _factor(self, direction: FloatArray) -> FloatArray:
        """Factor on the coefficients of friction for slip in a direction of the plane, shape (2, n_node)."""
        ground = self.ground
        level = np.hypot(direction[0], direction[1])
        factor: FloatArray = ground.sideways * level
        if self.axis is None:
            return factor
        # The same vector on the body axis, on the horizontal across it, and what is left where the axis is tilted.
        e = self.axis
        forth, aside = e[0] * direction[0] + e[1] * direction[1], e[0] * direction[1] - e[1] * direction[0]
        across = np.hypot(aside, e[2] * level)
        along = np.where(forth > 0.0, ground.forward, ground.backward)
        return np.asarray(np.hypot(along * forth, ground.sideways * across))


class Ground(Law):
    """The plane z = 0 under every rod."""

    law = physics.GroundLaw

    def __init__(self, bodies: Bodies) -> None:
        super().__init__(bodies)
        assert bodies.model.ground is not None
        self._law = bodies.model.ground
        self._axis = None if self._law.isotropic else np.zeros(3)
        counts = [rod.n_elem + 1 for rod in bodies.model.rods]
        self._reactions = [_Reaction(np.zeros(n), np.zeros(n), np.zeros((2, n))) for n in counts]

    def add_forces(self, simulator: Simulator) -> None:
        """Add the normal force on every rod, and find the body axis if friction needs it."""
        model, rods = self.bodies.model, self.bodies.rods
        if self._axis is not None:
            solid = [rod for index, rod in enumerate(rods) if index not in model.muscles]
            simulator.add_forcing_to(rods[0]).using(_BodyAxis, solid, self._axis)
        for index, (rod, reaction) in enumerate(zip(rods, self._reactions, strict=True)):
            radius = model.node_radius[model.nodes(index)]
            simulator.add_forcing_to(rod).using(_NormalForce, self._law, radius, reaction)

    def add_dampers(self, simulator: Simulator) -> None:
        """Add the friction on every rod."""
        kick = self.bodies.node_kick()
        for index, (rod, reaction) in enumerate(zip(self.bodies.rods, self._reactions, strict=True)):
            given = kick[self.bodies.model.nodes(index)]
            simulator.dampen(rod).using(_Friction, self._law, given, reaction, self._axis)

    def flow(self, before: RodState) -> Flow:
        """Energy that dashpots and friction took, at the mean velocity."""
        power = 0.0
        for index, (rod, reaction) in enumerate(zip(self.bodies.rods, self._reactions, strict=True)):
            mean = 0.5 * (before.velocity[self.bodies.model.nodes(index)].T + rod.velocity_collection)
            power += float((reaction.dashpot * mean[2]).sum() + (reaction.friction * mean[:2]).sum())
        return Flow(dissipated=-self.bodies.dt * power)
