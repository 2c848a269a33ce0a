"""Spherical joints: two nodes held together by a spring and a dashpot, as PyElastica's FreeJoint has it.

With x the way from the first node to the second and v its rate, the first feels k x + c v and the second the opposite;
no couple acts. Stored is k x^2 / 2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from lattice_gym.checks import REQUIRED, FloatArray, IntArray, Parameters, count, real, require
from lattice_gym.physics.laws.base import Generalised, Law, Linearised, PairSprings, Shortened, tuple_of

if TYPE_CHECKING:
    from lattice_gym.physics.assembly import RodModel
    from lattice_gym.physics.state import RodState


@dataclass(frozen=True)
class Joint(Parameters):
    """Spherical joint: a spring and a dashpot of zero rest length between two nodes."""

    rod_a: int = count(REQUIRED)
    node_a: int = count(REQUIRED)
    rod_b: int = count(REQUIRED)
    node_b: int = count(REQUIRED)
    stiffness: float = real(REQUIRED, 0.0, math.inf, "N/m")
    """[N/m]"""
    damping: float = real(0.0, 0.0, math.inf, "N s/m")
    """[N s/m]"""


class JointLaw(Law):
    """Springs and dashpots of all joints."""

    fields: ClassVar = {"joints": tuple_of(Joint)}

    @classmethod
    def present(cls, model: RodModel) -> bool:
        """Tell whether there are joints."""
        return len(model.joints) > 0

    @cached_property
    def _ends(self) -> tuple[IntArray, IntArray]:
        return self.model.tie_nodes(self.model.joints)

    @cached_property
    def _stiffness(self) -> FloatArray:
        return np.array([joint.stiffness for joint in self.model.joints])

    @cached_property
    def _damping(self) -> FloatArray:
        return np.array([joint.damping for joint in self.model.joints])

    def check(self) -> None:
        """Refuse nodes that are none, and a node joined with itself."""
        for k, joint in enumerate(self.model.joints):
            self.model.check_node(f"joints[{k}]", joint.rod_a, joint.node_a)
            self.model.check_node(f"joints[{k}]", joint.rod_b, joint.node_b)
            same = (joint.rod_a, joint.node_a) == (joint.rod_b, joint.node_b)
            require(not same, f"joints[{k}]: joins a node with itself")

    def energy(self, state: RodState) -> Mapping[str, FloatArray]:
        """Energy of every joint's spring, shape (n_joint,)."""
        first, second = self._ends
        apart = state.position[second] - state.position[first]
        return {"joint": 0.5 * self._stiffness * np.einsum("ni,ni->n", apart, apart)}

    def linearised(self, shortened: Shortened) -> Linearised:
        """Springs and dashpots alike in all directions."""
        springs, dashpots = (
            PairSprings(*self._ends, size[:, None, None] * np.eye(3)) for size in (self._stiffness, self._damping)
        )
        return Linearised([springs], [dashpots] if self._damping.any() else [])

    def force(self, state: RodState, tension: FloatArray) -> Generalised:
        """Pull the nodes of every joint together."""
        force, (first, second) = Generalised.zeros(self.model), self._ends
        pull = self._stiffness[:, None] * (state.position[second] - state.position[first])
        pull += self._damping[:, None] * (state.velocity[second] - state.velocity[first])
        np.add.at(force.node, first, pull)
        np.subtract.at(force.node, second, pull)
        return force
