"""PPO on single worms in its own vector environment."""

from __future__ import annotations

from typing import Any

import gymnasium
import torch
from tianshou.algorithm.modelfree.ppo import PPO
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.trainer import OnPolicyTrainerParams
from tianshou.utils.net.common import Net
from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic
from worm import EXTENSION, ID, N_STEP

import lattice_gym  # noqa: F401, registers the ids


def test_ppo_trains_and_is_tested() -> None:
    """One epoch; whole episodes come out of it."""
    env = gymnasium.make(ID, **EXTENSION)
    seen: Any = env.observation_space.shape
    moved: Any = env.action_space.shape
    actor = ContinuousActorProbabilistic(
        preprocess_net=Net(state_shape=seen, hidden_sizes=[16]), action_shape=moved, unbounded=True
    )
    critic = ContinuousCritic(preprocess_net=Net(state_shape=seen, hidden_sizes=[16]))
    policy = ProbabilisticActorPolicy(
        actor=actor,
        dist_fn=lambda parts: torch.distributions.Independent(torch.distributions.Normal(*parts), 1),
        action_space=env.action_space,
    )
    algorithm = PPO(policy=policy, critic=critic, optim=AdamOptimizerFactory(lr=1e-3))
    worms = [DummyVectorEnv([lambda: gymnasium.make(ID, **EXTENSION)] * 2) for _ in range(2)]
    result = algorithm.run_training(
        OnPolicyTrainerParams(
            training_collector=Collector(algorithm, worms[0], VectorReplayBuffer(8 * N_STEP, 2)),
            test_collector=Collector(algorithm, worms[1]),
            max_epochs=1,
            epoch_num_steps=4 * N_STEP,
            collection_step_num_env_steps=2 * N_STEP,
            update_step_num_repetitions=1,
            batch_size=N_STEP,
            test_step_num_episodes=2,
            test_in_training=False,
            show_progress=False,
        )
    )
    assert result.train_step == 4 * N_STEP
    assert result.test_episode >= 2
    assert -1.0 < result.best_reward < 1.0 + N_STEP
    env.close()
