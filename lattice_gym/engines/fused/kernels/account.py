"""Energy that enters and leaves, added up step by step: what the energy check asks for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.fused.kernels.compiling import compiled, inlined
from lattice_gym.engines.fused.kernels.damping import loss_factors, spin_loss
from lattice_gym.engines.fused.kernels.layout import LANES, Cells, Places
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.laws.damping import Splitting


class Account(NamedTuple):
    """Sums, and what is noted from one step to the next.

    `total` is the work of the muscles and of torques, and what was dissipated [J], shape (3,). By record and lane,
    shape (n_cell, LANES): what damping takes from a node, per square of its speed after the kick (`after`) and before
    (`before`) and per product of both (`mixed`) [kg], the inertia of an element [kg m^2], and of muscles the length [m]
    and the tension that acted [N] at the moment last counted; with components, shape (n_cell, 3, LANES): velocities and
    spins at the step before, and the non-conservative ground reaction on a node, friction and dashpot [N]. `line` and
    `line_tension` are length and tension of the lines, shape (n_line,).
    """

    total: FloatArray
    after: FloatArray
    before: FloatArray
    mixed: FloatArray
    inertia: FloatArray
    length: FloatArray
    tension: FloatArray
    velocity: FloatArray
    omega: FloatArray
    ground_reaction: FloatArray
    line: FloatArray
    line_tension: FloatArray


def pack(model: RodModel, node: Places, element: Places, n_cell: int, dt: float, splitting: Splitting) -> Account:
    """Account of one worm, with nothing in it: constants of every node and element by record and lane."""
    after, before, mixed, inertia, length, tension = np.zeros((6, n_cell, LANES))
    velocity, omega, reaction = np.zeros((3, n_cell, 3, LANES))
    line, line_tension = np.zeros((2, len(model.lines)))
    after[node], before[node], mixed[node] = loss_factors(model, dt, splitting)
    inertia[element] = model.rod_array("inertia")
    moved = length, tension, velocity, omega, reaction, line, line_tension
    return Account(np.zeros(3), after, before, mixed, inertia, *moved)


def flow(account: Account) -> Flow:
    """Energy that entered and left in the last call."""
    muscle_work, load_work, dissipated = account.total.tolist()
    return Flow(muscle_work, load_work, dissipated)


@inlined
def account_loss(account: Account | None, energy: float) -> None:
    """Add energy that was dissipated [J]."""
    if account is not None:
        account.total[2] += energy


@compiled
def open_account(cells: Cells, account: Account) -> None:
    """Begin the sums of a call anew; note velocities and spins."""
    account.total[:] = 0.0
    for n in range(cells.shape[0]):
        v, w = cells[n].v, cells[n].w
        for i in range(3):
            for j in range(LANES):
                account.velocity[n, i, j], account.omega[n, i, j] = v[i, j], w[i, j]


@compiled
def account_blocks(
    cells: Cells,
    work: Cells,
    block: IntArray,
    account: Account,
    torques: float | None,
    spin_damping: float | None,
    symmetric: float | None,
    ground: object | None,
    dt: float,
) -> None:
    """Add what the step just taken did: work of torques, dissipation by damping and by the ground.

    Forces work at the mean velocity of a step; of damping see `damping.loss_factors`.
    """
    twist, lost = 0.0, 0.0
    for b in range(block.shape[0]):
        first, last = block[b, 0], block[b, 1] - 1
        for n in range(first, last + 1):
            v, u = cells[n].v, account.velocity[n]
            after, before, mixed = account.after[n], account.before[n], account.mixed[n]
            if ground is not None:
                for i in range(3):
                    for j in range(LANES):
                        lost -= 0.5 * dt * account.ground_reaction[n, i, j] * (u[i, j] + v[i, j])
            for i in range(3):
                for j in range(LANES):
                    lost += v[i, j] * (after[j] * v[i, j] + mixed[j] * u[i, j]) + before[j] * u[i, j] * u[i, j]
                    u[i, j] = v[i, j]
        for n in range(first, last):
            here, early = cells[n], account.omega[n]
            w, couple = here.w, here.couple
            if torques is not None:
                for i in range(3):
                    for j in range(LANES):
                        twist += 0.5 * dt * couple[i, j] * (early[i, j] + w[i, j])
            if spin_damping is not None:
                lost += spin_loss(here, work[n], early, account.inertia[n], symmetric)
            for i in range(3):
                for j in range(LANES):
                    early[i, j] = w[i, j]
    account.total[1] += twist
    account.total[2] += lost
