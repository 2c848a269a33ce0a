"""Strength that changes with use: the closed-form curves, and what the environment makes of them."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from small_worms import SMALL

from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.goal import LatticeWormGoalEnv
from lattice_gym.physics.laws.adaptation import Adaptation, Strength
from lattice_gym.physics.measures import muscle_strain
from lattice_gym.physics.worm import build_model

pytestmark = pytest.mark.slow

USE: dict[str, Any] = {"activation": [0.0, 0.5, 1.0], "tension": [0.0, 1.0, 2.0], "strain": [0.0, -0.2, 0.3]}


def after(adaptation: Adaptation, n_step: int, duration: float, strength: Strength | None = None) -> Strength:
    """Strength after constant use."""
    strength = adaptation.initial(3) if strength is None else strength
    for _ in range(n_step):
        strength = adaptation.advance(strength, **USE, duration=duration)
    return strength


def test_use_raises_strength_along_the_curve() -> None:
    """After n episodes min(alpha^n, cap), with alpha = 1 + beta |strain| + gamma force; in either mode."""
    gains: dict[str, Any] = {"strain_gain": 0.4, "force_gain": 0.05, "cap": 1.9, "carry": True}
    alpha = 1.0 + 0.4 * np.array([0.0, 0.2, 0.3]) + 0.05 * np.array([0.0, 1.0, 2.0])
    each, always = Adaptation(**gains, mode="episode"), Adaptation(**gains, episode=2.0)
    one, other = each.initial(3), always.initial(3)
    for n in range(1, 6):
        one, other = after(each, 40, 0.05, one), after(always, 40, 0.05, other)
        np.testing.assert_allclose(one.factor, np.minimum(alpha ** (n - 1), 1.9), rtol=1e-12)
        one, other = each.at_reset(one), always.at_reset(other)
        for strength in (one, other):
            np.testing.assert_allclose(strength.factor, np.minimum(alpha**n, 1.9), rtol=1e-12)
    assert one.factor[2] == 1.9


def test_an_episode_counts_its_means() -> None:
    """Half an episode of rest halves alpha - 1; one without a step changes nothing."""
    adaptation = Adaptation(strain_gain=0.4, force_gain=0.05, mode="episode", carry=True)
    used = after(adaptation, 10, 0.1)
    rested = adaptation.advance(used, [0.0] * 3, [0.0] * 3, [0.0] * 3, 1.0)
    grown = [adaptation.at_reset(strength).factor - 1.0 for strength in (used, rested)]
    np.testing.assert_allclose(grown[1], 0.5 * grown[0], rtol=1e-12)
    begun = adaptation.at_reset(rested)
    assert adaptation.at_reset(begun) is begun


def test_fatigue_and_recovery_are_exponentials() -> None:
    """Towards R / (F a + R) at the rate F a + R, whatever the steps; and back at the rate R."""
    adaptation = Adaptation(fatigue_rate=0.5, recovery_rate=0.1)
    rate = 0.5 * np.array(USE["activation"]) + 0.1
    for time in (0.4, 3.0, 60.0):
        expected = 0.1 / rate + (1.0 - 0.1 / rate) * np.exp(-rate * time)
        for n_step in (1, 7, 40):
            tired = after(adaptation, n_step, time / n_step)
            np.testing.assert_allclose(tired.factor, expected, rtol=1e-12)
        rested = adaptation.advance(tired, [0.0] * 3, [0.0] * 3, [0.0] * 3, 5.0)
        np.testing.assert_allclose(1.0 - rested.factor, (1.0 - expected) * np.exp(-0.5), rtol=1e-12, atol=1e-15)


def test_without_recovery_fatigue_goes_on() -> None:
    """exp(-F a t), and rest changes nothing."""
    adaptation = Adaptation(fatigue_rate=0.5)
    np.testing.assert_allclose(after(adaptation, 4, 0.5).factor, np.exp([0.0, -0.5, -1.0]), rtol=1e-12)
    assert (Adaptation().max_strength, Adaptation(strain_gain=1.0, cap=3.0).max_strength) == (1.0, 3.0)
    assert (after(Adaptation(), 4, 0.5).factor == 1.0).all()


@pytest.mark.parametrize("muscle_model", ["rod", "line"])
def test_muscle_strain(muscle_model: str) -> None:
    """That of a worm stretched as a whole; 0 at rest."""
    env = LatticeWormEnv("extension", design={**SMALL, "muscle_model": muscle_model})
    model = build_model(build_lattice(env.design), named_layout("all", env.lattice))
    position = model.rest_state().position
    for stretch in (0.0, -0.3, 0.7):
        strain = muscle_strain(model, (1.0 + stretch) * position)
        assert strain.shape == (model.n_muscle,)
        np.testing.assert_allclose(strain, stretch, atol=1e-12)


def episode(env: LatticeWormEnv, n_step: int, seed: int | None = 0) -> list[Any]:
    """Return strengths after the reset and after every step of random actions."""
    env.action_space.seed(0)
    strengths = [env.reset(seed=seed)[1]["strength"]]
    for _ in range(n_step):
        observation, *_, info = env.step(env.action_space.sample())
        assert observation in env.observation_space
        np.testing.assert_array_equal(info["strength"], env.strength)
        strengths.append(info["strength"])
    return strengths


LIVING: dict[str, Any] = {"strain_gain": 0.5, "force_gain": 0.2, "episode": 1.0, "fatigue_rate": 0.8,
                          "recovery_rate": 0.3, "observed": True}  # fmt: skip


def test_strength_is_what_multiplies_the_tension() -> None:
    """A worm of half the strength moves as one of half the tension, to rounding."""
    half = Adaptation(fatigue_rate=0.1)
    strong = LatticeWormEnv("extension", design={**SMALL, "max_tension": 0.25}, dt=2e-4)
    weak = LatticeWormEnv("extension", design=SMALL, adaptation=half, dt=2e-4)
    for env in (strong, weak):
        env.reset(seed=0)
    weak.worms._strength = Strength(*np.array([1.0, 0.5, 0.0, 0.0])[:, None, None] * np.ones(weak.model.n_muscle))
    for env in (strong, weak):
        env.step(np.ones(env.action_space.shape))
    np.testing.assert_allclose(strong.state.position, weak.state.position, atol=1e-15)


def test_the_environment_follows_the_law() -> None:
    """Every step from the one before: mean activation, mean tension with the strength in it, and strain at the end."""
    env = LatticeWormEnv("extension", design=SMALL, adaptation=LIVING, control="ring")
    env.reset(seed=0)
    adaptation = Adaptation(**LIVING)
    strength = adaptation.initial(env.model.n_muscle)
    for k in range(8):
        before = env.activation
        observation, *_ = env.step(np.full(env.action_space.shape, float(k < 5)))
        active = 0.5 * (before + env.activation)
        tension = env.design.max_tension * active * strength.factor
        strain = muscle_strain(env.model, env.state.position)
        np.testing.assert_allclose(env.task.strength, strength.factor[None], rtol=1e-14)
        strength = adaptation.advance(strength, active, tension, strain, env.control_dt)
        np.testing.assert_allclose(env.strength, strength.factor, rtol=1e-14)
        np.testing.assert_array_equal(observation[-env.model.n_muscle :], env.strength.astype(np.float32))
    assert np.ptp(env.strength) > 1e-3


@pytest.mark.parametrize("carry", [False, True])
def test_resets(carry: bool) -> None:
    """Strengths are carried over a reset only where asked; with the mode "episode" they change there alone."""
    env = LatticeWormEnv("extension", design=SMALL, adaptation={**LIVING, "carry": carry})
    first, second = episode(env, 4), episode(env, 4)
    if carry:
        np.testing.assert_array_equal(second[0], first[-1])
        each = LatticeWormEnv("extension", design=SMALL, adaptation={"strain_gain": 0.5, "mode": "episode",
                                                                     "carry": True})  # fmt: skip
        first, second = episode(each, 4), episode(each, 4)
        assert all((strength == 1.0).all() for strength in first)
        assert all((strength == second[0]).all() for strength in second)
        assert second[0].min() > 1.0
    else:
        for one, other in zip(first, second, strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.filterwarnings("ignore:hill.* the physics step")
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_go_on_exactly(copied: Any) -> None:
    """Strength is part of the state."""
    env = LatticeWormEnv("extension", design=SMALL, adaptation={**LIVING, "carry": True}, hill={"max_speed": 3.0})
    episode(env, 3)
    other = copied(env)
    for one, two in zip((env, env), (other, other), strict=True):
        action = np.full(one.action_space.shape, 0.7)
        a, b = one.step(action), two.step(action)
        np.testing.assert_array_equal(a[0], b[0])
        np.testing.assert_array_equal(a[4]["strength"], b[4]["strength"])


def test_a_failed_step_trains_nothing() -> None:
    """Where the physics diverges strengths stay those of the last sound moment."""
    env = LatticeWormEnv("extension", design=SMALL, adaptation=LIVING, dt=0.005, allow_large_dt=True)
    strengths = episode(env, 0)
    terminated = False
    while not terminated:
        _, _, terminated, _, info = env.step(np.ones(env.action_space.shape))
        strengths.append(info["strength"])
    np.testing.assert_array_equal(strengths[-1], strengths[-2])


def flat_space(env: LatticeWormEnv) -> spaces.Box[np.float32]:
    """Return the observation space, or of one with goals the flat part."""
    space = env.observation_space
    space = space["observation"] if isinstance(space, spaces.Dict) else space
    assert isinstance(space, spaces.Box)
    return space


def test_goals_are_observed_beside_strengths() -> None:
    """The flat part ends in the strength of every muscle, within its bounds."""
    env = LatticeWormGoalEnv(design=SMALL, adaptation=LIVING)
    env.reset(seed=0)
    observation, *_ = env.step(np.ones(env.action_space.shape))
    assert observation in env.observation_space
    n_muscle = env.model.n_muscle
    np.testing.assert_array_equal(observation["observation"][-n_muscle:], env.strength.astype(np.float32))
    np.testing.assert_array_equal(flat_space(env).high[-n_muscle:], 2.0)
    assert flat_space(env).shape[0] == flat_space(LatticeWormGoalEnv(design=SMALL)).shape[0] + n_muscle


@pytest.mark.filterwarnings("ignore:hill.* the physics step")
def test_checkers_specs_and_space() -> None:
    """Gymnasium's checker passes; objects survive JSON; the observation grows by one number a muscle."""
    made = gymnasium.make(
        "LatticeWormExtension-v0", design=SMALL, adaptation=Adaptation(**LIVING), hill={"max_speed": 3.0}
    )
    env = made.unwrapped
    assert isinstance(env, LatticeWormEnv)
    check_env(env, skip_render_check=True)
    plain, blind = (LatticeWormEnv("extension", design=SMALL, adaptation=adaptation)
                    for adaptation in (None, {**LIVING, "observed": False}))  # fmt: skip
    n_muscle = env.model.n_muscle
    size = flat_space(plain).shape[0]
    assert (flat_space(env).shape[0], flat_space(blind).shape[0]) == (size + n_muscle, size)
    np.testing.assert_array_equal(flat_space(env).high[-n_muscle:], 2.0)
    assert (plain.strength == 1.0).all()
    assert "strength" not in plain.reset(seed=0)[1]
    assert made.spec is not None
    again = gymnasium.make(EnvSpec.from_json(made.spec.to_json())).unwrapped
    assert isinstance(again, LatticeWormEnv)
    assert (again.adaptation, again.model.hill) == (env.adaptation, env.model.hill)


def test_growth_shortens_the_default_step() -> None:
    """The default step is that for the max_tension_factor muscles there can be."""
    steps = [LatticeWormEnv("extension", design={**SMALL, "max_tension": 3.0}, adaptation=adaptation).dt
             for adaptation in (None, {"strain_gain": 1.0, "cap": 4.0}, {"cap": 4.0})]  # fmt: skip
    assert steps[1] < steps[0] == steps[2]


@pytest.mark.parametrize(
    "bad",
    [1, "much", {"gain": 1.0}, {"cap": 0.5}, {"strain_gain": -1.0}, {"force_gain": None}, {"mode": "daily"},
     {"mode": "episode"}, {"carry": 1}, {"observed": "yes"}, {"episode": 0.0}, {"fatigue_rate": float("nan")}],
)  # fmt: skip
def test_what_is_refused(bad: Any) -> None:
    """One ValueError that names it."""
    name = "(?i)adaptation" if not isinstance(bad, dict) or "gain" in bad else next(iter(bad))
    with pytest.raises(ValueError, match=name if bad != {"mode": "episode"} else "carry"):
        LatticeWormEnv("extension", design=SMALL, adaptation=bad)


@pytest.mark.parametrize(("name", "value"), [("activation", [0.0, 0.5, 1.5]), ("activation", [0.5]),
                                             ("tension", [-1.0, 0.0, 0.0]), ("strain", [np.nan, 0.0, 0.0]),
                                             ("duration", -1.0), ("duration", "1")])  # fmt: skip
def test_bad_use(name: str, value: Any) -> None:
    """It is named."""
    adaptation = Adaptation(strain_gain=1.0)
    with pytest.raises(ValueError, match=name):
        adaptation.advance(adaptation.initial(3), **{**USE, "duration": 0.1, name: value})
