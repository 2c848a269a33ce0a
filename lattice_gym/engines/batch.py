"""Engines of worms that move side by side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from lattice_gym.design import FloatArray
from lattice_gym.engines import Engine, EngineName, Health, Splitting, make_engine
from lattice_gym.model import RodModel, RodState


class BatchEngine:
    """One engine a worm, one after another."""

    def __init__(
        self,
        models: Sequence[RodModel],
        dt: float,
        splitting: Splitting = "pyelastica",
        *,
        engine: EngineName = "fused",
        energy_check: bool = False,
        step_check: bool = False,
        num_threads: int | None = None,
    ) -> None:
        self.models, self.dt, self.n_worm = list(models), dt, len(models)
        self._how = engine, dt, splitting, energy_check, step_check
        self._engines = [self._make(model) for model in models]
        states = [engine.state for engine in self._engines]
        self.position, self.velocity, self.bolus_position, self.bolus_velocity = (
            np.array([getattr(state, name) for state in states])
            for name in ("position", "velocity", "bolus_position", "bolus_velocity")
        )
        self._health = [Health()] * self.n_worm

    def advance(self, tension: npt.ArrayLike, n_substeps: int) -> npt.NDArray[np.int64]:
        """Advance all worms; status of each."""
        pull: FloatArray = np.asarray(tension)
        for k, engine in enumerate(self._engines):
            self._health[k] = engine.advance(pull[..., k, :], n_substeps)
            if self._health[k].ok:
                self._note(k)
        return np.array([int(health.status) for health in self._health])

    def _make(self, model: RodModel) -> Engine:
        name, dt, splitting, energy_check, step_check = self._how
        return make_engine(name, model, dt, splitting, energy_check, step_check)

    def _note(self, worm: int) -> None:
        state = self._engines[worm].state
        self.position[worm], self.velocity[worm] = state.position, state.velocity
        self.bolus_position[worm], self.bolus_velocity[worm] = state.bolus_position, state.bolus_velocity

    def health(self, worm: int) -> Health:
        """Health of a worm after the last call."""
        return self._health[worm]

    def state(self, worm: int) -> RodState:
        """State of a worm."""
        return self._engines[worm].state

    def restore(self, worm: int, state: RodState) -> None:
        """Put a worm somewhere."""
        self._engines[worm].restore(state)
        self._note(worm)

    def replace(self, worm: int, model: RodModel) -> None:
        """Give a worm other constants."""
        state = self._engines[worm].state
        self.models[worm], self._engines[worm] = model, self._make(model)
        self._engines[worm].restore(state)

    def close(self) -> None:
        """Nothing to free."""
