"""An iteration of PPO on worms registered with Ray, in the process that starts it."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.tune.registry import register_env
from worm import EXTENSION, ID, N_STEP

import lattice_gym  # noqa: F401, registers the ids


def test_an_iteration_of_ppo() -> None:
    """It counts whole episodes and a finite return."""
    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False)
    register_env("worm", lambda settings: gymnasium.make(ID, **EXTENSION, **settings))
    config = (
        PPOConfig()
        .environment("worm", env_config={"control_dt": 0.05})
        .env_runners(num_env_runners=0, num_envs_per_env_runner=2, rollout_fragment_length=2 * N_STEP)
        .training(train_batch_size_per_learner=4 * N_STEP, minibatch_size=N_STEP, num_epochs=1)
        .learners(num_learners=0, num_gpus_per_learner=0)
    )
    algorithm: Any = config.build_algo()
    result = algorithm.train()["env_runners"]
    assert result["episode_len_mean"] == N_STEP
    assert np.isfinite(result["episode_return_mean"])
    algorithm.stop()
    ray.shutdown()
