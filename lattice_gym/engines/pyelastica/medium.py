"""Gravity and buoyancy; the drag of a medium is part of the damping of nodes."""

from __future__ import annotations

import numpy as np
from elastica.external_forces import GravityForces

from lattice_gym.engines.pyelastica.law import Law, Simulator
from lattice_gym.engines.pyelastica.loads import ConstantLoads
from lattice_gym.physics.laws.medium import MediumLaw


class Medium(Law):
    """Weights, PyElastica's own, and buoyancy. Their energy is stored, so nothing flows."""

    law = MediumLaw

    def add_forces(self, simulator: Simulator) -> None:
        """Add buoyancy and weight to every rod."""
        model, gravity = self.bodies.model, self.bodies.model.gravity
        assert gravity is not None
        buoyancy = -np.outer(model.medium_density * model.node_volume, gravity)
        for index, rod in enumerate(self.bodies.rods):
            simulator.add_forcing_to(rod).using(ConstantLoads, buoyancy[model.nodes(index)].T)
            simulator.add_forcing_to(rod).using(GravityForces, acc_gravity=gravity)
