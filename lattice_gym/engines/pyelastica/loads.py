"""Constant loads: point forces and torques."""

from __future__ import annotations

import numpy as np
from elastica.external_forces import NoForces
from elastica.rod.cosserat_rod import CosseratRod

from lattice_gym.checks import FloatArray
from lattice_gym.engines.pyelastica.law import START, Law, Simulator
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.laws.loads import LoadLaw
from lattice_gym.physics.state import RodState


class ConstantLoads(NoForces[CosseratRod]):
    """Constant forces on nodes (laboratory frame) and torques on elements (material frame) of one rod.

    Shapes (3, n_node) and (3, n_elem), or one number for all.
    """

    def __init__(self, forces: FloatArray, torques: FloatArray | float = 0.0) -> None:
        super().__init__()
        self.forces, self.torques = forces, torques

    def apply_forces(self, system: CosseratRod, time: np.float64 = START) -> None:
        """Add the forces."""
        system.external_forces += self.forces

    def apply_torques(self, system: CosseratRod, time: np.float64 = START) -> None:
        """Add the torques."""
        system.external_torques += self.torques


class Loads(Law):
    """Point forces and torques."""

    law = LoadLaw

    def add_forces(self, simulator: Simulator) -> None:
        """Add the sum of its loads to every rod that has any."""
        model = self.bodies.model
        force, torque = np.zeros((model.n_node, 3)), np.zeros((model.n_elem, 3))
        for load in model.forces:
            force[model.nodes(load.rod)][load.node] += load.force
        for turn in model.torques:
            torque[model.elements(turn.rod)][turn.element] += turn.torque
        for index, rod in enumerate(self.bodies.rods):
            on_nodes, on_elements = force[model.nodes(index)].T, torque[model.elements(index)].T
            if on_nodes.any() or on_elements.any():
                simulator.add_forcing_to(rod).using(ConstantLoads, on_nodes, on_elements)

    def flow(self, before: RodState) -> Flow:
        """Work of the torques, at the mean spin; that of the forces follows from the states of a call."""
        work, model = 0.0, self.bodies.model
        for load in model.torques:
            early = before.omega[model.elements(load.rod)][load.element]
            late = self.bodies.rods[load.rod].omega_collection[:, load.element]
            work += 0.5 * self.bodies.dt * float((early + late) @ load.torque)
        return Flow(load_work=work)
