"""Named quantities of worms as they are now, for rewards, observations and wrappers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lattice_gym.body.lattice import Lattice
from lattice_gym.checks import FloatArray
from lattice_gym.physics import measures
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.state import Motion


@dataclass(frozen=True, eq=False)
class Measures:
    """What `physics.measures` tells of a motion, each computed when it is asked for; one row a worm."""

    lattice: Lattice
    """The body at rest."""
    model: RodModel
    """The assembly that moves."""
    motion: Motion
    """How it moves."""

    @property
    def site_position(self) -> FloatArray:
        """Place of every site [m], shape (n_worm, n_site, 3)."""
        return measures.site_positions(self.lattice, self.motion.position)

    @property
    def site_velocity(self) -> FloatArray:
        """Velocity of every site [m/s], shape (n_worm, n_site, 3)."""
        return measures.site_positions(self.lattice, self.motion.velocity)

    @property
    def ring_radii(self) -> FloatArray:
        """Mean radius of every level [m], shape (n_worm, n_level)."""
        return measures.ring_radii(self.lattice, self.motion.position)

    @property
    def muscle_lengths(self) -> FloatArray:
        """Length of every active muscle [m], shape (n_worm, n_muscle)."""
        return measures.muscle_lengths(self.model, self.motion.position)

    @property
    def muscle_rates(self) -> FloatArray:
        """How fast every active muscle grows longer [m/s], shape (n_worm, n_muscle)."""
        return measures.muscle_rates(self.model, self.motion.position, self.motion.velocity)

    @property
    def strain(self) -> FloatArray:
        """Strain of the body, positive where it is longer, shape (n_worm,)."""
        return measures.strain(self.lattice, self.motion.position)

    @property
    def twist_angle(self) -> FloatArray:
        """Angle by which the top is turned about its centre [rad], shape (n_worm,)."""
        return measures.twist_angle(self.lattice, self.motion.position)

    @property
    def bend_vector(self) -> FloatArray:
        """Bend angle [rad] times the horizontal direction that the top leans towards, shape (n_worm, 2)."""
        return measures.bend_vector(self.lattice, self.motion.position)

    @property
    def mass_centre(self) -> FloatArray:
        """Centre of mass [m], shape (n_worm, 3)."""
        return measures.mass_centre(self.model, self.motion.position)

    @property
    def top_centre(self) -> FloatArray:
        """Centre of the top ring [m], shape (n_worm, 3)."""
        return measures.top_centre(self.lattice, self.motion.position)

    @property
    def top_normal(self) -> FloatArray:
        """Unit normal of the top ring, shape (n_worm, 3)."""
        return measures.top_normal(self.lattice, self.motion.position)

    @property
    def top_velocity(self) -> FloatArray:
        """Velocity of the top ring's centre [m/s], shape (n_worm, 3)."""
        return measures.top_centre(self.lattice, self.motion.velocity)

    @property
    def base_centre(self) -> FloatArray:
        """Centre of the bottom ring [m], shape (n_worm, 3)."""
        return measures.base_centre(self.lattice, self.motion.position)

    @property
    def base_frame(self) -> FloatArray:
        """Axes that move with the base, as rows, shape (n_worm, 3, 3); the third is its normal."""
        axes = measures.base_frame(self.lattice, self.motion.position)
        return np.broadcast_to(axes, (len(self.motion.position), 3, 3))

    @property
    def base_velocity(self) -> FloatArray:
        """Velocity of the bottom ring's centre [m/s], shape (n_worm, 3)."""
        return measures.base_centre(self.lattice, self.motion.velocity)
