"""Damping of velocities and spins, once after the kick or all along it: see `physics.laws.damping`.

A node keeps the share `keep` of its velocity in a step. An element keeps exp(-y) of its spin about d3, where y is
`spin_decay` times its length: as its inertia over its dilatation bears the spin, the decay grows with its length.
Across d3, where the inertia is half as large, it keeps the square of that.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lattice_gym.checks import FloatArray
from lattice_gym.engines.fused.kernels.arithmetic import fma, series
from lattice_gym.engines.fused.kernels.compiling import compiled, compiled_strictly, inlined
from lattice_gym.engines.fused.kernels.layout import LANES, Cells, Places
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.damping import Splitting, damping_shares
from lattice_gym.physics.rod import Rod

# Of y, (1 - exp(-y)) / y, exact to rounding up to y = 0.25:
LARGE_DECAY = 0.25
_TAIL = series(lambda y: -np.expm1(-y) / y, 8, LARGE_DECAY)
# Spin damped to less than this share within a step is too slow to count; the bound keeps 1 / keep^2 finite.
_MIN_KEEP = 1e-70
# A rate of damping this large leaves no speed worth counting; without the bound what it left would overflow.
_MAX_RATE = 300.0


def node_decay(model: RodModel, dt: float) -> FloatArray:
    """Rate of damping of every node times the step, shape (n_node,)."""
    rate: FloatArray = model.node_damping / model.node_mass * dt
    return rate


def fill_nodes(cells: Cells, node: Places, model: RodModel, dt: float, splitting: Splitting) -> None:
    """Write what a unit of force adds to the velocity of each node of a worm, and what it keeps of its own."""
    before, after = damping_shares(node_decay(model, dt), splitting)
    cells["keep"][node] = before * after
    cells["kick"][node] = dt / model.node_mass * after


def fill_spins(cells: Cells, lane: int, rod: Rod, dt: float) -> None:
    """Write the rate of damping of a rod's spins into one lane of its records."""
    cells[:-1]["spin_decay"][:, lane] = 0.5 * dt * rod.rotational_damping / rod.inertia / rod.rest_length


def loss_factors(model: RodModel, dt: float, splitting: Splitting) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Energy that damping takes from a node: per square of its speed after the kick, before it, and per product [kg].

    Each of shape (n_node,). With the shares a and b of a velocity that damping leaves before and after the kick
    (`damping_shares`), a force f turns the velocity u into u' = a b u + b f dt / m and does the work f (u + u') dt / 2.
    What of it is not in the kinetic energy is m / 2 [(1/b - 1) u'^2 + (1 - a) u^2 + (1/b - a) u u'].
    """
    rate = node_decay(model, dt)
    if splitting != "symmetric":
        rate = np.minimum(rate, _MAX_RATE)
    before, after = damping_shares(rate, splitting)
    half = 0.5 * model.node_mass
    return half * (1.0 / after - 1.0), half * (1.0 - before), half * (1.0 / after - before)


@inlined
def spin_tail(y: float) -> float:
    """Series of (1 - exp(-y)) / y: the share that damping leaves of the spin that a couple gives along with it."""
    y2 = y * y
    low = fma(y2, fma(_TAIL[3], y, _TAIL[2]), fma(_TAIL[1], y, _TAIL[0]))
    high = fma(y2, fma(_TAIL[7], y, _TAIL[6]), fma(_TAIL[5], y, _TAIL[4]))
    return float(fma(y2 * y2, fma(y2 * y2, _TAIL[8], high), low))


@compiled_strictly
def large_decay(here: Any, work: Any, symmetric: float | None) -> None:
    """Write what damping leaves of the spin of element e where the series does not reach."""
    for j in range(LANES):
        y = here.spin_decay[j] * work.length[j]
        if y > LARGE_DECAY:
            work.spin_keep[j] = np.exp(-y)
            if symmetric is not None:
                work.spin_late[j] = (1.0 - np.exp(-y)) / y


@compiled
def spin_loss(here: Any, work: Any, early: FloatArray, inertia: FloatArray, symmetric: float | None) -> float:
    """Energy that damping took from the spin of element e in the step just taken [J]; see `loss_factors`."""
    w, keep, late, length, inv_rest = here.w, work.spin_keep, work.spin_late, work.length, here.inv_rest
    lost = 0.0
    for i in range(3):
        for j in range(LANES):
            left = max(keep[j], _MIN_KEEP)
            if symmetric is not None:
                after = late[j] if i == 2 else 0.5 * (1.0 + keep[j]) * late[j]
                before = (keep[j] if i == 2 else keep[j] * keep[j]) / after
            else:
                after, before = left if i == 2 else left * left, 1.0
            taken = (1.0 / after - 1.0) * w[i, j] * w[i, j] + (1.0 - before) * early[i, j] * early[i, j]
            taken += (1.0 / after - before) * early[i, j] * w[i, j]
            lost += (1.0 if i == 2 else 0.5) * inertia[j] / (length[j] * inv_rest[j]) * taken
    return lost
