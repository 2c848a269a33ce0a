"""Named trades between error and run time: how fine the mesh is, and how velocities are damped.

`python -m lattice_gym.benchmarks work-precision` measured them; `LatticeWormEnv` says what came out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from lattice_gym.body.design import MAX_ELEMENTS, LatticeDesign
from lattice_gym.checks import choice
from lattice_gym.physics.laws.damping import Splitting

FidelityName = Literal["fast", "default", "fine"]


@dataclass(frozen=True)
class Fidelity:
    """What a fidelity sets."""

    splitting: Splitting
    min_elements: int = 1
    """Elements per segment at least; a coarser design is refined to it."""
    max_elements: int = MAX_ELEMENTS
    """Elements per segment at most; a finer design is coarsened to it."""

    def remesh(self, design: LatticeDesign) -> LatticeDesign:
        """Design on this fidelity's mesh, with the damping per length that it has on its own."""
        mesh = min(max(design.elements_per_segment, self.min_elements), self.max_elements)
        if mesh == design.elements_per_segment:
            return design
        return replace(
            design, elements_per_segment=mesh, damping_mesh=design.damping_mesh or design.elements_per_segment
        )


FIDELITIES: dict[FidelityName, Fidelity] = {
    "fast": Fidelity("symmetric", max_elements=2),
    "default": Fidelity("symmetric"),
    "fine": Fidelity("symmetric", min_elements=16),
}
"""Every fidelity by name."""


def named_fidelity(name: FidelityName) -> Fidelity:
    """Fidelity by name; an unknown one is a ValueError."""
    return FIDELITIES[choice("fidelity", name, FIDELITIES)]
