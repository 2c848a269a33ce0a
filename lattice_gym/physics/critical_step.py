"""The critical time step of an assembly, the largest stable one, predicted from its forces around rest.

Around rest the forces are linear, M x'' = -K x - C x', with the dampers of nodes and elements treated apart. At the
critical step a mode y changes its sign every step, x_n = (-1)^n y. In position Verlet, where a damper leaves the shares
a and b of a velocity before and after the kick (`damping.damping_shares`) and dashpots C act by the velocity before the
kick, that gives (dt^2 K + 2 dt C) y = 2 M (1/b + a) y. All matrices are symmetric, so the largest eigenvalue decides
for the whole assembly; Lanczos' iteration finds it. Every law of the model adds its springs to K and its dashpots to C,
see `Law.linearised`. Weights are constant and friction only takes energy away: neither matters.

Two effects are left out, as forces around rest do not show them: kinks of a right angle between elements and, with the
"pyelastica" splitting, elements that spin about their rod. That splitting takes the gyroscopic term from before the
kick, which drives the spin of slender, hardly damped elements on a coarse mesh: such a worm may be stable only well
below the prediction.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from lattice_gym.checks import FloatArray, number
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.base import Generalised, Operator
from lattice_gym.physics.laws.damping import Splitting, coefficients, damping_shares
from lattice_gym.physics.laws.muscles import contraction

SAFETY = 0.72
"""Safety factor: share of the computed limit that `critical_dt` returns, chosen on the stability report's grid and its
random designs of seed 0."""

DT_MARGIN = 0.72
"""Share of the predicted critical step that `default_dt` may use."""

N_LANCZOS = 80
"""Steps k of Lanczos' iteration: from a random start the largest of n eigenvalues is then expected to within
0.103 (ln(n (k - 1)^4) / (k - 1))^2 (Kuczynski and Wozniakowski 1992, SIAM J. Matrix Anal. Appl. 13), 1.4 % of it and
0.7 % of the step for a hundred thousand."""

_MAX_ROUNDS = 100
_ROUND_TOLERANCE = 2e-3
"""Rounds of the step that dampers and dashpots depend on, at most, and the share of growth at which they end."""

_MAX_EXPONENT = 500.0
"""Damping over a step, c dt / m, beyond which the effective mass would overflow; velocities are zero long before."""

_FROZEN = 50.0
"""Damping over a step, of everything that moves, beyond which PyElastica's splitting damps all motion out in one
step."""


def critical_dt(model: RodModel, max_tension: float = 0.0, splitting: Splitting = "pyelastica") -> float:
    """Predict the critical time step of an assembly [s]; infinite where dampers or clamps make every step stable.

    Parameters
    ----------
    model
        Any assembly.
    max_tension
        Largest tension of a muscle [N]: stretch, shear and bending all stiffen as elements shorten, see
        `muscles.contraction`.
    splitting
        When velocities are damped, see `damping.Splitting`.

    Raises
    ------
    ValueError
        A tension that is negative or not finite.
    """
    return SAFETY * _Linear(model, number("max_tension", max_tension, 0.0, unit="N")).largest_dt(splitting)


def default_dt(model: RodModel, control_dt: float, max_tension: float = 0.0) -> float:
    """Largest step [s] that divides `control_dt` and is at most `DT_MARGIN` of that predicted without any damper.

    Dampers can make larger steps stable, but such steps do not resolve them: the motion freezes. Where clamps hold
    everything it is `control_dt`.
    """
    predicted = SAFETY * _Linear(model, max_tension).largest_dt(None)
    return control_dt / max(1, math.ceil(control_dt / (DT_MARGIN * predicted)))


class _Linear:
    """Forces of an assembly in line with small displacements [m] and turns [rad, material frame], muscles shortened.

    Vectors have the shape (3 n_node + 3 n_elem + 3 n_ball,), see `base.Generalised`.
    """

    def __init__(self, model: RodModel, max_tension: float) -> None:
        self._model, shortened = model, contraction(model, max_tension)
        parts = [law.linearised(shortened) for law in model.laws]
        # Springs on nodes alone are summed first: their order decides the last bits of every step.
        self.springs = sorted((spring for part in parts for spring in part.springs), key=lambda spring: spring.coupled)
        self.dashpots = [dashpot for part in parts for dashpot in part.dashpots]
        e = shortened.rod[model.element_rod]
        spin_mass = (model.rod_array("inertia") / e)[:, None] * [1.0, 1.0, 2.0]
        ball_mass = np.repeat([ball.mass for ball in model.balls], 3)
        self.mass = np.concatenate([np.repeat(model.node_mass, 3), spin_mass.ravel(), ball_mass])
        self.rate = coefficients(model) / self.mass
        self.free = np.ones(self.mass.size)
        free = Generalised.split(model, self.free)
        free.node[model.clamped_nodes[0]] = 0.0
        free.element[model.clamped_elements[0]] = 0.0

    def largest_dt(self, splitting: Splitting | None) -> float:
        """Limit of the step [s] before `SAFETY`; without dampers (but with dashpots) where splitting is None.

        The dampers' share and that of the dashpots depend on the step. Each round takes them at the step of the round
        before; the first is too short, and so no round goes beyond the limit.
        """
        spring = self._largest(self.mass, 1.0, 0.0)
        if spring == 0.0:
            return math.inf
        dashpot = self._largest(self.mass, 0.0, 1.0) if self.dashpots else 0.0
        # An oscillator with a lagged dashpot is stable while spring dt^2 + 2 dashpot dt <= 4.
        dt = 4.0 / (math.sqrt(dashpot**2 + 4.0 * spring) + dashpot)
        if not self.dashpots and (splitting is None or not self.rate.any()):
            return dt
        for _ in range(_MAX_ROUNDS):
            square = self._largest(self._effective_mass(dt, splitting), 1.0, 2.0 / dt)
            longer = 2.0 / math.sqrt(square)
            if splitting == "pyelastica" and longer * self.rate.min() > _FROZEN:
                return math.inf
            if longer < (1.0 + _ROUND_TOLERANCE) * dt:
                return longer
            dt = longer
        return dt

    def _effective_mass(self, dt: float, splitting: Splitting | None) -> FloatArray:
        """Effective mass at the critical step: m (1/late + early) / 2 with the `damping_shares` of a kick."""
        if splitting is None:
            return self.mass
        decay = self.rate * dt
        if splitting == "pyelastica":
            decay = np.minimum(decay, _MAX_EXPONENT)
        early, late = damping_shares(decay, splitting)
        mass: FloatArray = self.mass * 0.5 * (1.0 / late + early)
        return mass

    def _largest(self, mass: FloatArray, springs: float, dashpots: float) -> float:
        """Largest eigenvalue of springs * K + dashpots * C over the given masses."""
        scale = self.free / np.sqrt(mass)

        def apply(x: FloatArray) -> FloatArray:
            moved = scale * x
            scaled: FloatArray = scale * (
                springs * self._sum(self.springs, moved) + dashpots * self._sum(self.dashpots, moved)
            )
            return scaled

        return largest_eigenvalue(apply, scale.size)

    def _sum(self, operators: Sequence[Operator], x: FloatArray) -> FloatArray:
        """Return the forces of all operators against x."""
        against = np.zeros_like(x)
        moved, forces = Generalised.split(self._model, x), Generalised.split(self._model, against)
        for operator in operators:
            operator(moved, forces)
        return against


def largest_eigenvalue(apply: Callable[[FloatArray], FloatArray], size: int) -> float:
    """Largest eigenvalue of a symmetric operator on vectors of the given size, by Lanczos' iteration.

    Products of vectors are not left to the linear algebra library: it shares them among threads, which wait for each
    other for milliseconds where other processes run, as they do in training.
    """
    now = np.random.default_rng(0).standard_normal(size)
    now /= math.sqrt(_product(now, now))
    before, link = np.zeros(size), 0.0
    diagonal, links = [], []
    for _ in range(min(N_LANCZOS, size)):
        new = apply(now) - link * before
        diagonal.append(_product(new, now))
        new -= diagonal[-1] * now
        link = math.sqrt(_product(new, new))
        links.append(link)
        if link <= 1e-12 * max(map(abs, diagonal)):
            break
        before, now = now, new / link
    off = np.diag(links[:-1], 1)
    return float(np.linalg.eigvalsh(np.diag(diagonal) + off + off.T)[-1])


def _product(a: FloatArray, b: FloatArray) -> float:
    return float(np.einsum("i,i->", a, b))
