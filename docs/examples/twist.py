"""A task of your own: turn the top of the worm about its axis. `docs/tasks.md` explains it part by part."""

from typing import ClassVar

import numpy as np

from lattice_gym import Command, RewardTerm, Task, tie
from lattice_gym.checks import wrap_angle
from lattice_gym.physics.measures import azimuth_of, site_positions, top_sites
from lattice_gym.tasks.gait import hold


class Twist(Task):
    """Turn the top ring to a commanded angle: the reward is how much nearer to it the ring is than at rest."""

    name = "twist"
    time_limit = 40  # control steps of 0.05 s
    design: ClassVar = {"max_tension": 1.0}  # [N]
    rewards: ClassVar = {"nearer": RewardTerm(10.0, -np.pi, 0.14)}  # weight, least and largest value [rad]
    training: ClassVar = {"control": "muscle", "gamma": 0.8}
    bounds = (1.0,)  # of what `observe` gives

    @classmethod
    def muscles(cls, lattice):
        """Diagonals along the rods: from every site to both neighbours on the next level."""
        level, apart = lattice.site_level, abs(wrap_angle(lattice.site_azimuth - lattice.site_azimuth[:, None]))
        return tie(lattice, np.argwhere((level == level[:, None] + 1) & (apart < 4.0 / lattice.design.n_pairs)))

    @classmethod
    def gait(cls, lattice, layout, command):
        """Activate the diagonals that lean against the commanded angle, in proportion to it."""
        start, end = np.array([(muscle.start, muscle.end) for muscle in layout.active]).T
        lean = wrap_angle(lattice.site_azimuth[end] - lattice.site_azimuth[start])
        most = 0.15 if command["angle"] < 0.0 else 0.22  # at full drive, after 2 s [rad]
        return hold(np.where(lean * command["angle"] < 0.0, abs(command["angle"]) / most, 0.0))

    def command_ranges(self):
        """Angle [rad]: drawn from -0.12 to 0.12, given from -0.14 to 0.14."""
        return {"angle": Command(-0.12, 0.12, -0.14, 0.14, "rad")}

    def observe(self, motion, time):
        """Commanded angle over the largest."""
        return self.commanded["angle"][:, None] / 0.14

    def terms(self, motion, activation, time):
        """How much nearer the commanded angle is than it was at rest."""
        return {"nearer": abs(self.commanded["angle"]) - abs(self.angle(motion) - self.commanded["angle"])}

    def outcome(self, motion, worms):
        """Angle by which the top is turned [rad]."""
        return {"angle": self.angle(motion)}

    def angle(self, motion):
        """Angle by which the top ring is turned about its centre [rad], shape (n,)."""
        sites = top_sites(self.lattice)
        ring = site_positions(self.lattice, motion.position)[:, sites]
        azimuth = azimuth_of(ring - ring.mean(axis=1, keepdims=True))
        return wrap_angle(azimuth - self.lattice.site_azimuth[sites]).mean(axis=1)
