"""Stored energy of an assembly, and the ledger of what entered and left.

Each law's file has the energy that it stores. Here is the kinetic energy of nodes and of the spin of elements; that of
a ball is with its law. PyElastica's law of rods has no exact potential (`laws.elasticity`): the difference is part of
the ledger's residual, as are the spin that a stretching element carries and the integration error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lattice_gym.checks import FloatArray
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.state import RodState

ENERGY_TOLERANCE = 0.1
"""Largest spurious energy within one call, as a share of the ledger's scale.

The law of rods has no exact potential, so even a fine step makes some: at most 4.7 % in runs that are right to 1 % of
their height, 0.03 % in the median (`python -m lattice_gym.benchmarks divergence`), but 41 % in one violent snap, at any
step. An unstable step multiplies the energy within a few steps, and soon exceeds any tolerance.
"""

MIN_STRAIN = 1e-4
"""Strain of all rods whose energy is negligible: less energy is too little to judge a run by."""


@dataclass(frozen=True, eq=False)
class StoredEnergy:
    """Energy of a state."""

    parts: Mapping[str, FloatArray]
    """By name and place [J]: "translation" of every node, "rotation" of every element, and what each law stores."""
    weight: float = 0.0
    """The part of it whose zero is arbitrary, that of weights [J]."""

    def __repr__(self) -> str:
        return f"StoredEnergy({self.total:.6g} J: {', '.join(self.parts)})"

    @cached_property
    def total(self) -> float:
        """All of it [J]."""
        return float(sum(part.sum() for part in self.parts.values()))


@dataclass(frozen=True)
class Flow:
    """What entered and left over some time [J]."""

    muscle_work: float = 0.0
    """Work that the muscles' tension did, as far as it acted (`hill.Hill`)."""
    load_work: float = 0.0
    """Work that point forces and torques did, and the constant force on the ball."""
    dissipated: float = 0.0
    """What damping of nodes, spin and joints, contacts of ball and rods, dashpots and friction of the ground took."""


@dataclass(frozen=True)
class Ledger:
    """Energy over some time [J]: muscle work + load work = stored + dissipated + residual."""

    muscle_work: float
    load_work: float
    stored: float
    """What the assembly holds more than before."""
    dissipated: float
    residual: float
    """What is missing; where it is negative, energy is spurious."""
    scale: float
    """What the residual is compared with: the larger stored energy of both states plus all work and dissipation.

    Weights count by their work, as the zero of their energy is arbitrary.
    """


class EnergyMeter:
    """Reads the stored energy of states of one model."""

    def __init__(self, model: RodModel) -> None:
        self.model = model
        self._rest, self._inertia = model.rod_array("rest_length"), model.rod_array("inertia")
        self.negligible = 0.5 * MIN_STRAIN**2 * float(model.rod_array("stretch_stiffness") @ self._rest)
        """Energy that counts as none [J]."""

    def stored(self, state: RodState) -> StoredEnergy:
        """Return the stored energy of a state."""
        low, spin = self.model.lower_node, state.omega * state.omega
        side = state.position[low + 1] - state.position[low]
        e = np.sqrt(np.einsum("ni,ni->n", side, side)) / self._rest
        parts = {
            "translation": 0.5 * self.model.node_mass * np.einsum("ni,ni->n", state.velocity, state.velocity),
            "rotation": 0.5 * self._inertia / e * (spin[:, 0] + spin[:, 1] + 2.0 * spin[:, 2]),
        }
        weight = 0.0
        for law in self.model.laws:
            stored = law.energy(state)
            parts |= stored
            if law.gauge:
                weight += float(sum(part.sum() for part in stored.values()))
        return StoredEnergy(parts, weight)

    def force_work(self, before: RodState, after: RodState) -> float:
        """Work of the constant forces on nodes and on the ball between two states [J]."""
        return float(sum(law.work(before, after) for law in self.model.laws))

    def peak_element(self, energy: StoredEnergy) -> tuple[int, int]:
        """Rod and element that hold most, by kinetic, stretch and bending energy."""
        parts, low, left = energy.parts, self.model.lower_node, self.model.left_element
        share = parts["rotation"] + parts["stretch"]
        share += 0.5 * (parts["translation"][low] + parts["translation"][low + 1])
        for side in (left, left + 1):
            share[side] += 0.5 * parts["bend"]
        element = int(np.argmax(share))
        rod = int(self.model.element_rod[element])
        return rod, element - int(self.model.element_offset[rod])


def ledger(before: StoredEnergy, after: StoredEnergy, flow: Flow, negligible: float) -> Ledger:
    """Ledger between two states; `negligible` is the energy that counts as none [J]."""
    stored = after.total - before.total
    high, low = before.weight, after.weight
    moved = abs(flow.muscle_work) + abs(flow.load_work) + abs(low - high) + abs(flow.dissipated)
    return Ledger(
        muscle_work=flow.muscle_work,
        load_work=flow.load_work,
        stored=stored,
        dissipated=flow.dissipated,
        residual=flow.muscle_work + flow.load_work - stored - flow.dissipated,
        scale=max(before.total - high, after.total - low, negligible) + moved,
    )
