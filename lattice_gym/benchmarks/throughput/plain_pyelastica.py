"""A worm in PyElastica as its user would write it: its rods, joints, constraints, damper and stepper, and one force.

What the throughput report measures against. The reference engine behind `simulate` does the same and more.
"""

from __future__ import annotations

import numpy as np
from elastica.boundary_conditions import FixedConstraint
from elastica.dissipation import AnalyticalLinearDamper
from elastica.external_forces import NoForces
from elastica.joint import FreeJoint
from elastica.modules.base_system import BaseSystemCollection
from elastica.modules.connections import Connections
from elastica.modules.constraints import Constraints
from elastica.modules.damping import Damping
from elastica.modules.forcing import Forcing
from elastica.rod.cosserat_rod import CosseratRod
from elastica.timestepper.symplectic_steppers import PositionVerlet

from lattice_gym.checks import FloatArray
from lattice_gym.physics.assembly import RodModel

_START = np.float64(0.0)


class Simulator(BaseSystemCollection, Constraints, Connections, Forcing, Damping):
    """Rods with what a worm needs."""


class Contraction(NoForces[CosseratRod]):
    """Constant tension [N] along every element of a muscle."""

    def __init__(self, tension: float) -> None:
        super().__init__()
        self.tension = tension

    def apply_forces(self, system: CosseratRod, time: np.float64 = _START) -> None:
        """Pull the two nodes of every element together."""
        pull = self.tension * system.tangents
        system.external_forces[:, :-1] += pull
        system.external_forces[:, 1:] -= pull


class PlainPyElastica:
    """Rods, joints, clamped bases and muscles of a model, at rest; whatever else a model may hold is refused.

    Raises
    ------
    ValueError
        The model has loads, lines or surroundings, or rods under stress at rest.
    """

    def __init__(self, model: RodModel, tension: float, dt: float) -> None:
        others = (model.forces, model.torques, model.lines, model.ball, model.ground, model.hill, model.contact)
        curved = any(rod.natural_curvature is not None for rod in model.rods)
        if any(others) or curved or model.gravity is not None or model.medium_drag > 0.0:
            raise ValueError("model: must hold no more than rods free of stress, joints, clamps and muscle rods")
        self._dt = dt
        self._time = np.float64(0.0)
        self._stepper = PositionVerlet()
        self._simulator = Simulator()
        self.rods: list[CosseratRod] = []
        for rod in model.rods:
            made = CosseratRod.straight_rod(
                rod.n_elem,
                rod.position[0].copy(),
                rod.directors[0, 2].copy(),
                rod.directors[0, 0].copy(),
                float(rod.rest_length.sum()),
                float(rod.radius[0]),
                rod.density,
                youngs_modulus=rod.youngs_modulus,
                shear_modulus=rod.shear_modulus,
                position=rod.position.T.copy(),
                directors=np.moveaxis(rod.directors, 0, -1).copy(),
            )
            made.rest_sigma[:], made.rest_kappa[:] = made.sigma, made.kappa
            self._simulator.append(made)
            self.rods.append(made)
        for joint in model.joints:
            self._simulator.connect(
                self.rods[joint.rod_a], self.rods[joint.rod_b], joint.node_a, joint.node_b
            ).using(FreeJoint, k=joint.stiffness, nu=joint.damping)  # fmt: skip
        for muscle in model.muscles:
            self._simulator.add_forcing_to(self.rods[muscle]).using(Contraction, tension)
        for clamp in model.clamps:
            self._simulator.constrain(self.rods[clamp.rod]).using(
                FixedConstraint,
                constrained_position_idx=() if clamp.node is None else (clamp.node,),
                constrained_director_idx=() if clamp.element is None else (clamp.element,),
            )
        for rod, made in zip(model.rods, self.rods, strict=True):
            self._simulator.dampen(made).using(
                AnalyticalLinearDamper,
                translational_damping_constant=rod.damping,
                rotational_damping_constant=rod.rotational_damping,
                time_step=np.float64(dt),
            )
        self._simulator.finalize()

    def advance(self, n_steps: int) -> None:
        """Take so many steps."""
        for _ in range(n_steps):
            self._time = self._stepper.step(self._simulator, self._time, self._dt)

    @property
    def position(self) -> FloatArray:
        """Node positions [m], shape (n_node, 3)."""
        return np.concatenate([rod.position_collection.T for rod in self.rods])

    @property
    def velocity(self) -> FloatArray:
        """Node velocities [m/s], shape (n_node, 3)."""
        return np.concatenate([rod.velocity_collection.T for rod in self.rods])
