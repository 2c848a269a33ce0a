"""Gravity, buoyancy and drag of a fluid at rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from lattice_gym.checks import Bounds, Part


@dataclass(frozen=True, kw_only=True)
class Medium(Part):
    """Fluid at rest around the worm, under gravity along -z."""

    bounds: ClassVar[Bounds] = {
        "gravity": (0.0, 100.0, "m/s^2"),
        "density": (0.0, 20_000.0, "kg/m^3"),
        "drag": (0.0, 1e6, "N s/m^2"),
    }

    gravity: float = 9.81
    """[m/s^2]"""
    density: float = 1000.0
    """Of the fluid [kg/m^3]: what it carries of a rod's weight."""
    drag: float = 0.0
    """Resistance to motion, per speed and length of a rod [N s/m^2]."""
