"""Hill's factors on the tension of muscles."""

from __future__ import annotations

import numpy as np

from lattice_gym.checks import FloatArray
from lattice_gym.physics.laws.hill import Hill


def hill_factor(hill: Hill, length: FloatArray, rate: FloatArray) -> FloatArray:
    """Share of the tension that acts, by length over rest length and its rate [1/s], both of one shape."""
    share: FloatArray = np.ones_like(length)
    if hill.width is not None:
        share *= np.exp(-(((length / hill.optimal_length - 1.0) / hill.width) ** 2))
    if hill.max_speed is not None:
        v, a, most = rate / hill.max_speed, hill.curvature, hill.eccentric
        c = (2.0 + 2.0 / a) / (most - 1.0)
        shortening, lengthening = np.minimum(v, 0.0), np.maximum(v, 0.0)
        hyperbola = np.where(v <= -1.0, 0.0, (1.0 + shortening) / (1.0 - shortening / a))
        share *= np.where(v <= 0.0, hyperbola, (1.0 + c * most * lengthening) / (1.0 + c * lengthening))
    return share
