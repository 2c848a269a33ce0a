"""Health of the worms: which are sound, and where another failed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.fused.kernels.ball import Ball
from lattice_gym.engines.fused.kernels.compiling import compiled_strictly
from lattice_gym.engines.fused.kernels.joints import Joints
from lattice_gym.engines.fused.kernels.layout import LANES, Cells
from lattice_gym.engines.fused.kernels.lines import Lines


class WormTable(NamedTuple):
    """Whose records are whose: record and lane of every node and element of each worm, and how it ended a call.

    Shapes (n_worm, n_node) and (n_worm, n_elem). `max_gap` is the gap beyond which each joint counts as torn [m], shape
    (n_worm, n_joint), and the dilatations those beyond which an element or a line counts as overstretched. Positions
    [m] and velocities [m/s] of sound worms are written in the `row` of each, shape (n, n_node, 3). `status` (as
    `engines.health.Status`) and `found`, the element or joint at fault, have the shape (n_worm,).
    """

    node_cell: IntArray
    node_lane: IntArray
    cell: IntArray
    lane: IntArray
    max_gap: FloatArray
    min_dilatation: float
    max_dilatation: float
    row: IntArray
    position: FloatArray
    velocity: FloatArray
    status: IntArray
    found: IntArray


@compiled_strictly
def is_sound(cells: Cells, blocks: IntArray, worms: WormTable) -> bool:
    """Tell whether `inspect` would find no element of some blocks at fault, all lanes at once."""
    min_dilatation, max_dilatation = worms.min_dilatation, worms.max_dilatation
    faults = 0
    for block in range(blocks.shape[0]):
        for e in range(blocks[block, 0], blocks[block, 1] - 1):
            here, there = cells[e], cells[e + 1]
            for j in range(LANES):
                square, along, sum_ = 0.0, 0.0, 0.0
                for i in range(3):
                    side = there.x[i, j] - here.x[i, j]
                    square += side * side
                    along += here.q[6 + i, j] * side
                    sum_ += abs(here.v[i, j]) + abs(there.v[i, j]) + abs(here.w[i, j])
                for i in range(9):
                    sum_ += abs(here.q[i, j])
                dilatation = np.sqrt(square) * here.inv_rest[j]
                # Written so that NaN is none of it.
                bounded = (square + sum_ < np.inf) & (dilatation >= min_dilatation) & (dilatation <= max_dilatation)
                faults += not (bounded & (along > 0.0))
    return faults == 0


@compiled_strictly
def inspect(
    cells: Cells,
    worms: WormTable,
    worm: int,
    sound: bool,
    joints: Joints,
    lines: Lines | None,
    ball: Ball | None,
) -> tuple[int, int]:
    """Status code of a worm and its first element or joint at fault, or (0, -1) and it is written in its row.

    Lines count on from the elements; a failure of the ball has no element, -1. Where all elements are known to be
    `sound` they are not looked at.
    """
    min_dilatation, max_dilatation = worms.min_dilatation, worms.max_dilatation
    n_elem, n_joint = worms.cell.shape[1], worms.max_gap.shape[1]
    for e in range(0 if sound else n_elem):
        first, j = worms.cell[worm, e], worms.lane[worm, e]
        here, there = cells[first], cells[first + 1]
        square, along, sum_ = 0.0, 0.0, 0.0
        for i in range(3):
            side = there.x[i, j] - here.x[i, j]
            square += side * side
            along += here.q[6 + i, j] * side
            sum_ += abs(here.v[i, j]) + abs(there.v[i, j]) + abs(here.w[i, j])
        for i in range(9):
            sum_ += abs(here.q[i, j])
        if not np.isfinite(square + sum_):
            return 1, e
        dilatation = np.sqrt(square) * here.inv_rest[j]
        if dilatation < min_dilatation or dilatation > max_dilatation:
            return 2, e
        if along <= 0.0:
            return 3, e
    for k in range(n_joint):
        n = worm * n_joint + k
        a, b, la, lb = cells[joints.cell_a[n]], cells[joints.cell_b[n]], joints.lane_a[n], joints.lane_b[n]
        square = 0.0
        for i in range(3):
            gap = b.x[i, lb] - a.x[i, la]
            square += gap * gap
        if not square <= worms.max_gap[worm, k] * worms.max_gap[worm, k]:
            return 4, k
    if lines is not None:
        n_line = lines.cell_a.shape[0] // worms.row.shape[0]
        for k in range(n_line):
            n = worm * n_line + k
            a, b, la, lb = cells[lines.cell_a[n]], cells[lines.cell_b[n]], lines.lane_a[n], lines.lane_b[n]
            square = 0.0
            for i in range(3):
                side = b.x[i, lb] - a.x[i, la]
                square += side * side
            dilatation = np.sqrt(square) / lines.rest_length[n]
            if dilatation < min_dilatation or dilatation > max_dilatation:
                return 2, n_elem + k
    if ball is not None:
        for i in range(3):
            if not np.isfinite(ball.position[i] + ball.velocity[i] + ball.omega[i]):
                return 1, -1
        for i in range(3):
            ball.output[0][i], ball.output[1][i] = ball.position[i], ball.velocity[i]
    row = worms.row[worm]
    for n in range(worms.node_cell.shape[1]):
        here, j = cells[worms.node_cell[worm, n]], worms.node_lane[worm, n]
        for i in range(3):
            worms.position[row, n, i], worms.velocity[row, n, i] = here.x[i, j], here.v[i, j]
    return 0, -1
