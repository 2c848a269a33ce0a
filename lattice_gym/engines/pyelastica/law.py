"""What every law is in this engine: forces and dampers for PyElastica's simulator, and the energy that they move."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import numpy as np
from elastica.modules.base_system import BaseSystemCollection
from elastica.modules.connections import Connections
from elastica.modules.constraints import Constraints
from elastica.modules.damping import Damping
from elastica.modules.forcing import Forcing
from elastica.rigidbody.sphere import Sphere
from elastica.rod.cosserat_rod import CosseratRod

from lattice_gym.checks import FloatArray
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.laws import base as laws
from lattice_gym.physics.state import RodState

START = np.float64(0.0)
"""Default of the argument `time` in PyElastica's interfaces; no law here depends on it."""


class Simulator(BaseSystemCollection, Constraints, Connections, Forcing, Damping):
    """PyElastica's simulator with everything a model may hold."""


class Bodies(NamedTuple):
    """What laws act on."""

    model: RodModel
    rods: list[CosseratRod]
    sphere: Sphere | None
    """The ball, if there is one."""
    dt: float
    """Time step [s]."""
    tension: FloatArray
    """Muscle tensions [N], shape (n_muscle, 1), written before each step."""

    def positions(self) -> FloatArray:
        """Positions of all nodes [m], shape (n_node, 3)."""
        return np.concatenate([rod.position_collection.T for rod in self.rods])

    def velocities(self) -> FloatArray:
        """Velocities of all nodes [m/s], shape (n_node, 3)."""
        return np.concatenate([rod.velocity_collection.T for rod in self.rods])

    def add_node_forces(self, force: FloatArray) -> None:
        """Add forces on all nodes [N], shape (n_node, 3)."""
        for index, rod in enumerate(self.rods):
            rod.external_forces += force[self.model.nodes(index)].T

    def node_kick(self) -> FloatArray:
        """Velocity that a unit force adds to each node in a step [m/(N s)], damping included, shape (n_node,)."""
        mass, damping = self.model.node_mass, self.model.node_damping
        given: FloatArray = self.dt / mass * np.exp(-damping / mass * self.dt)
        return given


class Law:
    """One law of a model; made only where the model has it. By itself it adds nothing.

    PyElastica applies forces, and then dampers, in the order in which they are declared.
    """

    law: ClassVar[type[laws.Law]]
    """What it is in the physics, which tells where it is present."""

    def __init__(self, bodies: Bodies) -> None:
        self.bodies = bodies

    def add_forces(self, simulator: Simulator) -> None:
        """Declare what is summed before the kick of a step."""

    def add_dampers(self, simulator: Simulator) -> None:
        """Declare what changes velocities after the kick."""

    def flow(self, before: RodState) -> Flow:
        """Energy that entered and left by this law in the step just taken, which began in the state `before`."""
        return Flow()
