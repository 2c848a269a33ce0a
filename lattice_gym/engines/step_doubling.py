"""The step check by step doubling: the distance of a run from the same run at half the step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lattice_gym.engines.health import Health, Status, element_at
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.state import RodState

STEP_TOLERANCE = 0.03
"""Distance of a node from its place in a run at half the step, over the longest side of the assembly at rest, above
which the step is too long: between the 1 % that counts as right and the 10 % that counts as wrong."""


class StepDoubling:
    """Compares one worm with the same at half the step."""

    def __init__(self, model: RodModel) -> None:
        self._model = model
        self._size = float(np.ptp(model.rest_state().position, axis=0).max())
        self.error: float | None = None
        """Largest distance of a node or the ball between both runs, over the longest side at rest; None: unknown."""

    def discard(self) -> None:
        """Forget the error: a call failed, or another state was set."""
        self.error = None

    def compare(self, state: RodState, finer: RodState, half_step_health: Health) -> Health:
        """Judge a state by that of the run at half the step, which ended in `half_step_health`."""
        self.error, model = None, self._model
        if not half_step_health.ok:
            return replace(half_step_health, status=Status.INACCURATE)
        own, other = (np.concatenate([of.position, of.ball_position]) for of in (state, finer))
        apart = np.linalg.norm(own - other, axis=1)
        node = int(np.argmax(apart))
        self.error = float(apart[node]) / self._size
        if self.error <= STEP_TOLERANCE:
            return Health()
        if node >= model.n_node:
            return Health(Status.INACCURATE)
        rod = int(np.searchsorted(model.node_offset, node, side="right")) - 1
        return Health(Status.INACCURATE, rod, element_at(model, rod, node - int(model.node_offset[rod])))
