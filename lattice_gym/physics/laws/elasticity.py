"""Stretch, shear, bending and twist of rods."""

from __future__ import annotations

MIN_DILATATION, MAX_DILATATION = 0.1, 5.0
"""Length over rest length outside which an element counts as over-stretched: linear elasticity ended long before."""
