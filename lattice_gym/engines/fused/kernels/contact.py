"""Rods that touch: normal contact of listed pairs of elements, a neighbour list with a skin; see `laws.contact`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.fused.kernels.compiling import compiled, inlined
from lattice_gym.engines.fused.kernels.layout import Cells, Places
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws import contact as law
from lattice_gym.physics.laws.elasticity import MAX_DILATATION

_SKIN = 0.25
"""How much further than they touch elements are listed, over the largest radii of two of them together."""
_LISTED = 16
"""Pairs for which there is room between calls, per element; where more are listed every call lists anew."""
_PARALLEL = 1e-12
"""As `laws.contact.PARALLEL`: a kernel reads no other folder, see `compiling`."""
_FAR_CELL = 1e9
"""Cells of the grid that a coordinate may be away from the origin: what is further has diverged and is not listed."""
_MIN_SQUARE = 1e-300

PairList = tuple[IntArray, int]
"""Pairs of elements as rows of an array, and how many of its rows are in use."""


class Contact(NamedTuple):
    """Elements that may touch, as the law has it: record, lane, rod and radius [m], shape (n,) each.

    Those that element i never touches are `excluded[row[i] : row[i + 1]]`, all beyond i. Elements nearer than their
    radii and the `skin` [m] are listed, again once a node has moved more than half the skin from where it was then,
    `listed` [m], shape (n, 2, 3), infinite where none is; `ends` are where they are now. An element beyond the length
    `longest` [m] has diverged and is not listed. `pairs` has the list, `n_listed` how many rows of it there are, shape
    (1,). Work space of the listing: `grid`, shape (n, 3), `next_in_bucket`, shape (n,), and `head`, whose size is a
    power of two.
    """

    cell: IntArray
    lane: IntArray
    rod: IntArray
    radius: FloatArray
    excluded: IntArray
    row: IntArray
    listed: FloatArray
    ends: FloatArray
    pairs: IntArray
    n_listed: IntArray
    grid: IntArray
    head: IntArray
    next_in_bucket: IntArray
    stiffness: float
    damping: float
    skin: float
    longest: float


def pack(model: RodModel, place: Places) -> Contact | None:
    """Tables of one worm, whose elements are at `place`, with nothing listed."""
    contact = model.contact
    if contact is None:
        return None
    element = law.touchable(model)
    n_elem = len(element)
    rod, radius = model.element_rod[element], model.element_radius[element]
    excluded = np.searchsorted(element, law.excluded(model))
    rest = model.rod_array("rest_length")
    return Contact(
        cell=place.cell[element], lane=place.lane[element], rod=rod, radius=radius,
        excluded=excluded[:, 1].copy(), row=np.searchsorted(excluded[:, 0], np.arange(n_elem + 1)),
        listed=np.full((n_elem, 2, 3), np.inf), ends=np.zeros((n_elem, 2, 3)),
        pairs=np.zeros((_LISTED * n_elem + 1, 2), np.int64), n_listed=np.zeros(1, np.int64),
        grid=np.zeros((n_elem, 3), np.int64),
        head=np.zeros(2 ** (2 * n_elem).bit_length(), np.int64), next_in_bucket=np.zeros(n_elem, np.int64),
        stiffness=contact.stiffness, damping=contact.damping, skin=_SKIN * 2.0 * float(radius.max(initial=0.0)),
        longest=MAX_DILATATION * float(rest[element].max(initial=0.0)),
    )  # fmt: skip


def clear_list(contact: Contact) -> None:
    """Let the next step list anew: where a run diverged, nothing could tell how far nodes have moved since."""
    contact.listed[:] = np.inf


@inlined
def listed_pairs(contact: Contact | None) -> PairList:
    """Pairs that the call before has listed."""
    if contact is None:
        return np.empty((0, 2), np.int64), 0
    return contact.pairs, contact.n_listed[0]


@compiled
def add_contact_forces(cells: Cells, contact: Contact | None, pairs: PairList) -> tuple[PairList, float]:
    """Add the forces of all contacts, with pairs listed anew where nodes have moved too far.

    Returns the pairs and the power that the dashpots dissipate [W].
    """
    if contact is None:
        return pairs, 0.0
    if _write_ends(cells, contact) > 0.25 * contact.skin * contact.skin:
        pairs = list_pairs(cells, contact)
    return pairs, _add_normal_forces(cells, contact, pairs[0], pairs[1])


@compiled
def close_list(contact: Contact | None, pairs: PairList) -> None:
    """Forget a list that outgrew its room: it is lost with this call."""
    if contact is None:
        return
    if pairs[1] > len(contact.pairs):
        contact.listed[:] = np.inf


@compiled
def _write_ends(cells: Cells, contact: Contact) -> float:
    """Note where the nodes of every element stand; return the largest square of a way gone since they were listed."""
    most, ends, listed = 0.0, contact.ends, contact.listed
    for e in range(contact.cell.shape[0]):
        here, there, j = cells[contact.cell[e]].x, cells[contact.cell[e] + 1].x, contact.lane[e]
        first, second = 0.0, 0.0
        for i in range(3):
            ends[e, 0, i], ends[e, 1, i] = here[i, j], there[i, j]
            first += (here[i, j] - listed[e, 0, i]) ** 2
            second += (there[i, j] - listed[e, 1, i]) ** 2
        most = max(most, first, second)
    return most


@compiled
def _add_normal_forces(cells: Cells, contact: Contact, pairs: IntArray, count: int) -> float:
    """Add the push of listed elements where they overlap to their nodes; return the power that it dissipates [W]."""
    lost = 0.0
    for k in range(count):
        one, two = pairs[k, 0], pairs[k, 1]
        s, t, gx, gy, gz, square = nearest(contact.ends, one, two)
        distance = contact.radius[one] + contact.radius[two]
        if not square < distance * distance:
            continue
        inverse = 1.0 / np.sqrt(max(square, _MIN_SQUARE))
        normal = (gx * inverse, gy * inverse, gz * inverse)
        here_a, there_a, j = cells[contact.cell[one]], cells[contact.cell[one] + 1], contact.lane[one]
        here_b, there_b, m = cells[contact.cell[two]], cells[contact.cell[two] + 1], contact.lane[two]
        rate = 0.0
        for i in range(3):
            speed = (1.0 - s) * here_a.v[i, j] + s * there_a.v[i, j] - (1.0 - t) * here_b.v[i, m] - t * there_b.v[i, m]
            rate += speed * normal[i]
        spring = contact.stiffness * (distance - square * inverse)
        push = max(spring - contact.damping * rate, 0.0)
        for i in range(3):
            force = push * normal[i]
            here_a.force[i, j] += (1.0 - s) * force
            there_a.force[i, j] += s * force
            here_b.force[i, m] -= (1.0 - t) * force
            there_b.force[i, m] -= t * force
        lost += (spring - push) * rate
    return lost


@compiled
def nearest(ends: FloatArray, one: int, two: int) -> tuple[float, float, float, float, float, float]:
    """Shares of two segments where they are nearest, the vector from the second to the first there, and its square.

    Their ends have the shape (n, 2, 3). Ericson 2005, Real-Time Collision Detection, section 5.1.9.
    """
    ax, ay, az = ends[one, 0, 0], ends[one, 0, 1], ends[one, 0, 2]
    bx, by, bz = ends[two, 0, 0], ends[two, 0, 1], ends[two, 0, 2]
    ux, uy, uz = ends[one, 1, 0] - ax, ends[one, 1, 1] - ay, ends[one, 1, 2] - az
    wx, wy, wz = ends[two, 1, 0] - bx, ends[two, 1, 1] - by, ends[two, 1, 2] - bz
    rx, ry, rz = ax - bx, ay - by, az - bz
    uu, ww, uw = ux * ux + uy * uy + uz * uz, wx * wx + wy * wy + wz * wz, ux * wx + uy * wy + uz * wz
    ur, wr = ux * rx + uy * ry + uz * rz, wx * rx + wy * ry + wz * rz
    turned = uu * ww - uw * uw
    if turned > _PARALLEL * uu * ww:
        s = min(max((uw * wr - ur * ww) / turned, 0.0), 1.0)
    else:
        s = 0.5 * (min(max(-ur / uu, 0.0), 1.0) + min(max((uw - ur) / uu, 0.0), 1.0))
    t = (uw * s + wr) / ww
    if t < 0.0:
        t, s = 0.0, min(max(-ur / uu, 0.0), 1.0)
    elif t > 1.0:
        t, s = 1.0, min(max((uw - ur) / uu, 0.0), 1.0)
    gx, gy, gz = rx + s * ux - t * wx, ry + s * uy - t * wy, rz + s * uz - t * wz
    return s, t, gx, gy, gz, gx * gx + gy * gy + gz * gz


@compiled
def list_pairs(cells: Cells, contact: Contact) -> PairList:
    """List the pairs of elements that may come to touch.

    Elements are put into the cells of a grid by their middles; two nearer than their radii and the skin are in cells
    that are neighbours. Where elements stand at all costs no memory: cells share a table. Pairs are in order, so that
    forces add up to the same last bit whenever the list was made.
    """
    n_elem, listed, grid, head, next_in_bucket = (
        len(contact.cell),
        contact.listed,
        contact.grid,
        contact.head,
        contact.next_in_bucket,
    )
    rod, radius, skin, excluded, row = contact.rod, contact.radius, contact.skin, contact.excluded, contact.row
    _write_ends(cells, contact)
    listed[:] = contact.ends
    longest, thickest, bound = 0.0, 0.0, contact.longest * contact.longest
    for e in range(n_elem):
        square = _square_length(listed, e)
        if square <= bound:
            longest = max(longest, square)
        thickest = max(thickest, radius[e])
    fine = 1.0 / (np.sqrt(longest) + 2.0 * thickest + skin)
    pairs, count = contact.pairs, 0
    head[:] = -1
    for e in range(n_elem):
        sound = _square_length(listed, e) <= bound
        for i in range(3):
            place = np.floor(0.5 * (listed[e, 0, i] + listed[e, 1, i]) * fine)
            sound = sound and abs(place) <= _FAR_CELL
            grid[e, i] = int(place) if sound else 0
        if not sound:
            continue
        x, y, z, first = grid[e, 0], grid[e, 1], grid[e, 2], count
        for near in range(27):
            p, q, r = x + near % 3 - 1, y + near // 3 % 3 - 1, z + near // 9 - 1
            other = head[_bucket(p, q, r, head.shape[0])]
            while other >= 0:
                same = grid[other, 0] == p and grid[other, 1] == q and grid[other, 2] == r
                if (
                    same
                    and rod[other] != rod[e]
                    and _is_near(listed, other, e, radius[other] + radius[e] + skin)
                    and not _is_excluded(excluded, row[other], row[other + 1], e)
                ):
                    if count == pairs.shape[0]:
                        more = np.empty((2 * count, 2), np.int64)
                        more[:count] = pairs
                        pairs = more
                    k = count
                    while k > first and pairs[k - 1, 0] > other:
                        pairs[k, 0] = pairs[k - 1, 0]
                        k -= 1
                    pairs[k, 0], pairs[count, 1] = other, e
                    count += 1
                other = next_in_bucket[other]
        bucket = _bucket(x, y, z, head.shape[0])
        next_in_bucket[e], head[bucket] = head[bucket], e
    contact.n_listed[0] = count
    return pairs, count


@compiled
def _bucket(x: int, y: int, z: int, size: int) -> int:
    """Place of a cell of the grid in a table whose size is a power of two."""
    return ((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & (size - 1)


@compiled
def _square_length(listed: FloatArray, e: int) -> float:
    """Square of the length of a segment."""
    square = 0.0
    for i in range(3):
        square += (listed[e, 1, i] - listed[e, 0, i]) ** 2
    return square


@compiled
def _is_near(listed: FloatArray, a: int, b: int, distance: float) -> bool:
    """Whether two segments are nearer than `distance`; their middles are then within it and half of either length."""
    apart, own, other = 0.0, 0.0, 0.0
    for i in range(3):
        apart += (listed[a, 0, i] + listed[a, 1, i] - listed[b, 0, i] - listed[b, 1, i]) ** 2
        own += (listed[a, 1, i] - listed[a, 0, i]) ** 2
        other += (listed[b, 1, i] - listed[b, 0, i]) ** 2
    # (p + q)^2 <= 2 p^2 + 2 q^2, twice: no root is needed.
    if apart > 8.0 * distance * distance + 4.0 * (own + other):
        return False
    return bool(nearest(listed, a, b)[5] < distance * distance)


@compiled
def _is_excluded(excluded: IntArray, first: int, last: int, b: int) -> bool:
    """Whether b is among excluded[first:last]."""
    found = False
    for k in range(first, last):
        found = found or excluded[k] == b
    return found
