"""Activation laws and rewards from outside the package, as an environment takes and checks them."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from small_worms import N_SMALL, SMALL, same

from lattice_gym.checks import FloatArray
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.vector import LatticeWormVectorEnv
from lattice_gym.physics.laws.activation import Activation, FirstOrder, Thelen, Twitch
from lattice_gym.tasks.axial import AxialTask
from lattice_gym.tasks.base import RewardTerm

pytestmark = pytest.mark.slow


class Delayed(Activation):
    """The command of the step before."""

    n_state = 2
    most: ClassVar[float] = 1.0

    def advance(self, state: FloatArray, command: FloatArray, duration: float) -> FloatArray:
        """Move on by one command."""
        return np.stack([self.most * state[1], command])


@pytest.mark.parametrize(
    ("activation", "law"),
    [
        ("thelen", Thelen()),
        ({"law": "twitch", "contraction_time": 0.1}, Twitch(contraction_time=0.1)),
        (FirstOrder(rise_time=0.02), FirstOrder(rise_time=0.02)),
        ({"law": f"{__name__}:Delayed"}, Delayed()),
    ],
)
def test_activation_laws(activation: Any, law: Activation) -> None:
    """Each is followed from step to step, and begins anew with an episode; a copy goes on as the original does."""
    env = LatticeWormEnv("extension", design=SMALL, control="ring", activation=activation)
    for _ in range(2):
        env.reset(seed=0)
        state = law.rest(env.action_space.shape)
        for seed in range(3):
            action = np.random.default_rng(seed).random(env.action_space.shape)
            twin = copy.deepcopy(env)
            assert same([env.step(action)], [twin.step(action)])
            state = law.advance(state, action, 0.05)
            np.testing.assert_allclose(env.activation, state[0][env.groups], rtol=1e-12)


def test_an_activation_out_of_bounds_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a law of one's own gives it; the time step is for muscles that are active at most."""
    env = LatticeWormEnv("extension", design=SMALL, activation=Delayed())
    env.reset(seed=0)
    env.step(np.ones(env.action_space.shape))
    monkeypatch.setattr(Delayed, "most", 1.5)
    with pytest.raises(ValueError, match=r"^Delayed.advance: activations must stay from 0 to 1"):
        env.step(np.ones(env.action_space.shape))
    with pytest.raises(ValueError, match=r"^activation = 3: must be one of 'first_order'"):
        LatticeWormEnv("extension", design=SMALL, activation=3)


class Humble(AxialTask):
    """An extension that promises less than it pays."""

    name = "humble"
    layout = "all"
    time_limit = 10
    rewards: ClassVar[Mapping[str, RewardTerm]] = {"strain": RewardTerm(1.0, -1e-6, 1e-6)}
    sign = 1.0


@pytest.mark.parametrize("kind", ["one", "many"])
def test_a_reward_beyond_what_is_declared_warns_once(kind: str) -> None:
    """As a divergence may then pay; what the tasks of the package pay never does."""
    kwargs: dict[str, Any] = {"task": Humble, "design": SMALL, "reward_weights": {"effort": 0.0}}
    env: Any = LatticeWormEnv(**kwargs) if kind == "one" else LatticeWormVectorEnv(2, **kwargs)
    env.reset(seed=0)
    with pytest.warns(
        UserWarning, match=r"^humble: a reward of .* beyond the -1e-06 to 1e-06 that its `rewards` declare"
    ):
        env.step(np.ones(env.action_space.shape))
    env.step(np.ones(env.action_space.shape))


def test_a_reward_on_the_wrong_side_warns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Even where its size is less than the width of the range; NaN is an error that names the term."""
    env = LatticeWormEnv(Humble, design=SMALL)
    env.reset(seed=0)
    monkeypatch.setattr(Humble, "terms", lambda self, *_: {"strain": np.full(self.n_worm, np.nan)})
    with pytest.raises(ValueError, match=r"^Humble.terms: 'strain' is NaN"):
        env.step(np.zeros(env.action_space.shape))
    monkeypatch.setattr(Humble, "terms", lambda self, *_: {"strain": np.full(self.n_worm, -0.5)})
    monkeypatch.setattr(Humble, "rewards", {"strain": RewardTerm(1.0, 0.0, 1.0)})
    env = LatticeWormEnv(Humble, design=SMALL)
    env.reset(seed=0)
    with pytest.warns(UserWarning, match=r"^humble: a reward of -0.5 .* beyond the -0.01 to 1 that"):
        env.step(np.zeros(env.action_space.shape))


@pytest.mark.parametrize("law", [FirstOrder(rise_time=0.02), Thelen(), Twitch(), Delayed()])
def test_activation_laws_survive_json(law: Activation) -> None:
    """Given as objects, of the package or not."""
    made = gymnasium.make("LatticeWormExtension-v0", design=SMALL, activation=law)
    assert made.spec is not None
    again = gymnasium.make(EnvSpec.from_json(made.spec.to_json())).unwrapped
    assert isinstance(again, LatticeWormEnv)
    assert (type(again.scene.activation_law), again.scene.activation_law.to_dict()) == (type(law), law.to_dict())


@pytest.mark.parametrize(
    ("method", "given_", "message"),
    [
        ("advance", np.zeros(3), r"^Delayed.advance has shape \(3,\): must have \(2, 1, 21\)"),
        ("advance", None, r"^Delayed.advance = None"),
        ("rest", np.full((2, 1, 21), 2.0), r"^Delayed.rest: activations must stay from 0 to 1"),
        ("rest", np.zeros((2, 21)), r"^Delayed.rest has shape \(2, 21\): must have \(2, 1, 21\)"),
    ],
)
def test_what_a_law_from_outside_gives_is_checked(
    method: str, given_: Any, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it gives it."""
    monkeypatch.setattr(Delayed, method, lambda self, *_: given_)

    def play() -> None:
        env = LatticeWormEnv("extension", design=SMALL, muscles="all", activation=Delayed())
        env.reset(seed=0)
        env.step(np.ones(N_SMALL))

    with pytest.raises(ValueError, match=message):
        play()


def test_a_law_from_outside_may_write_to_its_state(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is given a copy."""

    def advance(_: Activation, state: FloatArray, command: FloatArray, duration: float) -> FloatArray:
        state[0] = command
        return state

    monkeypatch.setattr(Delayed, "advance", advance)
    env = LatticeWormEnv("extension", design=SMALL, activation=Delayed())
    env.reset(seed=0)
    before = env.worms.group_activation
    env.step(np.ones(env.action_space.shape))
    assert before.max() == 0.0
    assert env.activation.min() == 1.0
