"""When and how much the velocities of nodes and elements are damped in a step."""

from __future__ import annotations

from typing import Literal

import numpy as np

from lattice_gym.checks import FloatArray

Splitting = Literal["pyelastica", "symmetric"]
"""When velocities are damped: once after the kick, as PyElastica does (first order), or all along it (second order).

"symmetric" solves m v' = F - c v over the step with its force held: a force ends in its true speed F / c, however long
the step. Damped once after the kick, that speed comes out as x / (exp(x) - 1) of the true one, with x = c dt / m. The
dashpots of joints take the velocities from before the kick in both, which is first order.
"""


def damping_shares(decay: FloatArray, splitting: Splitting) -> tuple[FloatArray, FloatArray]:
    """Shares of a velocity that damping leaves before and after the kick of a step; decay is c dt / m.

    Together they are exp(-decay). Symmetric: decay / (exp(decay) - 1) before, (1 - exp(-decay)) / decay after.
    """
    if splitting == "pyelastica":
        return np.ones_like(decay), np.exp(-decay)
    small = decay < 1e-12
    safe = np.where(small, 1.0, decay)
    after = np.where(small, 1.0, -np.expm1(-safe) / safe)
    return np.exp(-decay) / after, after
