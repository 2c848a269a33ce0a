"""Scores of a policy over seeded episodes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from lattice_gym.checks import items, whole
from lattice_gym.policies.base import EVALUATION_SEED, EnvLike, Policy, opened, play

SEEDS = range(EVALUATION_SEED, EVALUATION_SEED + 10)
"""Episodes that are scored unless others are given."""


@dataclass(frozen=True)
class Score:
    """Episodes of one policy: mean and population standard deviation of the return and of the outcome by its command.

    The outcome is that of each episode's end, as `Task.errors` measures it. One that some episodes lack is averaged
    over the others, and absent if all lack it.
    """

    returns: tuple[float, ...]
    outcome_mean: dict[str, float]
    outcome_std: dict[str, float]
    diverged_episodes: int
    by_command: dict[str, Score] = field(default_factory=dict)
    """The episodes of each command, where commands are drawn from a few: a mean over all would hide one that fails."""

    @property
    def return_mean(self) -> float:
        """Mean return of an episode."""
        return float(np.mean(self.returns))

    @property
    def return_std(self) -> float:
        """Standard deviation of the return over episodes."""
        return float(np.std(self.returns))

    def to_dict(self) -> dict[str, Any]:
        """JSON-safe values, mean and standard deviation of the return included."""
        parts = {command: part.to_dict() for command, part in self.by_command.items()}
        return vars(self) | {"return_mean": self.return_mean, "return_std": self.return_std, "by_command": parts}


@dataclass(frozen=True)
class Episode:
    """Result of one episode; `command` holds only the commanded numbers that are drawn from a list."""

    command: Mapping[str, float]
    gain: float
    outcome: Mapping[str, float]
    diverged: bool


def evaluate(
    policy: Policy,
    env: EnvLike,
    seeds: Iterable[int] = SEEDS,
    progress: Callable[[str], object] = lambda _line: None,
) -> Score:
    """Score a policy over one episode a seed.

    Parameters
    ----------
    policy
        Any callable from observation to action, a `Gait` too; see `lattice_gym.policies.base`.
    env
        An environment of one worm, its id, or all arguments of `gymnasium.make` as a dict. Muscles of an `adaptation`
        that carries over begin an episode as the one before left them.
    seeds
        One for each episode; ten from 1,000,000 on by default.
    progress
        Called with a line of text at every step.

    Raises
    ------
    ValueError
        What is none of these, and an action that the environment refuses.
    """
    each = items("seeds", seeds, partial(whole, low=0), what="seeds")
    if not each:
        raise ValueError("seeds = (): must name at least one episode")
    episodes: list[Episode] = []
    with opened(env) as (made, worm):
        for seed in each:
            gain, command, info = 0.0, dict[str, float](), dict[str, Any]()
            for number, step in enumerate(play(policy, made, seed)):
                progress(f"episode {len(episodes) + 1} of {len(each)}, step {number}")
                gain += step.reward
                info = dict(step.info)
                command = info.get("command", command)
            drawn = {name: value for name, value in command.items() if name in worm.task.choices}
            errors = worm.task.errors(info["outcome"], command)
            episodes.append(Episode(drawn, gain, errors, not worm.worms.health().ok))
    return _summary(episodes)


def gather(outcomes: Iterable[Mapping[str, float]]) -> dict[str, list[float]]:
    """Values of every name over the outcomes that have it."""
    table: dict[str, list[float]] = {}
    for outcome in outcomes:
        for name, value in outcome.items():
            table.setdefault(name, []).append(value)
    return table


def _summary(episodes: Sequence[Episode]) -> Score:
    """Score of the episodes, and of those of each command if there are several."""
    table = gather(episode.outcome for episode in episodes)
    commands = sorted({tuple(episode.command.items()) for episode in episodes})
    by_command: dict[str, Score] = {}
    for command in commands if len(commands) > 1 else ():
        title = ", ".join(f"{name} {value:.12g}" for name, value in command)
        by_command[title] = _summary([episode for episode in episodes if tuple(episode.command.items()) == command])
    return Score(
        tuple(episode.gain for episode in episodes),
        {name: float(np.mean(values)) for name, values in table.items()},
        {name: float(np.std(values)) for name, values in table.items()},
        sum(episode.diverged for episode in episodes),
        by_command,
    )
