"""Muscles without nodes: tension and stretch between two nodes."""

from __future__ import annotations

import numpy as np
from elastica.joint import ConnectionBase
from elastica.rod.cosserat_rod import CosseratRod
from elastica.typing import ConnectionIndex, RigidBodyType, RodType

from lattice_gym.checks import FloatArray
from lattice_gym.engines.pyelastica.hill import hill_factor
from lattice_gym.engines.pyelastica.law import START, Bodies, Law, Simulator
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.laws.lines import LineLaw
from lattice_gym.physics.state import RodState


class _Line(ConnectionBase[CosseratRod]):
    """Tension and stretch along the line between two nodes.

    `tension` [N] is written before each step; `acting` [N] is what acted in it; both have shape (1,).
    """

    def __init__(
        self, rest_length: float, stiffness: float, tension: FloatArray, acting: FloatArray, hill: Hill | None
    ) -> None:
        self.rest_length, self.stiffness = rest_length, stiffness
        self.tension, self.acting, self.hill = tension, acting, hill

    def apply_forces(
        self,
        system_one: RodType | RigidBodyType,
        index_one: ConnectionIndex,
        system_two: RodType | RigidBodyType,
        index_two: ConnectionIndex,
        time: np.float64 = START,
    ) -> None:
        side = system_two.position_collection[:, index_two] - system_one.position_collection[:, index_one]
        length = np.linalg.norm(side)
        dilatation = length / self.rest_length
        self.acting[:] = self.tension
        if self.hill is not None:
            apart = system_two.velocity_collection[:, index_two] - system_one.velocity_collection[:, index_one]
            rate = apart @ side / length / self.rest_length
            self.acting *= hill_factor(self.hill, np.atleast_1d(dilatation), np.atleast_1d(rate))
        force = (self.acting[0] + self.stiffness * (dilatation - 1.0) / dilatation) * side / length
        system_one.external_forces[:, index_one] += force
        system_two.external_forces[:, index_two] -= force

    def apply_torques(
        self,
        system_one: RodType | RigidBodyType,
        index_one: ConnectionIndex,
        system_two: RodType | RigidBodyType,
        index_two: ConnectionIndex,
        time: np.float64 = START,
    ) -> None:
        """Turn nothing: the force goes through the nodes."""


class Lines(Law):
    """Massless muscles; their masses and damping stand on the nodes that they join."""

    law = LineLaw

    def __init__(self, bodies: Bodies) -> None:
        super().__init__(bodies)
        self._acting = np.zeros((len(bodies.model.lines), 1))

    def add_forces(self, simulator: Simulator) -> None:
        """Connect the rods of every line."""
        model, rods = self.bodies.model, self.bodies.rods
        tension = self.bodies.tension[len(model.muscles) :]
        for line, pull, acting in zip(model.lines, tension, self._acting, strict=True):
            simulator.connect(rods[line.rod_a], rods[line.rod_b], line.node_a, line.node_b).using(
                _Line, line.rest_length, line.stiffness, pull, acting, model.hill
            )

    def flow(self, before: RodState) -> Flow:
        """Work of what acted over the shortening of the step."""
        shortening = line_lengths(self.bodies.model, before.position)
        shortening -= line_lengths(self.bodies.model, self.bodies.positions())
        return Flow(muscle_work=float(self._acting[:, 0] @ shortening))


def line_lengths(model: RodModel, position: FloatArray) -> FloatArray:
    """Length of every line [m], shape (n_line,), with nodes at `position`, shape (n_node, 3)."""
    a, b = model.line_nodes
    length: FloatArray = np.linalg.norm(position[b] - position[a], axis=1)
    return length
