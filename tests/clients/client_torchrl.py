"""Rolls out one worm and many, collects batches, and takes a step of PPO on them."""

from __future__ import annotations

import gymnasium
import pytest
import torch
from gymnasium.vector import AutoresetMode
from tensordict.nn import InteractionType, TensorDictModule
from tensordict.nn.distributions import NormalParamExtractor
from torchrl.envs import GymEnv, GymWrapper
from torchrl.envs.utils import check_env_specs
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE
from worm import EXTENSION, ID, N_STEP

import lattice_gym  # noqa: F401, registers the ids


def test_one_worm() -> None:
    """By its id; specifications hold, and an episode has its length."""
    env = GymEnv(ID, **EXTENSION)
    check_env_specs(env)
    assert env.rollout(3 * N_STEP).batch_size == torch.Size([N_STEP])
    env.close()


def test_many_worms_and_a_step_of_ppo() -> None:
    """They reset where torchrl asks for it, as it prefers; weights change and stay finite."""
    env = GymWrapper(gymnasium.make_vec(ID, num_envs=2, autoreset_mode=AutoresetMode.DISABLED, **EXTENSION))
    n_seen, n_action = env.observation_spec["observation"].shape[-1], env.action_spec.shape[-1]
    layer = torch.nn.Linear(n_seen, 2 * n_action)
    net = torch.nn.Sequential(layer, NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(net, ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": 0.0, "high": 1.0},
        return_log_prob=True,
        default_interaction_type=InteractionType.RANDOM,
    )
    critic = ValueOperator(torch.nn.Linear(n_seen, 1), in_keys=["observation"])
    with torch.no_grad():
        batch = env.rollout(2 * N_STEP, actor, break_when_any_done=False)
    assert batch.batch_size == torch.Size([2, 2 * N_STEP])
    assert int(batch["next", "truncated"].sum()) == 4
    before = layer.weight.detach().clone()
    optimiser = torch.optim.Adam([*net.parameters(), *critic.parameters()])
    GAE(gamma=0.99, lmbda=0.95, value_network=critic)(batch)
    losses = ClipPPOLoss(actor, critic)(batch.reshape(-1))
    sum(value for name, value in losses.items() if name.startswith("loss_")).backward()
    optimiser.step()
    assert bool(torch.isfinite(layer.weight).all())
    assert bool((layer.weight != before).any())
    env.close()


def test_a_mode_that_torchrl_has_no_use_for_is_refused() -> None:
    """It reads the mode as an attribute, and says so."""
    with pytest.raises(RuntimeError, match="must be one of SAME_STEP or DISABLED"):
        GymWrapper(gymnasium.make_vec(ID, num_envs=2, **EXTENSION))
