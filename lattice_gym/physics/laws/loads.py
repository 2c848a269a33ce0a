"""Constant forces on nodes, in the laboratory frame, and constant torques on elements, which turn with them.

Of forces the work between two states is known; that of torques each engine sums over its steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from lattice_gym.checks import REQUIRED, FloatArray, Parameters, checked, count
from lattice_gym.physics.laws.base import Generalised, Law, tuple_of, vector

if TYPE_CHECKING:
    from lattice_gym.physics.assembly import RodModel
    from lattice_gym.physics.state import RodState


@dataclass(frozen=True)
class PointForce(Parameters):
    """Constant force on a node."""

    rod: int = count(REQUIRED)
    node: int = count(REQUIRED)
    force: tuple[float, float, float] = checked(REQUIRED, vector, unit="N")
    """In the laboratory frame [N]."""


@dataclass(frozen=True)
class PointTorque(Parameters):
    """Constant torque on an element."""

    rod: int = count(REQUIRED)
    element: int = count(REQUIRED)
    torque: tuple[float, float, float] = checked(REQUIRED, vector, unit="N m")
    """In the material frame [N m]: it turns with the element."""


class LoadLaw(Law):
    """All point forces and torques."""

    fields: ClassVar = {"forces": tuple_of(PointForce), "torques": tuple_of(PointTorque)}

    @classmethod
    def present(cls, model: RodModel) -> bool:
        """Tell whether there are loads."""
        return len(model.forces) + len(model.torques) > 0

    def check(self) -> None:
        """Refuse nodes and elements that are none."""
        for k, force in enumerate(self.model.forces):
            self.model.check_node(f"forces[{k}]", force.rod, force.node)
        for k, torque in enumerate(self.model.torques):
            self.model.check_element(f"torques[{k}]", torque.rod, torque.element)

    def work(self, before: RodState, after: RodState) -> float:
        """Work of the forces [J]."""
        return sum(float(load @ (after.position[node] - before.position[node])) for node, load in self._forces())

    def force(self, state: RodState, tension: FloatArray) -> Generalised:
        """Add up what is given."""
        force = Generalised.zeros(self.model)
        for node, load in self._forces():
            force.node[node] += load
        for torque in self.model.torques:
            force.element[int(self.model.element_offset[torque.rod]) + torque.element] += torque.torque
        return force

    def _forces(self) -> list[tuple[int, FloatArray]]:
        """Row of the node and vector of every force."""
        offset, loads = self.model.node_offset, self.model.forces
        return [(int(offset[load.rod]) + load.node, np.array(load.force, float)) for load in loads]
