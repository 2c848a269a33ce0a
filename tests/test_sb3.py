"""Worms of a vector environment behind Stable-Baselines3's VecEnv, beside its own wrapping of single worms."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any, cast

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import RescaleAction
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecNormalize

from agents.config import InputError
from agents.environments import make_env, make_vector_env
from lattice_gym import LatticeWormVectorEnv
from lattice_gym.sb3 import WormVecEnv

pytestmark = pytest.mark.slow

IDS = sorted(name for name in gymnasium.registry if name.startswith("LatticeWorm"))
GOAL = "LatticeWormReachGoal-v0"
COMMANDS = {"azimuth": [0.0, 1.0, 2.0]}  # one is drawn for each episode


class Judged(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Adds the outcome by the command, which the adapter tells at the end of an episode."""

    def step(self, action: Any) -> Any:
        """Take a step of the worm."""
        *told, info = self.env.step(action)
        task = cast(Any, self.unwrapped).task
        info["outcome_errors"] = task.errors(info["outcome"], task.command)
        return *told, info


def _arguments(name: str, **others: Any) -> dict[str, Any]:
    return {"id": name, "control": "column", "fidelity": "fast"} | others


def _together(arguments: Mapping[str, Any], n_envs: int) -> VecEnv:
    """Worms of the vector environment, seen to be an adapter's."""
    venv = make_vector_env(arguments, n_envs)
    assert isinstance(venv.unwrapped, WormVecEnv)
    return venv


def _apart(arguments: Mapping[str, Any], n_envs: int) -> VecEnv:
    def one() -> Monitor:
        return Monitor(RescaleAction(Judged(make_env(arguments)), np.float32(-1.0), np.float32(1.0)))

    return DummyVecEnv([one] * n_envs)


def _starts(apart: VecEnv) -> list[dict[str, Any]]:
    """Return what single worms tell of their start, but for the outcome."""
    return [{name: value for name, value in info.items() if name != "outcome"} for info in apart.reset_infos]


def _copy(values: Any) -> Any:
    return {name: part.copy() for name, part in values.items()} if isinstance(values, dict) else values.copy()


@pytest.mark.parametrize(
    "arguments",
    [
        _arguments("LatticeWormBending-v0", command=COMMANDS, max_episode_steps=5),
        _arguments("LatticeWormExtension-v0", control="ring", design={"max_tension": 50.0}),  # these blow up
        _arguments("LatticeWormExtension-v0", control="ring", adaptation={}, max_episode_steps=4),
        _arguments(
            "LatticeWormReach-v0",
            max_episode_steps=4,
            randomise={"damping": (0.5, 2.0), "strength": (0.8, 1.2)},
            adaptation={"fatigue_rate": 0.5, "strain_gain": 0.5, "mode": "episode", "carry": True},
        ),
        _arguments(GOAL, max_episode_steps=5),
        _arguments(GOAL, design={"max_tension": 50.0}),
    ],
)
def test_worms_together_are_worms_apart(arguments: dict[str, Any]) -> None:
    """The same seeds and actions give the same numbers, to the last bit, over several episodes."""
    together, apart = _together(arguments, 3), _apart(arguments, 3)
    shape = (3, *(together.action_space.shape or ()))
    assert together.observation_space == apart.observation_space
    assert together.action_space == apart.action_space
    for venv in (together, apart):
        assert list(venv.seed(7)) == [7, 8, 9]
    _assert_same(together.reset(), apart.reset())
    _assert_same(together.unwrapped.reset_infos, _starts(apart))
    generator = np.random.default_rng(0)
    ended, kept = np.zeros(3, dtype=int), []
    for _ in range(16):
        actions = generator.uniform(-1.0, 1.0, shape).astype(np.float32)
        (seen, rewards, dones, infos), others = together.step(actions), apart.step(actions)
        _assert_same(seen, others[0])
        _assert_same(rewards, others[1])
        _assert_same(dones, others[2])
        for done, info, other in zip(dones, infos, others[3], strict=True):
            if done:
                assert info["episode"].pop("t") > 0.0
                other["episode"].pop("t")
                assert info["episode"].pop("r") == pytest.approx(other["episode"].pop("r"), abs=2e-6)  # both rounded
                _assert_same(info, other)
            else:
                terms = {"reward_terms": other["reward_terms"]}
                _assert_same(info, terms if arguments["id"] == GOAL else {})
        _assert_same(together.unwrapped.reset_infos, _starts(apart))
        ended += dones
        kept.append((seen, _copy(seen)))
    assert (ended >= 2).all()
    for seen, then in kept:  # what the learner holds is its own
        _assert_same(seen, then)
    together.close()
    apart.close()


def _assert_same(one: Any, other: Any) -> None:
    """Compare nested values, their names and the types of arrays."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for name, values in one.items():
            _assert_same(values, other[name])
    elif isinstance(one, list):
        assert len(one) == len(other)
        for part, counterpart in zip(one, other, strict=True):
            _assert_same(part, counterpart)
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    else:
        assert one == other


def test_seeds_and_options_are_for_one_reset() -> None:
    """Each worm has its own; what was given is used once."""
    arguments = _arguments("LatticeWormBending-v0", command=COMMANDS)
    together, apart = _together(arguments, 3), _apart(arguments, 3)
    for options in ({"azimuth": 0.5}, [{"azimuth": 0.1}, {}, {"azimuth": 0.3}], [{}, {}, {"azimuth": 0.3}], None):
        for venv in (together, apart):
            venv.seed(11)
            venv.set_options(options)
        _assert_same(together.reset(), apart.reset())
        _assert_same(together.unwrapped.reset_infos, _starts(apart))
    for options in ([{"azimuth": 0.1}, {}, {"azimuth": 0.3}], [{}, {}, {"azimuth": 0.3}], None):
        for venv in (together, apart):
            venv.set_options(options)  # without seeds: each worm goes on drawing
        _assert_same(together.reset(), apart.reset())
        _assert_same(together.unwrapped.reset_infos, _starts(apart))
    together.seed(11)
    starts: list[Any] = [together.reset() for _ in range(5)]
    assert any((starts[0] != start).any() for start in starts)
    together.close()
    apart.close()


def test_methods_of_worms() -> None:
    """One call for each worm asked for, by index as in DummyVecEnv."""
    venv = _together(_arguments(GOAL), 3)
    assert [venv.has_attr("compute_reward"), venv.has_attr("compute_regret")] == [True, False]
    assert venv.get_attr("render_mode", indices=[0, 2]) == [None, None]
    assert venv.env_is_wrapped(Monitor) == [True] * 3
    assert venv.env_is_wrapped(gymnasium.wrappers.TimeLimit, indices=[0]) == [False]
    goals = np.zeros((5, 3), dtype=np.float32)
    (rewards,) = venv.env_method("compute_reward", goals, goals, None, indices=[0])
    assert rewards.shape == (5,)
    assert len(venv.env_method("compute_reward", goals, goals, info=None)) == 3
    venv.close()


def test_attributes_are_shared() -> None:
    """One value for all worms, which is not set for some of them."""
    venv = _together(_arguments(GOAL), 3)
    venv.set_attr("note", "there")
    assert venv.get_attr("note", indices=[0, 2]) == ["there", "there"]
    with pytest.raises(ValueError, match=r"^indices = \[1\]: must be None, as all worms share note"):
        venv.set_attr("note", "here", indices=[1])
    venv.close()


def test_pictures_are_tiled() -> None:
    """One of each worm, two by two in one; none without a render mode."""
    venv = _together(_arguments("LatticeWormExtension-v0", control="ring", render_mode="rgb_array"), 2)
    assert venv.unwrapped.render_mode == "rgb_array"
    venv.reset()
    pictures = venv.get_images()
    assert [picture.shape for picture in pictures if picture is not None] == [(480, 640, 3)] * 2
    tiled = venv.unwrapped.render()
    assert tiled is not None
    np.testing.assert_array_equal(tiled[:480, :640], pictures[0])
    venv.close()
    blind = _together(_arguments("LatticeWormExtension-v0", control="ring"), 2)
    assert blind.get_images() == [None, None]
    blind.close()


def test_what_is_no_vector_of_worms_is_refused() -> None:
    """One clear error names what was given."""
    same_step: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP}
    worms = _arguments("LatticeWormExtension-v0", control="ring")
    for other in (
        make_env(worms),
        gymnasium.make_vec(**worms, vectorization_mode="sync", vector_kwargs=same_step),
        gymnasium.make_vec("CartPole-v1", vectorization_mode="sync", vector_kwargs=same_step),
    ):
        with pytest.raises(ValueError, match=r"^envs = .*: must be a LatticeWormVectorEnv, or a wrapper of one"):
            WormVecEnv(cast(Any, other))
    assert WormVecEnv(LatticeWormVectorEnv(2, task="extension", fidelity="fast", **same_step)).num_envs == 2
    with pytest.raises(ValueError, match=r"^envs: autoreset_mode must be AutoresetMode\.SAME_STEP, got .*NEXT_STEP"):
        WormVecEnv(gymnasium.make_vec(**worms))
    with pytest.raises(InputError, match="muscles = 'wings'"):
        make_vector_env(_arguments("LatticeWorm-v0", muscles="wings"), 2)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda venv: venv.step(np.zeros((2, 7))), r"actions: shape must be \(2, 8\), got \(2, 7\)"),
        (lambda venv: venv.step(np.zeros(8)), r"actions: shape must be \(2, 8\), got \(8,\)"),
        (lambda venv: venv.set_options([{}]), "options: must be one dict, or a list of one for each of 2 worms"),
        (lambda venv: venv.set_options([{}, None]), "options: must be one dict, or a list of one for each of 2 worms"),
        (lambda venv: venv.set_options("none"), "options: must be one dict, or a list of one for each of 2 worms"),
    ],
)
def test_what_does_not_fit_the_worms_is_refused(ask: Callable[[VecEnv], object], message: str) -> None:
    """Nothing is broadcast or left out."""
    venv = make_vector_env(_arguments("LatticeWormExtension-v0", control="ring"), 2).unwrapped
    venv.reset()
    with pytest.raises(ValueError, match=f"^{message}"):
        ask(venv)
    venv.close()


@pytest.mark.parametrize("name", [name for name in IDS if name != GOAL])
def test_ppo_learns_on_every_id(name: str) -> None:
    """Two short updates on two worms, over the end of an episode."""
    venv = VecNormalize(make_vector_env(_arguments(name, max_episode_steps=12), 2))
    model = PPO("MlpPolicy", venv, n_steps=16, batch_size=32, n_epochs=2, seed=0, device="cpu")
    before = {part: values.clone() for part, values in model.policy.state_dict().items()}
    model.learn(64)
    assert len(model.ep_info_buffer or ()) == 4
    assert any(not bool((before[part] == values).all()) for part, values in model.policy.state_dict().items())
    venv.close()


def test_hindsight_replay_pays_what_the_worm_would_have(monkeypatch: pytest.MonkeyPatch) -> None:
    """SAC learns from relabelled goals, and a replayed step that kept its own goal is paid as it was."""
    venv = make_vector_env(_arguments(GOAL, max_episode_steps=20), 2)
    model = SAC(
        "MultiInputPolicy",
        venv,
        learning_starts=80,
        batch_size=64,
        train_freq=4,
        policy_kwargs={"net_arch": [32, 32]},
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"copy_info_dict": True},
        buffer_size=1000,
        seed=0,
        device="cpu",
    )
    model.learn(400)
    assert model.num_timesteps == 400
    buffer = model.replay_buffer
    assert isinstance(buffer, HerReplayBuffer)
    assert model._n_updates > 0
    assert all(info["reward_terms"]["effort"] <= 0.0 for info in buffer.infos[:200].ravel())
    relabelled = buffer.sample(64)
    assert bool((relabelled.observations["desired_goal"] != relabelled.observations["desired_goal"][-1]).any())

    def own_goals(steps: Any, worms: Any) -> Any:
        return buffer.observations["desired_goal"][steps, worms]

    monkeypatch.setattr(buffer, "_sample_goals", own_goals)
    steps, worms = np.repeat(np.arange(190), 2), np.tile(np.arange(2), 190)
    replayed = buffer._get_virtual_samples(steps, worms)
    np.testing.assert_array_equal(replayed.rewards.numpy().ravel(), buffer.rewards[steps, worms])
    venv.close()


def test_scores_are_those_of_stable_baselines() -> None:
    """Its own evaluation takes the episode sums, without a warning that they are missing."""
    venv = make_vector_env(_arguments("LatticeWormExtension-v0", control="ring", max_episode_steps=6), 2)
    model = PPO("MlpPolicy", venv, n_steps=16, batch_size=32, seed=0, device="cpu")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        returns, lengths = evaluate_policy(model, venv, n_eval_episodes=3, return_episode_rewards=True)
    assert isinstance(returns, list)
    assert lengths == [6, 6, 6]
    venv.close()
