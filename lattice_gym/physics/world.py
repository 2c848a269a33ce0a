"""What surrounds a worm, and how it touches itself: medium, ground, bolus, contact, their units and their bounds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

from lattice_gym.checks import Bounds, Part, known_fields, shown


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


@dataclass(frozen=True, kw_only=True)
class Ground(Part):
    """The plane z = 0, with normal contact and Coulomb friction; the defaults bear the default worm in water.

    It then rests at a depth of at most 5 % of a rod's radius, and the ground shortens the stable step by under 1 %.
    Forward, backward and sideways are those of the body as it lies at the moment, whose axis `RodModel.rod_ends` tells.
    With d the direction of a node's slip in the plane and e the unit vector of that axis, the coefficients have the
    factor sqrt((f d.e)^2 + sideways^2 (1 - (d.e)^2)), where f is `forward` for d.e > 0 and else `backward`. So the axis
    counts as far as it is level: a body that stands upright has no forward, and all of its slip is sideways.
    """

    bounds: ClassVar[Bounds] = {
        "stiffness": (1e-6, 1e9, "N/m"),
        "damping": (0.0, 1e6, "N s/m"),
        "static_friction": (0.0, 100.0, "1"),
        "kinetic_friction": (0.0, 100.0, "1"),
        "forward": (0.0, 100.0, "1"),
        "backward": (0.0, 100.0, "1"),
        "sideways": (0.0, 100.0, "1"),
    }

    stiffness: float = 100.0
    """Of a node's contact [N/m]."""
    damping: float = 0.1
    """Of a node's contact, along the normal [N s/m]."""
    static_friction: float = 0.5
    kinetic_friction: float = 0.5
    """Friction over normal force, at rest (never less than in motion) and in motion."""
    forward: float = 1.0
    backward: float = 1.0
    sideways: float = 1.0
    """Factors on both coefficients for slip towards the body's top, its base and across: alike they are isotropic."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.static_friction < self.kinetic_friction:
            raise ValueError(
                f"Ground.static_friction = {self.static_friction!r}: must not be below "
                f"kinetic_friction = {self.kinetic_friction!r}"
            )

    @property
    def isotropic(self) -> bool:
        """Whether friction is the same in all directions."""
        return self.forward == self.backward == self.sideways


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


@dataclass(frozen=True, kw_only=True)
class Contact(Part):
    """Rods push at each other where they come to overlap, without friction; see `lattice_gym.contact`.

    Muscles touch nothing, a rod does not touch itself, and where rods cross they are joined: elements that are near
    each other at rest there never touch (`contact.MARGIN`). So it acts on the default worm only beyond the strength of
    its muscles. Where those that compress it pull with 3 N, six times their strength, the defaults keep what may touch
    nineteen twentieths of its radii apart.
    """

    bounds: ClassVar[Bounds] = {"stiffness": (1e-6, 1e9, "N/m"), "damping": (0.0, 1e6, "N s/m")}

    stiffness: float = 300.0
    """Of the contact of two elements [N/m]."""
    damping: float = 0.05
    """Of that contact, along the normal [N s/m]."""


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
