"""Damping of nodes and of spin: PyElastica's, after the kick of a step."""

from __future__ import annotations

from typing import Any

import numpy as np
from elastica.dissipation import AnalyticalLinearDamper

from lattice_gym.checks import FloatArray
from lattice_gym.engines.pyelastica.law import Law, Simulator
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.laws.damping import DampingLaw
from lattice_gym.physics.state import RodState

_MAX_RATE = 300.0
"""Damping this large leaves no speed worth counting; without the bound what it left would overflow."""


class _NodeDamper(AnalyticalLinearDamper):
    """PyElastica's damper with a constant for each node [N s/m], shape (n_node,), where lines add to the rod's own."""

    def __init__(self, node_damping: FloatArray, rotational_damping: float, time_step: float, **kwargs: Any) -> None:
        super().__init__(
            translational_damping_constant=0.0,
            rotational_damping_constant=rotational_damping,
            time_step=np.float64(time_step),
            **kwargs,
        )
        self._translational_damping_coefficient = np.exp(-node_damping / self.system.mass * time_step)


class LinearDamping(Law):
    """Linear damping of nodes and elements, with the drag of the medium."""

    law = DampingLaw

    def add_dampers(self, simulator: Simulator) -> None:
        """Damp every rod that is damped."""
        model = self.bodies.model
        for index, (rod, made) in enumerate(zip(model.rods, self.bodies.rods, strict=True)):
            node_damping = model.node_damping[model.nodes(index)]
            if node_damping.any() or rod.rotational_damping > 0.0:
                simulator.dampen(made).using(
                    _NodeDamper, node_damping, rod.rotational_damping, time_step=self.bodies.dt
                )

    def flow(self, before: RodState) -> Flow:
        """Energy that damping took.

        A kick by the force f, then a velocity scaled by D: f u_mean dt, with u_mean the mean of the velocities before
        and after the step, goes into kinetic energy but for m / 2 (1/D - 1) (u' + u) u'.
        """
        lost, model, dt = 0.0, self.bodies.model, self.bodies.dt
        for index, (rod, made) in enumerate(zip(model.rods, self.bodies.rods, strict=True)):
            nodes = model.nodes(index)
            mass, damping = model.node_mass[nodes], model.node_damping[nodes]
            late, early = made.velocity_collection, before.velocity[nodes].T
            rate = np.minimum(dt * damping / mass, _MAX_RATE)
            lost += float(0.5 * mass * np.expm1(rate) @ (late * (late + early)).sum(axis=0))
            spin, early = made.omega_collection, before.omega[model.elements(index)].T
            rate = np.minimum(dt * rod.rotational_damping / rod.inertia * made.dilatation, _MAX_RATE)
            across, along = 0.5 * np.expm1(rate), np.expm1(0.5 * rate)
            both = spin * (spin + early)
            lost += float(rod.inertia / made.dilatation @ (across * (both[0] + both[1]) + along * both[2]))
        return Flow(dissipated=lost)
