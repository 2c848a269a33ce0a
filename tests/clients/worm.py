"""The short worm that every client is run on."""

from __future__ import annotations

from typing import Any

ID = "LatticeWormExtension-v0"
N_STEP = 8
"""Steps of an episode."""
EXTENSION: dict[str, Any] = {"control": "ring", "fidelity": "fast", "max_episode_steps": N_STEP}
