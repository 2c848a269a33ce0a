"""Tension of muscle rods along their elements."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.fused.kernels.account import Account
from lattice_gym.engines.fused.kernels.compiling import compiled
from lattice_gym.engines.fused.kernels.hill import Hill, hill_factor
from lattice_gym.engines.fused.kernels.layout import CELL, LANES, Cells, Places
from lattice_gym.physics.assembly import RodModel


class TensionFields(NamedTuple):
    """The records as flat numbers, and the fields there that hold tensions.

    These are the tension and its rise in a step of every muscle element, shape (2, n_worm, n); `muscle` is that of
    each, shape (n,). Written flat it takes half the time of writing field by field.
    """

    flat: FloatArray
    place: IntArray
    muscle: IntArray

    def write(self, tension: FloatArray, rise: FloatArray) -> None:
        """Write the tension of the next step and its rise [N], shape (n_worm, n_muscle) each."""
        self.flat[self.place] = np.array([tension, rise]).take(self.muscle, axis=-1)


def pack(model: RodModel, element: Places, cells: Cells) -> TensionFields:
    """Places of the tensions of worms whose elements are at `element`, shape (n_worm, n_elem)."""
    muscle = np.full(model.n_rod, -1)
    muscle[list(model.muscles)] = np.arange(len(model.muscles))
    muscle_of = np.repeat(muscle, [rod.n_elem for rod in model.rods])
    pulled = muscle_of >= 0
    flat = cells.view(np.float64)
    place_of = np.arange(flat.size).view(CELL)
    at = element.of((slice(None), pulled))
    place = np.array([place_of[name][at] for name in ("tension", "tension_rise")]).view(np.int64)
    return TensionFields(flat, place, muscle_of[pulled])


@compiled
def _length(pair: Cells, j: int) -> float:
    """Length of element e of lane j as its nodes stand."""
    square = 0.0
    for i in range(3):
        side = pair[1].x[i, j] - pair[0].x[i, j]
        square += side * side
    return float(np.sqrt(square))


@compiled
def account_muscles(
    cells: Cells, active: IntArray, hill: Hill | None, account: Account, counts: bool, lag: float
) -> None:
    """Add the work of the muscle rods since the moment last counted, by the trapezoid rule; begin to count from now.

    The tension now is `lag` rises before the one that comes next.
    """
    work = 0.0
    for b in range(active.shape[0]):
        for n in range(active[b, 0], active[b, 1] - 1):
            here, there = cells[n], cells[n + 1]
            for j in range(LANES):
                length, tension = _length(cells[n : n + 2], j), here.tension[j] - lag * here.tension_rise[j]
                if hill is not None:
                    along = 0.0
                    for i in range(3):
                        along += (there.v[i, j] - here.v[i, j]) * (there.x[i, j] - here.x[i, j])
                    inv_rest = here.inv_rest[j]
                    tension *= hill_factor(length * inv_rest, along / length * inv_rest, hill)
                if counts:
                    work += 0.5 * (account.tension[n, j] + tension) * (account.length[n, j] - length)
                account.length[n, j], account.tension[n, j] = length, tension
    account.total[0] += work
