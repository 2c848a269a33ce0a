"""Spherical joints between nodes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Joint:
    """Spherical joint: a spring [N/m] and a dashpot [N s/m] of zero rest length between two nodes."""

    rod_a: int
    node_a: int
    rod_b: int
    node_b: int
    stiffness: float
    damping: float = 0.0
