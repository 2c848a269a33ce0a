"""Records of the compiled code, in which rods stand side by side in lanes.

Rods with the same element count stand in the `LANES` lanes of one *block*: record n of a block holds node n, element n
and the Voronoi region between elements n and n + 1 of each of its rods. Every field of the structured dtype has a
compile-time offset, so LLVM proves that fields do not alias and turns each `for j in range(LANES)` loop into packed
instructions. A spare lane holds a copy of a rod that neither moves nor turns. No lane acts on another: rods of several
worms share blocks, and each moves to the last bit as in any other company.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lattice_gym.checks import IntArray

LANES = 16
_CACHE_LINE = 64


def _record(**fields: int) -> np.dtype[np.void]:
    """Record of fields by their number of components; `x[i, lane]`, or `rest[lane]` of a single one.

    As `np.record` has it, so that kernels run as plain Python too, see `tests/test_kernels.py`.
    """
    parts = [(name, np.float64, (n, LANES) if n > 1 else (LANES,)) for name, n in fields.items()]
    return np.dtype((np.record, parts))


CELL = _record(
    # node
    x=3, v=3, force=3, kick=1, keep=1,
    # element
    q=9, w=3, rest=1, shear=1, stretch=1, spin_kick=1, spin_decay=1,
    # Voronoi region
    bend=1, twist=1, rest_turn=3,
    # only where the scene has them
    tension=1, tension_rise=1, inv_rest=1, couple=3, load=3, height=1,
)  # fmt: skip
"""One record of a block.

Of a node its position [m], velocity [m/s] and force [N]; in a step a unit force adds `kick` to the velocity, about
dt / m, and damping leaves the share `keep` of the velocity before. Of an element its directors as rows, angular
velocity in the material frame [rad/s], rest length [m], stiffness against shear and stretch [N], dt / (J1 rest), and
half the rate of damping times dt over the rest length. Of a Voronoi region bend and twist stiffness times 16 rest^2,
and half the rotation at rest. Tension of a muscle [N] and its rise in a step, 1 / rest, external couple [N m], constant
load [N], node radius [m].
"""

WORK = _record(
    arm=2, passed=3, length=1, stretch_rate=1, lean=3, spin_keep=1, spin_late=1, half_angle=1,
    square=1, sine=1, versine=1,
)  # fmt: skip
"""What is known of an element within a step. Two records are enough to step with: they stay in the fastest memory."""

Cells = npt.NDArray[Any]


class Blocks(NamedTuple):
    """Records, work space, and the blocks of passive rods and of muscles: rows (first record, one past the last).

    `work` has two records; for an energy account as many as `cells` or more, their number a power of two.
    """

    cells: Cells
    work: Cells
    passive: IntArray
    active: IntArray


class Places(NamedTuple):
    """Record and lane of nodes or elements; with the shape (n,) each it indexes a field of the records."""

    cell: IntArray
    lane: IntArray

    def of(self, key: Any) -> Places:
        """Those of one worm, where shapes are (n_worm, n), or those of some nodes, `[:, nodes]`."""
        return Places(self.cell[key], self.lane[key])


def aligned(dtype: np.dtype[np.void], count: int) -> Cells:
    """Make records of zeros that begin on a cache line, so that no packed load straddles two."""
    space = np.zeros(count * dtype.itemsize + _CACHE_LINE, np.uint8)
    start = -space.ctypes.data % _CACHE_LINE
    return space[start : start + count * dtype.itemsize].view(dtype)
