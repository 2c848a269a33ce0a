"""Searches two trials for the strength of a constant command, by the return of an episode."""

from __future__ import annotations

import gymnasium
import numpy as np
import optuna
from worm import EXTENSION, ID, N_STEP

import lattice_gym  # noqa: F401, registers the ids


def test_a_search_finds_the_stronger_command() -> None:
    """A longer body is worth more."""
    env = gymnasium.make(ID, **EXTENSION)

    def gain(trial: optuna.Trial) -> float:
        env.reset(seed=0)
        command = np.full(env.action_space.shape or (), trial.suggest_float("command", 0.0, 1.0), np.float32)
        return sum(float(env.step(command)[1]) for _ in range(N_STEP))

    study = optuna.create_study(direction="maximize", sampler=optuna.samplers.GridSampler({"command": [0.1, 0.9]}))
    study.optimize(gain, n_trials=2)
    assert study.best_params == {"command": 0.9}
    env.close()
