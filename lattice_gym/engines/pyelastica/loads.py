"""Constant loads: point forces and torques, with the buoyancy that a medium gives."""

from __future__ import annotations

import numpy as np
from elastica.external_forces import NoForces
from elastica.rod.cosserat_rod import CosseratRod

from lattice_gym.checks import FloatArray
from lattice_gym.engines.pyelastica.law import START, Law, Simulator
from lattice_gym.engines.pyelastica.medium import buoyancy
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.state import RodState


class _PointLoads(NoForces[CosseratRod]):
    """Constant forces on nodes (laboratory frame) and torques on elements (material frame) of one rod."""

    def __init__(self, forces: FloatArray, torques: FloatArray) -> None:
        super().__init__()
        self.forces, self.torques = forces, torques

    def apply_forces(self, system: CosseratRod, time: np.float64 = START) -> None:
        system.external_forces += self.forces

    def apply_torques(self, system: CosseratRod, time: np.float64 = START) -> None:
        system.external_torques += self.torques


class Loads(Law):
    """Point loads and buoyancy."""

    @classmethod
    def acts_on(cls, model: RodModel) -> bool:
        """Whether any node or element is loaded."""
        return len(model.forces) + len(model.torques) > 0 or bool(buoyancy(model).any())

    def add_forces(self, simulator: Simulator) -> None:
        """Add the sum of its loads to every rod that has any."""
        model = self.bodies.model
        force, torque = buoyancy(model), np.zeros((model.n_elem, 3))
        for load in model.forces:
            force[model.nodes(load.rod)][load.node] += load.force
        for turn in model.torques:
            torque[model.elements(turn.rod)][turn.element] += turn.torque
        for index, rod in enumerate(self.bodies.rods):
            on_nodes, on_elements = force[model.nodes(index)].T, torque[model.elements(index)].T
            if on_nodes.any() or on_elements.any():
                simulator.add_forcing_to(rod).using(_PointLoads, on_nodes, on_elements)

    def flow(self, before: RodState) -> Flow:
        """Work of the torques, at the mean spin; that of the forces follows from the states of a call."""
        work, model = 0.0, self.bodies.model
        for load in model.torques:
            early = before.omega[model.elements(load.rod)][load.element]
            late = self.bodies.rods[load.rod].omega_collection[:, load.element]
            work += 0.5 * self.bodies.dt * float((early + late) @ load.torque)
        return Flow(load_work=work)
