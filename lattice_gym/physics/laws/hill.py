"""How the force of a muscle depends on its length and on how fast it shortens (Hill 1938, Thelen 2003).

It stores nothing of its own. To the critical time step every strand of a muscle is a spring and a dashpot more, each at
its steepest and under full tension.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from lattice_gym.checks import FloatArray, Parameters, real
from lattice_gym.physics.laws.base import Generalised, Law, Linearised, PairSprings, Shortened
from lattice_gym.physics.laws.muscles import Strands

if TYPE_CHECKING:
    from lattice_gym.physics.assembly import RodModel
    from lattice_gym.physics.state import RodState


@dataclass(frozen=True, kw_only=True)
class Hill(Parameters):
    """Factors on the tension of every muscle, by its length and its speed (Hill 1938, Proc. R. Soc. B 126:136).

    The forms are those of Thelen 2003 (J. Biomech. Eng. 125:70) at full activation. With l the length over the length
    of greatest force, v the rate of length over rest length, over `max_speed` (negative: shortening), A the curvature
    and M the eccentric force,

        force-length     exp(-((l - 1) / width)^2)
        force-velocity   0                                where v <= -1
                         (1 + v) / (1 - v / A)            where -1 < v <= 0
                         (1 + c M v) / (1 + c v)          where v > 0, with c = (2 + 2 / A) / (M - 1)

    The second branch is Hill's hyperbola, the third rises twice as steeply at rest and goes to M. They act in each
    element of a muscle (in a line: on the whole) and at every physics step; passive stretch is the rod's. Thelen lets
    the speed fall with activation; here it does not. The defaults are his for young adults, not those of cultured
    muscle. A factor whose field is None is 1.

    Force-velocity is a damper, taken as it stands before the kick, and the nodes of muscle rods are light: for the
    default worm `critical_step.critical_dt` is 34 times shorter with these defaults, with muscles as lines 3 times. A
    longer step does not blow up, as the factor is bounded, but muscles chatter.
    """

    width: float | None = real(math.sqrt(0.45), 1e-2, 1e6, "1", none=True)
    """Of the force-length curve, over the length of greatest force; None: force does not depend on length."""
    optimal_length: float = real(1.0, 0.1, 10.0, "rest lengths")
    """Length of greatest force, over the length at rest."""
    max_speed: float | None = real(10.0, 1e-3, 1e9, "rest lengths / s", none=True)
    """Shortening at which no force is left [rest lengths / s]; None: force does not depend on speed."""
    curvature: float = real(0.25, 1e-2, 1e6, "1")
    """A of Hill's hyperbola: large is a straight line."""
    eccentric: float = real(1.4, 1.01, 10.0, "1")
    """Force at which a muscle yields while it is lengthened fast, over that at rest."""

    @property
    def peak(self) -> float:
        """Bound of the product of both factors."""
        return 1.0 if self.max_speed is None else self.eccentric

    @property
    def steepest_length(self) -> float:
        """Largest change of the force-length factor with length over rest length."""
        return 0.0 if self.width is None else math.sqrt(2.0 / math.e) / (self.width * self.optimal_length)

    @property
    def steepest_speed(self) -> float:
        """Largest change of the force-velocity factor with rate over rest length [s]: that just above rest."""
        return 0.0 if self.max_speed is None else (2.0 + 2.0 / self.curvature) / self.max_speed

    def factor(self, length: FloatArray, rate: FloatArray) -> FloatArray:
        """Share of the tension that acts; length over rest length and its rate [1/s], one shape, kept."""
        share = np.ones_like(length)
        if self.width is not None:
            share = np.exp(-(((length / self.optimal_length - 1.0) / self.width) ** 2))
        if self.max_speed is not None:
            v, most = rate / self.max_speed, self.eccentric
            c = (2.0 + 2.0 / self.curvature) / (most - 1.0)
            slow, fast = np.clip(v, -1.0, 0.0), np.maximum(v, 0.0)
            share = share * np.where(v > 0.0, (1.0 + c * most * fast) / (1.0 + c * fast),
                                     (1.0 + slow) / (1.0 - slow / self.curvature))  # fmt: skip
        return share


class HillLaw(Law):
    """What length and speed change of the tension of muscles."""

    fields: ClassVar = {"hill": Hill.resolve}

    @classmethod
    def present(cls, model: RodModel) -> bool:
        """Tell whether there are muscles whose force is not just their tension."""
        return model.hill is not None and model.n_muscle > 0

    @cached_property
    def _hill(self) -> Hill:
        assert self.model.hill is not None
        return self.model.hill

    @cached_property
    def _strands(self) -> Strands:
        return Strands.of(self.model)

    def linearised(self, shortened: Shortened) -> Linearised:
        """Spring and dashpot along every strand, of its tension over its length at rest."""
        hill, strands, place = self._hill, self._strands, self.model.rest_state().position
        side = place[strands.second] - place[strands.first]
        along = np.einsum("ni,nj->nij", side, side) / np.sum(side**2, axis=1)[:, None, None]
        unit = shortened.tension / strands.rest_length[:, None, None] * along
        springs = PairSprings(strands.first, strands.second, hill.peak * hill.steepest_length * unit)
        dashpots = PairSprings(strands.first, strands.second, hill.steepest_speed * unit)
        return Linearised([springs], [dashpots] if hill.steepest_speed * shortened.tension > 0.0 else [])

    def force(self, state: RodState, tension: FloatArray) -> Generalised:
        """Pull the ends of every strand together by what acts more than its tension; mostly it is less."""
        strands = self._strands
        direction, length = strands.directions(state.position)
        apart = state.velocity[strands.second] - state.velocity[strands.first]
        rate = np.sum(apart * direction, axis=1)
        factor = self._hill.factor(length / strands.rest_length, rate / strands.rest_length)
        return strands.node_forces(self.model, state, (factor - 1.0) * tension[strands.muscle])
