"""Massless muscles between two nodes: an elastic line and a tension, see `physics.laws.lines.Line`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.fused.kernels.account import Account
from lattice_gym.engines.fused.kernels.compiling import compiled, inlined
from lattice_gym.engines.fused.kernels.hill import Hill, hill_factor
from lattice_gym.engines.fused.kernels.joints import tie_ends
from lattice_gym.engines.fused.kernels.layout import Cells, Places
from lattice_gym.physics.assembly import RodModel


class Lines(NamedTuple):
    """Lines of all worms, worm by worm: record and lane of both nodes, rest length [m], E A [N], shape (n,) each.

    The tension [N] is advanced in place by its rise at every step.
    """

    cell_a: IntArray
    lane_a: IntArray
    cell_b: IntArray
    lane_b: IntArray
    rest_length: FloatArray
    stiffness: FloatArray
    tension: FloatArray
    rise: FloatArray


def pack(model: RodModel, node: Places) -> Lines | None:
    """Lines whose constants are to be filled in, where the scene has any."""
    if not model.lines:
        return None
    ends = tie_ends(model, model.lines, node)
    return Lines(*ends, *np.zeros((4, len(ends[0]))))


def fill(lines: Lines | None, worm: int, model: RodModel) -> None:
    """Write the constants of a worm."""
    if lines is not None:
        own = slice(worm * len(model.lines), (worm + 1) * len(model.lines))
        lines.rest_length[own] = [line.rest_length for line in model.lines]
        lines.stiffness[own] = [line.stiffness for line in model.lines]


def write_tension(lines: Lines | None, tension: FloatArray, rise: FloatArray) -> None:
    """Write the tension of the next step and its rise [N], shape (n_worm, n_muscle): lines are the last muscles."""
    if lines is not None:
        n_line = len(lines.tension) // len(tension)
        lines.tension[:] = tension[:, -n_line:].ravel()
        lines.rise[:] = rise[:, -n_line:].ravel()


@inlined
def apply_lines(cells: Cells, lines: Lines | None, hill: Hill | None) -> None:
    """Pull each line's two nodes together by its tension and by E A (e - 1) / e, the force of a stretched rod."""
    if lines is None:
        return
    for n in range(lines.cell_a.shape[0]):
        a, b, la, lb = cells[lines.cell_a[n]], cells[lines.cell_b[n]], lines.lane_a[n], lines.lane_b[n]
        dx, dy, dz = b.x[0, lb] - a.x[0, la], b.x[1, lb] - a.x[1, la], b.x[2, lb] - a.x[2, la]
        inverse = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
        tension = lines.tension[n]
        if hill is not None:
            du, dv, dw = b.v[0, lb] - a.v[0, la], b.v[1, lb] - a.v[1, la], b.v[2, lb] - a.v[2, la]
            inv_rest, rate = 1.0 / lines.rest_length[n], (du * dx + dv * dy + dw * dz) * inverse
            tension *= hill_factor(inv_rest / inverse, rate * inv_rest, hill)
        pull = (tension + lines.stiffness[n] * (1.0 - lines.rest_length[n] * inverse)) * inverse
        a.force[0, la] += pull * dx
        a.force[1, la] += pull * dy
        a.force[2, la] += pull * dz
        b.force[0, lb] -= pull * dx
        b.force[1, lb] -= pull * dy
        b.force[2, lb] -= pull * dz
        lines.tension[n] += lines.rise[n]


@compiled
def account_lines(cells: Cells, lines: Lines, hill: Hill | None, account: Account, counts: bool, lag: float) -> None:
    """Add the work of the lines since the moment last counted, as `muscles.account_muscles` does."""
    for n in range(lines.cell_a.shape[0]):
        a, b, la, lb = cells[lines.cell_a[n]], cells[lines.cell_b[n]], lines.lane_a[n], lines.lane_b[n]
        square, along = 0.0, 0.0
        for i in range(3):
            side = b.x[i, lb] - a.x[i, la]
            square += side * side
            along += (b.v[i, lb] - a.v[i, la]) * side
        length, pull = np.sqrt(square), lines.tension[n] - lag * lines.rise[n]
        if hill is not None:
            inv_rest = 1.0 / lines.rest_length[n]
            pull *= hill_factor(length * inv_rest, along / length * inv_rest, hill)
        if counts:
            account.total[0] += 0.5 * (account.line_tension[n] + pull) * (account.line[n] - length)
        account.line[n], account.line_tension[n] = length, pull
