"""Gravity and buoyancy; the drag of a medium is part of the damping of nodes."""

from __future__ import annotations

import numpy as np
from elastica.external_forces import GravityForces

from lattice_gym.checks import FloatArray
from lattice_gym.engines.pyelastica.law import Law, Simulator
from lattice_gym.physics.assembly import RodModel


class Medium(Law):
    """Weights: PyElastica's own. Their energy is stored, so nothing flows."""

    @classmethod
    def acts_on(cls, model: RodModel) -> bool:
        """Whether there is gravity."""
        return model.gravity is not None

    def add_forces(self, simulator: Simulator) -> None:
        """Add its weight to every rod."""
        for rod in self.bodies.rods:
            simulator.add_forcing_to(rod).using(GravityForces, acc_gravity=self.bodies.model.gravity)


def buoyancy(model: RodModel) -> FloatArray:
    """Buoyancy on every node [N], shape (n_node, 3)."""
    if model.gravity is None:
        return np.zeros((model.n_node, 3))
    force: FloatArray = -np.outer(model.medium_density * model.node_volume, model.gravity)
    return force
