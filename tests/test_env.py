"""The environment as Gymnasium, Stable-Baselines3 and a hostile caller see it."""

from __future__ import annotations

import copy
import json
import pickle
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordVideo, RescaleAction, TimeLimit
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.env_checker import check_env as check_env_sb3

import lattice_gym
from lattice_gym.benchmarks.divergence.runs import plan
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.health import Health, Status
from lattice_gym.engines.registry import EngineName
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.fidelity import FidelityName
from lattice_gym.envs.goal import LatticeWormGoalEnv
from lattice_gym.envs.scene import resolve_world
from lattice_gym.envs.settling import SETTLED_SPEED
from lattice_gym.envs.terms import MOTION_BOUND
from lattice_gym.envs.vector import LatticeWormVectorEnv
from lattice_gym.physics.critical_step import critical_dt
from lattice_gym.physics.laws.activation import Activation, FirstOrder, Thelen, Twitch, advance_activation
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.measures import muscle_lengths, site_positions
from lattice_gym.physics.state import Motion
from lattice_gym.physics.world import World
from lattice_gym.recording.trajectory import Recorder
from lattice_gym.tasks.axial import AxialTask
from lattice_gym.tasks.base import EFFORT_WEIGHT, MIN_PENALTY, RewardTerm
from lattice_gym.tasks.peristalsis import Peristalsis
from lattice_gym.tasks.registry import TASKS

pytestmark = pytest.mark.slow

IDS = {
    "LatticeWorm-v0": ("peristalsis", 90, 200),
    "LatticeWormPeristalsis-v0": ("peristalsis", 90, 200),
    "LatticeWormExtension-v0": ("extension", 48, 40),
    "LatticeWormCompression-v0": ("compression", 42, 40),
    "LatticeWormBending-v0": ("bending", 90, 40),
    "LatticeWormReach-v0": ("reach", 90, 60),
    "LatticeWormCrawl-v0": ("crawl", 90, 200),
    "LatticeWormTransport-v0": ("transport", 90, 200),
}
SMALL = {"n_pairs": 3, "period_ratio": 1.5, "elements_per_segment": 2}
"""A lattice of three sites on each of five levels: quick to build and to step."""
N_SMALL = 21
"""Its muscles."""
SMALL_WAVE = {"wavelength": 0.1, "speed": 0.1}


class Delayed(Activation):
    """The command of the step before."""

    n_state = 2
    most: ClassVar[float] = 1.0

    def advance(self, state: FloatArray, command: FloatArray, duration: float) -> FloatArray:
        """Move on by one command."""
        return np.stack([self.most * state[1], command])


def _env(id: str, **kwargs: Any) -> LatticeWormEnv:
    env = gymnasium.make(id, **kwargs).unwrapped
    assert isinstance(env, LatticeWormEnv)
    return env


def _episode(env: gymnasium.Env[Any, Any], n_step: int, seed: int = 0) -> list[Any]:
    """Everything a seeded episode of random actions returns."""
    env.action_space.seed(seed)
    returned: list[Any] = [env.reset(seed=seed)]
    returned += [env.step(env.action_space.sample()) for _ in range(n_step)]
    return returned


def _refusal(call: Callable[[], object]) -> str | None:
    """Return the message of the ValueError a call raises, if it does."""
    try:
        call()
    except ValueError as error:
        return str(error)
    return None


def _same(first: list[Any], second: list[Any]) -> bool:
    return pickle.dumps(first) == pickle.dumps(second)


@pytest.mark.parametrize("id", list(IDS))
def test_ids(id: str) -> None:
    """Every id makes its task; the time limit is registered, not the environment's."""
    env = gymnasium.make(id)
    task, n_action, limit = IDS[id]
    assert isinstance(env.unwrapped, LatticeWormEnv)
    assert (env.unwrapped.task.name, env.action_space.shape) == (task, (n_action,))
    assert env.spec is not None
    assert env.spec.max_episode_steps == limit
    env.reset(seed=0)
    action = np.zeros(n_action, dtype=np.float32)
    ends = [env.step(action)[2:4] for _ in range(limit)]
    assert ends == [(False, False)] * (limit - 1) + [(False, True)]
    assert env.unwrapped.step(action)[3] is False


@pytest.mark.parametrize("id", list(IDS)[1:])
def test_gymnasium_checker(id: str) -> None:
    """No warning (all warnings are errors here), rendering included."""
    check_env(_env(id, render_mode="rgb_array"))


@pytest.mark.parametrize("id", list(IDS)[1:])
@pytest.mark.parametrize("control", ["muscle", "ring"])
def test_stable_baselines_checker(id: str, control: str) -> None:
    """As training wraps it; the checker looks at spaces and types, not at numbers."""
    env = RescaleAction(gymnasium.make(id, control=control, rhythm=1.0), np.float32(-1.0), np.float32(1.0))
    check_env_sb3(env)
    assert isinstance(env.action_space, gymnasium.spaces.Box)
    assert (env.action_space.low == -1.0).all()
    assert (env.action_space.high == 1.0).all()
    env.reset(seed=0)
    observation, reward, terminated, truncated, info = env.step(env.action_space.high)
    assert observation in env.observation_space
    assert (terminated, truncated, info["status"]) == (False, False, "ok")
    assert reward == sum(info["reward_terms"].values())


def test_importing_is_light_and_registers() -> None:
    """Torch, PyElastica and graphics stay out; the module prefix of an id imports the package."""
    code = (
        "import gymnasium, sys; env = gymnasium.make('lattice_gym:LatticeWorm-v0'); env.reset(); "
        "env.step(env.action_space.sample()); "
        "print([m for m in ('torch', 'elastica', 'pyvista', 'vtkmodules', 'matplotlib') if m in sys.modules])"
    )
    root = Path(lattice_gym.__file__).resolve().parents[1]
    run = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


@pytest.mark.parametrize("id", list(IDS)[1:])
def test_rewards_sum_exactly(id: str) -> None:
    """To the last bit, and the info has what it should."""
    env = gymnasium.make(id)
    for _, reward, _, _, info in _episode(env, 25)[1:]:
        assert reward == sum(info["reward_terms"].values())
        assert set(info) == {"reward_terms", "outcome", "status", "clipped_actions", "clipped_observations"}
        assert (info["status"], info["clipped_actions"], info["clipped_observations"]) == ("ok", 0, 0)
        assert list(info["reward_terms"])[-2:] == ["effort", "divergence"]
        assert all(type(value) is float for value in {**info["reward_terms"], **info["outcome"]}.values())
        assert type(reward) is float


@pytest.mark.parametrize("id", list(IDS)[1:])
@pytest.mark.parametrize("points", ["sites", "nodes"])
def test_observations(id: str, points: str) -> None:
    """They share no memory, stay inside their space, and only what is commanded is constant over an episode."""
    env = _env(id, observation=[points, "activation", "command", "clock"], rhythm=1.3)
    steps = _episode(env, 30)
    seen = np.array([step[0] for step in steps])
    assert seen.dtype == np.float32
    assert all(step[0] in env.observation_space for step in steps)
    assert not any(np.shares_memory(a[0], b[0]) for a, b in pairwise(steps))
    n_free = {"sites": 54, "nodes": 492} if env.design.base == "free" else {"sites": 48, "nodes": 480}
    n_moving, n_action = 6 * n_free[points], env.action_space.shape[0]
    assert seen.shape[1] == n_moving + n_action + len(env.task.bounds) + 2
    constant = np.flatnonzero(np.ptp(seen, axis=0) == 0.0) - n_moving - n_action
    assert constant.tolist() == {"bending": [0, 1], "peristalsis": [2, 3, 4], "crawl": [0], "transport": [0]}.get(
        env.task.name, []
    )
    commands = np.array([env.reset()[0][n_moving + n_action :][: len(env.task.bounds)] for _ in range(8)])
    # Whoever crawls always starts on course, and what is carried in its place.
    assert np.all(np.ptp(commands, axis=0)[: 1 if env.task.name in ("crawl", "transport") else None] > 0.0)


def test_observation_holds_what_it_says() -> None:
    """Each part against the state it was read from."""
    env = _env("LatticeWorm-v0", rhythm=2.0, control="ring")
    observation = _episode(env, 13)[-1][0]
    free, n = env.lattice.site_level > 0, 3 * 48
    moved = site_positions(env.lattice, env.state.position) - env.lattice.site_position
    np.testing.assert_allclose(observation[:n], moved[free].ravel() / 0.02, rtol=1e-6, atol=1e-7)
    velocity = site_positions(env.lattice, env.state.velocity)
    np.testing.assert_allclose(observation[n : 2 * n], velocity[free].ravel() / 0.1, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(observation[2 * n : 2 * n + 15][env.groups], env.activation, rtol=1e-6)
    asked = env.task.observe(Motion.of(env.state), np.array([env.time]))[0]
    np.testing.assert_allclose(observation[-7:-2], asked, rtol=1e-6)
    np.testing.assert_allclose(
        observation[-2:], [np.cos(4 * np.pi * env.time), np.sin(4 * np.pi * env.time)], rtol=1e-5
    )
    assert env.time == pytest.approx(13 * 0.05)
    assert 0.3 < np.abs(observation[: 2 * n]).max() < 5.0


def test_free_base_observes_every_site() -> None:
    """Nothing is held, so nothing is left out, and every level is to follow the wave."""
    env = LatticeWormEnv(design={"base": "free"})
    assert env.observation_space.shape == (6 * 54 + 90 + 5,)
    assert isinstance(env.task, Peristalsis)
    assert env.task.target(np.zeros(1)).shape == (1, 9)
    assert _episode(env, 3)[-1][4]["status"] == "ok"


@pytest.mark.parametrize("control", ["muscle", "ring", "column", [0, 1] * 45])
def test_control(control: Any) -> None:
    """The action of a group is the command of its muscles, followed by exact first-order dynamics."""
    env = _env("LatticeWorm-v0", control=control)
    env.reset(seed=0)
    n_action = {"muscle": 90, "ring": 15, "column": 24}.get(str(control), 2)
    assert env.action_space.shape == (n_action,)
    activation = np.zeros(90)
    for seed in range(3):
        action = np.random.default_rng(seed).random(n_action)
        env.step(action)
        activation = advance_activation(activation, action[env.groups], 0.05, 0.015, 0.05)
        np.testing.assert_allclose(env.activation, activation, rtol=1e-12)


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
            assert _same([env.step(action)], [twin.step(action)])
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


def test_a_refused_reset_does_not_seed() -> None:
    """The generator goes on as if nothing had been asked."""
    one, other = (_env("LatticeWormReach-v0", design=SMALL) for _ in range(2))
    for env in (one, other):
        env.reset(seed=0)
    with pytest.raises(ValueError, match="options"):
        one.reset(seed=5, options={"nope": 1})
    assert one.reset()[1] == other.reset()[1]


@pytest.mark.parametrize("law", [FirstOrder(rise_time=0.02), Thelen(), Twitch(), Delayed()])
def test_activation_laws_survive_json(law: Activation) -> None:
    """Given as objects, of the package or not."""
    made = gymnasium.make("LatticeWormExtension-v0", design=SMALL, activation=law)
    assert made.spec is not None
    again = gymnasium.make(EnvSpec.from_json(made.spec.to_json())).unwrapped
    assert isinstance(again, LatticeWormEnv)
    assert (type(again.scene.activation), again.scene.activation.to_dict()) == (type(law), law.to_dict())


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


def test_state_does_not_survive_reset() -> None:
    """A reset after violent steps starts as the first one did, and what is handed out is a copy."""
    env = _env("LatticeWorm-v0")
    first = _episode(env, 45)
    env.state.position[:] = np.nan
    env.activation[:] = np.nan
    assert _same(first, _episode(env, 45))


def test_seeds() -> None:
    """The same seed gives the same episode, another seed another, and a reset without one goes on drawing."""
    env = gymnasium.make("LatticeWorm-v0")
    first = _episode(env, 3, seed=1)
    assert _same(first, _episode(gymnasium.make("LatticeWorm-v0"), 3, seed=1))
    assert not _same(first[:1], [env.reset(seed=2)])
    assert env.reset()[1]["command"] != env.reset()[1]["command"]


def test_commands() -> None:
    """Held by the constructor, for one episode by options, and told at reset."""
    env = _env("LatticeWormBending-v0", command={"azimuth": 1.0})
    assert env.reset(seed=0)[1] == {"command": {"azimuth": 1.0}, "status": "ok"}
    observation, info = env.reset(options={"azimuth": -2.0})
    assert info["command"] == env.task.command == {"azimuth": -2.0}
    np.testing.assert_allclose(observation[-2:], [np.cos(-2.0), np.sin(-2.0)], rtol=1e-6)
    assert env.reset()[1]["command"] == {"azimuth": 1.0}


@pytest.mark.parametrize("form", ["objects", "dicts"])
def test_specs_survive_json(form: str) -> None:
    """An EnvSpec made with objects or dicts, through JSON, makes an environment that behaves the same."""
    design = LatticeDesign(diameter=0.07)
    layout = named_layout("all", build_lattice(design)).switched(np.arange(90) % 3 > 0)
    world = World(medium=Medium(drag=0.01), ground=Ground(static_friction=0.7))
    kwargs: dict[str, Any] = {"design": design, "muscles": layout, "world": world}
    if form == "dicts":
        kwargs = {name: value.to_dict() for name, value in kwargs.items()}
    env = gymnasium.make("LatticeWorm-v0", control="ring", rhythm=1.0, command={"speed": 0.1}, **kwargs)
    assert env.spec is not None
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    one, other = env.unwrapped, again.unwrapped
    assert isinstance(one, LatticeWormEnv)
    assert isinstance(other, LatticeWormEnv)
    assert (one.design, one.layout, one.world) == (other.design, other.layout, other.world) == (design, layout, world)
    assert one.observation_space == other.observation_space
    assert one.action_space == other.action_space
    assert _same(_episode(env, 3), _episode(again, 3))


def test_numpy_arguments() -> None:
    """Taken as they are; JSON knows them only as plain numbers, and says so."""
    groups = LatticeWormEnv(control="ring").groups
    kwargs: dict[str, Any] = {
        "control": groups,
        "rhythm": np.float32(1.0),
        "control_dt": np.float64(0.05),
        "command": {"speed": np.float32(0.125), "phase": np.int64(1)},
    }
    env = gymnasium.make("LatticeWorm-v0", **kwargs)
    plain = kwargs | {"control": groups.tolist(), "rhythm": 1.0, "command": {"speed": 0.125, "phase": 1}}
    same = gymnasium.make("LatticeWorm-v0", **plain)
    assert env.spec is not None
    assert same.spec is not None
    with pytest.raises(TypeError, match="not JSON serializable"):
        env.spec.to_json()
    again = gymnasium.make(EnvSpec.from_json(same.spec.to_json()))
    assert _same(_episode(env, 2), _episode(again, 2))
    assert _same(_episode(env, 2), _episode(same, 2))


@pytest.mark.parametrize("task", list(TASKS))
def test_any_task_in_any_world(task: str, engine_name: EngineName) -> None:
    """Everything at once, on either engine; deterministic, and a copy goes on as it would."""
    # A worm must be at rest before it crawls; a ball slips out between so few rods and is not, so it has lines instead.
    ball = None if task == "crawl" else Ball(radius=0.02)
    world = World(medium=Medium(drag=0.01), ground=Ground(forward=0.5), ball=ball, lying=True)
    design = SMALL | {"base": "free", "muscle_model": "line" if ball is None else "rod"}
    command = SMALL_WAVE if task == "peristalsis" else None
    kwargs: dict[str, Any] = {"control": "ring", "control_dt": 0.01, "command": command}
    env = LatticeWormEnv(task, design=design, world=world, engine=engine_name, **kwargs)
    first = _episode(env, 3)
    assert all(step[0] in env.observation_space for step in first)
    assert first[-1][4]["status"] == "ok"
    assert _same(first, _episode(env, 3))
    twin, action = copy.deepcopy(env), env.action_space.sample()
    assert _same([env.step(action)], [twin.step(action)])


def _of(rows: list[Any], name: str) -> Any:
    return np.array([row[0][name] for row in rows])


def test_goals() -> None:
    """A Dict that both checkers take; any goals are rewarded as the task would, its own to the last bit."""
    env = _env("LatticeWormReachGoal-v0", control="column")
    assert isinstance(env, LatticeWormGoalEnv)
    check_env(env, skip_render_check=True)
    check_env_sb3(env, warn=False)
    steps = _episode(env, 5)
    assert all(step[0] in env.observation_space for step in steps)
    assert steps[0][0]["observation"].shape == (6 * 48 + 24,)
    np.testing.assert_allclose(steps[0][0]["achieved_goal"], 0.0, atol=1e-6)
    achieved, desired, infos = (
        _of(steps[1:], "achieved_goal"),
        _of(steps[1:], "desired_goal"),
        [s[4] for s in steps[1:]],
    )
    rewards = [step[1] for step in steps[1:]]
    np.testing.assert_array_equal(env.compute_reward(achieved, desired, infos), rewards)
    assert [env.compute_reward(a, d, i) for a, d, i in zip(achieved, desired, infos, strict=True)] == rewards
    # Of what was reached itself the reward is its distance from rest; infos without terms leave the effort out.
    hindsight = env.compute_reward(achieved, achieved, [{}] * 5)
    np.testing.assert_allclose(hindsight, 0.2 * np.linalg.norm(achieved, axis=1), rtol=1e-6)
    diverged = {"reward_terms": {"approach": 0.0, "effort": 0.0, "divergence": -MIN_PENALTY}}
    assert env.compute_reward(achieved[0], desired[0], diverged) == -MIN_PENALTY
    # One info counts for all goals, None for none, and their number must fit.
    plain = env.compute_reward(achieved, desired, None)
    np.testing.assert_array_equal(plain, env.compute_reward(achieved, desired, {}))
    np.testing.assert_array_equal(plain, env.compute_reward(achieved, desired, [None] * 5))
    np.testing.assert_array_equal(
        env.compute_reward(achieved, desired, infos[2]), env.compute_reward(achieved, desired, [infos[2]] * 5)
    )
    np.testing.assert_array_equal(env.compute_reward(achieved[:1], desired[:1], infos[:1]), rewards[:1])
    assert env.compute_reward(achieved[0], desired[0], None) == np.asarray(plain)[0]
    assert np.shape(env.compute_reward(achieved[:0], desired[:0], [])) == (0,)
    hostile: list[Any] = [infos[:4], infos[:1], [], 7, ["ok"] * 5, "infos"]
    for wrong in hostile:
        with pytest.raises(ValueError, match=r"^info\b"):
            env.compute_reward(achieved, desired, wrong)
    with pytest.raises(ValueError, match=r"^info: must be one mapping"):
        env.compute_reward(achieved[0], desired[0], infos)
    with pytest.raises(ValueError, match=r"^task = 'bending': has no goals; those that do: reach"):
        LatticeWormGoalEnv("bending")
    with pytest.raises(ValueError, match=r"^task = 'swimming': must be one of"):
        LatticeWormGoalEnv("swimming")


@pytest.mark.parametrize("copy_info", [False, True])
def test_hindsight_replay(copy_info: bool) -> None:
    """SAC learns from relabelled goals, wrapped as in training."""
    env = gymnasium.make("LatticeWormReachGoal-v0", control="column", fidelity="fast", max_episode_steps=5)
    model = SAC(
        "MultiInputPolicy",
        RescaleAction(env, np.float32(-1.0), np.float32(1.0)),
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"copy_info_dict": copy_info},
        learning_starts=10,
        batch_size=8,
        policy_kwargs={"net_arch": [8]},
        buffer_size=100,
        seed=0,
    )
    model.learn(20)
    assert isinstance(model.replay_buffer, HerReplayBuffer)
    sample = model.replay_buffer.sample(32, env=model.get_vec_normalize_env())
    assert np.isfinite(sample.rewards.numpy()).all()
    goals = {name: sample.next_observations[name].numpy() for name in ("achieved_goal", "desired_goal")}
    worm = env.unwrapped
    assert isinstance(worm, LatticeWormGoalEnv)
    again = worm.compute_reward(**goals, info=[{}] * 32)
    # Effort, at most a hundredth, is not in a sample.
    np.testing.assert_allclose(sample.rewards.numpy()[:, 0], again, atol=EFFORT_WEIGHT + 1e-6)


def test_a_worm_that_crawls_has_settled() -> None:
    """On the ground, for good; what is observed begins at zero, and wherever it went does not matter."""
    env = _env("LatticeWormCrawl-v0", control="ring", command={"direction": 1})
    observation, _ = env.reset(seed=0)
    np.testing.assert_array_equal(observation[: 6 * 54 + 15], 0.0)
    start = env.state
    assert 0.0 < start.position[:, 2].min() < env.design.structure_radius
    for _ in range(20):
        env.step(np.zeros(15))
    np.testing.assert_allclose(env.state.position, start.position, atol=5e-5)
    away = env.state
    away.position[:] += [0.3, -0.1, 0.0]
    env.worms.restore(away)
    observation = env.worms.observe()[0][0]
    np.testing.assert_allclose(observation[: 3 * 54], 0.0, atol=1e-3)
    np.testing.assert_allclose(observation[-2:], [1.0, -1.0], atol=1e-3)


@pytest.mark.parametrize("fidelity", ["fast", "default"])
@pytest.mark.parametrize("task", ["crawl", "transport"])
def test_doing_nothing_earns_nothing_once_settled(task: str, fidelity: FidelityName) -> None:
    """Over a whole episode, either way."""
    env = LatticeWormEnv(task, fidelity=fidelity, control="ring", command={"direction": 1})
    env.reset(seed=0)
    rewards = [env.step(np.zeros(15))[1] for _ in range(200)]
    assert np.abs(rewards).max() < 1e-4


@pytest.mark.parametrize("drag", [0.0, 1.0, 100.0])
def test_drag_holds_up_no_settling(drag: float) -> None:
    """A worm of few elements rolls over as it comes to rest: it has done so, however slowly the medium would let it."""
    env = LatticeWormEnv("crawl", fidelity="fast", control="ring", world={"medium": {"drag": drag}})
    env.reset(seed=0)
    start = env.state.position
    for _ in range(20):
        env.step(np.zeros(15))
    assert np.abs(env.state.position - start).max() < SETTLED_SPEED * env.design.height


@pytest.mark.parametrize("density", [990.0, 1001.0, 1010.0])
def test_a_ball_that_friction_holds_comes_to_rest(density: float) -> None:
    """At once, and stays."""
    env = LatticeWormEnv("transport", fidelity="fast", control="ring", world={"ball": {"density": density}})
    env.reset(seed=0)
    start = env.state.ball_position
    for _ in range(20):
        env.step(np.zeros(15))
    assert np.abs(env.state.ball_position - start).max() < SETTLED_SPEED * env.design.height


@pytest.mark.parametrize(
    ("task", "world", "message"),
    [
        ("transport", {"ball": {"density": 1050.0}}, r"^world: transport is over before it starts"),
        ("transport", {"ball": {"density": 500.0}}, r"^world: transport is over before it starts"),
        ("crawl", {"medium": {"density": 2000.0}}, r"^world: worm and ball do not come to rest .* after 30 s"),
        ("crawl", {"ground": None}, r"^world.ground = None: there is nothing to crawl on"),
        ("crawl", {"medium": None}, r"^world.medium: has no gravity"),
        ("crawl", {"medium": {"gravity": 0.0}}, r"^world.medium: has no gravity"),
        ("crawl", {"lying": False}, r"^world.lying = False: a worm that crawls must lie"),
    ],
)
def test_worlds_in_which_nothing_comes_to_rest(task: str, world: dict[str, Any], message: str) -> None:
    """Refused at once, not played: the ball that sinks or rises out of its rings, the worm that falls or floats."""
    with pytest.raises(ValueError, match=message):
        LatticeWormEnv(task, fidelity="fast", world=world)


@pytest.mark.parametrize("task", ["crawl", "transport"])
def test_restating_a_world_changes_nothing(task: str) -> None:
    """A dict changes parts by name: any own value, restated, leaves all others; an object replaces its part."""
    lattice = build_lattice(LatticeDesign(**TASKS[task].design))
    own = TASKS[task].world(lattice)
    for name, part in own.to_dict().items():
        single = [{field: value} for field, value in part.items()] if isinstance(part, dict) else []
        for stated in (part, *single):
            assert resolve_world({name: stated}, TASKS[task].world, lattice) == own
    changed = resolve_world({"medium": {"drag": 0.5}, "ball": Ball(friction=0.2)}, TASKS[task].world, lattice)
    assert own.medium is not None
    assert changed == replace(own, medium=replace(own.medium, drag=0.5), ball=Ball(friction=0.2))
    assert resolve_world({"medium": None, "ground": {}}, TASKS["reach"].world, lattice) == World(ground=Ground())


@pytest.mark.parametrize(("height", "direction", "held"), [(0.13, 1.0, True), (0.13, -1.0, False), (-0.02, -1.0, True)])
def test_a_ball_that_has_left_ends_the_episode(height: float, direction: float, held: bool) -> None:
    """By the commanded end it is delivered, by the other lost, and that costs; the next episode has it back."""
    env = _env("LatticeWormTransport-v0", control="ring", command={"direction": direction})
    env.reset(seed=0)
    state = env.state
    state.ball_position[0, 2] = height
    env.worms.restore(state)
    _, reward, terminated, truncated, info = env.step(np.zeros(15))
    assert (terminated, truncated, info["status"]) == (True, False, "ok")
    assert info["reward_terms"]["lost"] == (0.0 if held else -5.0)
    assert reward == sum(info["reward_terms"].values())
    assert (info["outcome"]["held"], info["outcome"]["delivered"]) == (float(held), float(held))
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(15))
    observation, _ = env.reset(seed=0)
    np.testing.assert_array_equal(observation[-6:], 0.0)


@pytest.mark.parametrize("control", ["muscle", "column"])
def test_work_of_muscles(control: str) -> None:
    """Mean tension times shortening is the work that the energy ledger has, to what a control step resolves."""
    env = LatticeWormEnv("compression", muscles="all", control=control, energy_check=True)
    env.reset(seed=0)
    length, activation, work, booked = muscle_lengths(env.model, env.state.position), env.activation, 0.0, 0.0
    for _ in range(30):
        env.step(np.ones(env.action_space.shape))
        now = muscle_lengths(env.model, env.state.position)
        work += 0.5 * env.design.max_tension * float((activation + env.activation) @ (length - now))
        length, activation = now, env.activation
        ledger = env.worms.engine.ledger()
        assert ledger is not None
        booked += ledger.muscle_work
    assert work == pytest.approx(booked, rel=0.05)


def test_rings_cannot_bend() -> None:
    """Alike all round, as the docstring says; muscles and columns can."""
    assert "cannot bend" in str(LatticeWormEnv.__doc__)
    largest = {}
    for control in ("ring", "column"):
        env = LatticeWormEnv("bending", control=control)
        largest[control] = max(step[4]["outcome"]["bend_angle"] for step in _episode(env, 20)[1:])
    assert largest["ring"] < 1e-6
    assert largest["column"] > 0.01


def test_names_of_the_package() -> None:
    """What the README builds muscles with."""
    lattice = build_lattice(LatticeDesign())
    layout = lattice_gym.vertical(lattice) | lattice_gym.horizontal(lattice) | lattice_gym.tie(lattice, [(0, 17)])
    assert lattice_gym.resolve_layout(layout.to_dict(), lattice) == layout
    assert all(hasattr(lattice_gym, name) for name in lattice_gym.__all__)


@pytest.mark.parametrize("copied", [lambda env: pickle.loads(pickle.dumps(env)), copy.deepcopy])
def test_copies_go_on_exactly(copied: Any, engine_name: EngineName) -> None:
    """A copy made within an episode goes on as the original does, on either engine, and apart from it."""
    env = LatticeWormEnv(design=SMALL, engine=engine_name, command=SMALL_WAVE)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(3):
        env.step(rng.random(env.action_space.shape))
    twin = copied(env)
    actions = rng.random((3, *env.action_space.shape))
    original = [env.step(action) for action in actions]
    assert _same(original, [twin.step(action) for action in actions])
    assert _same([env.reset()], [twin.reset()])


def test_engines_agree() -> None:
    """With velocities damped alike, the two engines return the same observations and rewards, to rounding."""
    shared: dict[str, Any] = {"design": SMALL, "splitting": "pyelastica", "command": SMALL_WAVE}
    envs = [LatticeWormEnv(engine=engine, **shared) for engine in ("fused", "pyelastica")]
    for fused, reference in zip(*(_episode(env, 4) for env in envs), strict=True):
        np.testing.assert_allclose(fused[0], reference[0], atol=1e-6)
        if len(fused) == 5:
            assert fused[1] == pytest.approx(reference[1], abs=1e-7)


@given(
    st.lists(st.floats(allow_nan=False, width=32), min_size=N_SMALL, max_size=N_SMALL),
    st.sampled_from([np.float32, np.float64, list]),
)
@settings(max_examples=25, deadline=None)
def test_any_number_is_clipped_and_counted(values: list[float], kind: Any) -> None:
    """Infinities too; the reward stays finite and the observation in its space."""
    env = _HOSTILE
    env.reset(seed=0)
    observation, reward, _, _, info = env.step(kind(values))
    assert info["clipped_actions"] == sum(not 0.0 <= value <= 1.0 for value in values)
    assert observation in env.observation_space
    assert np.isfinite(reward)
    expected = advance_activation(np.zeros(N_SMALL), np.clip(values, 0.0, 1.0), 0.05, 0.015, 0.05)
    np.testing.assert_allclose(env.activation, expected)


_HOSTILE = LatticeWormEnv(design=SMALL, command=SMALL_WAVE)


@pytest.mark.parametrize(
    "action",
    [
        np.full(N_SMALL, np.nan),
        np.append(np.zeros(N_SMALL - 1), np.nan),
        np.zeros(N_SMALL - 1),
        np.zeros((1, N_SMALL)),
        np.zeros(N_SMALL, dtype=np.complex128),
        np.zeros(N_SMALL, dtype=np.bool_),
        np.array(["a"] * N_SMALL),
        [None] * N_SMALL,
        [[0.0], [0.0, 1.0]],
        0.5,
        None,
        "up",
        {"muscle": 1.0},
    ],
)
def test_wrong_actions(action: Any) -> None:
    """A ValueError that names the action, and the episode goes on as if nothing had been asked."""
    _HOSTILE.reset(seed=0)
    before = pickle.dumps(_HOSTILE.state)
    with pytest.raises(ValueError, match=r"^action:"):
        _HOSTILE.step(action)
    assert pickle.dumps(_HOSTILE.state) == before
    assert _HOSTILE.step(np.zeros(N_SMALL))[4]["status"] == "ok"


def test_steps_need_a_reset() -> None:
    """Before the first one, as Gymnasium's own wrapper has it."""
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset"):
        LatticeWormEnv(design=SMALL, command=SMALL_WAVE).step(np.zeros(N_SMALL))


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"task": "swimming"}, r"^task = 'swimming': must be one of extension"),
        ({"task": ["bending"]}, r"^task = "),
        ({"design": 7}, r"^design = 7"),
        ({"design": {"n_pair": 6}}, r"^LatticeDesign: there is no 'n_pair'"),
        ({"design": {"period_ratio": 1.4}}, r"^LatticeDesign.period_ratio = 1.4: .* nearest"),
        ({"muscles": "strong"}, r"^muscles = 'strong'"),
        ({"muscles": 3}, r"^muscles = 3"),
        ({"muscles": {"muscles": [{"orientation": "custom", "start": 0, "end": 54}]}}, r"^muscles: site 54"),
        ({"muscles": {"muscles": []}}, r"^muscles"),
        ({"control": "brain"}, r"^control = 'brain'"),
        ({"control": [0, 1]}, r"^control = \[0, 1\]: must be a sequence of 90 groups, one for each"),
        ({"control": [0, 2] * 45}, r"^control: group 1 drives no muscle"),
        ({"rhythm": 0.0}, r"^rhythm = 0.0: must be a number above 0 and at most 10 \[Hz\]"),
        ({"rhythm": 11.0}, r"^rhythm = 11.0"),
        ({"rhythm": "fast"}, r"^rhythm = 'fast'"),
        ({"engine": "steam"}, r"^engine = 'steam': must be one of fused, pyelastica"),
        ({"dt": 0.0}, r"^dt = 0.0"),
        ({"dt": float("nan")}, r"^dt = nan"),
        ({"dt": "small"}, r"^dt = 'small'"),
        ({"dt": True}, r"^dt = True"),
        ({"dt": 0.1}, r"^dt = 0.1: must be a number above 0 and at most 0.05"),
        ({"dt": 1e-9}, r"^dt = 1e-09: 5e\+07 steps in control_dt"),
        ({"dt": 3e-4}, r"^dt = 0.0003: must divide .* 0.00029940\d* and 0.00030120\d* s"),
        ({"dt": 1e-3}, r"^dt = 0.001: above the critical time step, .* allow_large_dt=True"),
        ({"allow_large_dt": "yes"}, r"^allow_large_dt = 'yes'"),
        ({"control_dt": 0.0}, r"^control_dt = 0.0"),
        ({"control_dt": -0.05}, r"^control_dt = -0.05"),
        ({"control_dt": float("inf")}, r"^control_dt = inf"),
        ({"control_dt": 10**400}, r"^control_dt = 1000"),
        ({"control_dt": 0.2}, r"^command: .*4 control steps"),
        ({"observation": "pixels"}, r"^observation = 'pixels': must be a list of terms; write \["),
        ({"observation": []}, r"^observation = "),
        ({"task": "crawl", "design": LatticeDesign()}, r"^world: a worm that lies needs a free base"),
        ({"task": "crawl", "design": LatticeDesign(), "world": World()}, r"^design.base = .*must be free"),
        ({"task": "crawl", "command": {"direction": 0.5}}, r"^command\['direction'\] = 0.5: must be -1 or 1"),
        ({"task": "transport", "world": {"ball": None}}, r"^world.ball = None: there is nothing to carry"),
        (
            {"task": "transport", "design": {"n_pairs": 2, "period_ratio": 1.0}},
            r"^design: 2 pairs of rods leave no room for a ball",
        ),
        ({"world": {"lying": True}}, r"^world: a worm that lies needs a free base"),
        ({"world": 7}, r"^world = 7: must be World"),
        ({"world": {"moon": None}}, r"^World: there is no 'moon'"),
        ({"world": {"ground": {"stiffness": -1.0}}}, r"^Ground.stiffness = -1.0"),
        ({"command": {"azimuth": 0.0}}, r"^command: there is no 'azimuth'"),
        ({"render_mode": "human"}, r"^render_mode = 'human'"),
        ({"render_mode": 3}, r"^render_mode = 3"),
        ({"design": {"structure_youngs_modulus": 1e13}}, r"^dt = .* steps in control_dt"),
    ],
)
def test_wrong_arguments(kwargs: dict[str, Any], message: str) -> None:
    """The error names the argument."""
    with pytest.raises(ValueError, match=message):
        LatticeWormEnv(**kwargs)


_JUNK = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), st.lists(st.floats(), max_size=3),
    st.dictionaries(st.text(max_size=5), st.floats(), max_size=2),
)  # fmt: skip


@given(
    name=st.sampled_from(
        [
            "task",
            "design",
            "muscles",
            "control",
            "rhythm",
            "engine",
            "dt",
            "allow_large_dt",
            "control_dt",
            "observation",
            "command",
            "world",
            "render_mode",
            "randomise",
        ]
    ),
    value=_JUNK,
)
@settings(max_examples=150, deadline=None)
def test_any_argument_is_taken_or_named(name: str, value: Any) -> None:
    """Whatever an argument is, it makes a working environment or a ValueError that names it."""
    kwargs: dict[str, Any] = {"task": "bending", "design": SMALL} | {name: value}
    message = _refusal(lambda: LatticeWormEnv(**kwargs))
    if message is None:
        env = LatticeWormEnv(**kwargs)
        assert env.reset(seed=0)[0] in env.observation_space
    else:
        assert name in message.lower()


@given(options=_JUNK)
@settings(max_examples=50, deadline=None)
def test_any_options_are_taken_or_named(options: Any) -> None:
    """None and an empty dict change nothing; what the task does not command is refused."""
    message = _refusal(lambda: _HOSTILE.reset(seed=0, options=options))
    assert (message is None) == (options is None or options == {})
    assert message is None or message.startswith("options")
    assert _HOSTILE.reset(seed=0)[0] in _HOSTILE.observation_space


@pytest.mark.parametrize("divisor", [160, 200, 500])
def test_dt(divisor: int) -> None:
    """Any whole fraction of the control step below the critical step is taken as it is."""
    env = LatticeWormEnv(dt=0.05 / divisor)
    assert (env.n_substeps, env.dt) == (divisor, 0.05 / divisor)
    assert env.dt < critical_dt(env.model, env.design.max_tension)
    assert LatticeWormEnv().n_substeps * LatticeWormEnv().dt == pytest.approx(0.05, rel=1e-12)


@pytest.mark.parametrize("task", list(TASKS))
def test_divergence_ends_the_episode_and_never_pays(task: str, engine_name: EngineName) -> None:
    """With a step far too large: status, the last sound observation again, no NaN, and a return below nothing."""
    env = LatticeWormEnv(
        task,
        design=SMALL,
        engine=engine_name,
        dt=0.005,
        allow_large_dt=True,
        command=SMALL_WAVE if task == "peristalsis" else None,
    )
    observation, _ = env.reset(seed=0)
    total, terminated, info = 0.0, False, dict[str, Any]()
    for _ in range(40):
        before = observation
        observation, reward, terminated, truncated, info = env.step(np.ones(env.action_space.shape))
        total += reward
        assert observation in env.observation_space
        assert reward == sum(info["reward_terms"].values())
        assert not truncated
        if terminated:
            break
    assert terminated
    assert re.fullmatch(r"(non_finite|overstretched|inverted) \(rod \d+, element \d+\)", info["status"])
    assert tuple(info["reward_terms"]) == (*env.task.weights, "divergence")
    assert reward == info["reward_terms"]["divergence"] == -MIN_PENALTY
    np.testing.assert_array_equal(observation, before)
    assert np.isfinite(env.state.position).all()
    assert total < -0.5 * MIN_PENALTY
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.ones(env.action_space.shape))
    env.reset(seed=0)
    assert env.state.time == 0.0


def test_any_engine_failure_is_survived(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whichever status the engine returns is what the environment reports, and the state is put back."""
    env = LatticeWormEnv(design=SMALL, command=SMALL_WAVE)
    env.reset(seed=0)
    env.step(np.ones(N_SMALL))
    engine, state = env.worms.engine, pickle.dumps(env.state)
    advance = engine.advance

    def fail(tension: Any, n_substeps: int) -> Any:
        advance(tension, n_substeps)
        return np.array([Status.INVERTED])

    monkeypatch.setattr(engine, "advance", fail)
    monkeypatch.setattr(engine, "health", lambda worm=0: Health(Status.INVERTED, 4, 2))
    _, _, terminated, _, info = env.step(np.zeros(N_SMALL))
    assert terminated
    assert info["status"] == "inverted (rod 4, element 2)"
    assert pickle.dumps(env.state) == state == pickle.dumps(engine.state(0))
    assert env.task.caption(env.state) == ""


def test_a_run_astray_ends_the_episode() -> None:
    """With the step check only: a run of the divergence report that any other check lets pass; then a fresh start."""
    run = plan(20_114)
    kwargs: dict[str, Any] = {
        "task": "extension", "design": run.design, "muscles": run.layout, "splitting": run.splitting,
        "dt": run.dt, "allow_large_dt": True, "energy_check": True,
    }  # fmt: skip
    checked, plain = LatticeWormEnv(**kwargs, step_check=True), LatticeWormEnv(**kwargs)
    commands = np.random.default_rng((run.seed, 1)).random((5, run.model.n_muscle)) < 0.5

    def episode(env: LatticeWormEnv) -> list[Any]:
        return [env.reset(seed=0), *(env.step(action) for action in commands.astype(float))]

    first, plain_first = episode(checked), episode(plain)
    assert _same(first[:-1], plain_first[:-1])
    assert [step[2] for step in first[1:]] == [False] * 4 + [True]
    assert not plain_first[-1][2]
    assert re.fullmatch(r"inaccurate \(rod \d+, element \d+\)", first[-1][4]["status"])
    assert first[-1][4]["reward_terms"]["divergence"] == -MIN_PENALTY
    np.testing.assert_array_equal(first[-1][0], first[-2][0])
    with pytest.raises(gymnasium.error.ResetNeeded):
        checked.step(commands[0].astype(float))
    assert _same(first, episode(checked))


@pytest.mark.parametrize("copied", [lambda env: pickle.loads(pickle.dumps(env)), copy.deepcopy])
def test_a_copy_keeps_the_step_check(copied: Any) -> None:
    """It goes on as the original does, and compares from where it was copied on."""
    env = LatticeWormEnv(design=SMALL, command=SMALL_WAVE, step_check=True)
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.ones(N_SMALL))
    twin: LatticeWormEnv = copied(env)
    assert twin.worms.engine.step_error() is None
    for action in (np.ones(N_SMALL), np.zeros(N_SMALL)):
        assert _same([env.step(action)], [twin.step(action)])
        assert twin.worms.engine.step_error() not in (None, 0.0, env.worms.engine.step_error())
    for one in (env, twin):
        one.reset(seed=0)
        one.step(np.ones(N_SMALL))
    assert twin.worms.engine.step_error() == env.worms.engine.step_error() is not None


def test_time_goes_on_where_physics_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each step has its own time, the failed one too, so that it can be recorded; what is observed stays as it was."""
    env = LatticeWormEnv(design=SMALL, command=SMALL_WAVE, rhythm=1.3)
    observation, _ = env.reset(seed=0)
    recorder = Recorder(env.design, env.layout, env.task.name)
    for step in range(4):
        recorder.append(env.time, env.state.position, env.activation)
        assert env.time == pytest.approx(0.05 * step)
        before = observation
        if step == 2:
            monkeypatch.setattr(env.worms.engine, "advance", lambda *_: np.array([Status.NON_FINITE]))
        if step < 3:
            observation, _, terminated, _, _ = env.step(np.ones(N_SMALL))
    assert terminated
    np.testing.assert_array_equal(observation, before)
    assert np.all(np.diff(recorder.build().time) > 0.0)
    assert env.time == pytest.approx(0.15)
    assert env.reset(seed=0)[0] in env.observation_space
    assert env.time == 0.0


def test_far_observations_are_clipped_and_counted() -> None:
    """What moves beyond the bound is held at it, and the info says how many numbers were."""
    env = LatticeWormEnv("extension", design=SMALL)
    env.reset(seed=0)
    far = env.state
    rods = slice(0, env.lattice.n_rod * env.lattice.n_node)
    far.velocity[rods][~np.isin(np.arange(rods.stop), env.model.node_offset)] = 1e6
    env.worms.restore(far)
    seen, clipped = env.worms.observe()
    observation = seen[0]
    assert clipped[0] == np.count_nonzero(np.abs(observation) == MOTION_BOUND) > 0
    assert observation in env.observation_space


def test_the_target_is_in_the_picture() -> None:
    """Where the command of the episode has it."""
    env, places = LatticeWormEnv("reach", fidelity="fast", render_mode="rgb_array"), []
    for rise in (0.4, 0.0):
        env.reset(seed=0, options={"radius": 0.0, "rise": rise})
        picture = env.render()
        assert picture is not None
        red, green, blue = picture.astype(int).transpose(2, 0, 1)
        rows, _ = np.nonzero((green > red + 60) & (green > blue + 30))
        places.append(rows.mean())
    env.close()
    assert places[1] - places[0] > 50.0


def test_rendering(monkeypatch: pytest.MonkeyPatch) -> None:
    """A picture that changes as the worm moves; none without a render mode; close may be called again."""
    env = LatticeWormEnv("extension", render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    env.step(np.ones(48))
    second = env.render()
    assert first is not None
    assert second is not None
    assert first.dtype == np.uint8
    assert first.shape == second.shape == (480, 640, 3)
    assert (first != second).any()
    again = pickle.loads(pickle.dumps(env)).render()
    np.testing.assert_allclose(again.astype(float), second.astype(float), atol=2.0)
    drawn: list[str] = []
    monkeypatch.setattr(env._pictures.renderer, "update", lambda *arguments: drawn.append(arguments[3]))
    env.render()
    assert drawn == [env.task.caption(env.state)]
    assert drawn[0].startswith("strain +")
    env.close()
    env.close()
    assert LatticeWormEnv("extension").render() is None


def test_record_video(tmp_path: Path) -> None:
    """Gymnasium's own recorder writes a video at the control rate."""
    env = gymnasium.make("LatticeWormExtension-v0", render_mode="rgb_array")
    assert env.metadata["render_fps"] == pytest.approx(20.0)
    recorder: gymnasium.Env[Any, Any] = RecordVideo(TimeLimit(env, 5), str(tmp_path / "videos"), disable_logger=True)
    recorder.reset(seed=0)
    while not recorder.step(recorder.action_space.sample())[3]:
        pass
    recorder.close()
    (video,) = tmp_path.glob("videos/*.mp4")
    assert video.stat().st_size > 1000


def test_dict_forms_are_json() -> None:
    """What the docstring calls dict forms are."""
    env = LatticeWormEnv()
    again = LatticeWormEnv(
        design=json.loads(json.dumps(env.design.to_dict())), muscles=json.loads(json.dumps(env.layout.to_dict()))
    )
    assert (again.design, again.layout) == (env.design, env.layout)
