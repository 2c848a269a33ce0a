"""Train, evaluate and film a worm that learns peristalsis: `python -m agents.demo`, or `make demo`."""

from __future__ import annotations

import shutil
import sys
import time
from dataclasses import replace
from pathlib import Path

import tyro

from agents import run_folder
from agents.config import InputError, TrainConfig, errors_as_messages
from agents.evaluation import evaluate, format_scores
from agents.rollouts import export
from agents.run_folder import Run
from agents.training import train

SETTINGS = TrainConfig(total_steps=150_000, seed=1, time_limit=240.0)
"""Enough to learn the wave, and a limit for slow machines [s]."""


def demo(
    path: Path = Path("runs/demo"), settings: TrainConfig = SETTINGS, fresh: bool = False, episodes: int = 10
) -> bool:
    """Train in `path`, or reuse or continue what is there; whether the policy beats doing nothing and random actions.

    Raises InputError if `path` holds a run with other settings or a damaged one, unless `fresh` discards it.
    """
    began = time.monotonic()
    settings = replace(settings, control=settings.driven)
    if fresh and path.exists():
        if not (path / run_folder.CONFIG).is_file():
            raise InputError(f"{path}: not a run folder, so not deleted; move it away by hand")
        shutil.rmtree(path)
    known = path.exists()
    if known and replace(Run.open(path).config, time_limit=settings.time_limit) != settings:
        raise InputError(f"{path}: a run with other settings; discard it with: python -m agents.demo --fresh")
    train(replace(settings, resume=path) if known else replace(settings, run_dir=path))
    print("\nevaluating on seeds that training never saw ...", flush=True)
    scores = evaluate(path, episodes, command="python -m agents.demo")
    print(format_scores(scores), flush=True)
    print("\nfilming ...", flush=True)
    for title, file in export(path).written().items():
        print(f"{title:16}{file}")
    print(f"{'scores':16}{path / run_folder.EVALUATION}\n{'TensorBoard':16}{path / run_folder.TENSORBOARD}")
    baseline = max(scores["nothing"].return_mean, scores["random"].return_mean)
    learned = scores["policy"].return_mean > baseline
    verdict = "beats" if learned else "DOES NOT beat"
    print(f"\nthe trained policy {verdict} doing nothing and random actions ({time.monotonic() - began:.0f} s)")
    return learned


def main(fresh: bool = False) -> None:
    """Train a policy on LatticeWorm-v0 for a few minutes, score it beside baselines and film it.

    Parameters
    ----------
    fresh
        Discard what an earlier demo left and start over.
    """
    if not demo(fresh=fresh):
        sys.exit(1)


if __name__ == "__main__":
    with errors_as_messages():
        tyro.cli(main)
