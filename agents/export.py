"""A trained policy as a file of arrays, which numpy alone plays: `python -m agents.export RUN policy.npz`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from agents.command_line import run
from agents.config import InputError, allow_modules, input_errors
from agents.policies import policy_of
from agents.run_folder import Run


def main(
    source: Annotated[Path, tyro.conf.Positional],
    file: Annotated[Path, tyro.conf.Positional],
    allow: tuple[str, ...] = (),
) -> None:
    """Write weights and normalisation of a run's newest checkpoint, and its environment, to a file without code.

    Play it with `lattice_gym.load_policy(FILE)`, which needs neither Stable-Baselines3 nor torch; score and film it
    with `python -m agents.evaluation FILE` and `python -m agents.rollouts FILE`.

    Parameters
    ----------
    source
        Run folder of `python train.py`.
    file
        File to write, *.npz.
    allow
        Modules that the run may name, as of a task of your own: their code runs.
    """
    allow_modules(allow)
    if file.suffix != ".npz":
        raise InputError(f"file = {file}: must end in .npz")
    policy = policy_of(Run.open(source))
    with input_errors():
        policy.save(file)
    print(f"{policy} of {policy.origin['steps']} steps; play it with: lattice_gym.load_policy({str(file)!r})")


if __name__ == "__main__":
    run(main, "python -m agents.export")
