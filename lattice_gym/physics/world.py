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
    ground: Ground | None = checked(None, Ground.resolve)
    ball: Ball | None = checked(None, Ball.resolve)
    contact: Contact | None = checked(None, Contact.resolve)
    lying: bool = checked(False, flag)
    """The axis along +x instead of +z, the lowest surface of a rod at z = 0."""
