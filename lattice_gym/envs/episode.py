"""Episodes of worms side by side: all that lies between actions, observations and rewards but the physics."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from lattice_gym.body.design import LatticeDesign
from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.envs.observation import Observation, Observer
from lattice_gym.envs.randomisation import Factors, Randomisation, pull
from lattice_gym.physics.laws.activation import followed
from lattice_gym.physics.laws.adaptation import Adaptation
from lattice_gym.physics.measures import muscle_strain
from lattice_gym.physics.state import Motion
from lattice_gym.tasks.base import DIVERGENCE, Task


class Episodes:
    """One episode of each of several worms, which begin and end apart but step together.

    Parameters
    ----------
    task
        What is asked of the worms.
    observer
        What is observed of them.
    design
        Of their bodies.
    groups
        Control group of every muscle, shape (n_muscle,).
    adaptation
        How use changes the strength of muscles; None: not at all.
    randomisation
        Factors that are drawn for every episode; None: none.

    """

    def __init__(
        self,
        task: Task,
        observer: Observer,
        design: LatticeDesign,
        groups: IntArray,
        adaptation: Adaptation | None,
        randomisation: Randomisation | None,
    ) -> None:
        self.task, self.observer, self._design, self._groups = task, observer, design, groups
        self._adaptation, self._randomisation = adaptation, randomisation
        n_worm = task.n_worm
        self.activation = np.zeros((n_worm, int(groups.max()) + 1))
        """Of every control group, shape (n_worm, n_action)."""
        self.n_step = np.zeros(n_worm, dtype=np.int64)
        """Control steps since each episode began, shape (n_worm,)."""
        self.trained = None if adaptation is None else adaptation.untrained((n_worm, len(groups)))
        """Strength by use of every muscle; None without an adaptation."""
        self._pull = None if randomisation is None else np.ones((n_worm, len(groups)))
        self._left = [math.exp(-task.control_dt / time) for time in (design.rise_time, design.decay_time)]
        self._next, self._tension = self.activation, np.zeros((2, n_worm, len(groups)))

    @property
    def time(self) -> FloatArray:
        """Time since each episode began [s], shape (n_worm,)."""
        return np.asarray(self.n_step * self.task.control_dt, dtype=np.float64)

    @property
    def strength(self) -> FloatArray | None:
        """Strength by use of every muscle over the design's, shape (n_worm, n_muscle); None without an adaptation."""
        return None if self.trained is None else self.trained.factor

    def begin(self, rng: np.random.Generator, options: Mapping[str, object] | None, worm: int = 0) -> Factors:
        """Begin an episode of one worm, and return the factors drawn for it; its engine is to take them over."""
        self.task.begin(rng, options, worm)
        self.activation[worm] = 0.0
        self.n_step[worm] = 0
        if self._adaptation is not None and self.trained is not None:
            one = np.arange(self.task.n_worm) == worm
            begun = self._adaptation.begun(self.trained.row(worm))
            self.trained = self.trained.where(one, begun)
        if self._randomisation is None or self._pull is None:
            return {}
        factors = self._randomisation.draw(rng, len(self._groups))
        self._pull[worm] = pull(factors)
        return factors

    def tension(self, command: FloatArray) -> FloatArray:
        """Tension of every muscle at the start and at the end of a control step [N], shape (2, n_worm, n_muscle).

        Commands lie in [0, 1], one a control group, shape (n_worm, n_action).
        """
        design, before = self._design, self.activation
        self._next = followed(before, command, *self._left)
        tension = design.max_tension * np.array([before, self._next]).take(self._groups, axis=-1)
        factors = [factor for factor in (self.strength, self._pull) if factor is not None]
        if factors:
            self.task.strength = math.prod(factors[1:], start=factors[0])
            tension *= self.task.strength
        self._tension = tension
        return tension

    def score(
        self, motion: Motion, sound: npt.NDArray[np.bool_]
    ) -> tuple[dict[str, FloatArray], npt.NDArray[np.bool_]]:
        """Reward terms of the control step that ends, shape (n_worm,) each, and which episodes are over.

        Of worms that are not sound, whose physics failed and whose motion is that of the last sound moment, nothing
        changes: all that they earn is the penalty.
        """
        whole = bool(sound.all())
        lost = None if whole else np.flatnonzero(~sound)
        memory = {} if lost is None else self.task.remembered(lost)
        before, after = self.activation, self._next
        self.activation = after if whole else np.where(sound[:, None], after, before)
        self.n_step += sound
        if self._adaptation is not None and self.trained is not None:
            active, strain = 0.5 * (before + after)[:, self._groups], muscle_strain(self.task.model, motion.position)
            used = self._adaptation.used(self.trained, active, self._tension.mean(axis=0), strain, self.task.control_dt)
            self.trained = self.trained.where(sound, used)
        terms = self.task.reward_terms(motion, self.activation.take(self._groups, axis=-1), self.time)
        terms[DIVERGENCE] = np.zeros(len(sound))
        if lost is not None:
            self.task.remind(lost, memory)
            for name, values in terms.items():
                values[lost] = -self.task.penalty if name == DIVERGENCE else 0.0
        return terms, ~sound | self.task.over(motion)

    def observe(self, motion: Motion) -> tuple[Observation, IntArray]:
        """Observations of all worms, and how many numbers of each were clipped; see `Observer`."""
        return self.observer(motion, self.activation, self.time, self.strength)
