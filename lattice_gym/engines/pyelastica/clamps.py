"""Clamps: PyElastica's own fixed constraints."""

from __future__ import annotations

from elastica.boundary_conditions import FixedConstraint

from lattice_gym.engines.pyelastica.law import Bodies, Simulator


def add_clamps(bodies: Bodies, simulator: Simulator) -> None:
    """Hold the clamped nodes and elements of every rod."""
    for index, rod in enumerate(bodies.rods):
        clamps = [clamp for clamp in bodies.model.clamps if clamp.rod == index]
        if clamps:
            simulator.constrain(rod).using(
                FixedConstraint,
                constrained_position_idx=tuple(clamp.node for clamp in clamps if clamp.node is not None),
                constrained_director_idx=tuple(clamp.element for clamp in clamps if clamp.element is not None),
            )
