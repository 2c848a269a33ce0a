"""What extension and compression share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.physics.measures import strain
from lattice_gym.physics.state import Motion
from lattice_gym.tasks.base import MAX_STRAIN, RewardTerm, Task, check_base


class AxialTask(Task):
    """Change the body's length: the reward is the strain times a sign."""

    time_limit = 40
    rewards: ClassVar[Mapping[str, RewardTerm]] = {"strain": RewardTerm(1.0, -MAX_STRAIN, MAX_STRAIN)}
    training: ClassVar[Mapping[str, Any]] = {"control": "ring", "gamma": 0.8}
    sign: ClassVar[float]
    """What longer is worth."""

    def prepare(self) -> None:
        """Refuse a free body whose base cannot tell how it is tilted."""
        check_base(self.lattice)

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Strain, positive where it is asked for."""
        return {"strain": self.sign * strain(self.lattice, motion.position)}

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Strain, positive when longer."""
        return {"strain": strain(self.lattice, motion.position)}

    def describe(self, outcome: Mapping[str, float], worm: int) -> str:
        """Strain in per cent."""
        return f"strain {100.0 * outcome['strain']:+.1f} %"
