"""Actions in another range than that of commands: the same worm, to the last bit, whichever way it is told."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any, cast

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.wrappers import RescaleAction
from stable_baselines3 import PPO

from agents import run_folder
from agents.config import TrainConfig
from agents.environments import make_env
from lattice_gym import LatticeWormEnv, LatticeWormVectorEnv, gait, group_means
from lattice_gym.envs.actions import to_action, to_command
from lattice_gym.policies.baselines import DoNothing, RandomActions
from lattice_gym.sb3 import WormVecEnv

ID = "LatticeWormExtension-v0"
FAST: dict[str, Any] = {"fidelity": "fast", "control": "ring"}
N_ACTION = 8


def _episode(env: Any, actions: Any, shape: tuple[int, ...] = ()) -> list[Any]:
    """Return what an episode of these actions tells, one row of them a step."""
    told: list[Any] = [env.reset(seed=3)]
    for action in actions:
        told.append(env.step(np.broadcast_to(action, (*shape, N_ACTION))))
    return told


def _commands(dtype: npt.DTypeLike = np.float32) -> Any:
    return np.random.default_rng(0).uniform(0.0, 1.0, (12, N_ACTION)).astype(dtype)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_default_is_from_zero_to_one(dtype: npt.DTypeLike) -> None:
    """The commands themselves, to the last bit."""
    env, told = LatticeWormEnv("extension", **FAST), LatticeWormEnv("extension", action_range=(0, 1), **FAST)
    assert env.action_space == told.action_space == gymnasium.spaces.Box(0.0, 1.0, (N_ACTION,), np.float32)
    assert env.action_range == told.action_range == (0.0, 1.0)
    commands = _commands(dtype)
    assert repr(_episode(env, commands)) == repr(_episode(told, commands))
    np.testing.assert_array_equal(env.worms.previous_action[0], commands[-1])
    np.testing.assert_array_equal(env.action_of(commands[0]), commands[0])


@pytest.mark.parametrize(
    ("ends", "dtype"),
    [
        ((-1, 1), np.float32),
        ((-1, 1), np.float64),
        ((-3.0, 0.7), np.float32),  # in float64 gymnasium itself rounds such ends to float32
        ((5, 6.5), np.float32),
        ((-0.1, 0.1), np.float32),
    ],
)
def test_it_is_what_gymnasium_rescales(ends: Any, dtype: npt.DTypeLike) -> None:
    """One worm, and each of several, as in a RescaleAction around commands."""
    low, high = np.float32(ends[0]), np.float32(ends[1])
    env = gymnasium.make(ID, action_range=ends, **FAST)
    twin = RescaleAction(gymnasium.make(ID, **FAST), low, high)
    assert env.action_space == twin.action_space
    actions = np.random.default_rng(1).uniform(low, high, (12, N_ACTION)).astype(dtype)
    told = _episode(env, actions)
    assert repr(told) == repr(_episode(twin, actions))
    many = gymnasium.make_vec(ID, num_envs=2, action_range=ends, **FAST)
    assert many.single_action_space == env.action_space
    assert many.action_space.shape == (2, N_ACTION)
    for one, both in zip(told[1:], _episode(many, actions, (2,))[1:], strict=True):
        np.testing.assert_array_equal(both[0][0], one[0])
        assert both[1][0] == one[1]


@pytest.mark.parametrize("ends", [(-1, 1), (-3.0, 0.7), (-0.1, 0.1), (1e5, 1e5 + 1)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.longdouble])
def test_ends_are_zero_and_one(ends: Any, dtype: npt.DTypeLike) -> None:
    """And nothing that the space holds leaves them or counts as clipped."""
    env = LatticeWormEnv("extension", action_range=ends, **FAST)
    low, high = env.action_space.low, env.action_space.high
    for action, command, clipped in ((low, 0.0, 0), (high, 1.0, 0), (low - 1.0, 0.0, 8), (high + 1.0, 1.0, 8)):
        commands, n_clipped = to_command(action.astype(dtype), (N_ACTION,), env.action_range)
        np.testing.assert_array_equal(commands, command)
        assert n_clipped == clipped
    env.action_space.seed(0)
    for _ in range(200):
        commands, n_clipped = to_command(env.action_space.sample(), (N_ACTION,), env.action_range)
        assert n_clipped == 0
        assert ((commands >= 0.0) & (commands <= 1.0)).all()


def test_whole_numbers_are_actions() -> None:
    """As integers, and as a list."""
    for action in (np.array([-1, 0, 1, 2] * 2), [-1, 0, 1, 2] * 2):
        command, n_clipped = to_command(action, (8,), (-1.0, 1.0))
        assert command.tolist() == [0.0, 0.5, 1.0, 1.0] * 2
        assert n_clipped == 2


def test_what_is_told_is_in_commands() -> None:
    """The observed previous action, clipped counts and gaits say which they are."""
    observed = ["activation", "previous_action"]
    env = LatticeWormEnv("extension", action_range=(-1, 1), observation=observed, **FAST)
    env.reset(seed=0)
    seen, _, _, _, info = env.step(np.array([-2.0, -1.0, 0.0, 0.5, 1.0, 3.0, 0.0, 0.0]))
    assert info["clipped_actions"] == 2
    np.testing.assert_array_equal(seen[N_ACTION:], [0.0, 0.0, 0.5, 0.75, 1.0, 1.0, 0.5, 0.5])
    np.testing.assert_array_equal(env.action_of([0.0, 0.25, 1.0]), [-1.0, -0.5, 1.0])


def test_a_gait_drives_worms_of_any_range() -> None:
    """By the action of its commands: the same episode to rounding, for one worm and for several."""
    outcomes = []
    for ends in ((0, 1), (-1, 1), (-7, 2)):
        env: Any = LatticeWormEnv("extension", action_range=ends, **FAST)
        env.reset(seed=0)
        wave = gait("extension", env.lattice, env.layout, {})
        for _ in range(20):
            *_, info = env.step(env.action_of(group_means(wave(env.time), env.groups)))
        outcomes.append(info["outcome"]["strain"])
    assert outcomes[0] > 0.05
    np.testing.assert_allclose(outcomes, outcomes[0], rtol=1e-9)
    many = LatticeWormVectorEnv(2, task="extension", action_range=(-1, 1), **FAST)
    assert many.action_of(np.zeros((2, N_ACTION))).tolist() == [[-1.0] * N_ACTION] * 2


def test_a_specification_keeps_it() -> None:
    """Through JSON, through a deep copy, and for goals."""
    env = gymnasium.make("LatticeWormReachGoal-v0", action_range=(-1, 1), **FAST | {"control": "column"})
    assert env.spec is not None
    again: Any = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.action_space == env.action_space
    assert copy.deepcopy(again).unwrapped.action_range == (-1.0, 1.0)


@pytest.mark.parametrize(
    "given",
    [None, 1, (1,), (1, -1), (0, 0), (0, 1, 2), (0, np.inf), (np.nan, 1), "01", (1e5, 1e5 + 1e-6), {0, 1}, (-1e7, 0)],
)
def test_what_is_no_range_is_refused(given: Any) -> None:
    """By name, for one worm and for many."""
    for make in (LatticeWormEnv, LatticeWormVectorEnv):
        with pytest.raises(ValueError, match=r"^action_range\b"):
            make(task="extension", action_range=given, **FAST)


def test_array_is_a_range() -> None:
    """Of any kind of number."""
    assert LatticeWormEnv("extension", action_range=np.array([-1, 1]), **FAST).action_range == (-1.0, 1.0)


def test_first_actions_of_ppo() -> None:
    """Two thirds are clipped from 0 to 1 and a third from -1 to 1, as of a Gaussian around 0."""
    shares = {}
    for ends in ((0, 1), (-1, 1)):
        env = gymnasium.make("LatticeWorm-v0", action_range=ends, fidelity="fast")
        model = PPO("MlpPolicy", env, n_steps=8, batch_size=8, seed=0, device="cpu")
        observation, _ = env.reset(seed=0)
        actions = np.array([model.predict(observation)[0] for _ in range(200)])
        shares[ends] = np.isin(actions, ends).mean()
    assert shares[0, 1] == pytest.approx(0.5 + 0.159, abs=0.03)
    assert shares[-1, 1] == pytest.approx(0.317, abs=0.03)


@pytest.mark.parametrize("ends", [(0, 1), (-2, 2)])
def test_stable_baselines_sees_minus_one_to_one(ends: Any) -> None:
    """The adapter's actions lie there whatever the worms' range, and mean the same."""
    same_step = gymnasium.vector.AutoresetMode.SAME_STEP
    made = [
        WormVecEnv(LatticeWormVectorEnv(2, None, same_step, task="extension", action_range=each, **FAST))
        for each in (ends, (-1, 1))
    ]
    generator = np.random.default_rng(0)
    for venv in made:
        venv.seed(5)
        venv.reset()
    for _ in range(5):
        actions = generator.uniform(-1.0, 1.0, (2, N_ACTION)).astype(np.float32)
        one, other = (cast(Any, venv.step(actions)) for venv in made)
        np.testing.assert_allclose(one[0], other[0], atol=1e-6)
    assert made[0].action_space == made[1].action_space


def test_training_takes_a_range(tmp_path: Path) -> None:
    """From the file of further arguments; by default an episode's environment takes what the learner gives."""
    env: Any = make_env(run_folder.requested_arguments(TrainConfig(task="extension")))
    assert env.action_space.low[0] == -1.0
    file = tmp_path / "further.json"
    file.write_text(json.dumps({"action_range": [-2, 2]}))
    env = make_env(run_folder.requested_arguments(TrainConfig(task="extension", environment=file)))
    env.reset(seed=0)
    assert env.action_space.low[0] == -2.0
    nothing, chance = DoNothing(), RandomActions()
    nothing.reset(env, 0)
    assert (nothing(None) == -2.0).all()
    chance.reset(env, 0)
    drawn = np.array([chance(None) for _ in range(9)])
    assert -2.0 <= drawn.min() < -1.5
    assert 1.5 < drawn.max() <= 2.0


def test_there_and_back() -> None:
    """The action of a command stands for that command."""
    commands = _commands(np.float64)
    for ends in ((-1.0, 1.0), (-3.0, 0.75)):
        back, n_clipped = to_command(to_action(commands, ends), commands.shape, ends)
        assert not n_clipped.any()
        np.testing.assert_allclose(back, commands, rtol=0.0, atol=1e-15)
