"""Grow shorter."""

from __future__ import annotations

from typing import final

from lattice_gym.tasks.axial import AxialTask


@final
class Compression(AxialTask):
    """Grow shorter: the reward is the strain with its sign turned."""

    name = "compression"
    layout = "compression"
    sign = -1.0
