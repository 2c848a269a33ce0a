"""Constant forces on nodes and torques on elements."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PointForce:
    """Constant force on a node [N], in the laboratory frame."""

    rod: int
    node: int
    force: tuple[float, float, float]


@dataclass(frozen=True)
class PointTorque:
    """Constant torque on an element [N m], in its material frame: it turns with the element."""

    rod: int
    element: int
    torque: tuple[float, float, float]
