"""What a scene has besides the worm: medium, ground, bolus, contact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from lattice_gym.checks import known_fields, shown
from lattice_gym.physics.laws.ball import Bolus
from lattice_gym.physics.laws.contact import Contact
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.medium import Medium


@dataclass(frozen=True, kw_only=True)
class World:
    """What a scene has besides the worm; `World()` is nothing at all."""

    medium: Medium | None = None
    ground: Ground | None = None
    bolus: Bolus | None = None
    contact: Contact | None = None
    lying: bool = False
    """The axis along +x instead of +z, the lowest surface of a rod at z = 0."""

    def __post_init__(self) -> None:
        for name, kind in (("medium", Medium), ("ground", Ground), ("bolus", Bolus), ("contact", Contact)):
            object.__setattr__(self, name, kind.resolve(f"World.{name}", getattr(self, name)))
        if not isinstance(self.lying, bool):
            raise ValueError(f"World.lying = {shown(self.lying)}: must be True or False")

    def to_dict(self) -> dict[str, Any]:
        """Fields by name, with what is absent as None; JSON can hold them."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> World:
        """World from its fields by name; those that are missing are absent."""
        return cls(**known_fields(cls, values, "parts"))
