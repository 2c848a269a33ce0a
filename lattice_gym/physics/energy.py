"""Where the energy of an assembly is, and the ledger that says where it came from and went.

What each law stores stands in its file. Kinetic energy is that of nodes and of the spin of elements; a ball's is with
its law. No potential gives the law of rods quite (`laws.elasticity`): what that leaves is part of the ledger's
residual, like the spin that a stretching element carries, and the integration error.
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
"""Share of the energy at stake that may be spurious within one call.

The law is no elastic body's, so that even a fine step finds some: at most 4.7 % in runs that are right to 1 % of their
height, 0.03 % in their median (`python -m lattice_gym.benchmarks divergence`), though 41 % in one violent snap, at any
step. An unstable step multiplies its energy within a few steps and is soon beyond any share.
"""

LEAST_STRAIN = 1e-4
"""Energy below that of all rods stretched by this much is too little to judge a run by."""


@dataclass(frozen=True, eq=False)
class StoredEnergy:
    """Energy of a state."""

    parts: Mapping[str, FloatArray]
    """By name and place [J]: "translation" of every node, "rotation" of every element, and what each law stores."""
    weight: float = 0.0
    """What of it counts from a zero that can be chosen at will [J]."""

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
    """Energy at stake: the most that was stored at either end, and all work and dissipation.

    Of weights it is the work, as their energy counts from anywhere.
    """


class EnergyMeter:
    """Reads the stored energy of states of one model."""

    def __init__(self, model: RodModel) -> None:
        self.model = model
        self._rest, self._inertia = model.of_rods("rest_length"), model.of_rods("inertia")
        self.least = 0.5 * LEAST_STRAIN**2 * float(model.of_rods("stretch_stiffness") @ self._rest)
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

    def most(self, energy: StoredEnergy) -> tuple[int, int]:
        """Rod and element that hold most, by kinetic, stretch and bending energy."""
        parts, low, left = energy.parts, self.model.lower_node, self.model.left_element
        share = parts["rotation"] + parts["stretch"]
        share += 0.5 * (parts["translation"][low] + parts["translation"][low + 1])
        for side in (left, left + 1):
            share[side] += 0.5 * parts["bend"]
        element = int(np.argmax(share))
        rod = int(np.searchsorted(self.model.element_offset, element, side="right")) - 1
        return rod, element - int(self.model.element_offset[rod])


def ledger(before: StoredEnergy, after: StoredEnergy, flow: Flow, least: float) -> Ledger:
    """Ledger between two states; `least` is the energy that counts as none [J]."""
    stored = after.total - before.total
    high, low = before.weight, after.weight
    moved = abs(flow.muscle_work) + abs(flow.load_work) + abs(low - high) + abs(flow.dissipated)
    return Ledger(
        muscle_work=flow.muscle_work,
        load_work=flow.load_work,
        stored=stored,
        dissipated=flow.dissipated,
        residual=flow.muscle_work + flow.load_work - stored - flow.dissipated,
        scale=max(before.total - high, after.total - low, least) + moved,
    )
