"""A rigid ball that pushes at rods."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from lattice_gym.checks import Bounds, FloatArray, Part
from lattice_gym.physics.rod import array_of_shape, checked_size, require


@dataclass(frozen=True, kw_only=True)
class Bolus(Part):
    """A rigid ball inside the lattice, whose muscles must then be rods: lines touch nothing.

    A medium carries its share of the ball's weight, but neither the medium's drag nor the ground acts on it.
    """

    bounds: ClassVar[Bounds] = {
        "radius": (1e-4, 10.0, "m"),
        "density": (1e-3, 1e5, "kg/m^3"),
        "level": (0.0, 1e4, "levels"),
        "stiffness": (1e-6, 1e9, "N/m"),
        "damping": (0.0, 1e6, "N s/m"),
        "friction": (0.0, 100.0, "1"),
    }

    radius: float = 0.03
    """[m]"""
    density: float = 1000.0
    """[kg/m^3]"""
    level: float = 1.0
    """Where its centre starts, on the axis, in levels from the base."""
    stiffness: float = 50.0
    """Of its contact with an element [N/m]."""
    damping: float = 0.05
    """Of that contact, along the normal [N s/m]."""
    friction: float = 0.3
    """Friction over normal force."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ball:
    """Rigid uniform ball that pushes at elements of rods, each a cylinder of its rest radius with round ends.

    Where it overlaps one by a depth, with u the velocity of its material at the nearest point of the centre line over
    that of the line there, it pushes with N = max(0, stiffness depth - damping u_n) along the normal. Friction, at most
    friction N, takes all slip u_t that everything else leaves at the end of a step, or acts against it in full:
    Coulomb's law. Both act on the centre line: the lever rule shares them between its two nodes, and the ball has the
    opposite force and its moment, so that momentum and angular momentum close; the rod is not twisted.
    """

    position: FloatArray
    """Where its centre starts [m], shape (3,)."""
    radius: float
    """[m]"""
    mass: float
    """[kg]"""
    stiffness: float
    """Of the contact with an element [N/m]."""
    damping: float = 0.0
    """Of that contact, along the normal [N s/m]."""
    friction: float = 0.0
    """Friction over normal force."""
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Constant force, as its weight less what the medium carries [N]."""

    def __post_init__(self) -> None:
        for name in ("radius", "mass"):
            object.__setattr__(self, name, checked_size(f"Ball.{name}", getattr(self, name), above=True))
        for name in ("stiffness", "damping", "friction"):
            object.__setattr__(self, name, checked_size(f"Ball.{name}", getattr(self, name), above=False))
        object.__setattr__(self, "position", array_of_shape("Ball.position", self.position, (3,)))
        object.__setattr__(self, "force", tuple(array_of_shape("Ball.force", self.force, (3,)).tolist()))
        sound = self.inertia > 0.0 and math.isfinite(self.inertia) and math.isfinite(1.0 / self.inertia)
        require(sound, "Ball.radius, mass: inertia leaves the range of numbers; they are far too large or too small")

    @property
    def inertia(self) -> float:
        """Moment of inertia about any diameter [kg m^2]."""
        return 0.4 * self.mass * self.radius**2
