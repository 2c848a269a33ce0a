"""Muscles without nodes of their own, between two nodes."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Line:
    """Muscle without nodes of its own: the tension and stretch of a straight rod between two nodes.

    Its mass and its damping stand on its two ends, half on either.
    """

    rod_a: int
    node_a: int
    rod_b: int
    node_b: int
    rest_length: float
    """[m]"""
    stiffness: float
    """E A [N]"""
    mass: float = 0.0
    """[kg]"""
    damping: float = 0.0
    """[N s/m]"""
    density: float = math.inf
    """What its mass has for a volume [kg/m^3]: a medium carries nothing of an infinitely dense one."""
