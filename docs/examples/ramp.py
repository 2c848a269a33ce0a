"""An activation law of your own: `activation="ramp:Ramp"`, or `{"law": "ramp:Ramp", "rate": 5.0}` with its field."""

from dataclasses import dataclass

import numpy as np

from lattice_gym.checks import real
from lattice_gym.physics.laws.activation import Activation


@dataclass(frozen=True, kw_only=True)
class Ramp(Activation):
    """Follow the command at a constant rate."""

    rate: float = real(10.0, 0.1, 1000.0, "1/s")  # default, least, largest, unit

    def advance(self, state, command, duration):
        """Return the exact state after a command was held; state[0] is the activation."""
        most = self.rate * duration
        return state + np.clip(command - state, -most, most)
