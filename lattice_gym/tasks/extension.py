"""Grow longer."""

from __future__ import annotations

from typing import final

from lattice_gym.tasks.axial import AxialTask


@final
class Extension(AxialTask):
    """Grow longer: the reward is the strain."""

    name = "extension"
    layout = "extension"
    sign = 1.0
