"""The environment as Gymnasium, Stable-Baselines3 and a hostile caller see it."""

from __future__ import annotations

import copy
import json
import pickle
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordVideo, RescaleAction, TimeLimit
from small_worms import SMALL, SMALL_WAVE, bare_env, episode, same
from stable_baselines3.common.env_checker import check_env as check_env_sb3

import lattice_gym
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.engines.health import Status
from lattice_gym.engines.registry import EngineName
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.info import STATUS
from lattice_gym.physics.laws.activation import advance_activation
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.measures import muscle_lengths, site_positions
from lattice_gym.physics.state import Motion
from lattice_gym.physics.world import World
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
    check_env(bare_env(id, fidelity="fast", render_mode="rgb_array"))


@pytest.mark.parametrize("id", list(IDS)[1:])
@pytest.mark.parametrize("control", ["muscle", "ring"])
def test_stable_baselines_checker(id: str, control: str) -> None:
    """As training wraps it; the checker looks at spaces and types, not at numbers."""
    worm = gymnasium.make(id, fidelity="fast", control=control, rhythm=1.0)
    env = RescaleAction(worm, np.float32(-1.0), np.float32(1.0))
    check_env_sb3(env)
    assert isinstance(env.action_space, gymnasium.spaces.Box)
    assert (env.action_space.low == -1.0).all()
    assert (env.action_space.high == 1.0).all()
    env.reset(seed=0)
    observation, reward, terminated, truncated, info = env.step(env.action_space.high)
    assert observation in env.observation_space
    assert (terminated, truncated, info["status"]) == (False, False, Status.OK)
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
    env = gymnasium.make(id, fidelity="fast")
    for _, reward, _, _, info in episode(env, 25)[1:]:
        assert reward == sum(info["reward_terms"].values())
        assert set(info) == {"command", "reward_terms", "outcome", *STATUS, "clipped_actions", "clipped_observations"}
        assert (info["status"], info["clipped_actions"], info["clipped_observations"]) == (Status.OK, 0, 0)
        assert list(info["reward_terms"])[-2:] == ["effort", "divergence"]
        assert all(type(value) is float for value in {**info["reward_terms"], **info["outcome"]}.values())
        assert type(reward) is float


@pytest.mark.parametrize("id", list(IDS)[1:])
@pytest.mark.parametrize("points", ["sites", "nodes"])
def test_observations(id: str, points: str) -> None:
    """They share no memory, stay inside their space, and only what is commanded is constant over an episode."""
    env = bare_env(id, fidelity="fast", observation=[points, "activation", "command", "clock"], rhythm=1.3)
    steps = episode(env, 30)
    seen = np.array([step[0] for step in steps])
    assert seen.dtype == np.float32
    assert all(step[0] in env.observation_space for step in steps)
    assert not any(np.shares_memory(a[0], b[0]) for a, b in pairwise(steps))
    n_free = {"sites": 54, "nodes": 204} if env.design.base == "free" else {"sites": 48, "nodes": 192}
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
    env = bare_env("LatticeWorm-v0", rhythm=2.0, control="ring")
    observation = episode(env, 13)[-1][0]
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
    assert episode(env, 3)[-1][4]["status"] == Status.OK


@pytest.mark.parametrize("control", ["muscle", "ring", "column", [0, 1] * 45])
def test_control(control: Any) -> None:
    """The action of a group is the command of its muscles, followed by exact first-order dynamics."""
    env = bare_env("LatticeWorm-v0", control=control)
    env.reset(seed=0)
    n_action = {"muscle": 90, "ring": 15, "column": 24}.get(str(control), 2)
    assert env.action_space.shape == (n_action,)
    activation = np.zeros(90)
    for seed in range(3):
        action = np.random.default_rng(seed).random(n_action)
        env.step(action)
        activation = advance_activation(activation, action[env.groups], 0.05, 0.015, 0.05)
        np.testing.assert_allclose(env.activation, activation, rtol=1e-12)


def test_state_does_not_survive_reset() -> None:
    """A reset after violent steps starts as the first one did, and what is handed out is a copy."""
    env = bare_env("LatticeWorm-v0")
    first = episode(env, 45)
    env.state.position[:] = np.nan
    env.activation[:] = np.nan
    assert same(first, episode(env, 45))


def test_seeds() -> None:
    """The same seed gives the same episode, another seed another, and a reset without one goes on drawing."""
    env = gymnasium.make("LatticeWorm-v0")
    first = episode(env, 3, seed=1)
    assert same(first, episode(gymnasium.make("LatticeWorm-v0"), 3, seed=1))
    assert not same(first[:1], [env.reset(seed=2)])
    assert env.reset()[1]["command"] != env.reset()[1]["command"]


def test_commands() -> None:
    """Held by the constructor, for one episode by options, and told at reset."""
    env = bare_env("LatticeWormBending-v0", command={"azimuth": 1.0})
    assert env.reset(seed=0)[1]["command"] == {"azimuth": 1.0}
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
    assert same(episode(env, 3), episode(again, 3))


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
    other = gymnasium.make("LatticeWorm-v0", **plain)
    assert env.spec is not None
    assert other.spec is not None
    with pytest.raises(TypeError, match="not JSON serializable"):
        env.spec.to_json()
    again = gymnasium.make(EnvSpec.from_json(other.spec.to_json()))
    assert same(episode(env, 2), episode(again, 2))
    assert same(episode(env, 2), episode(other, 2))


@pytest.mark.parametrize("task", list(TASKS))
def test_any_task_in_any_world(task: str, engine_name: EngineName) -> None:
    """Everything at once, on either engine; deterministic, and a copy goes on as it would."""
    # A worm must be at rest before it crawls; a ball slips out between so few rods and is not, so it has lines instead.
    ball = None if task == "crawl" else Ball(radius=0.02)
    world = World(medium=Medium(drag=0.01), ground=Ground(forward=0.5), ball=ball, lying=True).to_dict()
    design = SMALL | {"base": "free", "muscle_model": "line" if ball is None else "rod"}
    command = SMALL_WAVE if task == "peristalsis" else None
    kwargs: dict[str, Any] = {"control": "ring", "control_dt": 0.01, "command": command}
    env = LatticeWormEnv(task, design=design, world=world, engine=engine_name, **kwargs)
    first = episode(env, 3)
    assert all(step[0] in env.observation_space for step in first)
    assert first[-1][4]["status"] == Status.OK
    assert same(first, episode(env, 3))
    twin, action = copy.deepcopy(env), env.action_space.sample()
    assert same([env.step(action)], [twin.step(action)])


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
        largest[control] = max(step[4]["outcome"]["bend_angle"] for step in episode(env, 20)[1:])
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
    assert same(original, [twin.step(action) for action in actions])
    assert same([env.reset()], [twin.reset()])


def test_engines_agree(engine_pair: tuple[EngineName, EngineName]) -> None:
    """With velocities damped alike, the two engines return the same observations and rewards, to rounding."""
    shared: dict[str, Any] = {"design": SMALL, "splitting": "pyelastica", "command": SMALL_WAVE}
    envs = [LatticeWormEnv(engine=engine, **shared) for engine in engine_pair]
    for fused, reference in zip(*(episode(env, 4) for env in envs), strict=True):
        np.testing.assert_allclose(fused[0], reference[0], atol=1e-6)
        if len(fused) == 5:
            assert fused[1] == pytest.approx(reference[1], abs=1e-7)


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
