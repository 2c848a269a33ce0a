"""PPO on many worms, by its trainer."""

from __future__ import annotations

import lattice_gym  # noqa: F401, registers the ids
