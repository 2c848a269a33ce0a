"""What extension and compression share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.physics.measures import strain
from lattice_gym.physics.state import Motion
from lattice_gym.tasks.base import Command, Task, check_base, effort


class AxialTask(Task):
    """Change the body's length: the reward is the strain times a sign."""

    term_names = ("strain", "effort")
    sign: ClassVar[float]
    """What longer is worth."""

    def _prepare(self) -> None:
        check_base(self.lattice)

    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Nothing is commanded."""
        return np.empty((self.n_worm, 0))

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Strain, positive where it is asked for, and effort."""
        return {"strain": self.sign * strain(self.lattice, motion.position), "effort": effort(activation)}

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Strain, positive when longer."""
        return {"strain": strain(self.lattice, motion.position)}

    def _caption(self, outcome: Mapping[str, float], worm: int) -> str:
        """Strain in per cent."""
        return f"strain {100.0 * outcome['strain']:+.1f} %"

    def _commands(self) -> dict[str, Command]:
        return {}
