"""Observation terms: each one named part of what is observed, with its size, unit and bounds.

The docstring of a term's class says what it is; tables for readers are made from it.
"""
# ruff: noqa: D102, as the docstring of a class says what its call gives

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar, final

import numpy as np

from lattice_gym.checks import TAU, FloatArray, IntArray
from lattice_gym.physics.laws.elasticity import MAX_DILATATION
from lattice_gym.physics.measures import base_centre, ring_radii
from lattice_gym.tasks.registry import TASKS

if TYPE_CHECKING:
    from lattice_gym.envs.core import Worms
    from lattice_gym.envs.scene import Scene

DISPLACEMENT_SCALE = 0.2
"""Displacements are observed in units of this share of the height."""
MOTION_BOUND = 20.0
"""Bound of displacements, velocities and rates, several times what the default design reaches."""
RADIUS_BOUND = 10.0
"""Bound of a ring's radius over that at rest."""


class ObservationTerm(ABC):
    """A named part of an observation; a subclass from anywhere may be observed, see `LatticeWormEnv`.

    Parameters
    ----------
    scene
        Body, muscles, world and task, before anything moves. A ValueError says what of it is missing.

    """

    name: ClassVar[str]
    """As in `LatticeWormEnv(observation=[...])`."""
    unit: ClassVar[str] = "1"
    """What its numbers are given in."""
    stays_within: bool = False
    """Whether its numbers can never leave their bounds; of any other term those that do are clipped and counted."""
    low: FloatArray
    """Least value of every number, shape (size,); of the class, or set by `__init__`, as `high` is."""
    high: FloatArray
    """Largest value of every number, shape (size,)."""

    def __init__(self, scene: Scene) -> None:  # noqa: B027, some need nothing of it
        """Set `low` and `high` where they depend on the scene."""

    @abstractmethod
    def __call__(self, worms: Worms) -> FloatArray:
        """Return its numbers now, shape (n_worm, size); nothing of the worms may be written to."""

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return len(self.high)

    def _bound(self, size: int, low: float, high: float) -> None:
        """Give all of its numbers the same bounds."""
        self.low, self.high = np.full(size, low), np.full(size, high)


class _Points(ObservationTerm):
    """Displacements from rest of points of the body, then their velocities; without those that the base holds."""

    unit = "0.2 body lengths; body lengths / s"

    def __init__(self, scene: Scene) -> None:
        points = self._points(scene)
        self._nodes = points[~np.isin(points, scene.model.clamped_nodes[0]).any(axis=1)].T
        self._rest, self._travels = self._sum(scene.start.position), scene.task_class.travels
        # Of sums over the nodes of a point, which are one or two, so that nothing is rounded by it.
        scale = len(self._nodes) * scene.design.height
        self._scale = scale * np.array([DISPLACEMENT_SCALE, 1.0])[:, None, None]
        self._bound(2 * self._rest.size, -MOTION_BOUND, MOTION_BOUND)

    def __call__(self, worms: Worms) -> FloatArray:
        motion = worms.motion
        moving = np.empty((len(motion.position), 2, *self._rest.shape))
        displacement = np.subtract(self._sum(motion.position), self._rest, out=moving[:, 0])
        if self._travels:
            for along in (displacement[..., 0], displacement[..., 1]):
                along -= along.mean(axis=-1, keepdims=True)
        moving[:, 1] = self._sum(motion.velocity)
        moving /= self._scale
        return moving.reshape(len(moving), -1)

    def _sum(self, values: FloatArray) -> FloatArray:
        """Sum of the values at the nodes of each point, shape (..., n_point, 3)."""
        first, *others = self._nodes
        total: FloatArray = values.take(first, axis=-2)
        for other in others:
            total += values.take(other, axis=-2)
        return total

    @staticmethod
    @abstractmethod
    def _points(scene: Scene) -> IntArray:
        """Nodes whose mean is a point, shape (n_point, 1 or 2)."""


@final
class Sites(_Points):
    """Displacement from rest of every site (x, y, z), then velocity of each; none that the base holds."""

    name = "sites"

    @staticmethod
    def _points(scene: Scene) -> IntArray:
        return scene.lattice.site_nodes


@final
class Nodes(_Points):
    """The same of every node of the structure rods."""

    name = "nodes"

    @staticmethod
    def _points(scene: Scene) -> IntArray:
        return np.arange(scene.lattice.n_rod * scene.lattice.n_node)[:, None]


@final
class Activation(ObservationTerm):
    """Activation of each control group: its muscles share one."""

    name = "activation"
    stays_within = True

    def __init__(self, scene: Scene) -> None:
        self._bound(scene.n_group, 0.0, 1.0)

    def __call__(self, worms: Worms) -> FloatArray:
        return worms.group_activation


@final
class Command(ObservationTerm):
    """What the task commands, see `LatticeWormEnv`."""

    name = "command"

    def __init__(self, scene: Scene) -> None:
        if scene.goals_apart:
            raise ValueError('observation: "command" is observed apart, as "desired_goal"; leave it out')
        # Tasks of the package clip what they tell themselves; that of any other task is checked.
        self.stays_within = TASKS.get(scene.task_class.name) is scene.task_class
        self.high = np.array(scene.task_class.bounds, dtype=np.float64)
        self.low = -self.high

    def __call__(self, worms: Worms) -> FloatArray:
        told = worms.task.observe(worms.motion, worms.sound_time)
        if not self.stays_within and np.shape(told) != (worms.n_worm, self.size):
            raise ValueError(
                f"{type(worms.task).__name__}.observe gave shape {np.shape(told)}: must give (n_worm, len(bounds)) = "
                f"{(worms.n_worm, self.size)}; bounds = {worms.task.bounds}"
            )
        return told


@final
class Clock(ObservationTerm):
    """Cosine and sine of a clock of frequency `rhythm` that starts with the episode."""

    name = "clock"
    stays_within = True

    def __init__(self, scene: Scene) -> None:
        if scene.rhythm is None:
            raise ValueError('observation: "clock" needs a rhythm; give its frequency as rhythm [Hz]')
        self._rhythm = scene.rhythm
        self._bound(2, -1.0, 1.0)

    def __call__(self, worms: Worms) -> FloatArray:
        angle = TAU * self._rhythm * worms.sound_time
        return np.array([np.cos(angle), np.sin(angle)]).T


@final
class Strength(ObservationTerm):
    """Strength of each muscle by its use, needs `adaptation`."""

    name = "strength"
    unit = "that of the design"
    stays_within = True

    def __init__(self, scene: Scene) -> None:
        if scene.adaptation is None:
            raise ValueError('observation: "strength" needs an adaptation; without one it is 1')
        self._bound(scene.model.n_muscle, 0.0, scene.adaptation.max_strength)

    def __call__(self, worms: Worms) -> FloatArray:
        return worms.strength


@final
class MuscleLengths(ObservationTerm):
    """Length of each muscle."""

    name = "muscle_lengths"
    unit = "its length at rest"

    def __init__(self, scene: Scene) -> None:
        self._rest = scene.model.muscle_rest_length
        self._bound(scene.model.n_muscle, 0.0, MAX_DILATATION)

    def __call__(self, worms: Worms) -> FloatArray:
        return worms.measures.muscle_lengths / self._rest


@final
class MuscleRates(ObservationTerm):
    """How fast each muscle grows longer."""

    name = "muscle_rates"
    unit = "its length at rest / s"

    def __init__(self, scene: Scene) -> None:
        self._rest = scene.model.muscle_rest_length
        self._bound(scene.model.n_muscle, -MOTION_BOUND, MOTION_BOUND)

    def __call__(self, worms: Worms) -> FloatArray:
        return worms.measures.muscle_rates / self._rest


@final
class RingRadii(ObservationTerm):
    """Mean radius of the ring of sites at each level."""

    name = "ring_radii"
    unit = "that at rest"

    def __init__(self, scene: Scene) -> None:
        if scene.lattice.n_level == 0:
            raise ValueError('observation: "ring_radii" needs levels, and a lattice with uneven phases has none')
        self._rest = ring_radii(scene.lattice, scene.lattice.position.reshape(-1, 3))
        self._bound(len(self._rest), 0.0, RADIUS_BOUND)

    def __call__(self, worms: Worms) -> FloatArray:
        over_rest: FloatArray = worms.measures.ring_radii / self._rest
        return over_rest


@final
class BodyFrame(ObservationTerm):
    """Pose and velocity of the top: centre from the base's, unit normal, velocity (x, y, z each).

    Those of a free base come first: centre from where episodes start, unit normal, velocity.
    """

    name = "body_frame"
    unit = "body lengths; 1; body lengths / s"

    def __init__(self, scene: Scene) -> None:
        lattice, rest = scene.lattice, scene.start.position
        self._height, self._free = scene.design.height, scene.design.base == "free"
        self._start = base_centre(lattice, rest)
        one = np.repeat([MOTION_BOUND, 1.0, MOTION_BOUND], 3)
        self.high = np.tile(one, 2 if self._free else 1)
        self.low = -self.high

    def __call__(self, worms: Worms) -> FloatArray:
        measures, height = worms.measures, self._height
        base = measures.base_centre
        parts = [(measures.top_centre - base) / height, measures.top_normal, measures.top_velocity / height]
        if self._free:
            axes = measures.base_frame
            parts = [(base - self._start) / height, axes[..., 2, :], measures.base_velocity / height, *parts]
        return np.concatenate(parts, axis=-1)


@final
class GroundContact(ObservationTerm):
    """1 for each site of which a node touches the ground, else 0; needs `world.ground`."""

    name = "ground_contact"
    stays_within = True

    def __init__(self, scene: Scene) -> None:
        if scene.model.ground is None:
            raise ValueError('observation: "ground_contact" needs a ground; give world={"ground": {}}')
        self._nodes = scene.lattice.site_nodes
        self._radius = scene.model.node_radius[self._nodes]
        self._bound(len(self._nodes), 0.0, 1.0)

    def __call__(self, worms: Worms) -> FloatArray:
        touches = worms.motion.position[:, self._nodes, 2] < self._radius
        return np.asarray(touches.any(axis=-1), dtype=np.float64)


@final
class PreviousAction(ObservationTerm):
    """Last command of each control group, as clipped, 0 at the start; from 0 to 1 whatever the range of actions."""

    name = "previous_action"
    stays_within = True

    def __init__(self, scene: Scene) -> None:
        self._bound(scene.n_group, 0.0, 1.0)

    def __call__(self, worms: Worms) -> FloatArray:
        return worms.previous_action


TERMS: dict[str, type[ObservationTerm]] = {
    term.name: term
    for term in (
        Sites, Nodes, Activation, Command, Clock, Strength, MuscleLengths, MuscleRates, RingRadii, BodyFrame,
        GroundContact, PreviousAction,
    )
}  # fmt: skip
"""Every term of the package by name."""
