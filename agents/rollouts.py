"""One recorded episode as numbers, video and pictures: `python -m agents.rollouts POLICY`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from agents import run_folder
from agents.command_line import Progress
from agents.command_line import run as run_program
from agents.config import InputError, allow_modules, input_errors
from agents.evaluation import POLICIES, PolicyName, make_policy
from agents.policies import PolicyFile, environment_of, open_source
from agents.run_folder import Run
from lattice_gym.checks import whole
from lattice_gym.envs.fidelity import FidelityName
from lattice_gym.policies.base import EVALUATION_SEED
from lattice_gym.policies.baselines import NoGaitError
from lattice_gym.policies.recording import record as record_policy
from lattice_gym.recording.files import prepare
from lattice_gym.recording.trajectory import Trajectory
from lattice_gym.rendering.figures import plot_activation, save
from lattice_gym.rendering.video import render_video

GIF_SIZE = (480, 360)
ROUNDING = 1e-9
"""Times that differ by less are the same [s]."""


@dataclass(frozen=True)
class Artefacts:
    """Files of one recorded episode."""

    trajectory: Path
    video: Path
    activation: Path
    learning_curve: Path | None
    gif: Path | None = None

    def paths(self) -> dict[str, Path]:
        """Files that were asked for, by title."""
        return {name.replace("_", " "): path for name, path in vars(self).items() if path is not None}


def record(source: Run | PolicyFile, policy: PolicyName = "policy", seed: int = EVALUATION_SEED) -> Trajectory:
    """Record one seeded episode of a policy by its name, as `lattice_gym.record` does of any."""
    with input_errors():
        seed = whole("seed", seed, 0)
    player, progress = make_policy(policy, source), Progress()
    with environment_of(source, player) as env:
        try:
            return record_policy(player, env, seed, progress)
        except NoGaitError as error:
            raise InputError(str(error)) from error


def export(
    path: Path,
    policy: PolicyName = "policy",
    seed: int = EVALUATION_SEED,
    gif: tuple[float, float] | None = None,
    fidelity: FidelityName | None = None,
) -> Artefacts:
    """Record an episode with its video and heat map, of a run folder with the run's learning curve.

    `path` is a run folder, or a policy file, beside which the files then stand under its name. `gif` is the span [s] of
    which an animated GIF is written too. The worm is computed at the fidelity given, which then is in the names of the
    files, by default at that of training. Raises InputError that names a missing or damaged file, or a span that holds
    no frames of the episode.
    """
    source = open_source(path).at(fidelity)
    stem = run_folder.at_fidelity(f"{policy}-{seed}", fidelity)
    files = Artefacts(
        source.place(f"{stem}.npz"),
        source.place(f"{stem}.mp4"),
        source.place(f"{stem}-activation.png"),
        source.place(run_folder.at_fidelity("learning_curve.png", fidelity)) if isinstance(source, Run) else None,
        None if gif is None else source.place(f"{stem}.gif"),
    )
    prepare(files.trajectory.parent)
    if isinstance(source, Run) and files.learning_curve is not None:
        plot_learning_curve(source, files.learning_curve, fidelity)
    trajectory = record(source, policy, seed)
    progress = Progress()
    if gif is not None and files.gif is not None:
        render_video(
            span(trajectory, gif), files.gif, size=GIF_SIZE, progress=lambda k, n: progress(f"GIF: frame {k} of {n}")
        )
    trajectory.save(files.trajectory)
    plot_activation(trajectory, files.activation)
    render_video(trajectory, files.video, progress=lambda k, n: progress(f"filming: frame {k} of {n}"))
    return files


def span(trajectory: Trajectory, gif: tuple[float, float]) -> Trajectory:
    """Frames of a span of time, both ends included; raises InputError if it is none of the episode's or holds none."""
    time, (start, end) = trajectory.time, gif
    shown = (time >= start - ROUNDING) & (time <= end + ROUNDING)
    if not (0.0 <= start < end <= time[-1] + ROUNDING) or not shown.any():
        raise InputError(f"gif = {gif}: must be start and end of a span with frames in 0 to {time[-1]:g} s")
    return replace(
        trajectory,
        time=time[shown],
        position=trajectory.position[shown],
        ball=None if trajectory.ball is None else trajectory.ball[shown],
        activation=trajectory.activation[shown],
        reward=trajectory.reward[shown],
        outcome=tuple(trajectory.outcome[frame] for frame in np.flatnonzero(shown)),
    )


def plot_learning_curve(run: Run, path: Path, fidelity: FidelityName | None = None) -> None:
    """Draw return over environment steps, with the policies as lines that were evaluated at the fidelity given."""
    from matplotlib.figure import Figure  # costs a second that training does not need

    rows = [row for row in run.rows() if "worm/return_mean" in row]
    steps, mean, spread = ([row[n] for row in rows] for n in (run_folder.STEPS, "worm/return_mean", "worm/return_std"))
    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    axes = figure.subplots()
    low, high = ([m + side * s for m, s in zip(mean, spread, strict=True)] for side in (-1.0, 1.0))
    axes.plot(steps, mean, color="tab:blue", label="in training, with exploration")
    axes.fill_between(
        steps, low, high, color="tab:blue", alpha=0.2, linewidth=0.0, label="± standard deviation over episodes"
    )
    for (name, level), colour in zip(
        evaluated_returns(run, fidelity).items(), ("black", "tab:green", "tab:gray", "tab:orange"), strict=False
    ):
        axes.axhline(level, color=colour, linestyle="--", linewidth=1.0, label=name)
    axes.set_xlabel("environment steps")
    axes.set_ylabel("return of an episode")
    axes.set_title(f"{run.config.task}, control by {run.config.resolved_control}, seed {run.config.seed}")
    axes.legend(loc="best", fontsize="small")
    axes.grid(alpha=0.3)
    save(figure, path, dpi=150)


def evaluated_returns(run: Run, fidelity: FidelityName | None = None) -> dict[str, float]:
    """Mean return of every evaluated policy, the trained one only as its newest checkpoint; nothing before that.

    The names tell a fidelity other than that of training.
    """
    path = run.path / run_folder.at_fidelity(run_folder.EVALUATION, fidelity)
    if not path.exists():
        return {}
    report = run_folder.read_json(path)
    try:
        given = report["policies"]
        means = {name: float(given[name]["return_mean"]) for name in POLICIES if name in given or name != "gait"}
        current = report["steps"] == run.steps
        scored = report.get("fidelity", run.config.fidelity)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: damaged or not of this kind: {error!r}") from error
    note = "" if scored == run.config.fidelity else f" ({scored})"
    return {
        title + note: means[name] for name, title in POLICIES.items() if name in means and (current or name != "policy")
    }


def main(
    source: Annotated[Path, tyro.conf.Positional],
    policy: PolicyName = "policy",
    seed: int = EVALUATION_SEED,
    gif: tuple[float, float] | None = None,
    fidelity: FidelityName | None = None,
    allow: tuple[str, ...] = (),
) -> None:
    """Record one episode and write its trajectory, video, activation heat map and, of a run, the learning curve.

    Parameters
    ----------
    source
        Run folder of `python train.py`, or policy file of `python -m agents.export`.
    policy
        What drives the muscles: the trained policy, or one of the baselines.
    seed
        Seed of the episode.
    gif
        Start and end of a span of which an animated GIF is written too [s].
    fidelity
        How finely the worm is computed; as in training by default.
    allow
        Modules that it may name, as of a task of your own: their code runs.
    """
    allow_modules(allow)
    for title, path in export(source, policy, seed, gif, fidelity).paths().items():
        print(f"{title:16}{path}")


if __name__ == "__main__":
    run_program(main, "python -m agents.rollouts")
