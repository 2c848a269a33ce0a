"""Crawl along +x or -x on the ground."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, final

import numpy as np

from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import MuscleLayout
from lattice_gym.checks import TAU, FloatArray, IntArray, invalid_value, number
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.measures import mass_centre, muscle_lengths
from lattice_gym.physics.state import Motion
from lattice_gym.physics.world import World
from lattice_gym.tasks.base import COMMAND_BOUND, Command, RewardTerm, Task, quotient
from lattice_gym.tasks.gait import MAX_NUMBER, MIN_NUMBER, Gait, longitudinal, muscle_middles, required_commands

CRAWL_FREQUENCY, CRAWL_WAVELENGTH = 1.0, 1.0
"""Of the crawling wave [Hz], [body lengths]: the best of wavelengths from 0.6 to 2; at 2 Hz it is a quarter faster."""


@final
class Crawl(Task):
    """Crawl along +x or -x on the ground: the reward is the way the centre of mass went along the commanded direction.

    A free worm lies along x, in water, which is nearly as dense as it is, and moves only by friction. Its rods are
    damped a tenth as much as the default design's: that damping resists every motion, 23 N s/m in all, and at a
    centimetre a second takes more than the 0.13 N that friction can give.
    """

    name = "crawl"
    layout = "all"
    time_limit = 200
    # 10 for a body length: the hand-made gait earns ten times what its effort costs. Nothing crawls two body lengths a
    # second, twenty times as fast as the gait at 3 Hz.
    rewards: ClassVar[Mapping[str, RewardTerm]] = {"progress": RewardTerm(10.0, -0.1, 0.1)}
    # Strokes last longer than the five steps that a discount of 0.8 looks ahead.
    training: ClassVar[Mapping[str, Any]] = {"control": "ring", "gamma": 0.95}
    bounds = (1.0, COMMAND_BOUND)
    design: ClassVar[Mapping[str, Any]] = {"base": "free", "damping": 0.003}
    settles = True
    travels = True

    MIN_DISTANCE: ClassVar[float] = 0.01
    """Way [body lengths] below which no course and no cost of transport is given."""

    @classmethod
    def world(cls, lattice: Lattice) -> World:
        """Return a ground to lie on in water, which resists as it does a rod at 0.13 m/s.

        Across a flow of speed v a cylinder of diameter D has the drag Cd rho D v^2 / 2 per length, with Cd about 1.5 at
        the Reynolds numbers here: 7.5 v N s/m^2 per speed for the 10 mm of a rod. `Medium` is linear, and has that of
        about 0.13 m/s. Without it the nearly weightless worm can hop, and goes further by trembling at the control rate
        than by crawling.
        """
        return World(medium=Medium(drag=1.0), ground=Ground(), lying=True)

    def prepare(self) -> None:
        """Refuse a body that is clamped or does not lie on the ground by its weight."""
        if self.lattice.design.base == "clamped":
            raise ValueError('design.base = "clamped": a worm that crawls must be free')
        if self.model.ground is None:
            raise ValueError("world.ground = None: there is nothing to crawl on")
        if self.model.gravity is None or not self.model.gravity.any():
            raise ValueError("world.medium: has no gravity; a worm that crawls must lie on the ground by its weight")
        body = self.model.rods[0].position
        if not np.allclose(np.diff(body[:, 0]), np.diff(self.lattice.position[0, :, 2])):
            raise ValueError("world.lying = False: a worm that crawls must lie")

    def initial_memory(self) -> dict[str, FloatArray]:
        """Where it started and is, its way in the last step, what its muscles have done, and when that was."""
        length = muscle_lengths(self.model, self.rest.position)
        start = mass_centre(self.model, self.rest.position)
        nothing = np.zeros(())
        moved = {"start": start, "centre": start, "length": length, "activation": 0.0 * length}
        return moved | {"way": nothing, "work": nothing, "time": nothing}

    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Commanded direction along x, and how far the body is off course, to +y, in body lengths."""
        aside = self._displacement(motion, self.memory["start"])[:, 1]
        return np.array([self.commanded["direction"], np.minimum(np.maximum(aside, -COMMAND_BOUND), COMMAND_BOUND)]).T

    def remember(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Way along the commanded direction in this step [body lengths], and the work of the muscles so far [J]."""
        centre, length = mass_centre(self.model, motion.position), muscle_lengths(self.model, motion.position)
        before, design = self.memory, self.lattice.design
        way = (centre - before["centre"])[:, 0] * self.commanded["direction"] / design.height
        # Tension is linear in time over the step, so its mean is that of its ends.
        tension = 0.5 * design.max_tension * self.strength * (before["activation"] + activation)
        work = before["work"] + (tension * np.maximum(before["length"] - length, 0.0)).sum(axis=-1)
        return {"centre": centre, "way": way, "length": length, "activation": activation, "work": work, "time": time}

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Way along the commanded direction in this step [body lengths]."""
        return {"progress": self.memory["way"]}

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Speed along the command [body lengths a minute], drift off it [rad], cost of transport.

        `LatticeWormEnv` says what that is.
        """
        start, time, work = (self.memory[name][worms] for name in ("start", "time", "work"))
        way = self._displacement(motion, start)
        along = way[:, 0] * self.commanded["direction"][worms]
        moved = np.hypot(way[:, 0], way[:, 1]) >= self.MIN_DISTANCE
        gravity = 0.0 if self.model.gravity is None else float(np.linalg.norm(self.model.gravity))
        haul = float(self.model.node_mass.sum()) * gravity * along * self.lattice.design.height
        return {
            "speed": quotient(60.0 * along, time, time > 0.0),
            "drift": np.where(moved, np.arctan2(np.abs(way[:, 1]), along), 0.0),
            "cost_of_transport": quotient(work, haul, (along >= self.MIN_DISTANCE) & (haul > 0.0)),
        }

    @classmethod
    def errors(cls, outcome: Mapping[str, float], command: Mapping[str, float]) -> dict[str, float]:
        """Speed [body lengths a minute], drift [deg], and cost of transport where it went along the command at all."""
        cost = {name: value for name, value in outcome.items() if name == "cost_of_transport" and value > 0.0}
        return {"speed": outcome["speed"], "drift_deg": float(np.degrees(outcome["drift"]))} | cost

    def describe(self, outcome: Mapping[str, float], worm: int) -> str:
        """Speed along the command and drift."""
        way = "+x" if self.commanded["direction"][worm] > 0.0 else "-x"
        return (
            f"{outcome['speed']:+.1f} body lengths/min along {way}, {np.degrees(outcome['drift']):.0f} deg off course"
        )

    @classmethod
    def gait(cls, lattice: Lattice, layout: MuscleLayout, command: Mapping[str, float]) -> Gait:
        """Peristaltic wave that runs against the commanded direction."""
        return crawling_gait(lattice, layout, **required_commands(cls.name, command, "direction"))

    def _displacement(self, motion: Motion, start: FloatArray) -> FloatArray:
        """Way of the centre of mass along x and y since the start [body lengths], shape (n, 2)."""
        way: FloatArray = (mass_centre(self.model, motion.position) - start)[:, :2] / self.lattice.design.height
        return way

    def command_ranges(self) -> dict[str, Command]:
        """Direction along x."""
        return {"direction": Command(-1.0, 1.0, -1.0, 1.0, "1", (-1.0, 1.0))}


def crawling_gait(
    lattice: Lattice,
    layout: MuscleLayout,
    direction: float,
    frequency: float = CRAWL_FREQUENCY,
    wavelength: float = CRAWL_WAVELENGTH,
    ring_share: float = 1.0,
) -> Gait:
    """Rings and vertical muscles in antiphase, as a wave that runs along the body against the direction it crawls in.

    Where vertical muscles contract the body is thick and stands, where rings do it is thin and moves on, as in an
    earthworm. The direction is +1 towards the top end, -1 towards the base; the frequency in Hz, the wavelength in
    heights.
    """
    direction = number("direction", direction, -MAX_NUMBER, MAX_NUMBER, "1")
    frequency = number("frequency", frequency, MIN_NUMBER, MAX_NUMBER, "Hz")
    wavelength = number("wavelength", wavelength, MIN_NUMBER, MAX_NUMBER, "body lengths")
    ring_share = number("ring_share", ring_share, 0.0, MAX_NUMBER, "1")
    if direction == 0.0:
        raise invalid_value("direction", direction, "must not be 0")
    along, height = longitudinal(lattice, layout), muscle_middles(lattice, layout)[:, 2]
    drive = 0.5 * np.where(along, 1.0, ring_share)
    return Gait(
        offset=drive,
        swing=np.where(along, drive, -drive),
        phase=TAU * height / (wavelength * lattice.design.height),
        frequency=-float(np.sign(direction)) * frequency,
    )
