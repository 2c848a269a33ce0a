"""Train one policy: `python train.py --task peristalsis --total-steps 100000 --seed 1`; see `--help`."""

from __future__ import annotations

from collections.abc import Sequence

import tyro

from agents.config import TrainConfig, errors_as_messages
from agents.training import resume_settings, train


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line and train; with --resume, whatever is not given is as the run had it."""
    config = tyro.cli(TrainConfig, args=arguments)
    if config.resume is not None:
        config = tyro.cli(TrainConfig, args=arguments, default=resume_settings(config.resume))
    print(f"run folder: {train(config)}")


if __name__ == "__main__":
    with errors_as_messages():
        main()
