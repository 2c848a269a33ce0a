"""What is observed of worms: from their motion to numbers of order one within finite bounds."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from lattice_gym.body.lattice import Lattice
from lattice_gym.checks import TURN, FloatArray, IntArray
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.adaptation import Adaptation
from lattice_gym.physics.state import Motion
from lattice_gym.tasks.base import COMMAND_BOUND, GoalTask, Task

Observation = Any
"""An array; of a worm with goals a dict of three."""

OBSERVATIONS = ("sites", "nodes")

POSITION_SCALE = 0.2
"""Displacements are observed in units of this share of the height."""
VELOCITY_SCALE = 1.0
"""Velocities are observed in units of this many heights a second."""
OBSERVATION_BOUND = 20.0
"""Bound of observed displacements and velocities, several times what the default design reaches."""


class Observer:
    """Observes worms side by side; what an observation holds says `LatticeWormEnv`.

    Parameters
    ----------
    model
        The assembly that moves.
    task
        What is asked of them; displacements count from its `rest`.
    n_action
        Number of control groups.
    points
        "sites" or "nodes".
    rhythm
        Frequency of the clock [Hz]; None: no clock.
    adaptation
        How strength changes, if that is observed.
    goals
        Whether goals are observed apart; for a `GoalTask`.

    """

    def __init__(
        self,
        model: RodModel,
        task: Task,
        n_action: int,
        points: str,
        rhythm: float | None,
        adaptation: Adaptation | None,
        goals: bool,
    ) -> None:
        self._task, self._rhythm, self._goals = task, rhythm, task if goals and isinstance(task, GoalTask) else None
        self._nodes = _observed_nodes(model, task.lattice, points).T
        self._rest = self._sum(task.rest.position)
        self._strength = adaptation is not None and adaptation.observed
        height = task.lattice.design.height
        # Of sums over the nodes of a point, which are one or two, so that nothing is rounded by it.
        self._scale = len(self._nodes) * height * np.array([POSITION_SCALE, VELOCITY_SCALE])[:, None, None]
        strongest = adaptation.most if adaptation is not None and adaptation.observed else 0.0
        self.space = self._space(n_action, model.n_muscle if self._strength else 0, strongest)

    def __call__(
        self, motion: Motion, activation: FloatArray, time: FloatArray, strength: FloatArray | None
    ) -> tuple[Observation, IntArray]:
        """Observations of all worms, and how many displacements and velocities of each lay beyond their bound.

        Parameters
        ----------
        motion
            Of all worms.
        activation
            Of every control group, shape (n_worm, n_action).
        time
            Since the start of each worm's episode [s], shape (n_worm,).
        strength
            Of every muscle, shape (n_worm, n_muscle); None: that of the design.

        """
        moving, beyond = self._moving(motion)
        parts = [moving, activation]
        if self._goals is None:
            parts.append(self._task.observe(motion, time))
        if self._rhythm is not None:
            angle = TURN * self._rhythm * time
            parts.append(np.array([np.cos(angle), np.sin(angle)]).T)
        if self._strength and strength is not None:
            parts.append(strength)
        flat = np.concatenate(parts, axis=-1, dtype=np.float32)
        if self._goals is None:
            return flat, beyond
        goals = {"achieved_goal": self._goals.achieved(motion), "desired_goal": self._goals.desired()}
        return {"observation": flat, **goals}, beyond

    def _moving(self, motion: Motion) -> tuple[FloatArray, IntArray]:
        """Scaled displacements and velocities, shape (n_worm, 6 n_point), and how many of each worm were clipped."""
        moving = np.empty((len(motion.position), 2, *self._rest.shape))
        displacement = np.subtract(self._sum(motion.position), self._rest, out=moving[:, 0])
        if self._task.travels:
            for along in (displacement[..., 0], displacement[..., 1]):
                along -= along.mean(axis=-1, keepdims=True)
        moving[:, 1] = self._sum(motion.velocity)
        moving /= self._scale
        free = moving.reshape(len(moving), -1)
        if np.abs(free).max(initial=0.0) <= OBSERVATION_BOUND:
            return free, np.zeros(len(free), dtype=np.int64)
        bounded = np.minimum(np.maximum(free, -OBSERVATION_BOUND), OBSERVATION_BOUND)
        return bounded, (bounded != free).sum(axis=-1)

    def _sum(self, values: FloatArray) -> FloatArray:
        """Sum of the values at the nodes of each observed point, shape (..., n_point, 3)."""
        first, *others = self._nodes
        total: FloatArray = values.take(first, axis=-2)
        for other in others:
            total += values.take(other, axis=-2)
        return total

    def _space(self, n_action: int, n_strength: int, strongest: float) -> spaces.Space[Any]:
        n_moving = 2 * self._rest.size
        commanded = self._task.bounds if self._goals is None else ()
        bounds = np.array(commanded + (() if self._rhythm is None else (1.0, 1.0)))
        most = np.full(n_strength, strongest)
        high = np.concatenate([np.full(n_moving, OBSERVATION_BOUND), np.ones(n_action), bounds, most])
        low = np.concatenate([np.full(n_moving, -OBSERVATION_BOUND), np.zeros(n_action), -bounds, 0.0 * most])
        flat = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
        if self._goals is None:
            return flat
        goal = spaces.Box(-COMMAND_BOUND, COMMAND_BOUND, (self._goals.n_goal,), np.float32)
        return spaces.Dict({"observation": flat, "achieved_goal": goal, "desired_goal": goal})


def _observed_nodes(model: RodModel, lattice: Lattice, points: str) -> npt.NDArray[np.int64]:
    """Rows of the nodes whose mean is an observed point, shape (n_point, 1 or 2); none that a clamp holds."""
    nodes = lattice.site_nodes if points == "sites" else np.arange(lattice.n_rod * lattice.n_node)[:, None]
    held = [model.node_offset[clamp.rod] + clamp.node for clamp in model.clamps if clamp.node is not None]
    return nodes[~np.isin(nodes, held).any(axis=1)]
