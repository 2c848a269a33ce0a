"""Carry a ball up or down inside the body."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, final

import numpy as np
import numpy.typing as npt

from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import MuscleLayout
from lattice_gym.checks import TAU, FloatArray, IntArray, invalid_value, number
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.measures import CentrelineProjection, centreline_projection, ring_radii
from lattice_gym.physics.state import Motion
from lattice_gym.physics.world import World
from lattice_gym.tasks.base import COMMAND_BOUND, GOAL_SCALE, Command, RewardTerm, Task, quotient
from lattice_gym.tasks.gait import MAX_NUMBER, MIN_NUMBER, Gait, longitudinal, muscle_middles, required_commands

CARRY_FREQUENCY, CARRY_WAVELENGTH, CARRY_VERTICAL_SHARE = 0.2, 0.5, 0.5
"""Frequency [Hz], wavelength [body lengths] and share of vertical muscles of the carrying wave: 0.1 body lengths a
second."""
CARRY_START = 0.565
"""Where the ball of the task has come to rest [body lengths]."""


@final
class Transport(Task):
    """Carry the ball inside the lattice towards the top (+1) or the base (-1): the reward is the way it went there.

    Its way is measured along the body's centreline at rest, see `measures.centreline_projection`. The episode ends once
    the ball has left the body: delivered, if by the commanded end, else lost. The ball has the density of the medium
    and starts between the two rings halfway up. Muscles of 0.5 N hardly move it.
    """

    name = "transport"
    layout = "all"
    time_limit = 200
    # 10 for a body length, as crawling earns. In all: a ball goes no further than the height, and is lost once.
    rewards: ClassVar[Mapping[str, RewardTerm]] = {
        "progress": RewardTerm(10.0, -1.0, 1.0, per_episode=True),
        "lost": RewardTerm(5.0, -1.0, 0.0, per_episode=True),
    }
    """A ball that is lost costs as much as it can gain, half a height."""
    # Strokes last longer than the five steps that a discount of 0.8 looks ahead.
    training: ClassVar[Mapping[str, Any]] = {"control": "ring", "gamma": 0.95}
    bounds = (1.0, *(COMMAND_BOUND,) * 6)
    design: ClassVar[Mapping[str, Any]] = {"max_tension": 1.0}
    settles = True

    RADIUS_RATIO: ClassVar[float] = 1.09
    """Radius of the ball over that of the room the ring muscles leave at rest."""

    @classmethod
    def world(cls, lattice: Lattice) -> World:
        """Return a ball of the medium's density that the rings hold, between the two halfway up."""
        design = lattice.design
        room = 0.5 * design.diameter * np.cos(np.pi / design.n_pairs) - design.muscle_radius
        most = 0.5 * design.diameter - design.structure_radius
        if not min(room, most) > 0.0:
            raise ValueError(f"design: {design.n_pairs} pairs of rods leave no room for a ball inside")
        radius = min(cls.RADIUS_RATIO * float(room), most)
        return World(medium=Medium(), ball=Ball(radius=radius, level=design.n_segment // 2 + 0.5, friction=0.1))

    def prepare(self) -> None:
        """Refuse a body without levels, and a world without a ball."""
        ring_radii(self.lattice, self.lattice.position.reshape(-1, 3))  # refuses a lattice without levels
        if self.model.n_ball == 0:
            raise ValueError("world.ball = None: there is nothing to carry")

    def initial_memory(self) -> dict[str, FloatArray]:
        """Where the ball started and is, its way in the last step, whether that lost it, and when that was."""
        height, nothing = self._projection(Motion.of(self.rest)).height[0], np.zeros(())
        return {"start": height, "height": height, "way": nothing, "lost": nothing, "time": nothing}

    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Direction; displacement of the ball over GOAL_SCALE body lengths, and its velocity [body lengths / s]."""
        height = self.lattice.design.height
        moved = (motion.ball_position[:, 0] - self.rest.ball_position[0]) / (GOAL_SCALE * height)
        moving = np.clip(
            np.concatenate([moved, motion.ball_velocity[:, 0] / height], axis=-1), -COMMAND_BOUND, COMMAND_BOUND
        )
        return np.concatenate([self.commanded["direction"][:, None], moving], axis=-1)

    def remember(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Way of the ball along the command in this step [body lengths], and -1 where it is lost."""
        place, direction = self._projection(motion), self.commanded["direction"]
        way = direction * (place.height - self.memory["height"]) / self.lattice.design.height
        lost = np.where(_lost(place, direction), -1.0, 0.0)
        return {"height": place.height, "way": way, "lost": lost, "time": time}

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Way of the ball along the command in this step [body lengths], and -1 where it is lost."""
        return {"progress": self.memory["way"], "lost": self.memory["lost"]}

    def terminated(self, motion: Motion) -> npt.NDArray[np.bool_]:
        """Tell whether the ball has left the body."""
        return self._projection(motion).outside

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Distance along the command [m], mean speed [m/s], whether it is held or lost, and delivered (1 or 0)."""
        place = self._projection(motion)
        direction, time = self.commanded["direction"][worms], self.memory["time"][worms]
        distance = direction * (place.height - self.memory["start"][worms])
        lost = _lost(place, direction)
        return {
            "distance": distance,
            "speed": quotient(distance, time, time > 0.0),
            "held": (~lost).astype(np.float64),
            "delivered": (place.outside & ~lost).astype(np.float64),
        }

    def describe(self, outcome: Mapping[str, float], worm: int) -> str:
        """Distance, speed, and what became of the ball."""
        way = "up" if self.commanded["direction"][worm] > 0.0 else "down"
        end = "" if outcome["held"] else ", lost"
        end = ", delivered" if outcome["delivered"] else end
        return f"{1e3 * outcome['distance']:+.1f} mm {way} at {1e3 * outcome['speed']:.1f} mm/s{end}"

    @classmethod
    def gait(cls, lattice: Lattice, layout: MuscleLayout, command: Mapping[str, float]) -> Gait:
        """Ring muscles that contract as a wave in the commanded direction, with the ball in its trough."""
        return carrying_gait(lattice, layout, **required_commands(cls.name, command, "direction"))

    def _projection(self, motion: Motion) -> CentrelineProjection:
        return centreline_projection(self.lattice, motion.position, motion.ball_position[:, 0])

    def command_ranges(self) -> dict[str, Command]:
        """Direction along the body."""
        return {"direction": Command(-1.0, 1.0, -1.0, 1.0, "1", (-1.0, 1.0))}


def _lost(place: CentrelineProjection, direction: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether a ball has left the body other than by the commanded end."""
    lost: npt.NDArray[np.bool_] = place.beside | (place.end == -direction)
    return lost


def carrying_gait(
    lattice: Lattice,
    layout: MuscleLayout,
    direction: float,
    frequency: float = CARRY_FREQUENCY,
    wavelength: float = CARRY_WAVELENGTH,
    vertical_share: float = CARRY_VERTICAL_SHARE,
    start: float = CARRY_START,
) -> Gait:
    """Rings that contract as a wave along the body in the commanded direction, with what they hold in its trough.

    Verticals contract in antiphase, where rings let go. The direction is +1 towards the top end, -1 towards the base;
    frequency in Hz, wavelength in body lengths; at time 0 a trough is at the height `start` [body lengths].
    """
    direction = number("direction", direction, -MAX_NUMBER, MAX_NUMBER, "1")
    frequency = number("frequency", frequency, MIN_NUMBER, MAX_NUMBER, "Hz")
    wavelength = number("wavelength", wavelength, MIN_NUMBER, MAX_NUMBER, "body lengths")
    vertical_share = number("vertical_share", vertical_share, 0.0, MAX_NUMBER, "1")
    start = number("start", start, -MAX_NUMBER, MAX_NUMBER, "body lengths")
    if direction == 0.0:
        raise invalid_value("direction", direction, "must not be 0")
    along = longitudinal(lattice, layout)
    above = muscle_middles(lattice, layout)[:, 2] / lattice.design.height - start
    drive = 0.5 * np.where(along, vertical_share, 1.0)
    return Gait(
        offset=drive,
        swing=np.where(along, drive, -drive),
        phase=TAU * above / wavelength,
        frequency=float(np.sign(direction)) * frequency,
        lead=0.0,
    )
