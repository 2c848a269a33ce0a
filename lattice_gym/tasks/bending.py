"""Lean towards a commanded azimuth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

import numpy as np

from lattice_gym.checks import TURN, FloatArray, IntArray
from lattice_gym.physics.measures import azimuth_of, bend_vector, top_sites
from lattice_gym.physics.state import Motion
from lattice_gym.tasks.base import Command, Task, check_base, effort


def _whole(degrees: float) -> int:
    """Whole degrees from 0 to 359."""
    return round(degrees) % 360


@final
class Bending(Task):
    """Lean towards a commanded azimuth: the part of the bend that way counts, the part sideways counts against."""

    name = "bending"
    layout = "all"
    term_names = ("bend", "sideways", "effort")
    bounds = (1.0, 1.0)

    def _prepare(self) -> None:
        top_sites(self.lattice)  # refuses a lattice whose top is no plane
        check_base(self.lattice)

    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Cosine and sine of the commanded azimuth."""
        return self._towards()

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Bend towards the commanded azimuth, sideways bend and effort."""
        x, y = bend_vector(self.lattice, motion.position).T
        cos, sin = self._towards().T
        return {"bend": x * cos + y * sin, "sideways": -np.abs(y * cos - x * sin), "effort": effort(activation)}

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Bend angle and its direction [rad]."""
        bend = bend_vector(self.lattice, motion.position)
        return {"bend_angle": np.hypot(bend[:, 0], bend[:, 1]), "bend_direction": azimuth_of(bend)}

    def _caption(self, outcome: Mapping[str, float], worm: int) -> str:
        """Bend angle, its direction and the one asked for, in degrees."""
        asked = self.commanded["azimuth"][worm] % TURN
        angle, towards, asked = np.degrees([outcome["bend_angle"], outcome["bend_direction"], asked])
        # What leans by less than is printed leans no way.
        way = f"towards {_whole(towards)} deg " if angle >= 0.05 else ""
        return f"bend {angle:.1f} deg {way}(asked: {_whole(asked)} deg)"

    def _towards(self) -> FloatArray:
        azimuth = self.commanded["azimuth"]
        return np.array([np.cos(azimuth), np.sin(azimuth)]).T

    def _commands(self) -> dict[str, Command]:
        return {"azimuth": Command(0.0, TURN, -TURN, TURN, "rad")}
