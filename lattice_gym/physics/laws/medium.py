"""A fluid at rest around an assembly: weight, buoyancy and drag.

Every node has the weight (m - rho V) g, with V the volume that it displaces. Drag is a damping of nodes, its
coefficient times the length that a node stands for, and acts with theirs, see `damping`. Stored is the weight times the
height above rest: a zero chosen at will.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from lattice_gym.checks import FloatArray, Parameters, array, number, optional, real, require
from lattice_gym.physics.laws.base import Generalised, Law

if TYPE_CHECKING:
    from lattice_gym.physics.assembly import RodModel
    from lattice_gym.physics.state import RodState


@dataclass(frozen=True, kw_only=True)
class Medium(Parameters):
    """Fluid at rest around the worm, under gravity along -z."""

    gravity: float = real(9.81, 0.0, 100.0, "m/s^2")
    """[m/s^2]"""
    density: float = real(1000.0, 0.0, 20_000.0, "kg/m^3")
    """Of the fluid [kg/m^3]: what it carries of a rod's weight."""
    drag: float = real(0.0, 0.0, 1e6, "N s/m^2")
    """Resistance to motion, per speed and length of a rod [N s/m^2]."""


class MediumLaw(Law):
    """Weight in a medium."""

    fields: ClassVar = {
        "gravity": partial(optional, partial(array, shape=(3,), unit="m/s^2", read_only=True)),
        "medium_density": partial(number, low=0.0, unit="kg/m^3"),
        "medium_drag": partial(number, low=0.0, unit="N s/m^2"),
    }
    gauge = True

    @classmethod
    def present(cls, model: RodModel) -> bool:
        """Tell whether there is gravity; drag alone is damping."""
        return model.gravity is not None

    @cached_property
    def _place(self) -> FloatArray:
        return self.model.rest_state().position

    def check(self) -> None:
        """Refuse weights beyond the range of numbers."""
        sound = bool(np.isfinite(self.model.node_weight).all())
        require(sound, "gravity, medium_density: far too large for these rods")

    def energy(self, state: RodState) -> Mapping[str, FloatArray]:
        """Weight times height above rest of every node, shape (n_node,)."""
        return {"weight": np.einsum("ni,ni->n", self.model.node_weight, self._place - state.position)}

    def force(self, state: RodState, tension: FloatArray) -> Generalised:
        """Weight less buoyancy."""
        force, model = Generalised.zeros(self.model), self.model
        if model.gravity is not None:
            force.node[:] = (model.node_mass - model.medium_density * model.node_volume)[:, None] * model.gravity
        return force
