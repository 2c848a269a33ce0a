"""PPO on many worms, by its trainer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import torch
from skrl.agents.torch.ppo import PPO
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer
from worm import EXTENSION, ID, N_STEP

import lattice_gym  # noqa: F401, registers the ids


class Actor(GaussianMixin, Model):
    """Means from what is seen, one spread an action."""

    def __init__(self, env: Any) -> None:
        Model.__init__(self, observation_space=env.observation_space, action_space=env.action_space, device="cpu")
        GaussianMixin.__init__(self, clip_actions=True)
        self.net = torch.nn.Linear(self.num_observations, self.num_actions)
        self.log_std = torch.nn.Parameter(torch.zeros(self.num_actions))

    def compute(self, inputs: dict[str, Any], role: str = "") -> tuple[torch.Tensor, dict[str, Any]]:
        """Mean, and the logarithm of the spread."""
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, Model):
    """Value of what is seen."""

    def __init__(self, env: Any) -> None:
        Model.__init__(self, observation_space=env.observation_space, action_space=env.action_space, device="cpu")
        DeterministicMixin.__init__(self)
        self.net = torch.nn.Linear(self.num_observations, 1)

    def compute(self, inputs: dict[str, Any], role: str = "") -> tuple[torch.Tensor, dict[str, Any]]:
        """Value."""
        return self.net(inputs["observations"]), {}


def test_ppo_learns_from_many_worms(tmp_path: Path) -> None:
    """Over the ends of episodes; weights change and stay finite."""
    env = wrap_env(gymnasium.make_vec(ID, num_envs=2, **EXTENSION))
    models: dict[str, Any] = {"policy": Actor(env), "value": Critic(env)}
    before = models["policy"].net.weight.detach().clone()
    settings: dict[str, Any] = {"rollouts": N_STEP, "learning_epochs": 1, "mini_batches": 2}
    settings["experiment"] = {"directory": str(tmp_path), "write_interval": 0, "checkpoint_interval": 0}
    agent = PPO(
        models=models,
        memory=RandomMemory(memory_size=N_STEP, num_envs=2, device="cpu"),
        observation_space=env.observation_space,
        action_space=env.action_space,
        device="cpu",
        cfg=settings,
    )
    trainer = SequentialTrainer(env=env, agents=agent, cfg={"timesteps": 3 * N_STEP, "headless": True})
    trainer.train()
    after = models["policy"].net.weight
    assert bool(torch.isfinite(after).all())
    assert bool((after != before).any())
    env.close()
