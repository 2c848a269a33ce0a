"""The plane z = 0: normal contact with a spring and a dashpot, Coulomb friction; see `physics.laws.ground.Ground`."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.fused.kernels.account import Account
from lattice_gym.engines.fused.kernels.compiling import compiled, inlined
from lattice_gym.engines.fused.kernels.layout import LANES, Cells, Places
from lattice_gym.physics.assembly import RodModel


class Axis(NamedTuple):
    """How the body lies: the unit vector from the mean of some nodes to that of others, `along`, shape (3,), in place.

    Records and lanes of either are given, shape (n,) each.
    """

    cell_a: IntArray
    lane_a: IntArray
    cell_b: IntArray
    lane_b: IntArray
    along: FloatArray


class Ground(NamedTuple):
    """Spring [N/m] and dashpot [N s/m] of a node, Coulomb's coefficients of friction.

    `forward`, `backward` and `sideways` are factors on both coefficients for slip along the body axis, against it and
    across. The axis is None where they are alike.
    """

    stiffness: float
    damping: float
    static_friction: float
    kinetic_friction: float
    forward: float
    backward: float
    sideways: float
    axis: Axis | None


def pack(model: RodModel, node: Places) -> Ground | None:
    """Constants of the ground; friction by direction is along the axis of the first worm, which is then alone."""
    ground, axis = model.ground, None
    if ground is None:
        return None
    if not ground.isotropic:
        tail, head = (node.of((0, end)) for end in model.rod_ends)
        axis = Axis(*tail, *head, np.zeros(3))
    friction = ground.static_friction, ground.kinetic_friction
    factors = ground.forward, ground.backward, ground.sideways
    return Ground(ground.stiffness, ground.damping, *friction, *factors, axis)


def fill(cells: Cells, node: Places, model: RodModel) -> None:
    """Write the height of a worm's nodes above the ground at which they touch it [m]."""
    cells["height"][node] = model.node_radius


def fill_spare(cells: Cells, first_lane: int) -> None:
    """Keep spare lanes off the ground."""
    cells["height"][:, first_lane:] = -np.inf


@inlined
def write_axis(cells: Cells, ground: Ground | None) -> None:
    """Write the body axis as its nodes stand, where friction depends on it."""
    if ground is not None:
        _write_axis(cells, ground.axis)


@compiled
def _write_axis(cells: Cells, axis: Axis | None) -> None:
    if axis is not None:
        square = 0.0
        for i in range(3):
            way = 0.0
            for n in range(axis.cell_a.shape[0]):
                way += cells[axis.cell_b[n]].x[i, axis.lane_b[n]] - cells[axis.cell_a[n]].x[i, axis.lane_a[n]]
            axis.along[i] = way
            square += way * way
        axis.along[:] /= np.sqrt(square)


@inlined
def _weighted_slip(u0: float, u1: float, ground: Ground, axis: Axis | None) -> float:
    """Speed of a slip times the factor that friction has in its direction, see `physics.laws.ground.Ground`."""
    a, b = u0, u1
    if axis is not None:
        e = axis.along
        a = u0 * e[0] + u1 * e[1]
        # Across, and what a tilted axis leaves of the slip: the root of slip^2 - a^2 without the loss of digits.
        b = np.sqrt((u1 * e[0] - u0 * e[1]) ** 2 + e[2] * e[2] * (u0 * u0 + u1 * u1))
    a *= ground.forward if a > 0.0 else ground.backward
    b *= ground.sideways
    return float(np.sqrt(a * a + b * b))


@compiled
def kick_on_ground(here: Any, ground: Ground, account: Account | None, n: int) -> None:
    """Kick and damp node n under the reaction of the ground.

    The normal force is that of a spring and a dashpot, but never pulls; it takes the velocity before the kick. It
    bounds the friction, which acts on the velocity after the kick and the damping: it stops the node where it can (the
    node sticks), else it takes its full size against the slip. So it balances the sum of all other forces, and never
    adds energy. The reaction is noted for the account, not yet its work: the ball's friction may change the velocity
    again.
    """
    x, v, force, kick, keep, height = here.x, here.v, here.force, here.kick, here.keep, here.height
    for j in range(LANES):
        depth = height[j] - x[2, j]
        spring = ground.stiffness * depth
        normal = spring - ground.damping * v[2, j]
        normal = normal if depth > 0.0 and normal > 0.0 else 0.0
        u0 = v[0, j] * keep[j] + force[0, j] * kick[j]
        u1 = v[1, j] * keep[j] + force[1, j] * kick[j]
        u2 = v[2, j] * keep[j] + (force[2, j] + normal) * kick[j]
        slip = u0 * u0 + u1 * u1
        grip = _weighted_slip(u0, u1, ground, ground.axis) * normal * kick[j]
        left = 1.0 - ground.kinetic_friction * grip / slip if slip > ground.static_friction * grip else 0.0
        if account is not None:
            share = (left - 1.0) / kick[j] if kick[j] > 0.0 else 0.0
            account.ground_reaction[n, 0, j], account.ground_reaction[n, 1, j] = share * u0, share * u1
            account.ground_reaction[n, 2, j] = normal - (spring if depth > 0.0 else 0.0)
        v[0, j], v[1, j], v[2, j] = left * u0, left * u1, u2
