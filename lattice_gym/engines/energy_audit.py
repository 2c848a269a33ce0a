"""The energy check: a ledger over every call, and a verdict on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lattice_gym.engines.health import Health, Status
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.energy import ENERGY_TOLERANCE, EnergyMeter, Flow, Ledger, StoredEnergy, ledger
from lattice_gym.physics.state import RodState


class EnergyAudit:
    """Ledger of one worm over its last call: opened with the state before the call, closed with that after it.

    The state at which a call was closed opens the next one, so that the stored energy is computed once a call.
    """

    def __init__(self, model: RodModel) -> None:
        self._meter = EnergyMeter(model)
        self._before: tuple[RodState, StoredEnergy] | None = None
        self.ledger: Ledger | None = None

    @property
    def is_open(self) -> bool:
        """Whether the energy before the next call is known."""
        return self._before is not None

    def open(self, state: RodState) -> None:
        """Take the energy of a state for that before the next call."""
        with np.errstate(all="ignore"):  # The state may be one that a failed call left behind.
            self._before = state, self._meter.stored(state)

    def discard(self) -> None:
        """Forget ledger and state: a call failed, or another state was set."""
        self._before = self.ledger = None

    def close(self, state: RodState, flow: Flow) -> Health:
        """Draw up the ledger of a call that ended in `state`, and judge it; a failure names where most energy is."""
        assert self._before is not None
        (start, stored), energy = self._before, self._meter.stored(state)
        work = replace(flow, load_work=flow.load_work + self._meter.force_work(start, state))
        self._before, self.ledger = (state, energy), ledger(stored, energy, work, self._meter.negligible)
        if not self.ledger.residual >= -ENERGY_TOLERANCE * self.ledger.scale:
            return Health(Status.ENERGY, *self._meter.peak_element(energy))
        return Health()
