"""The reference engine: assemblies made of PyElastica's own rods, joints, constraints, damping and stepper.

It calls none of the compiled laws of the fused engine.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lattice_gym.checks import FloatArray, IntArray, invalid_value
from lattice_gym.engines.base import Engine
from lattice_gym.engines.health import Health
from lattice_gym.engines.pyelastica.assembly import Assembly
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.state import RodState


class PyElasticaEngine(Engine):
    """Assemblies one after another, in one thread; `splitting` must be "pyelastica"."""

    def __init__(
        self,
        models: Sequence[RodModel],
        dt: float,
        splitting: Splitting = "pyelastica",
        *,
        energy_check: bool = False,
        step_check: bool = False,
        num_threads: int | None = None,
    ) -> None:
        if splitting == "symmetric":
            raise invalid_value("splitting", splitting, "the pyelastica engine damps as PyElastica does; take fused")
        super().__init__(
            models, dt, splitting, energy_check=energy_check, step_check=step_check, num_threads=num_threads
        )
        self._assemblies = [Assembly(model, self.dt, energy_check) for model in self.models]
        self._ends = [Health()] * self.n_worm

    def _advance(self, start: FloatArray, end: FloatArray, n_substeps: int) -> IntArray:
        for worm, assembly in enumerate(self._assemblies):
            self._ends[worm] = assembly.advance(start[worm], end[worm], n_substeps)
            if self._ends[worm].ok:
                self._show(worm, assembly.state)
        return np.array([health.status for health in self._ends], np.int64)

    def _health(self, worm: int) -> Health:
        return self._ends[worm]

    def _state(self, worm: int) -> RodState:
        return self._assemblies[worm].state

    def _restore(self, worm: int, state: RodState) -> None:
        self._assemblies[worm].restore(state)

    def _replace(self, worm: int, model: RodModel) -> None:
        self._assemblies[worm] = Assembly(model, self.dt, self.energy_check)

    def _flow(self, worm: int) -> Flow:
        return self._assemblies[worm].flow
