"""Gymnasium environments of a lattice worm made of Cosserat rods.

Importing it registers `LatticeWorm-v0`, `LatticeWormExtension-v0`, `LatticeWormCompression-v0`, `LatticeWormBending-v0`
and `LatticeWormPeristalsis-v0`; `LatticeWormEnv` is their specification.
"""

from __future__ import annotations

from gymnasium.envs.registration import register

from lattice_gym.design import LatticeDesign
from lattice_gym.env import LatticeWormEnv
from lattice_gym.gaits import gait, grouped
from lattice_gym.lattice import Lattice, build_lattice
from lattice_gym.muscles import Muscle, MuscleLayout, horizontal, named_layout, resolve_layout, tie, vertical

__all__ = [
    "Lattice",
    "LatticeDesign",
    "LatticeWormEnv",
    "Muscle",
    "MuscleLayout",
    "build_lattice",
    "gait",
    "grouped",
    "horizontal",
    "named_layout",
    "resolve_layout",
    "tie",
    "vertical",
]

# Control steps of 0.05 s: long enough for a shape to settle, and for ten periods of a typical wave.
_TIME_LIMITS = {"peristalsis": 200, "extension": 40, "compression": 40, "bending": 40}

for _task, _limit in _TIME_LIMITS.items():
    for _name in (
        ("LatticeWorm", "LatticeWormPeristalsis") if _task == "peristalsis" else (f"LatticeWorm{_task.title()}",)
    ):
        register(
            id=f"{_name}-v0",
            entry_point="lattice_gym.env:LatticeWormEnv",
            max_episode_steps=_limit,
            kwargs={"task": _task},
        )
