"""Grow shorter."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

import numpy as np

from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import MuscleLayout
from lattice_gym.tasks.axial import AxialTask
from lattice_gym.tasks.gait import Gait, constant_gait, longitudinal


@final
class Compression(AxialTask):
    """Grow shorter: the reward is the strain with its sign turned."""

    name = "compression"
    layout = "compression"
    sign = -1.0

    @classmethod
    def gait(cls, lattice: Lattice, layout: MuscleLayout, command: Mapping[str, float]) -> Gait:
        """Every vertical muscle fully active."""
        return constant_gait(np.where(longitudinal(lattice, layout), 1.0, 0.0))
