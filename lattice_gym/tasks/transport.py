"""Carry a ball up or down inside the body."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, final

import numpy as np
import numpy.typing as npt

from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import MuscleLayout
from lattice_gym.checks import TURN, FloatArray, IntArray, number, refused
from lattice_gym.physics.laws.ball import Bolus
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.measures import Lodging, lodging, ring_radii
from lattice_gym.physics.state import Motion
from lattice_gym.physics.world import World
from lattice_gym.tasks.base import COMMAND_BOUND, GOAL_SCALE, WAY_WEIGHT, Command, RewardTerm, Task, quotient
from lattice_gym.tasks.gait import LEAST, MOST, Gait, longitudinal, muscle_middles, needed

CARRY_FREQUENCY, CARRY_WAVELENGTH, CARRY_VERTICAL_SHARE = 0.2, 0.5, 0.5
"""Of the carrying wave [Hz], [heights]: what it holds rides it, at a tenth of a height a second."""
CARRY_START = 0.565
"""Where the ball of the task has come to rest [heights]."""


@final
class Transport(Task):
    """Carry the ball inside the lattice towards the top (+1) or the base (-1): the reward is the way it went there.

    Its way is measured along the body: from ring centre to ring centre, in rest heights, see `measures.lodging`. The
    episode is over once it has left the body: delivered, if by the commanded end, else lost. The ball is as heavy as
    the medium and starts between the two rings halfway up. Muscles of 0.5 N hardly move it.
    """

    name = "transport"
    layout = "all"
    time_limit = 200
    # In all: a ball goes no further than the height, and is lost once.
    rewards: ClassVar[Mapping[str, RewardTerm]] = {
        "progress": RewardTerm(WAY_WEIGHT, -1.0, 1.0, whole=True),
        "lost": RewardTerm(5.0, -1.0, 0.0, whole=True),
    }
    """A ball that is lost costs as much as it can gain, half a height."""
    # Strokes last longer than the five steps that a discount of 0.8 looks ahead.
    training: ClassVar[Mapping[str, Any]] = {"control": "ring", "gamma": 0.95}
    bounds = (1.0, *(COMMAND_BOUND,) * 6)
    design: ClassVar[Mapping[str, Any]] = {"max_tension": 1.0}
    settles = True

    SQUEEZE: ClassVar[float] = 1.09
    """Radius of the ball over that of the room the ring muscles leave at rest."""

    @classmethod
    def world(cls, lattice: Lattice) -> World:
        """Return a ball of the medium's density that the rings hold, between the two halfway up."""
        design = lattice.design
        room = 0.5 * design.diameter * np.cos(np.pi / design.n_pairs) - design.muscle_radius
        most = 0.5 * design.diameter - design.structure_radius
        if not min(room, most) > 0.0:
            raise ValueError(f"design: {design.n_pairs} pairs of rods leave no room for a ball inside")
        radius = min(cls.SQUEEZE * float(room), most)
        return World(medium=Medium(), bolus=Bolus(radius=radius, level=design.n_segment // 2 + 0.5, friction=0.1))

    def prepare(self) -> None:
        """Refuse a body without levels, and a world without a ball."""
        ring_radii(self.lattice, self.lattice.position.reshape(-1, 3))  # refuses a lattice without levels
        if self.model.n_bolus == 0:
            raise ValueError("world.bolus = None: there is nothing to carry")

    def blank_memory(self) -> dict[str, FloatArray]:
        """Where the ball started, where it was last, and when that was."""
        height = self._lodging(Motion.of(self.rest)).height[0]
        return {"start": height, "height": height, "time": np.zeros(())}

    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Direction; the ball's way from its start over GOAL_SCALE heights, and its velocity in heights a second."""
        height = self.lattice.design.height
        moved = (motion.bolus_position[:, 0] - self.rest.bolus_position[0]) / (GOAL_SCALE * height)
        moving = np.clip(
            np.concatenate([moved, motion.bolus_velocity[:, 0] / height], axis=-1), -COMMAND_BOUND, COMMAND_BOUND
        )
        return np.concatenate([self.commanded["direction"][:, None], moving], axis=-1)

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Way of the ball along the command in this step [heights], and -1 where it is lost."""
        place, direction = self._lodging(motion), self.commanded["direction"]
        way = direction * (place.height - self.memory["height"]) / self.lattice.design.height
        self.memory |= {"height": place.height, "time": time.copy()}
        lost = np.where(_lost(place, direction), -1.0, 0.0)
        return {"progress": way, "lost": lost}

    def over(self, motion: Motion) -> npt.NDArray[np.bool_]:
        """Tell whether the ball has left the body."""
        return self._lodging(motion).left

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Distance along the command [m], mean speed [m/s], whether it is held or lost, and delivered (1 or 0)."""
        place, direction, time = self._lodging(motion), self.commanded["direction"][worms], self.memory["time"][worms]
        distance = direction * (place.height - self.memory["start"][worms])
        lost = _lost(place, direction)
        return {
            "distance": distance,
            "speed": quotient(distance, time, time > 0.0),
            "held": (~lost).astype(np.float64),
            "delivered": (place.left & ~lost).astype(np.float64),
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
        return carrying_gait(lattice, layout, **needed(cls.name, command, "direction"))

    def _lodging(self, motion: Motion) -> Lodging:
        return lodging(self.lattice, motion.position, motion.bolus_position[:, 0])

    def command_ranges(self) -> dict[str, Command]:
        """Direction along the body."""
        return {"direction": Command(-1.0, 1.0, -1.0, 1.0, "1", (-1.0, 1.0))}


def _lost(place: Lodging, direction: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether a ball has left the body other than by the commanded end."""
    lost: npt.NDArray[np.bool_] = place.outside | (place.end == -direction)
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
    frequency in Hz, wavelength in heights; at time 0 a trough is at the height `start` [heights].
    """
    direction = number("direction", direction, -MOST, MOST, "1")
    frequency = number("frequency", frequency, LEAST, MOST, "Hz")
    wavelength = number("wavelength", wavelength, LEAST, MOST, "heights")
    vertical_share = number("vertical_share", vertical_share, 0.0, MOST, "1")
    start = number("start", start, -MOST, MOST, "heights")
    if direction == 0.0:
        raise refused("direction", direction, "must not be 0")
    along = longitudinal(lattice, layout)
    above = muscle_middles(lattice, layout)[:, 2] / lattice.design.height - start
    drive = 0.5 * np.where(along, vertical_share, 1.0)
    return Gait(
        offset=drive,
        swing=np.where(along, drive, -drive),
        phase=TURN * above / wavelength,
        frequency=float(np.sign(direction)) * frequency,
        lead=0.0,
    )
