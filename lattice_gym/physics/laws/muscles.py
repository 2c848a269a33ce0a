"""Contraction: the tension of a muscle pulls the ends of each of its elements together, along it.

A muscle is a rod that contracts (its field of `RodModel` is `muscles`), or a line between two nodes, see `lines`. Its
tension is given; what of it acts depends on length and speed with `hill`. Its passive elasticity is that of its rod.
"""

from __future__ import annotations

from functools import cached_property, partial
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from lattice_gym.checks import FloatArray, IntArray, items, require, whole
from lattice_gym.physics.laws.base import Generalised, Law, Shortened
from lattice_gym.physics.laws.elasticity import MIN_DILATATION

if TYPE_CHECKING:
    from lattice_gym.physics.assembly import RodModel
    from lattice_gym.physics.state import RodState

OVERSHOOT = 1.5
"""Peak load over the tension of a muscle, as what it pulls overshoots the balance. Chosen so that the muscles of an
undamped default worm under random commands stay within it."""

MIN_CONTRACTION = 0.5
"""Smallest length over rest length assumed for rods that are not muscles. An assumption, not a bound."""


class Strands(NamedTuple):
    """What contracts: every element of the rods that are muscles, in order, then every line."""

    first: IntArray
    second: IntArray
    """Rows of both nodes, shape (n_strand,)."""
    rest_length: FloatArray
    """[m], shape (n_strand,)"""
    muscle: IntArray
    """Whose strand it is, shape (n_strand,)."""

    @classmethod
    def of(cls, model: RodModel) -> Strands:
        """Strands of a model."""
        low, n_rod = model.lower_node, len(model.muscles)
        elements = np.concatenate([np.arange(model.n_elem)[model.elements(rod)] for rod in model.muscles] or [low[:0]])
        first, second = model.tie_nodes(model.lines)
        count = [model.rods[rod].n_elem for rod in model.muscles] + [1] * len(model.lines)
        return cls(
            np.concatenate([low[elements], first]),
            np.concatenate([low[elements] + 1, second]),
            np.append(model.rod_array("rest_length")[elements], [line.rest_length for line in model.lines]),
            np.repeat(np.arange(n_rod + len(model.lines)), count),
        )

    def directions(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return unit vectors along the strands, shape (n_strand, 3), and their lengths [m], shape (n_strand,)."""
        side = position[self.second] - position[self.first]
        length = np.linalg.norm(side, axis=1)
        return side / length[:, None], length

    def node_forces(self, model: RodModel, state: RodState, tension: FloatArray) -> Generalised:
        """Return the forces on nodes of a tension in each strand [N], shape (n_strand,)."""
        force = Generalised.zeros(model)
        pull = tension[:, None] * self.directions(state.position)[0]
        np.add.at(force.node, self.first, pull)
        np.subtract.at(force.node, self.second, pull)
        return force


def contraction(model: RodModel, max_tension: float) -> Shortened:
    """Length over rest length to which muscles may shorten each rod and each line.

    A force F shortens a rod of stiffness E A to E A / (E A + F), for it resists with E A (1 - e) / e. A muscle can do
    that to itself. It may load any other rod with its tension [N], but shorten it no further than itself, and not below
    `MIN_CONTRACTION`: rather than that, rods that are not muscles bend.
    """
    peak = max_tension * (1.0 if model.hill is None else model.hill.peak)
    if model.n_muscle == 0:
        return Shortened(np.ones(model.n_rod), np.ones(0), max_tension, peak)
    load = OVERSHOOT * max_tension
    rod_stiffness = np.array([rod.stretch_stiffness.min() for rod in model.rods])
    line_stiffness = np.array([line.stiffness for line in model.lines])
    rod = rod_stiffness / (rod_stiffness + load)
    line = np.maximum(line_stiffness, np.finfo(float).tiny) / (line_stiffness + load + np.finfo(float).tiny)
    muscle = np.zeros(model.n_rod, dtype=np.bool_)
    muscle[list(model.muscles)] = True
    shortest = float(np.concatenate([rod[muscle], line]).min())
    least = np.where(muscle, MIN_DILATATION, max(shortest, MIN_CONTRACTION))
    return Shortened(np.maximum(rod, least), np.maximum(line, MIN_DILATATION), max_tension, peak)


class MuscleLaw(Law):
    """Tension of rods that contract and of lines.

    To the critical time step its tension counts where it stiffens rods and lines across themselves, see `elasticity`
    and `lines`.
    """

    fields: ClassVar = {"muscles": partial(items, each=partial(whole, low=0), what="rods")}

    @classmethod
    def present(cls, model: RodModel) -> bool:
        """Tell whether anything contracts."""
        return model.n_muscle > 0

    @cached_property
    def _strands(self) -> Strands:
        return Strands.of(self.model)

    def check(self) -> None:
        """Refuse rods that are none, and one named twice."""
        for k, rod in enumerate(self.model.muscles):
            self.model.check_element(f"muscles[{k}]", rod, 0)
        require(len(set(self.model.muscles)) == len(self.model.muscles), "muscles: a rod is named twice")

    def force(self, state: RodState, tension: FloatArray) -> Generalised:
        """Pull the ends of every strand together."""
        return self._strands.node_forces(self.model, state, tension[self._strands.muscle])
