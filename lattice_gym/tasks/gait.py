"""Open-loop gaits: activations over time, and what those of the tasks share.

A task's own gait stands in its file. Gaits are baselines and starting points, not optima: each follows from one idea
about the body, and its few numbers were read from the default design.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import MuscleLayout
from lattice_gym.checks import (
    REQUIRED,
    TAU,
    FloatArray,
    IntArray,
    Parameters,
    array,
    checked,
    invalid_value,
    number,
    real,
)

LEAD = 0.07
"""Lead of a gait over the commanded wave [s]: commands are constant within a control step, and muscles lag behind."""
MIN_NUMBER, MAX_NUMBER = 1e-9, 1e9
"""Sizes that the numbers of a gait lie between, wide enough for any body in SI units; some may also be 0."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Gait(Parameters):
    """A wave of muscle commands: ``offset + swing cos(2 pi frequency (t + lead) - phase)``, clipped to [0, 1].

    Called with a time [s] it returns the command of every active muscle, shape (n_muscle,).
    """

    offset: FloatArray = checked(REQUIRED, array, shape=("n_muscle",))
    """Mean command of each muscle, shape (n_muscle,)."""
    swing: FloatArray = checked(REQUIRED, array, shape=("n_muscle",))
    """Amplitude of each muscle's command, shape (n_muscle,)."""
    phase: FloatArray = checked(REQUIRED, array, shape=("n_muscle",), unit="rad")
    """Lag of each muscle [rad], shape (n_muscle,)."""
    frequency: float = real(0.0, -MAX_NUMBER, MAX_NUMBER, "Hz")
    """Cycles a second [Hz]; negative runs the wave backwards."""
    lead: float = real(LEAD, -MAX_NUMBER, MAX_NUMBER, "s")
    """Time by which the commands run ahead [s]."""

    def __call__(self, time: float) -> FloatArray:
        """Commands at a time [s], shape (n_muscle,), in [0, 1]."""
        angle = TAU * self.frequency * (number("time", time, -MAX_NUMBER, MAX_NUMBER, "s") + self.lead)
        command: FloatArray = np.clip(self.offset + self.swing * np.cos(angle - self.phase), 0.0, 1.0)
        return command


def group_means(command: FloatArray, groups: IntArray) -> FloatArray:
    """Turn commands of muscles into those of control groups: their means, shape (n_group,).

    `command` and `groups` have shape (n_muscle,), the latter as in `env.unwrapped.groups`. With the default
    `action_range` that is the action; `env.unwrapped.action_of` gives the action of any other.
    """
    if np.shape(command) != np.shape(groups) or np.ndim(groups) != 1:
        raise ValueError(f"command has shape {np.shape(command)}: must be one a muscle, {np.shape(groups)}")
    mean: FloatArray = np.bincount(groups, command) / np.bincount(groups)
    return mean


def constant_gait(offset: FloatArray) -> Gait:
    """Gait that holds every muscle, shape (n_muscle,), clipped to [0, 1]."""
    return Gait(offset=offset, swing=np.zeros_like(offset), phase=np.zeros_like(offset))


def _ends(lattice: Lattice, layout: MuscleLayout) -> tuple[FloatArray, FloatArray]:
    active = layout.active
    sites = np.array([(muscle.start, muscle.end) for muscle in active], dtype=np.int64).reshape(-1, 2)
    return lattice.site_position[sites[:, 0]], lattice.site_position[sites[:, 1]]


def muscle_middles(lattice: Lattice, layout: MuscleLayout) -> FloatArray:
    """Rest position of every active muscle's middle [m], shape (n_muscle, 3)."""
    start, end = _ends(lattice, layout)
    return 0.5 * (start + end)


def longitudinal(lattice: Lattice, layout: MuscleLayout) -> npt.NDArray[np.bool_]:
    """Mask of the active muscles that run along the body rather than around it, ones tied by hand included."""
    start, end = _ends(lattice, layout)
    along = end - start
    return np.asarray(np.abs(along[:, 2]) > np.hypot(along[:, 0], along[:, 1]))


def required_commands(task: str, command: Mapping[str, float], *names: str) -> dict[str, float]:
    """Return those commanded numbers that a gait needs; a ValueError names what is missing."""
    if not isinstance(command, Mapping):
        raise invalid_value("command", command, "must be a mapping of names to numbers")
    missing = [name for name in names if name not in command]
    if missing:
        raise ValueError(f"command: {task} needs {', '.join(names)}; missing {', '.join(missing)}")
    return {name: command[name] for name in names}
