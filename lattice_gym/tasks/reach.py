"""Bring the top's centre to a commanded place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, final

import numpy as np
import numpy.typing as npt

from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import MuscleLayout
from lattice_gym.checks import TAU, FloatArray, IntArray, number
from lattice_gym.physics.measures import base_frame, top_centre
from lattice_gym.physics.state import Motion
from lattice_gym.tasks.base import COMMAND_BOUND, GOAL_SCALE, MAX_STRAIN, Command, CommandValues, GoalTask, RewardTerm
from lattice_gym.tasks.gait import MAX_NUMBER, Gait, constant_gait, longitudinal, muscle_middles, required_commands

REACH_SHARPNESS = (3.8, 44.0)
REACH_LENGTHENING = (6.7, 5.5)
"""Coefficients of `reaching_gait`: least squares over what the default design reached."""


def _goal_distance(achieved: npt.NDArray[np.float32], desired: npt.NDArray[np.float32]) -> FloatArray:
    """Distances between goals of shape (n, 3), in body lengths."""
    apart: FloatArray = GOAL_SCALE * np.linalg.norm(desired.astype(np.float64) - achieved, axis=-1)
    return apart


@final
class Reach(GoalTask):
    """Bring the centre of the top ring to a target: the reward is how much nearer it is than it was at rest.

    A goal is a displacement of that centre from rest, along the axes of the base at rest, in units of GOAL_SCALE body
    lengths. A target lies at `radius` from the axis, towards `azimuth`, and `rise` above the top at rest.

    Targets are drawn from what the default design can do under constant commands, after 3 s: verticals at
    clip(s cos + max(-b, 0)) and rings at clip(-s cos + max(b, 0)), with the cosine of the angle from the target's
    azimuth, s from 0 to 3 and b from -1 to 1. So the centre comes to within 0.02 body lengths of every target with a
    radius from 0.05 to 0.2 and a rise from -0.08 to 0. Its largest radius is 0.24 body lengths; at a radius of 0.2 the
    rise spans -0.09 to 0.01, on the axis -0.16 to 0.11. The 100 mm of Schaffer et al. (arXiv 2408.16069), one body
    length here, are far beyond that.
    """

    name = "reach"
    layout = "all"
    time_limit = 60
    # A target lies within 3 body lengths of where the top rests.
    rewards: ClassVar[Mapping[str, RewardTerm]] = {"approach": RewardTerm(1.0, -MAX_STRAIN - 3.0, 3.0)}
    training: ClassVar[Mapping[str, Any]] = {"control": "column", "gamma": 0.8}
    goal_term = "approach"
    n_goal = 3
    bounds = (COMMAND_BOUND,) * n_goal

    REACHED: ClassVar[float] = 0.03
    """Distance within which a target counts as reached [body lengths]."""

    def prepare(self) -> None:
        """Measure where the top rests."""
        rest = self.model.rest_state().position
        self.origin = top_centre(self.lattice, rest)
        self.axes = base_frame(self.lattice, rest)

    def initial_memory(self) -> dict[str, FloatArray]:
        """Where the top is, as a goal, and when the target was first reached [s]; 0: not yet."""
        return {"achieved": self.achieved(Motion.of(self.rest))[0], "reach_time": np.zeros(())}

    def achieved(self, motion: Motion) -> npt.NDArray[np.float32]:
        """Displacement of the top's centre over GOAL_SCALE body lengths, shape (n, 3)."""
        moved = top_centre(self.lattice, motion.position) - self.origin
        unit = GOAL_SCALE * self.lattice.design.height
        along = np.sum(self.axes * moved[:, None, :], axis=-1)
        return np.asarray(np.clip(along / unit, -COMMAND_BOUND, COMMAND_BOUND), dtype=np.float32)

    def desired(self) -> npt.NDArray[np.float32]:
        """Displacement that is asked for over GOAL_SCALE body lengths, shape (n_worm, 3)."""
        azimuth, radius, rise = (self.commanded[name] for name in ("azimuth", "radius", "rise"))
        target = np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), rise]).T
        return np.ascontiguousarray(target / GOAL_SCALE, dtype=np.float32)

    def markers(self, worm: int) -> FloatArray:
        """Return the target."""
        unit = GOAL_SCALE * self.lattice.design.height
        return np.atleast_2d(self.origin + unit * self.desired()[worm] @ self.axes)

    def goal_reward(self, achieved: npt.NDArray[Any], desired: npt.NDArray[Any]) -> FloatArray:
        """Distance of the target from rest less that from the top's centre [body lengths]."""
        target = np.asarray(desired, dtype=np.float64)
        nearer: FloatArray = GOAL_SCALE * (np.linalg.norm(target, axis=-1) - np.linalg.norm(target - achieved, axis=-1))
        return nearer

    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Way from the top's centre to the target, over GOAL_SCALE body lengths."""
        way = np.clip(self.desired() - self.achieved(motion), -COMMAND_BOUND, COMMAND_BOUND)
        return np.asarray(way, dtype=np.float64)

    def remember(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, npt.NDArray[Any]]:
        """Where the top is, and the time where that is the target for the first time."""
        achieved, reached = self.achieved(motion), self.memory["reach_time"]
        new = (reached == 0.0) & (_goal_distance(achieved, self.desired()) <= self.REACHED)
        return {"achieved": achieved, "reach_time": np.where(new, time, reached)}

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """How much nearer the target is than at rest [body lengths]."""
        return {"approach": self.goal_reward(self.memory["achieved"], self.desired())}

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Distance from the target [m], whether it was reached at all (1 or 0), and when [s], 0 if not."""
        reach_time = self.memory["reach_time"][worms]
        distance = _goal_distance(self.achieved(motion), self.desired()[worms])
        return {
            "distance": distance * self.lattice.design.height,
            "reached": (reach_time > 0.0).astype(np.float64),
            "reach_time": reach_time,
        }

    @classmethod
    def errors(cls, outcome: Mapping[str, float], command: Mapping[str, float]) -> dict[str, float]:
        """Return the outcome, without the time [s] at which the target was reached where it was not."""
        return {name: value for name, value in outcome.items() if name != "reach_time" or outcome["reached"]}

    def describe(self, outcome: Mapping[str, float], worm: int) -> str:
        """Distance from the target, and when it was reached."""
        reached = f", reached after {outcome['reach_time']:.2f} s" if outcome["reached"] else ""
        return f"{1000.0 * outcome['distance']:.1f} mm from the target{reached}"

    @classmethod
    def gait(cls, lattice: Lattice, layout: MuscleLayout, command: Mapping[str, float]) -> Gait:
        """Bend towards the target that is held, lower or higher by all verticals or rings."""
        return reaching_gait(lattice, layout, **required_commands(cls.name, command, "azimuth", "radius", "rise"))

    def command_ranges(self) -> dict[str, Command]:
        """Place of the target in cylindrical coordinates about the top at rest."""
        return {
            "azimuth": Command(0.0, TAU, -TAU, TAU, "rad"),
            "radius": Command(0.05, 0.2, 0.0, 1.5, "body lengths"),
            "rise": Command(-0.08, 0.0, -1.0, 1.5, "body lengths"),
        }


EIGHT_TARGETS: CommandValues = {"azimuth": [TAU * k / 8 for k in range(8)], "radius": 0.2, "rise": -0.05}
"""Command of `Reach` for eight targets on a circle, as in Schaffer et al. 2024 (arXiv 2408.16069)."""


def reaching_gait(lattice: Lattice, layout: MuscleLayout, azimuth: float, radius: float, rise: float) -> Gait:
    """Hold a bend towards the azimuth [rad], and the verticals or the rings all round to lower or raise the top.

    Sharpness of the bend s = p radius + q radius^3, where the bend alone lowers the top by about 5.5 / 6.7 radius^2,
    and lengthening b = u rise + v radius^2; radius and rise in body lengths. Verticals take s cos + max(-b, 0), rings
    -s cos + max(b, 0), with the cosine of the angle from the azimuth.
    """
    azimuth = number("azimuth", azimuth, -MAX_NUMBER, MAX_NUMBER, "rad")
    radius = number("radius", radius, 0.0, MAX_NUMBER, "body lengths")
    rise = number("rise", rise, -MAX_NUMBER, MAX_NUMBER, "body lengths")
    sharpness = REACH_SHARPNESS[0] * radius + REACH_SHARPNESS[1] * radius**3
    lengthening = REACH_LENGTHENING[0] * rise + REACH_LENGTHENING[1] * radius**2
    middle = muscle_middles(lattice, layout)
    bend = sharpness * np.cos(np.arctan2(middle[:, 1], middle[:, 0]) - azimuth)
    shorten, lengthen = max(-lengthening, 0.0), max(lengthening, 0.0)
    return constant_gait(np.where(longitudinal(lattice, layout), bend + shorten, lengthen - bend))
