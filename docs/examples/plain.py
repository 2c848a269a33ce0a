"""A third engine: one step of position Verlet with the plain formula of every law, in numpy, one worm after another.

`lattice_gym.engines.registry.ENGINES["plain"] = "plain:PlainEngine"` makes it known.
"""

from dataclasses import replace

import numpy as np

from lattice_gym.engines.base import Engine
from lattice_gym.engines.health import Health, Status
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.laws.base import Generalised
from lattice_gym.physics.laws.damping import DampingLaw, coefficients, damping_shares


class PlainEngine(Engine):
    """Slow and short: no ball, no ground, no ledger. With the "pyelastica" splitting it agrees with the others."""

    def __init__(self, models, dt, splitting="pyelastica", **options):
        super().__init__(models, dt, splitting, **options)
        if self.energy_check:
            raise ValueError("energy_check = True: the plain engine keeps no ledger")
        for model in self.models:
            refuse(model)
        self._states = [model.rest_state() for model in self.models]
        self._ends = [Health()] * self.n_worm

    def _advance(self, start, end, n_substeps):
        for worm, model in enumerate(self.models):
            with np.errstate(all="ignore"):
                for k in range(n_substeps):
                    tension = start[worm] + (end[worm] - start[worm]) * ((k + 0.5) / n_substeps)
                    self._states[worm] = self._step(model, self._states[worm], tension)
            state = self._states[worm]
            sound = all(np.isfinite(part).all() for part in (state.position, state.velocity, state.directors))
            self._ends[worm] = Health() if sound else Health(Status.NON_FINITE, 0, 0)
            if sound:
                self._show(worm, state)
        return [health.status for health in self._ends]

    def _step(self, model, state, tension):
        """Half a drift, a kick with its damping, half a drift."""
        dt, state = self.dt, drifted(state, 0.5 * self.dt)
        forces = [law.force(state, tension) for law in model.laws if not isinstance(law, DampingLaw)]
        length = np.linalg.norm(state.position[model.lower_node + 1] - state.position[model.lower_node], axis=1)
        inertia = model.rod_array("inertia") * model.rod_array("rest_length") / length
        masses = model.node_mass[:, None], inertia[:, None] * [1.0, 1.0, 2.0]
        kicked = []
        for k, (mass, speed) in enumerate(zip(masses, (state.velocity, state.omega), strict=True)):
            decay = Generalised.split(model, coefficients(model))[k] * dt / mass
            early, late = damping_shares(decay, self.splitting)
            kicked.append(late * (early * speed + dt * sum(force[k] for force in forces) / mass))
        velocity, omega = kicked
        velocity[model.clamped_nodes[0]], omega[model.clamped_elements[0]] = 0.0, 0.0
        state = drifted(replace(state, velocity=velocity, omega=omega), 0.5 * dt)
        return replace(state, time=state.time + dt)

    def _health(self, worm):
        return self._ends[worm]

    def _state(self, worm):
        return self._states[worm].copy()

    def _restore(self, worm, state):
        self._states[worm] = state.copy()

    def _replace(self, worm, model):
        refuse(model)
        self._states[worm] = model.rest_state()

    def _flow(self, worm):
        return Flow()


def refuse(model):
    """Refuse a model with a law that this engine lacks."""
    for name in ("ball", "ground"):
        if getattr(model, name) is not None:
            raise ValueError(f"engine = 'plain': cannot have {name}; take fused or pyelastica")


def drifted(state, time):
    """Move on for a time [s] at constant velocities; directors turn about omega (Rodrigues' formula)."""
    angle = time * state.omega
    size = np.linalg.norm(angle, axis=1)[:, None, None]
    k = np.cross(np.eye(3)[None], angle[:, None, :])
    turn = np.eye(3) + np.sinc(size / np.pi) * k + 0.5 * np.sinc(size / (2.0 * np.pi)) ** 2 * k @ k
    directors = turn.transpose(0, 2, 1) @ state.directors
    return replace(state, position=state.position + time * state.velocity, directors=directors)
