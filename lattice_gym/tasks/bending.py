"""Lean towards a commanded azimuth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, final

import numpy as np

from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import MuscleLayout
from lattice_gym.checks import TAU, FloatArray, IntArray, number
from lattice_gym.physics.measures import azimuth_of, bend_vector, top_sites
from lattice_gym.physics.state import Motion
from lattice_gym.tasks.base import Command, RewardTerm, Task, check_base
from lattice_gym.tasks.gait import MAX_NUMBER, Gait, constant_gait, longitudinal, muscle_middles, required_commands

MIN_LEAN = 0.05
"""A worm that is bent by less leans no way [deg]."""


def _whole(degrees: float) -> int:
    """Whole degrees from 0 to 359."""
    return round(degrees) % 360


@final
class Bending(Task):
    """Lean towards a commanded azimuth: the part of the bend that way counts, the part sideways counts against."""

    name = "bending"
    layout = "all"
    time_limit = 40
    rewards: ClassVar[Mapping[str, RewardTerm]] = {
        "bend": RewardTerm(1.0, -np.pi, np.pi),
        "sideways": RewardTerm(1.0, -np.pi, 0.0),
    }
    training: ClassVar[Mapping[str, Any]] = {"control": "column", "gamma": 0.8}
    bounds = (1.0, 1.0)

    def prepare(self) -> None:
        """Refuse a body whose top or base spans no plane."""
        top_sites(self.lattice)  # refuses a lattice whose top is no plane
        check_base(self.lattice)

    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Cosine and sine of the commanded azimuth."""
        return self._towards()

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Bend towards the commanded azimuth [rad], and minus the size of its part across."""
        x, y = bend_vector(self.lattice, motion.position).T
        cos, sin = self._towards().T
        return {"bend": x * cos + y * sin, "sideways": -np.abs(y * cos - x * sin)}

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Bend angle and its direction [rad]."""
        bend = bend_vector(self.lattice, motion.position)
        return {"bend_angle": np.hypot(bend[:, 0], bend[:, 1]), "bend_direction": azimuth_of(bend)}

    @classmethod
    def errors(cls, outcome: Mapping[str, float], command: Mapping[str, float]) -> dict[str, float]:
        """Bend [deg], and where it leans at all the angle between its azimuth and that commanded, 0 to 180 deg."""
        bend = float(np.degrees(outcome["bend_angle"]))
        turn = float(np.degrees(outcome["bend_direction"] - command["azimuth"]))
        off = abs((turn + 180.0) % 360.0 - 180.0)
        return {"bend_deg": bend} | ({"off_azimuth_deg": off} if bend >= MIN_LEAN else {})

    def describe(self, outcome: Mapping[str, float], worm: int) -> str:
        """Bend angle, its direction and the one asked for, in degrees."""
        asked = self.commanded["azimuth"][worm] % TAU
        angle, towards, asked = np.degrees([outcome["bend_angle"], outcome["bend_direction"], asked])
        # What leans by less than is printed leans no way.
        way = f"towards {_whole(towards)} deg " if angle >= MIN_LEAN else ""
        return f"bend {angle:.1f} deg {way}(asked: {_whole(asked)} deg)"

    @classmethod
    def gait(cls, lattice: Lattice, layout: MuscleLayout, command: Mapping[str, float]) -> Gait:
        """Vertical muscles towards the commanded azimuth, ring muscles away from it."""
        return bending_gait(lattice, layout, **required_commands(cls.name, command, "azimuth"))

    def _towards(self) -> FloatArray:
        azimuth = self.commanded["azimuth"]
        return np.array([np.cos(azimuth), np.sin(azimuth)]).T

    def command_ranges(self) -> dict[str, Command]:
        """Azimuth to lean towards."""
        return {"azimuth": Command(0.0, TAU, -TAU, TAU, "rad")}


def bending_gait(lattice: Lattice, layout: MuscleLayout, azimuth: float, sharpness: float = 2.0) -> Gait:
    """Shorten the side that faces the azimuth [rad] with vertical muscles, lengthen the other with ring muscles.

    Activation follows the cosine of the angle from the azimuth (rings: from its opposite) times the sharpness, up to 1.
    """
    azimuth = number("azimuth", azimuth, -MAX_NUMBER, MAX_NUMBER, "rad")
    sharpness = number("sharpness", sharpness, 0.0, MAX_NUMBER, "1")
    middle = muscle_middles(lattice, layout)
    facing = np.cos(np.arctan2(middle[:, 1], middle[:, 0]) - azimuth)
    return constant_gait(sharpness * np.where(longitudinal(lattice, layout), facing, -facing))
