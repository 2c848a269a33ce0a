"""Train, evaluate and film a worm that learns peristalsis: `python -m agents.demo`, or `make demo`."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from agents import run_folder
from agents.command_line import Stopped, run
from agents.config import InputError, TrainConfig
from agents.evaluation import PolicyName, evaluate, format_scores
from agents.rollouts import export
from agents.run_folder import Run
from agents.training import train
from lattice_gym.policies.evaluation import Score
from lattice_gym.recording import files
from lattice_gym.rendering.extras import extra

SETTINGS = TrainConfig(total_steps=150_000, seed=1, time_limit=240.0)
"""Enough to learn the wave, and a limit for slow machines [s]."""


def demo(
    path: Path = Path("runs/demo"),
    settings: TrainConfig = SETTINGS,
    fresh: bool = False,
    episodes: int = 10,
    video: bool = True,
) -> bool:
    """Train in `path`, or reuse or continue what is there; whether the policy beats doing nothing and random actions.

    Raises InputError if `path` holds a run with other settings or a damaged one, unless `fresh` discards it, and where
    a video is wanted but cannot be made.
    """
    began = time.monotonic()
    settings = settings.resolved()
    if video:
        _need_video()
    if fresh and path.exists() and not run_folder.is_empty(path):
        if not (path / run_folder.CONFIG).is_file():
            raise InputError(f"{path}: not a run folder, so not deleted; move it away by hand")
        with files.claimed(path):
            run_folder.clear(path)
    _train(path, settings)
    print("\nevaluating on seeds that training never saw ...", flush=True)
    scores = evaluate(path, episodes, command="python -m agents.demo")
    print(format_scores(scores), flush=True)
    if video:
        print("\nfilming ...", flush=True)
        for title, file in export(path).paths().items():
            print(f"{title:16}{file}")
    print(f"{'scores':16}{path / run_folder.EVALUATION}\n{'TensorBoard':16}{path / run_folder.TENSORBOARD}")
    print(f"\n{verdict(scores, Run.open(path).steps)} ({time.monotonic() - began:.0f} s)")
    return beats_baselines(scores)


def _need_video() -> None:
    try:
        for name in ("pyvista", "imageio_ffmpeg", "matplotlib"):
            extra(name)
    except ImportError as error:
        raise InputError(f"{error}; or leave the video out with --no-video") from error


def _train(path: Path, settings: TrainConfig) -> None:
    """Train in `path` what is left of the settings' steps, after a line that says what was there."""
    if not (path / run_folder.VERSIONS).exists():  # new, empty, or killed while it was made
        train(replace(settings, run_dir=path))
        return
    known = Run.open(path)
    if replace(known.config, time_limit=settings.time_limit, num_threads=settings.num_threads) != settings:
        raise InputError(f"{path}: a run with other settings; discard it with: make demo FRESH=1")
    left = known.steps < settings.total_steps
    found = f"continuing {path} at" if left else f"{path} is trained,"
    print(f"{found} {known.steps:,} steps; make demo FRESH=1 starts over", flush=True)
    if left:
        train(replace(settings, resume=path))


def beats_baselines(scores: Mapping[PolicyName, Score]) -> bool:
    """Whether the trained policy does better than doing nothing and random actions."""
    return scores["policy"].return_mean > max(scores["nothing"].return_mean, scores["random"].return_mean)


def verdict(scores: Mapping[PolicyName, Score], steps: int) -> str:
    """Say what the policy has learned in so many steps; as a share of the gait where the gait gains anything."""
    beats = "beats" if beats_baselines(scores) else "DOES NOT beat"
    gait = scores["gait"].return_mean
    share = f"{100.0 * scores['policy'].return_mean / gait:.0f} % of the hand-made gait " if gait > 0.0 else ""
    return f"the trained policy {beats} doing nothing and random actions: {share}after {steps:,} steps"


def main(fresh: bool = False, video: bool = True) -> None:
    """Train a policy on LatticeWorm-v0 for a few minutes, score it beside baselines and film it.

    Run again, it continues what an earlier demo left.

    Parameters
    ----------
    fresh
        Discard what an earlier demo left and start over.
    video
        Film an episode, and draw its muscles and the learning curve.
    """
    try:
        learned = demo(fresh=fresh, video=video)
    except Stopped as stopped:
        raise Stopped(stopped.number, "make demo") from None
    if not learned:
        sys.exit(1)


if __name__ == "__main__":
    run(main, "python -m agents.demo")
