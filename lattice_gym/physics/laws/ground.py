"""The ground: normal contact and Coulomb friction of nodes on the plane z = 0.

A node of radius r at the height z is pressed in by d = r - z, and where that is positive pushed up with

    N = max(0, stiffness d - damping v_z)

Stored is stiffness d^2 / 2. Coulomb friction comes after all forces and damping of a step, on the velocities that
these leave: a node sticks where the force that takes all its slip is at most static_friction N times the factor of its
direction, see `Ground`; else kinetic_friction N times that factor acts against its slip.

To the critical time step the ground is a spring and a dashpot under every node. Friction only takes from velocities.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from lattice_gym.checks import FloatArray, Parameters, real, require
from lattice_gym.physics.laws.base import Generalised, Law, Linearised, NodeSprings, Shortened, one_or_none
from lattice_gym.physics.rod import FRAME_TOLERANCE

if TYPE_CHECKING:
    from lattice_gym.physics.assembly import RodModel
    from lattice_gym.physics.state import RodState


@dataclass(frozen=True, kw_only=True)
class Ground(Parameters):
    """The plane z = 0, with normal contact and Coulomb friction; the defaults bear the default worm in water.

    It then rests at a depth of at most 5 % of a rod's radius, and the ground shortens the critical step by under 1 %.
    Forward, backward and sideways are those of the body as it lies at the moment, whose axis `RodModel.rod_ends` tells.
    With d the direction of a node's slip in the plane and e the unit vector of that axis, the coefficients have the
    factor sqrt((f d.e)^2 + sideways^2 (1 - (d.e)^2)), where f is `forward` for d.e > 0 and else `backward`. So the axis
    counts as far as it is level: a body that stands upright has no forward, and all of its slip is sideways.
    """

    stiffness: float = real(100.0, 1e-6, 1e9, "N/m")
    """Of a node's contact [N/m]."""
    damping: float = real(0.1, 0.0, 1e6, "N s/m")
    """Of a node's contact, along the normal [N s/m]."""
    static_friction: float = real(0.5, 0.0, 100.0, "1")
    """Largest friction over normal force of a node that sticks; never less than `kinetic_friction`."""
    kinetic_friction: float = real(0.5, 0.0, 100.0, "1")
    """Friction over normal force of a node that slips."""
    forward: float = real(1.0, 0.0, 100.0, "1")
    """Factor on both coefficients for slip towards the body's top; friction is isotropic where all three are alike."""
    backward: float = real(1.0, 0.0, 100.0, "1")
    """The same factor for slip towards its base."""
    sideways: float = real(1.0, 0.0, 100.0, "1")
    """The same factor for slip across."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.static_friction < self.kinetic_friction:
            raise self._refused("static_friction", f"must not be below kinetic_friction = {self.kinetic_friction!r}")

    @property
    def isotropic(self) -> bool:
        """Whether friction is the same in all directions."""
        return self.forward == self.backward == self.sideways

    def factor(self, slip: FloatArray, axis: FloatArray) -> FloatArray:
        """Return the factor on both coefficients, shape (n,), for slip in the plane, shape (n, 2), and a body axis."""
        speed = np.linalg.norm(slip, axis=1)
        along = slip @ axis[:2] / np.where(speed > 0.0, speed, 1.0)
        f = np.where(along > 0.0, self.forward, self.backward)
        return np.sqrt((f * along) ** 2 + self.sideways**2 * (1.0 - along**2))

    def apply_friction(self, slip: FloatArray, normal: FloatArray, push: FloatArray, axis: FloatArray) -> FloatArray:
        """Return the slip that friction leaves.

        Parameters
        ----------
        slip
            Velocities in the plane that all else leaves [m/s], shape (n_node, 2).
        normal
            Normal forces [N], shape (n_node,).
        push
            What a unit force adds to a velocity in a step [s/kg], shape (n_node,).
        axis
            Unit vector of the body axis, shape (3,).
        """
        speed = np.linalg.norm(slip, axis=1)
        bound = self.factor(slip, axis) * normal * push
        share = 1.0 - self.kinetic_friction * bound / np.where(speed > 0.0, speed, 1.0)
        sticks = speed <= self.static_friction * bound
        remaining: FloatArray = np.where(sticks, 0.0, share)[:, None] * slip
        return remaining


class GroundLaw(Law):
    """Push of the ground at every node, and the friction there."""

    fields: ClassVar = {"ground": one_or_none(Ground)}

    @classmethod
    def present(cls, model: RodModel) -> bool:
        """Tell whether there is a ground."""
        return model.ground is not None

    @cached_property
    def _ground(self) -> Ground:
        assert self.model.ground is not None
        return self.model.ground

    def check(self) -> None:
        """Refuse friction by direction where rods' ends cancel out: of them the body axis is made."""
        if self._ground.isotropic:
            return
        place = self.model.rod_array("position")
        tail, head = self.model.rod_ends
        with np.errstate(all="ignore"):
            chord = place[head] - place[tail]
            length, most = float(np.linalg.norm(chord.sum(axis=0))), float(np.linalg.norm(chord, axis=1).sum())
        require(
            FRAME_TOLERANCE * most < length < math.inf,
            "ground: where friction differs by direction, rods that are no muscles must have a mean way, end to end",
        )

    def energy(self, state: RodState) -> Mapping[str, FloatArray]:
        """Energy of the spring under every node, shape (n_node,)."""
        depth = np.maximum(self.model.node_radius - state.position[:, 2], 0.0)
        return {"ground": 0.5 * self._ground.stiffness * depth**2}

    def linearised(self, shortened: Shortened) -> Linearised:
        """Springs and dashpots as if it bore every node."""
        upward, ground = np.array([0.0, 0.0, 1.0]), self._ground
        return Linearised(
            [NodeSprings(ground.stiffness * upward)],
            [NodeSprings(ground.damping * upward)] if ground.damping > 0.0 else [],
        )

    def force(self, state: RodState, tension: FloatArray) -> Generalised:
        """Push nodes up; for friction see `Ground.apply_friction`."""
        force, ground = Generalised.zeros(self.model), self._ground
        depth = self.model.node_radius - state.position[:, 2]
        normal = np.maximum(ground.stiffness * depth - ground.damping * state.velocity[:, 2], 0.0)
        force.node[:, 2] = np.where(depth > 0.0, normal, 0.0)
        return force
