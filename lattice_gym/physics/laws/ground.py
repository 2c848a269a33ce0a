"""The ground: normal contact and Coulomb friction of nodes on the plane z = 0."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from lattice_gym.checks import Bounds, Part


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
