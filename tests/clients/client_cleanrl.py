"""A loop in the style of its ppo_continuous_action.py (it is no package), with the wrappers that it uses."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import wrappers
from worm import EXTENSION, ID, N_STEP

import lattice_gym  # noqa: F401, registers the ids

N_ENVS = 2


def _make(gamma: float = 0.99) -> gymnasium.Env[Any, Any]:
    """One worm as CleanRL wraps it."""
    env: Any = wrappers.FlattenObservation(gymnasium.make(ID, **EXTENSION))
    env = wrappers.ClipAction(wrappers.RecordEpisodeStatistics(env))
    env = wrappers.NormalizeObservation(env)
    env = wrappers.TransformObservation(env, lambda seen: np.clip(seen, -10, 10), env.observation_space)
    env = wrappers.NormalizeReward(env, gamma=gamma)
    return wrappers.TransformReward(env, lambda reward: min(max(float(reward), -10.0), 10.0))


class Agent(torch.nn.Module):
    """Critic and Gaussian actor."""

    def __init__(self, n_seen: int, n_action: int) -> None:
        super().__init__()
        self.critic = torch.nn.Sequential(torch.nn.Linear(n_seen, 64), torch.nn.Tanh(), torch.nn.Linear(64, 1))
        self.mean = torch.nn.Sequential(torch.nn.Linear(n_seen, 64), torch.nn.Tanh(), torch.nn.Linear(64, n_action))
        self.log_std = torch.nn.Parameter(torch.zeros(1, n_action))

    def act(self, seen: torch.Tensor, action: torch.Tensor | None = None) -> tuple[torch.Tensor, ...]:
        """Return an action, its log-probability, and the value of what is seen."""
        law = torch.distributions.Normal(self.mean(seen), self.log_std.exp())
        action = law.sample() if action is None else action
        return action, law.log_prob(action).sum(1), self.critic(seen).flatten()


@pytest.mark.parametrize("together", [False, True])
def test_an_update_of_ppo(together: bool) -> None:
    """Over the ends of episodes: single worms in gymnasium's own vector environment, or this package's."""
    torch.manual_seed(0)
    if together:
        envs: Any = gymnasium.make_vec(ID, num_envs=N_ENVS, **EXTENSION)
        envs = wrappers.vector.RecordEpisodeStatistics(wrappers.vector.ClipAction(envs))
    else:
        envs = gymnasium.vector.SyncVectorEnv([_make] * N_ENVS)
    agent = Agent(envs.single_observation_space.shape[0], envs.single_action_space.shape[0])
    optimiser = torch.optim.Adam(agent.parameters(), lr=3e-4)
    seen, _ = envs.reset(seed=1)
    rows: list[tuple[torch.Tensor, ...]] = []
    n_ended = 0
    for _ in range(2 * N_STEP + 2):
        now = torch.as_tensor(np.asarray(seen), dtype=torch.float32)
        with torch.no_grad():
            action, log_prob, value = agent.act(now)
        seen, reward, terminated, truncated, infos = envs.step(action.numpy())
        ended = np.logical_or(terminated, truncated)
        if "episode" in infos:
            n_ended += int((infos["_episode"] & (infos["episode"]["l"] == N_STEP)).sum())
        rows.append((now, action, log_prob, value, torch.as_tensor(reward), torch.as_tensor(ended)))
    assert n_ended == 2 * N_ENVS
    observed, actions, log_probs, values, rewards, ends = (torch.stack(column) for column in zip(*rows, strict=True))
    gains = torch.zeros_like(values)
    for k in reversed(range(len(rows) - 1)):
        gains[k] = rewards[k] + 0.99 * gains[k + 1] * ~ends[k]
    before = [part.clone() for part in agent.parameters()]
    for _ in range(2):
        _, new_log_probs, new_values = agent.act(observed.flatten(0, 1), actions.flatten(0, 1))
        ratio, better = (new_log_probs - log_probs.flatten()).exp(), (gains - values).flatten()
        policy_loss = torch.max(-better * ratio, -better * ratio.clamp(0.8, 1.2)).mean()
        loss = policy_loss + 0.5 * ((new_values - gains.flatten()) ** 2).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert bool(torch.isfinite(loss))
    assert any(bool((old != new).any()) for old, new in zip(before, agent.parameters(), strict=True))
    envs.close()
