"""One recorded episode as numbers, video and pictures: `python -m agents.rollouts RUN`."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tqdm import tqdm

from agents import run_folder
from agents.config import InputError, errors_as_messages
from agents.environments import make_env
from agents.evaluation import POLICIES, PolicyName, make_policy, play
from agents.run_folder import Run
from lattice_gym.rendering import plot_activation, render_video
from lattice_gym.trajectory import Recorder, Trajectory, replacing


@dataclass(frozen=True)
class Artefacts:
    """Files of one recorded episode."""

    trajectory: Path
    video: Path
    activation: Path
    learning_curve: Path


def record(run: Run, policy: PolicyName = "policy", seed: int = 1000) -> Trajectory:
    """Play one seeded episode; the first frame is its start, each further one the end of a control step."""
    if seed < 0:
        raise InputError(f"seed = {seed}: must be 0 or more")
    env = make_env(run.env_arguments)
    worm: Any = env.unwrapped
    recorder = Recorder(worm.design, worm.layout, run.config.task)
    total = 0.0
    for step in play(env, make_policy(policy, run, env), seed):
        total += step.reward
        line = _outcome_line(total, step.info.get("outcome", {}))
        recorder.append(worm.time, worm.state.position, worm.activation, step.reward, line)
    env.close()
    return recorder.build()


def export(path: Path, policy: PolicyName = "policy", seed: int = 1000) -> Artefacts:
    """Record an episode into the run folder with its video, heat map and the run's learning curve.

    Raises InputError that names the missing or damaged file of the run folder.
    """
    run = Run.open(path)
    stem = f"{policy}-{seed}"
    files = Artefacts(
        path / f"{stem}.npz", path / f"{stem}.mp4", path / f"{stem}-activation.png", path / "learning_curve.png"
    )
    plot_learning_curve(run, files.learning_curve)
    trajectory = record(run, policy, seed)
    trajectory.save(files.trajectory)
    plot_activation(trajectory, files.activation)
    with tqdm(total=trajectory.n_frame, desc="filming", unit="frame", disable=not sys.stderr.isatty()) as bar:
        render_video(trajectory, files.video, progress=lambda done, _all: bar.update(done - bar.n))
    return files


def plot_learning_curve(run: Run, path: Path) -> None:
    """Draw return over environment steps, with the evaluated policies as lines if evaluation.json is there."""
    from matplotlib.figure import Figure  # costs a second that training does not need

    rows = [row for row in run.rows() if "worm/return_mean" in row]
    steps, mean, spread = ([row[n] for row in rows] for n in (run_folder.STEPS, "worm/return_mean", "worm/return_std"))
    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    axes = figure.subplots()
    low, high = ([m + side * s for m, s in zip(mean, spread, strict=True)] for side in (-1.0, 1.0))
    axes.fill_between(steps, low, high, color="tab:blue", alpha=0.2, linewidth=0.0)
    axes.plot(steps, mean, color="tab:blue", label="in training, with exploration")
    for (name, level), colour in zip(
        _evaluated(run).items(), ("black", "tab:green", "tab:gray", "tab:orange"), strict=False
    ):
        axes.axhline(level, color=colour, linestyle="--", linewidth=1.0, label=name)
    axes.set_xlabel("environment steps")
    axes.set_ylabel("return of an episode")
    axes.set_title(f"{run.config.task}, control by {run.config.driven}, seed {run.config.seed}")
    axes.legend(loc="best", fontsize="small")
    axes.grid(alpha=0.3)
    with replacing(path) as partial:
        figure.savefig(partial, dpi=150)


def _evaluated(run: Run) -> dict[str, float]:
    """Mean return of every evaluated policy; nothing before an evaluation."""
    path = run.path / run_folder.EVALUATION
    if not path.exists():
        return {}
    report = run_folder.read_json(path)
    try:
        return {title: float(report["policies"][name]["return_mean"]) for name, title in POLICIES.items()}
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: damaged or not of this kind: {error!r}") from error


def _outcome_line(total: float, outcome: Mapping[str, float]) -> str:
    parts = [f"return {total:.2f}", *(f"{name.replace('_', ' ')} {value:.3g}" for name, value in outcome.items())]
    return "   ".join(parts)


def main(run: Annotated[Path, tyro.conf.Positional], policy: PolicyName = "policy", seed: int = 1000) -> None:
    """Record one episode and write its trajectory, video, activation heat map and the learning curve.

    Parameters
    ----------
    run
        Run folder of `python train.py`.
    policy
        What drives the muscles.
    seed
        Seed of the episode.
    """
    files = export(run, policy, seed)
    for title, path in vars(files).items():
        print(f"{title.replace('_', ' '):15}{path}")


if __name__ == "__main__":
    with errors_as_messages():
        tyro.cli(main)
