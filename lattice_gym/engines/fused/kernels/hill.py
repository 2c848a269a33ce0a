"""Hill's factors on the tension of a muscle, by its length and its speed: see `physics.laws.hill.Hill`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lattice_gym.engines.fused.kernels.compiling import inlined
from lattice_gym.physics.laws import hill as law


class Hill(NamedTuple):
    """Constants of the law: inverse width, optimal length, maximal speed [s] and A; M; c.

    Where a factor is absent its inverse width, or its inverse speed, is 0.
    """

    inv_width: float
    inv_optimal: float
    inv_speed: float
    inv_curvature: float
    eccentric: float
    rise: float


def pack(hill: law.Hill | None) -> Hill | None:
    """Constants of a law."""
    if hill is None:
        return None
    return Hill(
        0.0 if hill.width is None else 1.0 / hill.width,
        1.0 / hill.optimal_length,
        0.0 if hill.max_speed is None else 1.0 / hill.max_speed,
        1.0 / hill.curvature,
        hill.eccentric,
        (2.0 + 2.0 / hill.curvature) / (hill.eccentric - 1.0),
    )


@inlined
def hill_factor(dilatation: float, rate: float, hill: Hill) -> float:
    """Force-length times force-velocity of a length over rest length and its rate [1/s].

    The branches for slow and fast are multiplied, as each is 1 where the other holds.
    """
    length = (dilatation * hill.inv_optimal - 1.0) * hill.inv_width
    speed = rate * hill.inv_speed
    slow, fast = max(min(speed, 0.0), -1.0), hill.rise * max(speed, 0.0)
    upper = (1.0 + slow) * (1.0 + hill.eccentric * fast)
    return float(np.exp(-length * length) * upper / ((1.0 - slow * hill.inv_curvature) * (1.0 + fast)))
