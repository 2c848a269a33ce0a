"""Spherical joints: PyElastica's own."""

from __future__ import annotations

from elastica.joint import FreeJoint

from lattice_gym.engines.pyelastica.law import Law, Simulator
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.laws.joints import JointLaw
from lattice_gym.physics.state import RodState


class Joints(Law):
    """A spring and a dashpot between two nodes."""

    law = JointLaw

    def add_forces(self, simulator: Simulator) -> None:
        """Connect the rods of every joint."""
        rods = self.bodies.rods
        for joint in self.bodies.model.joints:
            simulator.connect(rods[joint.rod_a], rods[joint.rod_b], joint.node_a, joint.node_b).using(
                FreeJoint, k=joint.stiffness, nu=joint.damping
            )

    def flow(self, before: RodState) -> Flow:
        """Energy that dashpots took: their force, of the rate before the kick, times the mean rate."""
        lost, velocity = 0.0, self.bodies.velocities()
        for joint, a, b in zip(
            self.bodies.model.joints, *self.bodies.model.tie_nodes(self.bodies.model.joints), strict=True
        ):
            early, late = before.velocity[b] - before.velocity[a], velocity[b] - velocity[a]
            lost += 0.5 * self.bodies.dt * joint.damping * float(early @ (early + late))
        return Flow(dissipated=lost)
