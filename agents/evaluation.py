"""A trained policy beside doing nothing, random actions and a hand-made gait: `python -m agents.evaluation POLICY`."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import tyro

from agents import run_folder
from agents.command_line import Progress
from agents.command_line import run as run_program
from agents.config import InputError, allow_modules, input_errors
from agents.policies import PolicyFile, environment_of, open_source, policy_of
from agents.run_folder import Run
from lattice_gym.checks import choice, whole
from lattice_gym.envs.fidelity import FidelityName
from lattice_gym.policies.base import EVALUATION_SEED, Policy
from lattice_gym.policies.baselines import DoNothing, GaitPolicy, NoGaitError, RandomActions
from lattice_gym.policies.evaluation import Score
from lattice_gym.policies.evaluation import evaluate as score
from lattice_gym.recording.files import prepare

PolicyName = Literal["policy", "gait", "nothing", "random"]
POLICIES: dict[PolicyName, str] = {
    "policy": "trained policy",
    "gait": "hand-made gait",
    "nothing": "do nothing",
    "random": "random actions",
}

BASELINES = {"gait": GaitPolicy, "nothing": DoNothing, "random": RandomActions}


def make_policy(name: PolicyName, source: Run | PolicyFile) -> Policy:
    """Policy by its name; raises InputError if the trained one cannot be read or the name is unknown."""
    with input_errors():
        choice("policy", name, POLICIES)
    return policy_of(source) if name == "policy" else BASELINES[name]()


def evaluate(
    path: Path,
    episodes: int = 10,
    seed: int = EVALUATION_SEED,
    command: str = "",
    fidelity: FidelityName | None = None,
) -> dict[PolicyName, Score]:
    """Score a trained policy and the baselines, a gait if the task has one, on the same seeds: evaluation.json.

    `path` is a run folder, of which the newest checkpoint is scored, or a policy file, beside which the report then
    stands under its name. The worm is computed at the fidelity given, which then is in the name of the report, by
    default at that of training. `lattice_gym.evaluate` scores any other policy. Raises InputError on a damaged file and
    where an episode would have a seed of training.
    """
    with input_errors():
        episodes, seed = whole("episodes", episodes, 1), whole("seed", seed, 0)
    source = open_source(path).at(fidelity)
    prepare(report_file(source, fidelity).parent)
    trained = policy_of(source)
    seeds = range(seed, seed + episodes)
    for first, last in trained.origin.get("seeds", ()):
        if seeds.start <= last and first < seeds.stop:
            raise InputError(f"seed = {seed}: episodes must not have those of training, {first} to {last}")
    progress = Progress()
    scores: dict[PolicyName, Score] = {}
    for name, title in POLICIES.items():
        policy = trained if name == "policy" else BASELINES[name]()
        # One each: muscles may carry over what an earlier episode did to them.
        with environment_of(source, policy) as env, suppress(NoGaitError):
            scores[name] = score(policy, env, seeds, partial(progress, title))
    report = {
        "made": run_folder.made_by(command),
        "trained_with": trained.origin.get("sessions"),
        "task": source.env_arguments.get("task", source.env_arguments["id"]),
        "fidelity": source.fidelity,
        "steps": trained.origin.get("steps"),
        "seeds": list(seeds),
        "policies": {name: result.to_dict() for name, result in scores.items()},
    }
    run_folder.write_json(report_file(source, fidelity), report)
    return scores


def report_file(source: Run | PolicyFile, fidelity: FidelityName | None) -> Path:
    """Where the scores are written."""
    return source.place(run_folder.at_fidelity(run_folder.EVALUATION, fidelity))


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
    policy: Annotated[Path, tyro.conf.Positional],
    episodes: int = 10,
    seed: int = EVALUATION_SEED,
    fidelity: FidelityName | None = None,
    allow: tuple[str, ...] = (),
) -> None:
    """Print mean and spread of return and outcome over seeded episodes, the same for every policy.

    Seeds from which training started episodes are refused.

    Parameters
    ----------
    policy
        Run folder of `python train.py`, or policy file of `python -m agents.export`.
    episodes
        Episodes of each policy.
    seed
        Seed of the first episode; the next one has seed + 1.
    fidelity
        How finely the worm is computed; as in training by default.
    allow
        Modules that it may name, as of a task of your own: their code runs.
    """
    allow_modules(allow)
    command = shlex.join(["python", "-m", "agents.evaluation", *sys.argv[1:]])
    scores = evaluate(policy, episodes, seed, command, fidelity)
    print(format_scores(scores))
    source = open_source(policy).at(fidelity)
    print(
        f"\nmean +- standard deviation over {episodes} episodes at fidelity {source.fidelity}; "
        f"written to {report_file(source, fidelity)}"
    )


if __name__ == "__main__":
    run_program(main, "python -m agents.evaluation")
