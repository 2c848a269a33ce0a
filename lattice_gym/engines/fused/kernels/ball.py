"""The rigid ball: contact with every element that it overlaps, and Coulomb friction there; see `physics.laws.ball`.

Friction is that of all touches together, found by symmetric projected Gauss-Seidel sweeps on the velocities that all
other forces leave.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.fused.kernels.compiling import compiled
from lattice_gym.engines.fused.kernels.layout import LANES, Cells, Places
from lattice_gym.physics.assembly import RodModel

# Sweeps forth and back over the touches, at most; they end when no friction changed by more than this share of the
# largest that may be.
_MAX_SWEEPS = 6
_TOLERANCE = 1e-9
_MIN_SQUARE = 1e-300

TOUCH = np.dtype(
    (
        np.record,
        [(name, np.int64) for name in ("cell", "lane", "first", "second")]
        + [(name, np.float64) for name in ("share_b", "kick_a", "kick_b", "effective_mass", "max_friction")]
        + [(name, np.float64, (3,)) for name in ("gap", "normal", "early", "friction")],
    )
)
"""An element on which the ball's friction acts in this step: record, lane, rows of its nodes in `Ball.nodes`, share of
the second.

A unit of friction [N] adds `kick_a` and `kick_b` to the velocities of its nodes in the step, and changes the slip
there by one over the `effective_mass` (times dt): the diagonal of the Delassus matrix. It can be at most `max_friction`
[N]. `gap` leads from the centre line to the ball's centre [m], along `normal`; `early` is the slip before the kick
[m/s], `friction` that on the ball [N].
"""


class Ball(NamedTuple):
    """Position [m], velocity [m/s], angular velocity [rad/s] and constant force [N], shape (3,) each, in place.

    `distance` has the radii of ball and element together, by record and lane [m], shape (n_cell, LANES), 0 where there
    is nothing to touch. `cell` and `lane` are those of every element in the order of the model, shape (n_elem,). A unit
    of force adds `kick` to its velocity in a step, a unit of torque `spin_kick` to its spin. Work space: `load`, the
    force of the contacts but for friction [N], shape (3,); `overlaps`, whether it overlaps any element of a record,
    shape (n_cell,); `touches`, shape (n_elem,); and velocities of the nodes that it touches [m/s], shape (2 n_elem, 3).
    `output` are its position and velocity as of the last sound moment, shape (3,) each.
    """

    position: FloatArray
    velocity: FloatArray
    omega: FloatArray
    force: FloatArray
    load: FloatArray
    distance: FloatArray
    overlaps: npt.NDArray[np.bool_]
    cell: IntArray
    lane: IntArray
    touches: npt.NDArray[Any]
    nodes: FloatArray
    kick: float
    spin_kick: float
    stiffness: float
    damping: float
    friction: float
    output: tuple[FloatArray, FloatArray]


def pack(
    model: RodModel, element: Places, n_cell: int, dt: float, output: tuple[FloatArray, FloatArray]
) -> Ball | None:
    """Ball of one worm, at rest where it starts, shown in two rows of shape (1, 3)."""
    ball = model.ball
    if ball is None:
        return None
    distance = np.zeros((n_cell, LANES))
    distance[element] = ball.radius + model.element_radius
    return Ball(
        position=ball.position.copy(), velocity=np.zeros(3), omega=np.zeros(3), force=np.array(ball.force),
        load=np.zeros(3), distance=distance, overlaps=np.zeros(n_cell, np.bool_), cell=element.cell, lane=element.lane,
        touches=np.zeros(model.n_elem, TOUCH), nodes=np.zeros((2 * model.n_elem, 3)),
        kick=dt / ball.mass, spin_kick=dt / ball.inertia,
        stiffness=ball.stiffness, damping=ball.damping, friction=ball.friction, output=(output[0][0], output[1][0]),
    )  # fmt: skip


@compiled
def drift_ball(ball: Ball | None, drift: float) -> None:
    """Move the ball by its velocity over `drift` seconds."""
    if ball is None:
        return
    for i in range(3):
        ball.position[i] += drift * ball.velocity[i]


@compiled
def kick_ball(cells: Cells, passive: IntArray, active: IntArray, ball: Ball | None) -> tuple[int, float]:
    """Add the normal forces of the ball's contacts, and kick it by them and its constant force.

    Returns the number of touches with friction, and the power that the dashpots dissipate [W].
    """
    n_touch, lost = 0, 0.0
    if ball is None:
        return n_touch, lost
    ball.load[:] = 0.0
    if _mark_overlaps(cells, passive, active, ball):
        n_touch, lost = _add_normal_forces(cells, ball)
    for i in range(3):
        ball.velocity[i] += ball.kick * (ball.load[i] + ball.force[i])
    return n_touch, lost


@compiled
def _mark_overlaps(cells: Cells, passive: IntArray, active: IntArray, ball: Ball) -> bool:
    """Mark the records of which the ball overlaps an element; tell whether there are any."""
    found = False
    c0, c1, c2 = ball.position[0], ball.position[1], ball.position[2]
    for blocks in (passive, active):
        for b in range(blocks.shape[0]):
            for e in range(blocks[b, 0], blocks[b, 1] - 1):
                x0, x1, distance = cells[e].x, cells[e + 1].x, ball.distance[e]
                n_touching = 0
                for j in range(LANES):
                    dx, dy, dz = x1[0, j] - x0[0, j], x1[1, j] - x0[1, j], x1[2, j] - x0[2, j]
                    gx, gy, gz = c0 - x0[0, j], c1 - x0[1, j], c2 - x0[2, j]
                    share_b = (gx * dx + gy * dy + gz * dz) / (dx * dx + dy * dy + dz * dz)
                    share_b = min(max(share_b, 0.0), 1.0)
                    gx, gy, gz = gx - share_b * dx, gy - share_b * dy, gz - share_b * dz
                    n_touching += 1 if gx * gx + gy * gy + gz * gz < distance[j] * distance[j] else 0
                ball.overlaps[e] = n_touching > 0
                found = found or n_touching > 0
    return found


@compiled
def _add_normal_forces(cells: Cells, ball: Ball) -> tuple[int, float]:
    """Add the normal force on every element of the marked records that the ball overlaps, see `physics.laws.ball`.

    It is added to the forces on both nodes and to the ball's load. Returns the number of touches with friction, which
    are noted in the order of the model, and the power that the dashpots dissipate [W].
    """
    n_touch, lost, load, touches = 0, 0.0, ball.load, ball.touches
    c0, c1, c2 = ball.position[0], ball.position[1], ball.position[2]
    v0, v1, v2 = ball.velocity[0], ball.velocity[1], ball.velocity[2]
    w0, w1, w2 = ball.omega[0], ball.omega[1], ball.omega[2]
    for k in range(ball.cell.shape[0]):
        e, j = ball.cell[k], ball.lane[k]
        if not ball.overlaps[e]:
            continue
        here, there, distance = cells[e], cells[e + 1], ball.distance[e, j]
        x0, x1, u0, u1, f0, f1 = here.x, there.x, here.v, there.v, here.force, there.force
        dx, dy, dz = x1[0, j] - x0[0, j], x1[1, j] - x0[1, j], x1[2, j] - x0[2, j]
        gx, gy, gz = c0 - x0[0, j], c1 - x0[1, j], c2 - x0[2, j]
        share_b = (gx * dx + gy * dy + gz * dz) / (dx * dx + dy * dy + dz * dz)
        share_b = min(max(share_b, 0.0), 1.0)
        share_a = 1.0 - share_b
        gx, gy, gz = gx - share_b * dx, gy - share_b * dy, gz - share_b * dz
        square = gx * gx + gy * gy + gz * gz
        if not square < distance * distance:
            continue
        inverse = 1.0 / np.sqrt(max(square, _MIN_SQUARE))
        nx, ny, nz = gx * inverse, gy * inverse, gz * inverse
        ux = v0 - (w1 * gz - w2 * gy) - (share_a * u0[0, j] + share_b * u1[0, j])
        uy = v1 - (w2 * gx - w0 * gz) - (share_a * u0[1, j] + share_b * u1[1, j])
        uz = v2 - (w0 * gy - w1 * gx) - (share_a * u0[2, j] + share_b * u1[2, j])
        rate = ux * nx + uy * ny + uz * nz
        spring = ball.stiffness * (distance - square * inverse)
        push = max(spring - ball.damping * rate, 0.0)
        lost += (spring - push) * rate
        for i, force in ((0, push * nx), (1, push * ny), (2, push * nz)):
            f0[i, j] -= share_a * force
            f1[i, j] -= share_b * force
            load[i] += force
        if ball.friction * push > 0.0:
            touch = touches[n_touch]
            touch.cell, touch.lane, touch.share_b, touch.max_friction = e, j, share_b, ball.friction * push
            touch.kick_a, touch.kick_b = here.kick[j] * share_a, there.kick[j] * share_b
            slip_per_force = ball.kick + ball.spin_kick * square + share_a * touch.kick_a + share_b * touch.kick_b
            touch.effective_mass = 1.0 / slip_per_force
            gap, normal, early, friction = touch.gap, touch.normal, touch.early, touch.friction
            gap[0], gap[1], gap[2] = gx, gy, gz
            normal[0], normal[1], normal[2] = nx, ny, nz
            early[0], early[1], early[2] = ux - rate * nx, uy - rate * ny, uz - rate * nz
            friction[0], friction[1], friction[2] = 0.0, 0.0, 0.0
            n_touch += 1
    return n_touch, lost


@compiled
def apply_friction(cells: Cells, ball: Ball | None, n_touch: int, drift: float) -> float:
    """Add the ball's friction to the velocities that all else left, and to what has drifted; return its power [W].

    The friction of one touch changes the slip of others, by the Delassus matrix. The solution minimises the kinetic
    energy within the friction cones: it stops the slip where it can, and else has its largest size against the slip.
    Each projected Gauss-Seidel update lowers that energy, so friction never adds any, however early the sweeps end.
    They run forth and back: what they leave is then a symmetric function of the slip, like a dashpot. What sweeps in
    one direction leave would, over many steps, drive what should stick.
    """
    if ball is None:
        return 0.0
    n_node, largest = 0, 0.0
    for k in range(n_touch):
        touch = ball.touches[k]
        before, j = ball.touches[max(k - 1, 0)], touch.lane
        largest = max(largest, touch.max_friction)
        follows = k > 0 and before.cell + 1 == touch.cell and before.lane == j
        touch.first = before.second if follows else n_node
        touch.second = touch.first + 1
        n_node = touch.second + 1
        for i in range(3):
            ball.nodes[touch.first, i] = cells[touch.cell].v[i, j]
            ball.nodes[touch.second, i] = cells[touch.cell + 1].v[i, j]
    for _ in range(_MAX_SWEEPS):
        change = _sweep(ball, n_touch, False)
        if not max(change, _sweep(ball, n_touch, True)) > (_TOLERANCE * largest) ** 2:
            break
    lost = 0.0
    for k in range(n_touch):
        touch = ball.touches[k]
        here, there, j = cells[touch.cell], cells[touch.cell + 1], touch.lane
        for i in range(3):
            lost -= 0.5 * touch.friction[i] * (touch.early[i] + _slip(ball, touch, i))
        for i in range(3):
            for node, row in ((here, touch.first), (there, touch.second)):
                node.x[i, j] += drift * (ball.nodes[row, i] - node.v[i, j])
                node.v[i, j] = ball.nodes[row, i]
    drift_ball(ball, drift)
    return lost


@compiled
def _slip(ball: Ball, touch: Any, i: int) -> float:
    """Component of the velocity of the ball over that of an element where they touch [m/s]."""
    j, k = (i + 1) % 3, (i + 2) % 3
    turning = ball.omega[j] * touch.gap[k] - ball.omega[k] * touch.gap[j]
    first, second = ball.nodes[touch.first, i], ball.nodes[touch.second, i]
    return float(ball.velocity[i] - turning - first - touch.share_b * (second - first))


@compiled
def _sweep(ball: Ball, n_touch: int, back: bool) -> float:
    """One projected Gauss-Seidel sweep over the frictions of the touches, from the first to the last or `back`.

    Returns the square of the largest change [N^2].
    """
    speed, spin, nodes, kick, spin_kick = ball.velocity, ball.omega, ball.nodes, ball.kick, ball.spin_kick
    v0, v1, v2, w0, w1, w2 = speed[0], speed[1], speed[2], spin[0], spin[1], spin[2]
    change = 0.0
    for step in range(n_touch):
        touch = ball.touches[n_touch - 1 - step if back else step]
        gap, normal, friction, a, b, share_b = (
            touch.gap,
            touch.normal,
            touch.friction,
            touch.first,
            touch.second,
            touch.share_b,
        )
        g0, g1, g2, n0, n1, n2 = gap[0], gap[1], gap[2], normal[0], normal[1], normal[2]
        a0, a1, a2 = nodes[a, 0], nodes[a, 1], nodes[a, 2]
        b0, b1, b2 = nodes[b, 0], nodes[b, 1], nodes[b, 2]
        u0 = v0 - (w1 * g2 - w2 * g1) - a0 - share_b * (b0 - a0)
        u1 = v1 - (w2 * g0 - w0 * g2) - a1 - share_b * (b1 - a1)
        u2 = v2 - (w0 * g1 - w1 * g0) - a2 - share_b * (b2 - a2)
        rate = u0 * n0 + u1 * n1 + u2 * n2
        f0 = friction[0] - (u0 - rate * n0) * touch.effective_mass
        f1 = friction[1] - (u1 - rate * n1) * touch.effective_mass
        f2 = friction[2] - (u2 - rate * n2) * touch.effective_mass
        size = f0 * f0 + f1 * f1 + f2 * f2
        if size > touch.max_friction * touch.max_friction:
            share = touch.max_friction / np.sqrt(size)
            f0, f1, f2 = share * f0, share * f1, share * f2
        d0, d1, d2 = f0 - friction[0], f1 - friction[1], f2 - friction[2]
        friction[0], friction[1], friction[2] = f0, f1, f2
        change = max(change, d0 * d0 + d1 * d1 + d2 * d2)
        kick_a, kick_b = touch.kick_a, touch.kick_b
        nodes[a, 0], nodes[a, 1], nodes[a, 2] = a0 - kick_a * d0, a1 - kick_a * d1, a2 - kick_a * d2
        nodes[b, 0], nodes[b, 1], nodes[b, 2] = b0 - kick_b * d0, b1 - kick_b * d1, b2 - kick_b * d2
        v0, v1, v2 = v0 + kick * d0, v1 + kick * d1, v2 + kick * d2
        w0 -= spin_kick * (g1 * d2 - g2 * d1)
        w1 -= spin_kick * (g2 * d0 - g0 * d2)
        w2 -= spin_kick * (g0 * d1 - g1 * d0)
    speed[0], speed[1], speed[2], spin[0], spin[1], spin[2] = v0, v1, v2, w0, w1, w2
    return change
