"""Damping of velocities: -c v on every node, -c omega on every element, and when in a step it acts.

PyElastica's analytical linear damper: a velocity falls by exp(-c dt / m) in a step, a spin by exp(-c dt e / J), with e
the length of the element over that at rest. Nothing is stored.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from lattice_gym.checks import FloatArray, require
from lattice_gym.physics.laws.base import Generalised, Law

if TYPE_CHECKING:
    from lattice_gym.physics.assembly import RodModel
    from lattice_gym.physics.state import RodState

Splitting = Literal["pyelastica", "symmetric"]
"""When velocities are damped: once after the kick, as PyElastica does (first order), or all along it (second order).

"symmetric" solves m v' = F - c v over the step with its force held: a force ends in its true speed F / c, however long
the step. Damped once after the kick, that speed comes out as x / (exp(x) - 1) of the true one, with x = c dt / m. The
dashpots of joints take the velocities from before the kick in both, which is first order.
"""


def damping_shares(decay: FloatArray, splitting: Splitting) -> tuple[FloatArray, FloatArray]:
    """Shares of a velocity that damping leaves before and after the kick of a step; decay is c dt / m.

    Together they are exp(-decay). Symmetric: decay / (exp(decay) - 1) before, (1 - exp(-decay)) / decay after.
    """
    if splitting == "pyelastica":
        return np.ones_like(decay), np.exp(-decay)
    small = decay < 1e-12
    safe = np.where(small, 1.0, decay)
    after = np.where(small, 1.0, -np.expm1(-safe) / safe)
    return np.exp(-decay) / after, after


def coefficients(model: RodModel) -> FloatArray:
    """Damping of every component of what moves [N s/m, N m s], shape (3 n_node + 3 n_elem + 3 n_ball,)."""
    spin = np.array([rod.rotational_damping for rod in model.rods])[model.element_rod]
    return np.repeat(np.concatenate([model.node_damping, spin, np.zeros(model.n_ball)]), 3)


class DampingLaw(Law):
    """Damping of rods and of lines, and the drag of the medium."""

    @classmethod
    def present(cls, model: RodModel) -> bool:
        """Tell whether anything is damped."""
        on_rods = any(rod.damping > 0.0 or rod.rotational_damping > 0.0 for rod in model.rods)
        return on_rods or model.medium_drag > 0.0 or any(line.damping > 0.0 for line in model.lines)

    def check(self) -> None:
        """Refuse sums beyond the range of numbers."""
        require(bool(np.isfinite(self.model.node_damping).all()), "medium_drag: far too large for these rods")

    def force(self, state: RodState, tension: FloatArray) -> Generalised:
        """Against velocities and spins."""
        c = Generalised.split(self.model, coefficients(self.model))
        return Generalised(-c.node * state.velocity, -c.element * state.omega, -c.ball * state.ball_velocity)
