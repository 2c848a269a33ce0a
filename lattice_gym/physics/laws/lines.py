"""Muscles without nodes of their own: the stretch of a straight rod between two nodes.

With l the rest length and e the length over it, a line pulls its two nodes together with E A (e - 1) / e, as a rod
does, besides the tension of its muscle (`muscles`). Stored is E A l (e - 1 - ln e).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from lattice_gym.checks import REQUIRED, FloatArray, IntArray, Parameters, checked, count, number, real, require
from lattice_gym.physics.laws.base import Generalised, Law, Linearised, PairSprings, Shortened, tuple_of
from lattice_gym.physics.laws.elasticity import path_share
from lattice_gym.physics.rod import FRAME_TOLERANCE

if TYPE_CHECKING:
    from lattice_gym.physics.assembly import RodModel
    from lattice_gym.physics.state import RodState


def _density(name: str, given: object) -> float:
    if isinstance(given, float) and given == math.inf:
        return given
    return number(name, given, 0.0, unit="kg/m^3", above=True)


@dataclass(frozen=True)
class Line(Parameters):
    """Muscle without nodes of its own: the tension and stretch of a straight rod between two nodes.

    Its mass and its damping stand on its two ends, half on either.
    """

    rod_a: int = count(REQUIRED)
    node_a: int = count(REQUIRED)
    rod_b: int = count(REQUIRED)
    node_b: int = count(REQUIRED)
    rest_length: float = real(REQUIRED, 0.0, math.inf, "m", above=True)
    """[m]"""
    stiffness: float = real(REQUIRED, 0.0, math.inf, "N")
    """E A [N]"""
    mass: float = real(0.0, 0.0, math.inf, "kg")
    """[kg]"""
    damping: float = real(0.0, 0.0, math.inf, "N s/m")
    """[N s/m]"""
    density: float = checked(math.inf, _density)
    """[kg/m^3]; an infinite density has no volume, and so no buoyancy."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not math.isfinite(self.stiffness / self.rest_length):
            raise self._refused("rest_length", "far too short for its stiffness [m]")

    def scaled(self, stiffness: float, damping: float) -> Line:
        """Return the line with factors on its stiffness and damping, which is not checked again."""
        line = copy(self)
        vars(line).update(stiffness=stiffness * self.stiffness, damping=damping * self.damping)
        return line


class LineLaw(Law):
    """Stretch of all lines."""

    fields: ClassVar = {"lines": tuple_of(Line)}

    @classmethod
    def present(cls, model: RodModel) -> bool:
        """Tell whether there are lines."""
        return len(model.lines) > 0

    @cached_property
    def _ends(self) -> tuple[IntArray, IntArray]:
        return self.model.tie_nodes(self.model.lines)

    @cached_property
    def _rest(self) -> FloatArray:
        return np.array([line.rest_length for line in self.model.lines])

    @cached_property
    def _stiffness(self) -> FloatArray:
        return np.array([line.stiffness for line in self.model.lines])

    def check(self) -> None:
        """Refuse nodes that are none, and ends at one place."""
        model = self.model
        for k, line in enumerate(model.lines):
            model.check_node(f"lines[{k}]", line.rod_a, line.node_a)
            model.check_node(f"lines[{k}]", line.rod_b, line.node_b)
            a, b = model.rods[line.rod_a].position[line.node_a], model.rods[line.rod_b].position[line.node_b]
            with np.errstate(all="ignore"):
                length = math.sqrt(np.sum((b - a) ** 2))
            apart = FRAME_TOLERANCE * line.rest_length < length < math.inf
            require(apart, f"lines[{k}]: its two ends lie at one place at rest, or too far apart")

    def energy(self, state: RodState) -> Mapping[str, FloatArray]:
        """Energy of every line's stretch, shape (n_line,)."""
        first, second = self._ends
        side = state.position[second] - state.position[first]
        e = np.sqrt(np.einsum("ni,ni->n", side, side)) / self._rest
        return {"line": self._stiffness * self._rest * (e - 1.0) ** 2 * path_share(e)}

    def linearised(self, shortened: Shortened) -> Linearised:
        """Springs along a line, E A / (l e^2), and across it, its tension over its length."""
        (first, second), place = self._ends, self.model.rest_state().position
        side = place[second] - place[first]
        along = np.einsum("ni,nj->nij", side, side) / np.sum(side**2, axis=1)[:, None, None]
        stretch = self._stiffness / (self._rest * shortened.line**2)
        across = shortened.peak / (self._rest * shortened.line)
        matrix = stretch[:, None, None] * along + across[:, None, None] * (np.eye(3) - along)
        return Linearised([PairSprings(first, second, matrix)])

    def force(self, state: RodState, tension: FloatArray) -> Generalised:
        """Pull the ends of every line together."""
        force, (first, second) = Generalised.zeros(self.model), self._ends
        side = state.position[second] - state.position[first]
        length = np.linalg.norm(side, axis=1)
        e = length / self._rest
        pull = (self._stiffness * (e - 1.0) / e / length)[:, None] * side
        np.add.at(force.node, first, pull)
        np.subtract.at(force.node, second, pull)
        return force
