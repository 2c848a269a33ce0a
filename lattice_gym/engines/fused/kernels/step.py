"""One step of position Verlet of a whole rod assembly, and the call that advances all worms of a pack.

The equations are those of Gazzola et al. 2018 (R. Soc. Open Sci. 5:171628) as PyElastica 1.0.0 discretises them:
circular sections (so J3 = 2 J1), linear elasticity, volume-preserving stretch. Within a step, in this order: weights
and point forces (what a force starts from), joints, lines, the ball's normal forces, rods that touch, internal forces
and muscle tension, the ground's normal force, kick, the ground's friction, the ball's, drift; damping goes along with
the kick or comes after it, see `laws.damping.Splitting`. The half drift that ends a step and the one that begins the
next are one full drift; the first and the last of a call are halves.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.fused.kernels.account import Account, account_blocks, account_loss, open_account
from lattice_gym.engines.fused.kernels.arithmetic import dot, fma
from lattice_gym.engines.fused.kernels.ball import Ball, apply_friction, drift_ball, kick_ball
from lattice_gym.engines.fused.kernels.compiling import compiled, entry, inlined
from lattice_gym.engines.fused.kernels.contact import Contact, add_contact_forces, close_list, listed_pairs
from lattice_gym.engines.fused.kernels.damping import LARGE_DECAY, large_decay, spin_tail
from lattice_gym.engines.fused.kernels.elasticity import bend_and_twist, force_along_d3
from lattice_gym.engines.fused.kernels.ground import Ground, kick_on_ground, write_axis
from lattice_gym.engines.fused.kernels.health import WormTable, inspect, is_sound
from lattice_gym.engines.fused.kernels.hill import Hill, hill_factor
from lattice_gym.engines.fused.kernels.joints import Joints, account_joints, apply_joints
from lattice_gym.engines.fused.kernels.layout import LANES, Blocks, Cells
from lattice_gym.engines.fused.kernels.lines import Lines, account_lines, apply_lines
from lattice_gym.engines.fused.kernels.muscles import account_muscles
from lattice_gym.engines.fused.kernels.rotation import (
    LARGE_T2,
    find_half_angle,
    find_turn,
    half_rotation,
    large_turn,
    rotate_element,
    turn,
)


class Laws(NamedTuple):
    """The laws of a scene. What it lacks is None and is compiled away; of a mere flag the other value is 1.0.

    `symmetric` is the splitting "symmetric"; ball, contact and account are only there where the pack has one worm.

    A field goes on to each function that uses it as an argument of its own: numba compiles no branch that a None
    argument rules out, but reads the fields of a tuple only when it runs. So the functions of a law do nothing where it
    is None, and `advance` calls them all.
    """

    joints: Joints
    joint_damping: FloatArray | None
    lines: Lines | None
    hill: Hill | None
    loads: float | None
    torques: float | None
    ground: Ground | None
    spin_damping: float | None
    symmetric: float | None
    ball: Ball | None
    contact: Contact | None
    account: Account | None


class BlockLaws(NamedTuple):
    """The laws that act within the pass over the blocks: scenes that differ in others alone share its code."""

    loads: float | None
    torques: float | None
    ground: Ground | None
    spin_damping: float | None
    symmetric: float | None
    account: Account | None


@entry
def advance(blocks: Blocks, laws: Laws, worms: WormTable, n_steps: int, dt: float) -> None:
    """Advance all worms in place by n_steps of position Verlet, and inspect each; NaN spreads, and nothing raises.

    All in one: numba makes the machine code of each function anew for each that it is compiled into.
    """
    cells, work, passive, active = blocks
    joints, joint_damping, lines, hill = laws.joints, laws.joint_damping, laws.lines, laws.hill
    ground, ball, contact, account = laws.ground, laws.ball, laws.contact, laws.account
    block_laws = BlockLaws(laws.loads, laws.torques, ground, laws.spin_damping, laws.symmetric, account)
    _open_account(cells, active, lines, hill, account)
    _half_drift(cells, work, passive, 0.5 * dt)
    _half_drift(cells, work, active, 0.5 * dt)
    drift_ball(ball, 0.5 * dt)
    pairs = listed_pairs(contact)
    for step in range(n_steps):
        drift = dt if step < n_steps - 1 else 0.5 * dt
        apply_joints(cells, joints, joint_damping)
        apply_lines(cells, lines, hill)
        _account_muscles(cells, active, lines, hill, account, 1.0, 0.0)
        n_touch, lost = kick_ball(cells, passive, active, ball)
        account_loss(account, dt * lost)
        pairs, lost = add_contact_forces(cells, contact, pairs)
        account_loss(account, dt * lost)
        write_axis(cells, ground)
        _step_blocks(cells, work, passive, block_laws, None, None, dt, drift)
        _step_blocks(cells, work, active, block_laws, 1.0, hill, dt, drift)
        lost = apply_friction(cells, ball, n_touch, drift)
        account_loss(account, dt * lost)
        _account_step(blocks, block_laws, account, joints, joint_damping, dt)
    close_list(contact, pairs)
    _account_muscles(cells, active, lines, hill, account, 0.5, 0.5)
    sound = is_sound(cells, passive, worms) and is_sound(cells, active, worms)
    for worm in range(worms.row.shape[0]):
        worms.status[worm], worms.found[worm] = inspect(cells, worms, worm, sound, joints, lines, ball)


@inlined
def _open_account(
    cells: Cells, active: IntArray, lines: Lines | None, hill: Hill | None, account: Account | None
) -> None:
    """Note what the work of the first step begins with."""
    if account is not None:
        open_account(cells, account)
        account_muscles(cells, active, hill, account, False, 0.5)
        if lines is not None:
            account_lines(cells, lines, hill, account, False, 0.5)


@inlined
def _account_muscles(
    cells: Cells,
    active: IntArray,
    lines: Lines | None,
    hill: Hill | None,
    account: Account | None,
    line_ago: float,
    rod_ago: float,
) -> None:
    """Add the work of lines and muscle rods since it was last added; the tension now is so many rises ago."""
    if account is not None:
        if lines is not None:
            account_lines(cells, lines, hill, account, True, line_ago)
        account_muscles(cells, active, hill, account, True, rod_ago)


@inlined
def _account_step(
    blocks: Blocks,
    laws: BlockLaws,
    account: Account | None,
    joints: Joints,
    joint_damping: FloatArray | None,
    dt: float,
) -> None:
    """Add what torques, damping and the ground did in the step just taken."""
    if account is not None:
        cells, work, passive, active = blocks
        torques, spin_damping, symmetric, ground = laws.torques, laws.spin_damping, laws.symmetric, laws.ground
        if joint_damping is not None:
            account_joints(cells, joints, joint_damping, account, dt)
        account_blocks(cells, work, passive, account, torques, spin_damping, symmetric, ground, dt)
        account_blocks(cells, work, active, account, torques, spin_damping, symmetric, ground, dt)


@compiled
def _half_drift(cells: Cells, work: Cells, block: IntArray, drift: float) -> None:
    """Drift every node and element of every block by `drift` seconds."""
    for b in range(block.shape[0]):
        rods = cells[block[b, 0] : block[b, 1]]
        n_elem = rods.shape[0] - 1
        for n in range(n_elem + 1):
            x, v = rods[n].x, rods[n].v
            for i in range(3):
                for j in range(LANES):
                    x[i, j] = fma(drift, v[i, j], x[i, j])
        for e in range(n_elem):
            find_turn(rods[e], work[0], drift)
            rotate_element(rods[e], work[0], drift)


@inlined
def _step_blocks(
    cells: Cells,
    work: Cells,
    block: IntArray,
    laws: BlockLaws,
    tension: float | None,
    hill: Hill | None,
    dt: float,
    drift: float,
) -> None:
    """Advance every block by one kick and one drift in a single pass over its records.

    A node is done once the stress on both its sides is known, an element once both its couples are: the pass works
    two records behind its front, while they are still in the first-level cache.
    """
    loads, torques, ground, spin_damping, symmetric, account = laws
    mask = work.shape[0] - 1
    for b in range(block.shape[0]):
        first = block[b, 0]
        rods = cells[first : block[b, 1]]
        last = rods.shape[0] - 2
        one = work[first & mask]
        one.passed[:] = 0.0
        _stress(rods[0:2], one, tension, hill, spin_damping, symmetric)
        _move_node(rods[0], drift, loads, ground, account, first)
        for e in range(last):
            one, two = work[(first + e) & mask], work[(first + e + 1) & mask]
            _stress(rods[e + 1 : e + 3], two, tension, hill, spin_damping, symmetric)
            _move_node(rods[e + 1], drift, loads, ground, account, first + e + 1)
            find_half_angle(rods[e : e + 2], one)
            _spin_element(rods[e : e + 2], one, two, dt, drift, 1.0, torques, spin_damping, symmetric)
            rotate_element(rods[e], one, drift)
        _move_node(rods[last + 1], drift, loads, ground, account, first + last + 1)
        one = work[(first + last) & mask]
        _spin_element(rods[last : last + 2], one, one, dt, drift, None, torques, spin_damping, symmetric)
        rotate_element(rods[last], one, drift)


@inlined
def _stress(
    pair: Cells,
    work: Any,
    tension: float | None,
    hill: Hill | None,
    spin_damping: float | None,
    symmetric: float | None,
) -> None:
    """Add the force of element e to both nodes and set its torque (material frame), of which twist has no part.

    The force is that of stretch, shear (`elasticity.force_along_d3`) and muscle tension, the torque Q t x force.
    """
    here, there = pair[0], pair[1]
    x0, x1, v0, v1, q, f0, f1 = here.x, there.x, here.v, there.v, here.q, here.force, there.force
    rest, shear, stretch, lean, arm = here.rest, here.shear, here.stretch, work.lean, work.arm
    length, stretch_rate, inv_rest = work.length, work.stretch_rate, here.inv_rest
    pull, rise = here.tension, here.tension_rise
    decay, spin_keep, spin_late = here.spin_decay, work.spin_keep, work.spin_late
    n_large = 0
    for j in range(LANES):
        dx, dy, dz = x1[0, j] - x0[0, j], x1[1, j] - x0[1, j], x1[2, j] - x0[2, j]
        square = dot(dx, dy, dz, dx, dy, dz)
        inverse = 1.0 / np.sqrt(square)
        size, inverse_square = square * inverse, inverse * inverse
        du, dv, dw = v1[0, j] - v0[0, j], v1[1, j] - v0[1, j], v1[2, j] - v0[2, j]
        rate = dot(du, dv, dw, dx, dy, dz) * inverse_square
        length[j], stretch_rate[j] = size, rate
        if symmetric is not None:
            lean[0, j], lean[1, j], lean[2, j] = dx * inverse_square, dy * inverse_square, dz * inverse_square
        if spin_damping is not None:
            y = decay[j] * size
            tail = spin_tail(y)
            spin_keep[j] = fma(-y, tail, 1.0)
            if symmetric is not None:
                spin_late[j] = tail
            n_large += 1 if y > LARGE_DECAY else 0
        a = dot(q[0, j], q[1, j], q[2, j], dx, dy, dz)
        b = dot(q[3, j], q[4, j], q[5, j], dx, dy, dz)
        c = dot(q[6, j], q[7, j], q[8, j], dx, dy, dz)
        across = force_along_d3(c, inverse, rest[j], shear[j], stretch[j])
        arm[0, j], arm[1, j] = b * across, -(a * across)
        along = shear[j]
        if tension is not None:
            now = pull[j]
            if hill is not None:
                now *= hill_factor(size * inv_rest[j], rate * (size * inv_rest[j]), hill)
            along += now
            pull[j] += rise[j]
        along *= inverse
        s0, s1, s2 = (
            fma(q[6, j], across, dx * along),
            fma(q[7, j], across, dy * along),
            fma(q[8, j], across, dz * along),
        )
        f0[0, j] += s0
        f0[1, j] += s1
        f0[2, j] += s2
        f1[0, j] -= s0
        f1[1, j] -= s1
        f1[2, j] -= s2
    if n_large > 0:
        large_decay(here, work, symmetric)


@inlined
def _move_node(
    here: Any, drift: float, loads: float | None, ground: Ground | None, account: Account | None, n: int
) -> None:
    """Kick, damp and drift node n, and reset its force to its constant load for the next step."""
    x, v, force, kick, keep, load = here.x, here.v, here.force, here.kick, here.keep, here.load
    if ground is not None:
        kick_on_ground(here, ground, account, n)
    for j in range(LANES):
        if ground is not None:
            u0, u1, u2 = v[0, j], v[1, j], v[2, j]
        else:
            u0 = fma(force[0, j], kick[j], v[0, j] * keep[j])
            u1 = fma(force[1, j], kick[j], v[1, j] * keep[j])
            u2 = fma(force[2, j], kick[j], v[2, j] * keep[j])
        f0, f1, f2 = 0.0, 0.0, 0.0
        if loads is not None:
            f0, f1, f2 = load[0, j], load[1, j], load[2, j]
        v[0, j], x[0, j], force[0, j] = u0, fma(drift, u0, x[0, j]), f0
        v[1, j], x[1, j], force[1, j] = u1, fma(drift, u1, x[1, j]), f1
        v[2, j], x[2, j], force[2, j] = u2, fma(drift, u2, x[2, j]), f2


@inlined
def _spin_element(
    pair: Cells,
    work: Any,
    after: Any,
    dt: float,
    drift: float,
    bends: float | None,
    torques: float | None,
    spin_damping: float | None,
    symmetric: float | None,
) -> None:
    """Kick and damp the angular velocity w of element e, by the couple of bend and twist to e + 1 if it `bends`.

    What bend and twist do to element e + 1 is passed on to it, and how far e turns in its drift is found.

    An element turns faster as it stretches. Two terms depend on the velocities themselves: J^-1 [(J w) x w], which is
    (-w1 w2, w0 w2, 0) for J3 = 2 J1 and turns (w0, w1) about d3, and w times the rate of stretch, for J / e bears the
    spin. PyElastica adds both as they stand before the kick: first order, and (w0, w1) grow longer, which feeds fast
    spin. The symmetric step turns (w0, w1) halfway through the kick by the mean of w2, and takes half the stretch from
    before and half from after the kick.
    """
    here, there = pair[0], pair[1]
    p, q, la, lb, half_angle, on = here.q, there.q, work.length, after.length, work.half_angle, after.passed
    bend, twist, rest_turn = here.bend, here.twist, here.rest_turn
    w, arm, passed, couple, rate, lean = here.w, work.arm, work.passed, here.couple, work.stretch_rate, work.lean
    v0, v1, spin_kick, keep, late = here.v, there.v, here.spin_kick, work.spin_keep, work.spin_late
    square, sine, versine, n_large = work.square, work.sine, work.versine, 0
    for j in range(LANES):
        m0, m1, m2 = arm[0, j] + passed[0, j], arm[1, j] + passed[1, j], passed[2, j]
        if torques is not None:
            m0, m1, m2 = m0 + couple[0, j], m1 + couple[1, j], m2 + couple[2, j]
        if bends is not None:
            u = half_rotation(p, q, half_angle[j], j)
            c0, c1, c2, p0, p1, p2 = bend_and_twist(u, rest_turn, j, la[j] + lb[j], bend[j], twist[j])
            m0, m1, m2 = m0 + c0, m1 + c1, m2 + c2
            on[0, j], on[1, j], on[2, j] = p0, p1, p2
        w0, w1, w2 = w[0, j], w[1, j], w[2, j]
        scale = la[j] * spin_kick[j]
        h0, h1, h2 = m0 * scale, m1 * scale, 0.5 * m2 * scale
        if symmetric is not None:
            early = 1.0 / fma(-0.5 * dt, rate[j], 1.0)
            a0, a1, a2 = w0 * early, w1 * early, w2 * early
            if spin_damping is not None:
                aside = fma(0.5, keep[j], 0.5) * late[j]
                h0, h1, h2 = h0 * aside, h1 * aside, h2 * late[j]
                a0, a1, a2 = a0 * keep[j] * keep[j], a1 * keep[j] * keep[j], a2 * keep[j]
            t = 0.25 * dt * (fma(w2, early, a2) + h2)
            s = 2.0 * t / fma(t, t, 1.0)
            m0, m1 = fma(0.5, h0, a0), fma(0.5, h1, a1)
            du, dv, dw = v1[0, j] - v0[0, j], v1[1, j] - v0[1, j], v1[2, j] - v0[2, j]
            grow = fma(0.5 * dt, dot(du, dv, dw, lean[0, j], lean[1, j], lean[2, j]), 1.0)
            z0 = fma(0.5, h0, fma(-s, fma(t, m0, m1), m0)) * grow
            z1 = fma(0.5, h1, fma(s, fma(-t, m1, m0), m1)) * grow
            z2 = (a2 + h2) * grow
        else:
            grow, about_d3 = fma(dt, rate[j], 1.0), dt * w2
            z0, z1, z2 = fma(w0, grow, fma(-about_d3, w1, h0)), fma(w1, grow, fma(about_d3, w0, h1)), fma(w2, grow, h2)
            if spin_damping is not None:
                aside = keep[j] * keep[j]
                z0, z1, z2 = z0 * aside, z1 * aside, z2 * keep[j]
        w[0, j], w[1, j], w[2, j] = z0, z1, z2
        square[j], sine[j], versine[j] = turn(z0, z1, z2, drift)
        n_large += 1 if square[j] > LARGE_T2 else 0
    if n_large > 0:
        large_turn(work)
