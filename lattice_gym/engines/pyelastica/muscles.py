"""Muscles that are rods: tension along every element."""

from __future__ import annotations

import numpy as np
from elastica.external_forces import NoForces
from elastica.rod.cosserat_rod import CosseratRod

from lattice_gym.checks import FloatArray
from lattice_gym.engines.pyelastica.hill import hill_factor
from lattice_gym.engines.pyelastica.law import START, Bodies, Law, Simulator
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.laws.muscles import MuscleLaw
from lattice_gym.physics.state import RodState


class _Contraction(NoForces[CosseratRod]):
    """Tension along every element of a muscle: pulls its two nodes together.

    `tension` [N] has shape (1,) and is written before each step; `acting` [N], shape (n_elem,), is what acted in it.
    """

    def __init__(self, tension: FloatArray, acting: FloatArray, hill: Hill | None) -> None:
        super().__init__()
        self.tension, self.acting, self.hill = tension, acting, hill

    def apply_forces(self, system: CosseratRod, time: np.float64 = START) -> None:
        self.acting[:] = self.tension
        if self.hill is not None:
            rate = np.sum(np.diff(system.velocity_collection) * system.tangents, axis=0) / system.rest_lengths
            self.acting *= hill_factor(self.hill, system.lengths / system.rest_lengths, rate)
        pull = self.acting * system.tangents
        system.external_forces[:, :-1] += pull
        system.external_forces[:, 1:] -= pull


class Muscles(Law):
    """Rods that contract."""

    law = MuscleLaw

    def __init__(self, bodies: Bodies) -> None:
        super().__init__(bodies)
        self._acting = [np.zeros(bodies.model.rods[index].n_elem) for index in bodies.model.muscles]

    def add_forces(self, simulator: Simulator) -> None:
        """Add its tension to every muscle."""
        model, rods, tension = self.bodies.model, self.bodies.rods, self.bodies.tension
        for index, pull, acting in zip(model.muscles, tension, self._acting, strict=False):
            simulator.add_forcing_to(rods[index]).using(_Contraction, pull, acting, model.hill)

    def flow(self, before: RodState) -> Flow:
        """Work of what acted over the shortening of the step."""
        work = 0.0
        for index, acting in zip(self.bodies.model.muscles, self._acting, strict=True):
            early = before.position[self.bodies.model.nodes(index)].T
            late = self.bodies.rods[index].position_collection
            shortening = np.linalg.norm(np.diff(early), axis=0) - np.linalg.norm(np.diff(late), axis=0)
            work += float(acting @ shortening)
        return Flow(muscle_work=work)
