"""Spherical joints: a spring, and a dashpot where the scene has one, between two nodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.fused.kernels.account import Account
from lattice_gym.engines.fused.kernels.compiling import compiled, inlined
from lattice_gym.engines.fused.kernels.layout import Cells, Places
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.joints import Joint
from lattice_gym.physics.laws.lines import Line


class Joints(NamedTuple):
    """Joints of all worms, worm by worm: record and lane of both nodes, stiffness [N/m], shape (n,) each."""

    cell_a: IntArray
    lane_a: IntArray
    cell_b: IntArray
    lane_b: IntArray
    stiffness: FloatArray


def pack(model: RodModel, node: Places) -> Joints:
    """Joints whose stiffness is to be filled in."""
    ends = tie_ends(model, model.joints, node)
    return Joints(*ends, np.zeros(len(ends[0])))


def pack_damping(model: RodModel, joints: Joints) -> FloatArray | None:
    """Damping of the joints [N s/m], to be filled in, where the scene has any."""
    return np.zeros_like(joints.stiffness) if is_damped(model) else None


def is_damped(model: RodModel) -> bool:
    """Whether any joint has a dashpot."""
    return any(joint.damping > 0.0 for joint in model.joints)


def fill(joints: Joints, damping: FloatArray | None, worm: int, model: RodModel) -> None:
    """Write the constants of a worm."""
    own = slice(worm * len(model.joints), (worm + 1) * len(model.joints))
    joints.stiffness[own] = [joint.stiffness for joint in model.joints]
    if damping is not None:
        damping[own] = [joint.damping for joint in model.joints]


def tie_ends(
    model: RodModel, ties: Sequence[Joint | Line], node: Places
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Find records and lanes of the first and of the second node of each tie, worm by worm."""
    (first, second), (cell, lane) = model.tie_nodes(ties), node
    return cell[:, first].ravel(), lane[:, first].ravel(), cell[:, second].ravel(), lane[:, second].ravel()


@inlined
def apply_joints(cells: Cells, joints: Joints, damping: FloatArray | None) -> None:
    """Add each joint's spring and dashpot to the forces on its two nodes."""
    for n in range(joints.cell_a.shape[0]):
        a, b, la, lb = cells[joints.cell_a[n]], cells[joints.cell_b[n]], joints.lane_a[n], joints.lane_b[n]
        for i in range(3):
            force = joints.stiffness[n] * (b.x[i, lb] - a.x[i, la])
            if damping is not None:
                force += damping[n] * (b.v[i, lb] - a.v[i, la])
            a.force[i, la] += force
            b.force[i, lb] -= force


@compiled
def account_joints(cells: Cells, joints: Joints, damping: FloatArray, account: Account, dt: float) -> None:
    """Add what the dashpots took in the step just taken: they pull with the velocities from before the kick."""
    lost = 0.0
    for n in range(joints.cell_a.shape[0]):
        a, b, la, lb = joints.cell_a[n], joints.cell_b[n], joints.lane_a[n], joints.lane_b[n]
        for i in range(3):
            before = account.velocity[b, i, lb] - account.velocity[a, i, la]
            rate = cells[b].v[i, lb] - cells[a].v[i, la]
            lost += 0.5 * damping[n] * before * (before + rate)
    account.total[2] += dt * lost
