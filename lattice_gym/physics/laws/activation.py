"""How a muscle follows its command."""

from __future__ import annotations

import math

import numpy as np

from lattice_gym.checks import FloatArray, finite_number, real_array, shown


def advance_activation(
    activation: FloatArray, command: FloatArray, duration: float, rise_time: float, decay_time: float
) -> FloatArray:
    """Activation after a command was held for a duration [s]: the exact solution of da/dt = (u - a) / tau.

    Activation a and command u have one shape, kept. tau is the rise time [s] where u > a, else the decay time [s]
    (Thelen 2003).
    """
    for name, value in (("rise_time", rise_time), ("decay_time", decay_time)):
        if (number := finite_number(value)) is None or number <= 0.0:
            raise ValueError(f"{name} = {shown(value)}: must be positive and finite [s]")
    if (number := finite_number(duration)) is None or number < 0.0:
        raise ValueError(f"duration = {shown(duration)}: must be finite and not negative [s]")
    now, towards = real_array("activation", activation), real_array("command", command)
    if now.shape != towards.shape:
        raise ValueError(f"command has shape {towards.shape}: must have the activation's, {now.shape}")
    return followed(now, towards, math.exp(-float(duration / rise_time)), math.exp(-float(duration / decay_time)))


def followed(now: FloatArray, towards: FloatArray, rising: float, falling: float) -> FloatArray:
    """Activation that has come nearer to a command, by shares of the way that are left where it rises and falls."""
    left = np.where(towards > now, rising, falling)
    # Written from the command, not the activation: so no rounding carries the result past the command.
    return towards + left * (now - towards)
