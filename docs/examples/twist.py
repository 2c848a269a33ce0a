"""A task of your own: turn the top of the worm about its axis. `docs/tasks.md` explains it part by part."""

import numpy as np

from lattice_gym import Command, ObservationTerm, RewardTerm, Task, diagonal
from lattice_gym.physics.measures import twist_angle


class TopAngle(ObservationTerm):  # of its own: how far the top is turned
    name, unit, low, high = "top_angle", "rad", np.full(1, -np.pi), np.full(1, np.pi)

    def __call__(self, worms):
        return worms.measures.twist_angle[:, None]  # a row a worm


class Twist(Task):
    name, time_limit = "twist", 40  # control steps of 0.05 s
    design = {"max_tension": 1.0}  # what differs from the default one [N]
    rewards = {"nearer": RewardTerm(10.0, -np.pi, 0.14)}  # weight, least and largest value [rad]
    training = {"control": "muscle", "gamma": 0.8}  # hints for a learner
    observation = ("sites", "activation", "command", "twist:TopAngle")
    bounds = (1.0,)  # of what `observe` gives, the term "command"

    @classmethod
    def muscles(cls, lattice):
        return diagonal(lattice)

    def command_ranges(self):  # drawn from -0.12 to 0.12, may be given from -0.14 to 0.14
        return {"angle": Command(-0.12, 0.12, -0.14, 0.14, "rad")}

    def observe(self, motion, time):
        return self.commanded["angle"][:, None] / 0.14

    def terms(self, motion, activation, time):  # how much nearer the top is to the angle than at rest
        angle = self.commanded["angle"]
        return {"nearer": abs(angle) - abs(twist_angle(self.lattice, motion.position) - angle)}

    def outcome(self, motion, worms):
        return {"angle": twist_angle(self.lattice, motion.position)}
