"""Where the physics fails: the episode ends, never pays, and says what happened."""

from __future__ import annotations

import copy
import pickle
import re
from typing import Any

import gymnasium
import numpy as np
import pytest
from small_worms import N_SMALL, SMALL, SMALL_WAVE, bare_env, same

from lattice_gym.benchmarks.divergence.runs import plan
from lattice_gym.engines.health import Health, Status
from lattice_gym.engines.registry import EngineName
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.info import describe_status
from lattice_gym.envs.terms import MOTION_BOUND
from lattice_gym.recording.trajectory import Recorder
from lattice_gym.tasks.base import MIN_PENALTY
from lattice_gym.tasks.registry import TASKS

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("height", "direction", "held"), [(0.13, 1.0, True), (0.13, -1.0, False), (-0.02, -1.0, True)])
def test_a_ball_that_has_left_ends_the_episode(height: float, direction: float, held: bool) -> None:
    """By the commanded end it is delivered, by the other lost, and that costs; the next episode has it back."""
    env = bare_env("LatticeWormTransport-v0", control="ring", command={"direction": direction})
    env.reset(seed=0)
    state = env.state
    state.ball_position[0, 2] = height
    env.worms.restore(state)
    _, reward, terminated, truncated, info = env.step(np.zeros(15))
    assert (terminated, truncated, info["status"]) == (True, False, Status.OK)
    assert info["reward_terms"]["lost"] == (0.0 if held else -5.0)
    assert reward == sum(info["reward_terms"].values())
    assert (info["outcome"]["held"], info["outcome"]["delivered"]) == (float(held), float(held))
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(15))
    observation, _ = env.reset(seed=0)
    np.testing.assert_array_equal(observation[-6:], 0.0)


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
    assert re.fullmatch(
        r"(not finite|overstretched|inverted): (muscle|structure rod) \d+ .*element \d+ .*", describe_status(info, env)
    )
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
    where = "structure rod 4 (left-handed), element 2 of 8, between levels 1 and 2"
    assert describe_status(info, env) == f"inverted: {where}"
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
    assert same(first[:-1], plain_first[:-1])
    assert [step[2] for step in first[1:]] == [False] * 4 + [True]
    assert not plain_first[-1][2]
    told = describe_status(first[-1][4], checked)
    assert re.fullmatch(r"inaccurate, as .* too long: (muscle|structure rod) \d+ .*", told)
    assert first[-1][4]["reward_terms"]["divergence"] == -MIN_PENALTY
    np.testing.assert_array_equal(first[-1][0], first[-2][0])
    with pytest.raises(gymnasium.error.ResetNeeded):
        checked.step(commands[0].astype(float))
    assert same(first, episode(checked))


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
        assert same([env.step(action)], [twin.step(action)])
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
