"""Crawl along +x or -x on the ground."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, final

import numpy as np

from lattice_gym.body.lattice import Lattice
from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.measures import mass_centre, muscle_lengths
from lattice_gym.physics.state import Motion
from lattice_gym.physics.world import World
from lattice_gym.tasks.base import COMMAND_BOUND, WAY_WEIGHT, Command, Task, effort, quotient


@final
class Crawl(Task):
    """Crawl along +x or -x on the ground: the reward is the way the centre of mass went along the commanded direction.

    A free worm lies along x, in water, which is nearly as dense as it is, and moves only by friction. Its rods are
    damped a tenth as much as the default design's: that damping resists every motion, 23 N s/m in all, and at a
    centimetre a second takes more than the 0.13 N that friction can give.
    """

    name = "crawl"
    layout = "all"
    term_names = ("progress", "effort")
    bounds = (1.0, COMMAND_BOUND)
    design: ClassVar[Mapping[str, Any]] = {"base": "free", "damping": 0.003}
    settles = True
    travels = True

    LEAST_WAY: ClassVar[float] = 0.01
    """Way [heights] below which no course and no cost of transport is given."""

    @classmethod
    def surroundings(cls, lattice: Lattice) -> World:
        """Return a ground to lie on in water, which resists as it does a rod at 0.13 m/s.

        Across a flow of speed v a cylinder of diameter D has the drag Cd rho D v^2 / 2 per length, with Cd about 1.5 at
        the Reynolds numbers here: 7.5 v N s/m^2 per speed for the 10 mm of a rod. `Medium` is linear, and has that of
        about 0.13 m/s. Without it the nearly weightless worm can hop, and goes further by trembling at the control rate
        than by crawling.
        """
        return World(medium=Medium(drag=1.0), ground=Ground(), lying=True)

    def _prepare(self) -> None:
        if self.lattice.design.base == "clamped":
            raise ValueError('design.base = "clamped": a worm that crawls must be free')
        if self.model.ground is None:
            raise ValueError("world.ground = None: there is nothing to crawl on")
        if self.model.gravity is None or not self.model.gravity.any():
            raise ValueError("world.medium: has no gravity; a worm that crawls must lie on the ground by its weight")
        body = self.model.rods[0].position
        if not np.allclose(np.diff(body[:, 0]), np.diff(self.lattice.position[0, :, 2])):
            raise ValueError("world.lying = False: a worm that crawls must lie")

    def _blank(self) -> dict[str, FloatArray]:
        length = muscle_lengths(self.model, self.rest.position)
        start = mass_centre(self.model, self.rest.position)
        nothing = np.zeros(())
        moved = {"start": start, "centre": start, "length": length, "activation": 0.0 * length}
        return moved | {"work": nothing, "time": nothing}

    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Commanded direction along x, and how far the body is off course, to +y, in heights."""
        aside = self._way(motion, self.memory["start"])[:, 1]
        return np.array([self.commanded["direction"], np.minimum(np.maximum(aside, -COMMAND_BOUND), COMMAND_BOUND)]).T

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Way along the commanded direction in this step, and effort."""
        centre, length = mass_centre(self.model, motion.position), muscle_lengths(self.model, motion.position)
        before, design = self.memory, self.lattice.design
        way = (centre - before["centre"])[:, 0] * self.commanded["direction"] / design.height
        # Tension is linear in time over the step, so its mean is that of its ends.
        tension = 0.5 * design.max_tension * self.strength * (before["activation"] + activation)
        work = before["work"] + (tension * np.maximum(before["length"] - length, 0.0)).sum(axis=-1)
        self.memory |= {"centre": centre, "length": length, "activation": activation.copy(), "work": work}
        self.memory["time"] = time.copy()
        return {"progress": WAY_WEIGHT * way, "effort": effort(activation)}

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Speed along the command [body lengths a minute], drift off it [rad] and cost of transport, see env.py."""
        start, time, work = (self.memory[name][worms] for name in ("start", "time", "work"))
        way = self._way(motion, start)
        along = way[:, 0] * self.commanded["direction"][worms]
        moved = np.hypot(way[:, 0], way[:, 1]) >= self.LEAST_WAY
        gravity = 0.0 if self.model.gravity is None else float(np.linalg.norm(self.model.gravity))
        haul = float(self.model.node_mass.sum()) * gravity * along * self.lattice.design.height
        return {
            "speed": quotient(60.0 * along, time, time > 0.0),
            "drift": np.where(moved, np.arctan2(np.abs(way[:, 1]), along), 0.0),
            "cost_of_transport": quotient(work, haul, (along >= self.LEAST_WAY) & (haul > 0.0)),
        }

    def _caption(self, outcome: Mapping[str, float], worm: int) -> str:
        """Speed along the command and drift."""
        way = "+x" if self.commanded["direction"][worm] > 0.0 else "-x"
        return (
            f"{outcome['speed']:+.1f} body lengths/min along {way}, {np.degrees(outcome['drift']):.0f} deg off course"
        )

    def _way(self, motion: Motion, start: FloatArray) -> FloatArray:
        """Way of the centre of mass along x and y since the start [heights], shape (n, 2)."""
        way: FloatArray = (mass_centre(self.model, motion.position) - start)[:, :2] / self.lattice.design.height
        return way

    def _commands(self) -> dict[str, Command]:
        return {"direction": Command(-1.0, 1.0, -1.0, 1.0, "1", (-1.0, 1.0))}
