"""The straight rod of which most cases are made."""

from __future__ import annotations

import numpy as np

from lattice_gym.physics.rod import Rod, straight_rod

E, G, RHO, RADIUS, LENGTH = 1e6, 4e5, 1000.0, 0.1, 1.0
AREA, SECOND_MOMENT = np.pi * RADIUS**2, np.pi / 4.0 * RADIUS**4
SPEED = np.sqrt(E / RHO)
"""Of sound along a bar [m/s]."""
GAZZOLA = "Gazzola et al. 2018, R. Soc. Open Sci. 5:171628"


def bar(n_elem: int, *, length: float = LENGTH, rate: float = 0.0, youngs_modulus: float = E) -> Rod:
    """Straight rod along z centred at the origin; `rate` [1/s] damps an inner node and an element."""
    share = length / n_elem
    return straight_rod(
        (0.0, 0.0, -0.5 * length),
        (0.0, 0.0, 0.5 * length),
        n_elem,
        radius=RADIUS,
        density=RHO,
        youngs_modulus=youngs_modulus,
        shear_modulus=G / E * youngs_modulus,
        normal=(1.0, 0.0, 0.0),
        damping=rate * RHO * AREA * share,
        rotational_damping=rate * RHO * SECOND_MOMENT * share,
    )
