"""Hindsight replay that keeps no infos would learn another reward: it is refused, by one worm and by many."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import RescaleAction
from stable_baselines3 import SAC, HerReplayBuffer

from agents.environments import make_vector_env
from lattice_gym import LatticeWormGoalEnv, LatticeWormGoalVectorEnv

ARGUMENTS: dict[str, Any] = {"control": "column", "fidelity": "fast"}
MISSING = r"^info: has no reward_terms.* HerReplayBuffer copy_info_dict=True"


def _alone() -> Any:
    env = gymnasium.make("LatticeWormReachGoal-v0", max_episode_steps=5, **ARGUMENTS)
    return RescaleAction(env, np.float32(-1.0), np.float32(1.0))


def _together() -> Any:
    return make_vector_env({"id": "LatticeWormReachGoal-v0", "max_episode_steps": 5, **ARGUMENTS}, 2)


@pytest.mark.parametrize("make", [_alone, _together])
def test_replay_without_infos_is_refused(make: Any) -> None:
    """The default of `HerReplayBuffer` ends at the first relabelled batch, with what to change."""
    model = SAC(
        "MultiInputPolicy",
        make(),
        replay_buffer_class=HerReplayBuffer,
        learning_starts=10,
        batch_size=8,
        policy_kwargs={"net_arch": [8]},
        buffer_size=100,
        seed=0,
    )
    with pytest.raises(ValueError, match=MISSING):
        model.learn(20)


@pytest.mark.parametrize("make", [LatticeWormGoalEnv, LatticeWormGoalVectorEnv])
def test_an_info_without_terms_is_refused(make: Any) -> None:
    """An empty info, that of a reset, and one among sound ones; None says that only the goals shall count."""
    env = make(**ARGUMENTS)
    goals, paid = np.ones((2, 3), dtype=np.float32), {"reward_terms": {"approach": 0.5, "effort": -0.25}}
    began = {"command": {}, "status": "ok"}
    wrong: list[Any] = [{}, began, [{}, {}], [paid, {}], np.array([{}, {}]), [None, {}]]
    for infos in wrong:
        with pytest.raises(ValueError, match=MISSING):
            env.compute_reward(goals, goals, infos)
    with pytest.raises(ValueError, match=MISSING):
        env.compute_reward(goals[0], goals[0], {})
    plain: Any = env.compute_reward(goals, goals, None)
    np.testing.assert_array_equal(env.compute_reward(goals, goals, [None, paid]), plain + np.array([0.0, -0.25]))
