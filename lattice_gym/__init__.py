"""Gymnasium environments of a lattice worm made of Cosserat rods.

Importing it registers `LatticeWorm-v0` and one id for every task, such as `LatticeWormCrawl-v0`; `LatticeWormEnv` is
their specification, with a table of them, and `LatticeWormVectorEnv` steps many of one kind at once. `register_task`
does so for a task of your own.

`evaluate`, `record` and `film` take any policy, a callable from observation to action, `load_policy` a trained one from
its file.
"""

from __future__ import annotations

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import (
    Muscle,
    MuscleLayout,
    diagonal,
    horizontal,
    named_layout,
    resolve_layout,
    tie,
    vertical,
)
from lattice_gym.engines.health import Status
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.goal import LatticeWormGoalEnv, LatticeWormGoalVectorEnv
from lattice_gym.envs.info import describe_status
from lattice_gym.envs.registration import register_builtin_tasks, register_task
from lattice_gym.envs.terms import ObservationTerm
from lattice_gym.envs.vector import LatticeWormVectorEnv
from lattice_gym.physics.laws.adaptation import Adaptation
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.laws.contact import Contact
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.world import World
from lattice_gym.policies.conversion import network_policy
from lattice_gym.policies.evaluation import evaluate
from lattice_gym.policies.network import NetworkPolicy, load_policy
from lattice_gym.policies.recording import film, record
from lattice_gym.tasks.base import Command, GoalTask, RewardTerm, Task
from lattice_gym.tasks.gait import Gait, group_means
from lattice_gym.tasks.registry import design_for, gait

__all__ = [
    "Adaptation",
    "Ball",
    "Command",
    "Contact",
    "Gait",
    "GoalTask",
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
    "NetworkPolicy",
    "ObservationTerm",
    "RewardTerm",
    "Status",
    "Task",
    "World",
    "build_lattice",
    "describe_status",
    "design_for",
    "diagonal",
    "evaluate",
    "film",
    "gait",
    "group_means",
    "horizontal",
    "load_policy",
    "named_layout",
    "network_policy",
    "record",
    "register_task",
    "resolve_layout",
    "tie",
    "vertical",
]

register_builtin_tasks()
