"""One assembly in PyElastica 1.0.0: its rods, the laws that act on them, and its stepper."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
from elastica.rigidbody.sphere import Sphere
from elastica.rod.cosserat_rod import CosseratRod
from elastica.timestepper.protocol import StepperProtocol
from elastica.timestepper.symplectic_steppers import PositionVerlet

from lattice_gym.checks import FloatArray
from lattice_gym.engines.health import Health, joint_gap_limits
from lattice_gym.engines.pyelastica.ball import Ball, make_sphere, reset_frame
from lattice_gym.engines.pyelastica.clamps import add_clamps
from lattice_gym.engines.pyelastica.contact import Contact
from lattice_gym.engines.pyelastica.damping import LinearDamping
from lattice_gym.engines.pyelastica.elasticity import make_rods
from lattice_gym.engines.pyelastica.ground import Ground
from lattice_gym.engines.pyelastica.health import health_of
from lattice_gym.engines.pyelastica.joints import Joints
from lattice_gym.engines.pyelastica.law import Bodies, Law, Simulator
from lattice_gym.engines.pyelastica.lines import Lines
from lattice_gym.engines.pyelastica.loads import Loads
from lattice_gym.engines.pyelastica.medium import Medium
from lattice_gym.engines.pyelastica.muscles import Muscles
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.state import RodState

LAWS: tuple[type[Law], ...] = (Joints, Muscles, Lines, Loads, Medium, Ball, Contact, LinearDamping, Ground)
"""Laws in the order in which their forces are summed. Friction must come after all other changes of velocities, and
that of the ball last of all, see `add_dampers` in `Assembly`."""


class Assembly:
    """One assembly, its time step and its tensions."""

    def __init__(self, model: RodModel, dt: float, energy_check: bool = False) -> None:
        self.model, self.dt = model, dt
        self.stepper: StepperProtocol = PositionVerlet()
        self.time = 0.0
        self.flow = Flow()
        """Energy that entered and left in the last call to `advance`; kept with the energy check."""
        self._energy_check = energy_check
        self._bodies = Bodies(model, make_rods(model), make_sphere(model.ball), dt, np.zeros((model.n_muscle, 1)))
        self._laws = [acting(self._bodies) for acting in LAWS if acting.law.present(model)]
        self._joint_gap_limits = joint_gap_limits(model)
        self._simulator = self._assemble()

    def _assemble(self) -> Simulator:
        simulator, sphere = Simulator(), self._bodies.sphere
        simulator.extend(self._bodies.rods)
        if sphere is not None:
            simulator.append(sphere)
        for law in self._laws:
            law.add_forces(simulator)
        add_clamps(self._bodies, simulator)
        # Friction of the ball takes what slip that of the ground has left.
        for law in sorted(self._laws, key=lambda law: isinstance(law, Ball)):
            law.add_dampers(simulator)
        simulator.finalize()
        return simulator

    @property
    def state(self) -> RodState:
        """A copy of the state."""
        rods, sphere, ball_state = self._bodies.rods, self._bodies.sphere, {}
        if sphere is not None:
            moving = (sphere.position_collection, sphere.velocity_collection, sphere.omega_collection)
            names = ("ball_position", "ball_velocity", "ball_omega")
            ball_state = {name: array.T.copy() for name, array in zip(names, moving, strict=True)}
        return RodState(
            position=self._bodies.positions(),
            velocity=self._bodies.velocities(),
            directors=np.concatenate([np.moveaxis(rod.director_collection, -1, 0) for rod in rods]),
            omega=np.concatenate([rod.omega_collection.T for rod in rods]),
            **ball_state,
            time=self.time,
        )

    def restore(self, state: RodState) -> None:
        """Take over a state."""
        for index, rod in enumerate(self._bodies.rods):
            nodes, elements = self.model.nodes(index), self.model.elements(index)
            rod.position_collection[:] = state.position[nodes].T
            rod.velocity_collection[:] = state.velocity[nodes].T
            rod.director_collection[:] = np.moveaxis(state.directors[elements], 0, -1)
            rod.omega_collection[:] = state.omega[elements].T
            _clear(rod)
        if (sphere := self._bodies.sphere) is not None:
            sphere.position_collection[:] = state.ball_position.T
            sphere.velocity_collection[:] = state.ball_velocity.T
            sphere.omega_collection[:] = state.ball_omega.T
            _clear(sphere)
        self.time = state.time

    def advance(self, start: FloatArray, end: FloatArray, n_substeps: int) -> Health:
        """Advance with tensions that go from `start` to `end` [N], shape (n_muscle,)."""
        total = np.zeros(3)
        # A state that blows up overflows on its way; the health check names it, numpy need not.
        with np.errstate(all="ignore"):
            for step in range(n_substeps):
                self._bodies.tension[:, 0] = start + (end - start) * ((step + 0.5) / n_substeps)
                before = self.state if self._energy_check else None
                self.stepper.step(self._simulator, self.time, self.dt)
                self.time += self.dt
                if before is not None:
                    total += np.sum([astuple(law.flow(before)) for law in self._laws], axis=0)
                if self._bodies.sphere is not None:
                    reset_frame(self._bodies.sphere)
        self.flow = Flow(*total.tolist())
        return health_of(self._bodies, self._joint_gap_limits)


def _clear(body: CosseratRod | Sphere) -> None:
    """Set what a step leaves behind to zero: PyElastica does so by multiplication, which keeps what is not finite."""
    for left_over in (body.acceleration_collection, body.alpha_collection, body.external_forces, body.external_torques):
        left_over[:] = 0.0
