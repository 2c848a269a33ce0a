"""A trained policy beside doing nothing, random actions and a hand-made gait: `python -m agents.evaluation RUN`."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
import numpy.typing as npt
import tyro
from gymnasium.wrappers import RescaleAction
from stable_baselines3.common.vec_env import DummyVecEnv

from agents import run_folder
from agents.command_line import Progress
from agents.command_line import run as run_program
from agents.config import InputError, input_errors
from agents.environments import Env, make_env
from agents.run_folder import Run
from agents.training import gather, load_model, load_normaliser, worm_seeds
from lattice_gym.checks import choice, whole
from lattice_gym.envs.fidelity import FidelityName
from lattice_gym.tasks.gait import group_means
from lattice_gym.tasks.registry import has_gait

PolicyName = Literal["policy", "gait", "nothing", "random"]
POLICIES: dict[PolicyName, str] = {
    "policy": "trained policy",
    "gait": "hand-made gait",
    "nothing": "do nothing",
    "random": "random actions",
}

EVALUATION_SEED = 1_000_000
"""Seed of the first episode unless given: far above those that training usually starts from."""

Action = npt.NDArray[np.float32]
Policy = Callable[[Any], Action]
"""Observation -> action."""
PolicyMaker = Callable[[Env, int], Policy]
"""(environment just reset, seed of the episode) -> what acts in this episode."""


class NoGaitError(InputError):
    """A task makes no gait for what is commanded."""


@dataclass(frozen=True)
class Step:
    """What the reset (reward 0) or one control step gave."""

    reward: float
    info: Mapping[str, Any]


@dataclass(frozen=True)
class Score:
    """Episodes of one policy: mean and population standard deviation of the return and of `outcome_errors`.

    An outcome that some episodes lack is averaged over the others, and absent if all lack it.
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


def make_policy(name: PolicyName, run: Run, env: Env) -> PolicyMaker:
    """Policy by its name; raises InputError if the run's model cannot be read or the name is unknown."""
    if name == "policy":
        return trained_policy(run.newest, env)
    with input_errors():
        choice("policy", name, POLICIES)
    if name == "gait" and not has_gait(run.config.task_class):
        raise InputError(f"policy = {name!r}: {run.config.task} has no gait")
    return BASELINES[name]


def trained_policy(checkpoint: Path, env: Env) -> PolicyMaker:
    """Let a checkpoint's model act, without exploration and with its normalisation frozen."""
    learnt = RescaleAction(env, np.float32(-1.0), np.float32(1.0))
    normaliser = load_normaliser(checkpoint / run_folder.NORMALISATION, DummyVecEnv([lambda: learnt]))
    normaliser.training = False
    model = load_model(checkpoint / run_folder.MODEL, normaliser)

    def act(observation: Any) -> Action:
        action: Action = learnt.func(model.predict(normaliser.normalize_obs(observation), deterministic=True)[0])
        return action

    return lambda _env, _seed: act


def do_nothing(env: Env, _seed: int) -> Policy:
    """Every muscle off."""
    action: Action = cast(Any, env.action_space).low
    return lambda _observation: action


def random_actions(env: Env, seed: int) -> Policy:
    """Every action uniform and independent, also of what the environment draws from the same seed."""
    generator = np.random.default_rng([seed, 1])
    shape, (low, high) = env.action_space.shape, cast(Any, env.unwrapped).action_range
    return lambda _observation: generator.uniform(low, high, shape).astype(np.float32)


def hand_made_gait(env: Env, _seed: int) -> Policy:
    """Play the task's open-loop gait; muscles that share an action get the mean over them."""
    worm: Any = env.unwrapped
    activation = worm.task.gait(worm.lattice, worm.layout, worm.task.command)
    if activation is None:
        raise NoGaitError(f"policy = 'gait': {worm.task.name} has no gait for {worm.task.command}")

    def act(_observation: Any) -> Action:
        action: Action = worm.action_of(group_means(activation(worm.time), worm.groups)).astype(np.float32)
        return action

    return act


BASELINES: dict[PolicyName, PolicyMaker] = {"gait": hand_made_gait, "nothing": do_nothing, "random": random_actions}


def play(env: Env, start: PolicyMaker, seed: int) -> Iterator[Step]:
    """One seeded episode: its start, then step by step."""
    observation, info = env.reset(seed=seed)
    act = start(env, seed)
    yield Step(0.0, info)
    done = False
    while not done:
        observation, reward, terminated, truncated, info = env.step(act(observation))
        done = terminated or truncated
        yield Step(float(reward), info)


def score(env: Env, start: PolicyMaker, seeds: range, progress: Callable[[str], object] = lambda _line: None) -> Score:
    """Play one episode a seed; `progress` is called with a line of text at every step."""
    few = cast(Any, env.unwrapped).task.choices
    episodes: list[Episode] = []
    for seed in seeds:
        steps: list[Step] = []
        for step in play(env, start, seed):
            progress(f"episode {len(episodes) + 1} of {len(seeds)}, step {len(steps)}")
            steps.append(step)
        command = {name: value for name, value in steps[0].info["command"].items() if name in few}
        last = steps[-1].info
        gain = sum(step.reward for step in steps)
        episodes.append(Episode(command, gain, last["outcome_errors"], last["status"] != "ok"))
    return summary(episodes)


def summary(episodes: Sequence[Episode]) -> Score:
    """Score of the episodes, and of those of each command if there are several."""
    table = gather([episode.outcome for episode in episodes])
    commands = sorted({tuple(episode.command.items()) for episode in episodes})
    by_command: dict[str, Score] = {}
    for command in commands if len(commands) > 1 else ():
        title = ", ".join(f"{name} {value:.12g}" for name, value in command)
        by_command[title] = summary([episode for episode in episodes if tuple(episode.command.items()) == command])
    return Score(
        tuple(episode.gain for episode in episodes),
        {name: float(np.mean(values)) for name, values in table.items()},
        {name: float(np.std(values)) for name, values in table.items()},
        sum(episode.diverged for episode in episodes),
        by_command,
    )


def evaluate(
    path: Path,
    episodes: int = 10,
    seed: int = EVALUATION_SEED,
    command: str = "",
    fidelity: FidelityName | None = None,
) -> dict[PolicyName, Score]:
    """Score the newest checkpoint and the baselines, a gait if the task has one, on the same seeds: evaluation.json.

    The worm is computed at the fidelity given, which then is in the name of the file, by default at that of training.
    Raises InputError on a damaged run folder and where an episode would have a seed of training.
    """
    with input_errors():
        episodes, seed = whole("episodes", episodes, 1), whole("seed", seed, 0)
    run = Run.open(path).at(fidelity)
    sessions = run_folder.read_sessions(path / run_folder.VERSIONS)
    seeds = range(seed, seed + episodes)
    for session in sessions:
        seen = worm_seeds(run.config, session["from_step"])
        if seeds.start < seen.stop and seen.start < seeds.stop:
            raise InputError(f"seed = {seed}: episodes must not have those of training, {seen.start} to {seen[-1]}")
    checkpoint, progress = run.newest, Progress()
    scores: dict[PolicyName, Score] = {}
    for name, title in POLICIES.items():
        if name == "gait" and not has_gait(run.config.task_class):
            continue
        env = make_env(run.env_arguments)  # one each: muscles may carry over what an earlier episode did to them
        start = trained_policy(checkpoint, env) if name == "policy" else BASELINES[name]
        with suppress(NoGaitError):
            scores[name] = score(env, start, seeds, partial(progress, title))
        env.close()
    report = {
        "made": run_folder.made_by(command),
        "trained_with": sessions,
        "task": run.config.task,
        "fidelity": run.fidelity,
        "steps": int(checkpoint.name),
        "seeds": list(seeds),
        "policies": {name: result.to_dict() for name, result in scores.items()},
    }
    run_folder.write_json(path / run_folder.at_fidelity(run_folder.EVALUATION, fidelity), report)
    return scores


def format_scores(scores: Mapping[PolicyName, Score]) -> str:
    """Scores as a plain text table, mean +- standard deviation over episodes; "-" where no episode has a value.

    Below a policy stand its rows by command, where commands are drawn from a few.
    """
    outcomes = list(dict.fromkeys(name for result in scores.values() for name in result.outcome_mean))
    rows = [["", "return", *outcomes, "diverged"]]
    for name, result in scores.items():
        for title, part in {POLICIES[name]: result, **result.by_command}.items():
            mean, std = part.outcome_mean, part.outcome_std
            cells = [f"{mean[o]:.3f} +- {std[o]:.3f}" if o in mean else "-" for o in outcomes]
            gain = f"{part.return_mean:.3f} +- {part.return_std:.3f}"
            rows.append([title, gain, *cells, f"{part.diverged_episodes} of {len(part.returns)}"])
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return "\n".join("  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)


def main(
    run: Annotated[Path, tyro.conf.Positional],
    episodes: int = 10,
    seed: int = EVALUATION_SEED,
    fidelity: FidelityName | None = None,
) -> None:
    """Print mean and spread of return and outcome over seeded episodes, the same for every policy.

    Seeds from which training started episodes are refused.

    Parameters
    ----------
    run
        Run folder of `python train.py`.
    episodes
        Episodes of each policy.
    seed
        Seed of the first episode; the next one has seed + 1.
    fidelity
        How finely the worm is computed; as in training by default.
    """
    command = shlex.join(["python", "-m", "agents.evaluation", *sys.argv[1:]])
    scores = evaluate(run, episodes, seed, command, fidelity)
    print(format_scores(scores))
    file = run / run_folder.at_fidelity(run_folder.EVALUATION, fidelity)
    print(
        f"\nmean +- standard deviation over {episodes} episodes at fidelity {Run.open(run).at(fidelity).fidelity}; "
        f"written to {file}"
    )


if __name__ == "__main__":
    run_program(main, "python -m agents.evaluation")
