"""What a scene has besides the worm: medium, ground, ball, contact."""

from __future__ import annotations

from dataclasses import dataclass

from lattice_gym.checks import Parameters, checked, flag
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.laws.contact import Contact
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.medium import Medium


@dataclass(frozen=True, kw_only=True)
class World(Parameters):
    """What a scene has besides the worm; `World()` is nothing at all."""

    medium: Medium | None = checked(None, Medium.resolve)
    """Fluid around the worm, and gravity; None: neither."""
    ground: Ground | None = checked(None, Ground.resolve)
    """Plane that bears the worm, with friction; None: none."""
    ball: Ball | None = checked(None, Ball.resolve)
    """Rigid ball inside the lattice; None: none."""
    contact: Contact | None = checked(None, Contact.resolve)
    """How rods push at each other; None: they go through each other."""
    lying: bool = checked(False, flag)
    """The axis along +x instead of +z, the lowest surface of a rod at z = 0."""
