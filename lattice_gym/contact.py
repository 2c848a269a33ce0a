"""Where rods touch each other: the law in plain numpy, for the ledger, for the reference engine and for tests.

Every element of a rod that is no muscle is a cylinder of its rest radius with round ends, and pushes at those of other
rods. Where two overlap by a depth, with u_n the speed at which the nearest points of their centre lines part,

    N = max(0, stiffness depth - damping u_n)

acts on either along the line through these points, shared between its two nodes by the lever rule: momentum and angular
momentum close. There is no friction. Two elements that overlap at rest never touch: where rods cross they are joined,
and lie in each other. A rod does not touch itself, and muscles, which lie on the crossings, touch nothing.

At a node two elements meet, so that rods which touch node on node are held by four such pairs, within elements by one.
Once centre lines have crossed, the push is the other way: the law holds as long as depths stay below the reach.
"""

from __future__ import annotations

import numpy as np

from lattice_gym.design import FloatArray, IntArray
from lattice_gym.model import RodModel

PARALLEL = 1e-8
"""Square of the sine of the angle between two elements below which they touch in the middle of where they run along
each other: the nearest points are lost in rounding there."""


def nearest(a: FloatArray, along_a: FloatArray, b: FloatArray, along_b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Shares of two segments at which they are nearest, shape (n,) each, 0 at the starts a and b and 1 at the ends.

    The least of a convex function on a square: inside it, where that is within, else on the nearest of four sides.
    """
    square_a, square_b = np.sum(along_a**2, axis=1), np.sum(along_b**2, axis=1)
    both, gap = np.sum(along_a * along_b, axis=1), b - a

    def on_a(t: FloatArray | float) -> FloatArray:
        share: FloatArray = np.clip((np.sum(gap * along_a, axis=1) + t * both) / square_a, 0.0, 1.0)
        return share

    def on_b(s: FloatArray | float) -> FloatArray:
        share: FloatArray = np.clip((s * both - np.sum(gap * along_b, axis=1)) / square_b, 0.0, 1.0)
        return share

    zero, one = np.zeros(len(a)), np.ones(len(a))
    first = np.stack([zero, one, on_a(0.0), on_a(1.0)])
    second = np.stack([on_b(0.0), on_b(1.0), zero, one])
    apart = gap + second[..., None] * along_b - first[..., None] * along_a
    side, every = np.argmin(np.sum(apart**2, axis=2), axis=0), np.arange(len(a))
    s, t = first[side, every], second[side, every]
    turned = square_a * square_b - both**2
    slanted = turned > PARALLEL * square_a * square_b
    safe = np.where(slanted, turned, 1.0)
    inner_s = (np.sum(gap * along_a, axis=1) * square_b - np.sum(gap * along_b, axis=1) * both) / safe
    inner_t = (np.sum(gap * along_a, axis=1) * both - np.sum(gap * along_b, axis=1) * square_a) / safe
    inside = slanted & (inner_s > 0.0) & (inner_s < 1.0) & (inner_t > 0.0) & (inner_t < 1.0)
    s, t = np.where(inside, inner_s, s), np.where(inside, inner_t, t)
    middle = 0.5 * (on_a(0.0) + on_a(1.0))
    beside = ~slanted & (on_a(0.0) != on_a(1.0))
    return np.where(beside, middle, s), np.where(beside, on_b(middle), t)


def touchable(model: RodModel) -> IntArray:
    """Elements of all rods that are no muscles, in order."""
    return np.flatnonzero(~np.isin(rod_of(model), model.muscles))


def rod_of(model: RodModel) -> IntArray:
    """Rod of every element, shape (n_elem,)."""
    return np.repeat(np.arange(model.n_rod), [rod.n_elem for rod in model.rods])


def depths(model: RodModel, position: FloatArray, pairs: IntArray) -> FloatArray:
    """Depth to which each pair of elements overlaps [m], shape (n_pair,); negative where they are apart."""
    lower = np.arange(model.n_elem) + rod_of(model)
    start, side = position[lower], position[lower + 1] - position[lower]
    i, j = pairs.T
    s, t = nearest(start[i], side[i], start[j], side[j])
    distance = np.linalg.norm(start[i] + s[:, None] * side[i] - start[j] - t[:, None] * side[j], axis=1)
    depth: FloatArray = model.element_radius[i] + model.element_radius[j] - distance
    return depth


def overlapping(model: RodModel, position: FloatArray) -> IntArray:
    """Pairs of touchable elements of different rods that overlap, shape (n_pair, 2): first < second, sorted.

    Sorted by their place along the longest side of the assembly, elements are tried with those near them on it.
    """
    element, rod = touchable(model), rod_of(model)
    lower = element + rod[element]
    middle = 0.5 * (position[lower] + position[lower + 1])
    if not np.isfinite(middle).all() or len(element) == 0:
        return np.zeros((0, 2), np.int64)
    size = np.linalg.norm(position[lower + 1] - position[lower], axis=1) + 2.0 * model.element_radius[element]
    along = middle[:, np.argmax(np.ptp(middle, axis=0))]
    order = np.argsort(along)
    count = np.searchsorted(along[order], along[order] + size.max(), side="right") - np.arange(len(order)) - 1
    before = np.repeat(np.arange(len(order)), count)
    after = before + 1 + np.arange(len(before)) - np.repeat(np.cumsum(count) - count, count)
    pairs = np.sort(element[order[np.stack([before, after], axis=1)]], axis=1)
    pairs = pairs[rod[pairs[:, 0]] != rod[pairs[:, 1]]]
    pairs = pairs[depths(model, position, pairs) > 0.0]
    found: IntArray = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    return found


def excluded(model: RodModel) -> IntArray:
    """Pairs of elements that overlap at rest, and so never touch, as `overlapping` has them."""
    return overlapping(model, model.rest_state().position)
