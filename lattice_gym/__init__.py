"""Gymnasium environments of a lattice worm made of Cosserat rods.

Importing it registers `LatticeWorm-v0` and one id for every task, such as `LatticeWormCrawl-v0`; `LatticeWormEnv` is
their specification, with a table of them, and `LatticeWormVectorEnv` steps many of one kind at once.
"""

from __future__ import annotations

from gymnasium.envs.registration import register

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import Muscle, MuscleLayout, horizontal, named_layout, resolve_layout, tie, vertical
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.goal import LatticeWormGoalEnv, LatticeWormGoalVectorEnv
from lattice_gym.envs.vector import LatticeWormVectorEnv
from lattice_gym.physics.laws.adaptation import Adaptation
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.world import Bolus, Contact, Ground, Medium, World
from lattice_gym.tasks.gaits import gait, grouped

__all__ = [
    "Adaptation",
    "Bolus",
    "Contact",
    "Ground",
    "Hill",
    "Lattice",
    "LatticeDesign",
    "LatticeWormEnv",
    "LatticeWormGoalEnv",
    "LatticeWormGoalVectorEnv",
    "LatticeWormVectorEnv",
    "Medium",
    "Muscle",
    "MuscleLayout",
    "World",
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
_TIME_LIMITS = {
    "peristalsis": 200,
    "extension": 40,
    "compression": 40,
    "bending": 40,
    "reach": 60,
    "crawl": 200,
    "transport": 200,
}

for _task, _limit in _TIME_LIMITS.items():
    for _name in (
        ("LatticeWorm", "LatticeWormPeristalsis") if _task == "peristalsis" else (f"LatticeWorm{_task.title()}",)
    ):
        register(
            id=f"{_name}-v0",
            entry_point="lattice_gym.envs.env:LatticeWormEnv",
            vector_entry_point="lattice_gym.envs.vector:LatticeWormVectorEnv",
            max_episode_steps=_limit,
            kwargs={"task": _task},
        )
register(
    id="LatticeWormReachGoal-v0",
    entry_point="lattice_gym.envs.goal:LatticeWormGoalEnv",
    vector_entry_point="lattice_gym.envs.goal:LatticeWormGoalVectorEnv",
    max_episode_steps=_TIME_LIMITS["reach"],
    kwargs={"task": "reach"},
)
