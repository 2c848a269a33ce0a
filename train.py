"""Train one policy: `python train.py --task peristalsis --total-steps 100000 --seed 1`; see `--help`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from agents.command_line import as_program, command, options
from agents.config import TrainConfig
from agents.run_folder import Run
from agents.training import resume_settings, train

NAME = "python train.py"


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line and train; with --resume, whatever is not given is as the run had it.

    A task may stand in the working directory.
    """
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.append(here)
    config = options(TrainConfig, NAME, arguments)
    if config.resume is not None:
        config = options(TrainConfig, NAME, arguments, resume_settings(config.resume))
    run = train(config)
    score = command("python", "-m", "agents.evaluation", run) + Run.open(run).allowance
    print(f"run folder: {run}; score it with: {score}")


if __name__ == "__main__":
    with as_program():
        main()
