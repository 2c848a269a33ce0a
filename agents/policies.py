"""Policies of run folders and policy files: `load_policy`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from agents import run_folder
from agents.config import (
    LEARNER_ACTIVATION,
    LEARNER_RANGE,
    OBSERVATION_CLIP,
    OBSERVATION_EPSILON,
    InputError,
    input_errors,
)
from agents.run_folder import Run, Source, read_file
from lattice_gym.checks import items, whole
from lattice_gym.envs.actions import resolve_action_range
from lattice_gym.policies import network
from lattice_gym.policies.base import Env, Policy, opened
from lattice_gym.policies.conversion import from_state, normalisation
from lattice_gym.policies.network import NetworkPolicy


@dataclass(frozen=True)
class PolicyFile(Source):
    """A policy file that has been read."""

    policy: NetworkPolicy

    @classmethod
    def open(cls, path: Path) -> PolicyFile:
        """Read it; raises InputError that names the file where it cannot be, or does not say what it acts in."""
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        with input_errors():
            policy = network.load_policy(path)
            pair = partial(items, each=partial(whole, low=0), count=2, what="seeds, the first and the last")
            items(f"{path}: origin: seeds", policy.origin.get("seeds", ()), pair, what="pairs of seeds")
        if not policy.environment:
            raise InputError(f"{path}: does not say which environment it acts in")
        return cls(path=path, env_arguments=dict(policy.environment), policy=policy)

    def place(self, name: str) -> Path:
        """Where a file about it is written: beside it, under its name."""
        return self.path.with_name(f"{self.path.stem}-{name}")


def open_source(path: Path) -> Run | PolicyFile:
    """Read a run folder, or a policy file *.npz; raises InputError that names what is missing or damaged."""
    return PolicyFile.open(path) if path.suffix == ".npz" else Run.open(path)


def load_policy(path: Path | str) -> NetworkPolicy:
    """Policy of a run folder's newest checkpoint, or of a file *.npz: a callable from observation to action.

    It acts as the run's model of Stable-Baselines3 does with `deterministic=True`, to rounding, observations normalised
    as in training, in the environment that its `environment` makes. Nothing is unpickled, and nothing imported: where
    the run has a task or a term of somebody's own, import its module before.

    Raises
    ------
    InputError
        A missing or damaged file, one that names code which is not imported, or a run without a checkpoint.
    """
    return policy_of(open_source(Path(path)))


def policy_of(source: Run | PolicyFile) -> NetworkPolicy:
    """Policy of what `open_source` has read."""
    if isinstance(source, PolicyFile):
        return source.policy
    # With torch, which a file does not need.
    from agents.checkpoints import POLICY, read_normalisation, read_state
    from agents.training import worm_seeds

    checkpoint = source.newest
    moments = read_normalisation(checkpoint)
    mean, variance = (moments[f"observation_{moment}"] for moment in ("mean", "var"))
    scaled = normalisation(mean, variance, OBSERVATION_EPSILON, OBSERVATION_CLIP)
    sessions = run_folder.read_sessions(source.path / run_folder.VERSIONS)
    seeds = [worm_seeds(source.config, session["from_step"]) for session in sessions]
    origin = {"steps": int(checkpoint.name), "sessions": sessions, "seeds": [[each[0], each[-1]] for each in seeds]}

    def read(path: Path) -> NetworkPolicy:
        state = {name: values.numpy() for name, values in read_state(path, POLICY).items()}
        n_action = len(state["action_net.bias"])
        low, high = (np.full(n_action, end) for end in LEARNER_RANGE)
        return from_state(state, LEARNER_ACTIVATION, scaled, low, high, source.env_arguments, origin)

    policy = read_file(checkpoint / run_folder.MODEL, read)
    with input_errors():
        ends = resolve_action_range(source.env_arguments["action_range"])
    return policy if ends == LEARNER_RANGE else policy.in_range(*ends)


@contextmanager
def environment_of(source: Source, policy: Policy) -> Iterator[Env]:
    """Environment of a run or a file; InputError where it cannot be built, or is not one of the policy."""
    with ExitStack() as stack:
        with input_errors():
            env, _ = stack.enter_context(opened(source.env_arguments))
            if isinstance(policy, NetworkPolicy):
                policy.reset(env, 0)
        yield env
