"""Environments in several threads and processes move as in one, or an error says that they cannot."""

from __future__ import annotations

import gc
import multiprocessing
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection

import gymnasium
import numpy as np
import pytest
from numba.core.compiler_lock import global_compiler_lock

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.fused.engine import FusedEngine
from lattice_gym.engines.fused.kernels import compiling
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.vector import LatticeWormVectorEnv

WAIT = 60.0
"""Longest that a child or a thread is waited for [s]."""
Env = LatticeWormEnv | LatticeWormVectorEnv
IN_USE = r"^engine: another thread is advancing these worms"

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")]
linux = pytest.mark.skipif(sys.platform != "linux", reason="forks are for Linux")


def one() -> LatticeWormEnv:
    """One worm."""
    return LatticeWormEnv("extension", control="ring", fidelity="fast")


def many(num_envs: int = 6, num_threads: int = 2) -> LatticeWormVectorEnv:
    """Several worms."""
    return LatticeWormVectorEnv(num_envs, num_threads=num_threads, task="extension", control="ring", fidelity="fast")


def walk(env: Env, seed: int = 0) -> FloatArray:
    """Observations of four steps, shape (4, ...)."""
    random = np.random.default_rng(seed)
    env.reset(seed=seed)
    return np.stack([env.step(random.random(ones(env).shape))[0] for _ in range(4)])


def ones(env: Env) -> FloatArray:
    """Activate all."""
    return np.ones(env.action_space.sample().shape)


class Held:
    """Another thread that steps an environment, and is held in the midst of it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._go_on, self._within = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None
        advance = FusedEngine._advance

        def held(engine: FusedEngine, start: FloatArray, end: FloatArray, n_substeps: int) -> IntArray:
            if threading.current_thread() is self._thread:
                self._within.set()
                assert self._go_on.wait(WAIT)
            return advance(engine, start, end, n_substeps)

        monkeypatch.setattr(FusedEngine, "_advance", held)

    def begin(self, env: Env) -> None:
        """Let it begin."""
        self._thread = threading.Thread(target=env.step, args=(ones(env),))
        self._thread.start()
        assert self._within.wait(WAIT)

    def end(self) -> None:
        """Let it end its step."""
        self._go_on.set()
        if self._thread is not None:
            self._thread.join(WAIT)


@pytest.fixture
def held(monkeypatch: pytest.MonkeyPatch) -> Iterator[Held]:
    """Return what steps an environment in another thread."""
    thread = Held(monkeypatch)
    yield thread
    thread.end()


def test_environments_side_by_side_move_as_one_after_another() -> None:
    """Each in a thread of its own, one worm and a batch, which has threads as well."""
    alone = [walk(one(), seed) for seed in range(3)], [walk(many(), seed) for seed in range(3)]
    with ThreadPoolExecutor(3) as pool:
        np.testing.assert_array_equal(list(pool.map(lambda seed: walk(one(), seed), range(3))), alone[0])
        np.testing.assert_array_equal(list(pool.map(lambda seed: walk(many(), seed), range(3))), alone[1])


@pytest.mark.parametrize("make", [one, many])
def test_worms_that_another_thread_advances_are_refused(make: Callable[[], Env], held: Held) -> None:
    """To step, reset, restore or show them meanwhile would mix two moments; the step at work ends as alone."""
    env, alone = make(), make()
    for each in (env, alone):
        each.reset(seed=3)
    alone.step(ones(alone))
    engine = env.worms.engine
    state = engine.state()
    held.begin(env)
    for call in (
        lambda: env.step(ones(env)),
        lambda: env.reset(seed=0),
        lambda: env._pictures.draw(),
        lambda: engine.state(),
        lambda: engine.restore(0, state),
        lambda: engine.replace(0, engine.models[0]),
        lambda: engine.advance(np.zeros((engine.n_worm, engine.models[0].n_muscle)), 1),
    ):
        with pytest.raises(RuntimeError, match=IN_USE):
            call()
    held.end()
    np.testing.assert_array_equal(env.worms.motion.position, alone.worms.motion.position)
    np.testing.assert_array_equal(env.step(ones(env))[0], alone.step(ones(alone))[0])
    assert env.np_random_seed == alone.np_random_seed


def child_steps(env: Env, sent: Connection) -> None:
    """Step worms of the parent, or send the error."""
    try:
        sent.send(walk(env))
    except RuntimeError as error:
        sent.send(str(error))


def in_fork(env: Env) -> object:
    """Return what `walk` gives in a child, or its error."""
    received, sent = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(target=child_steps, args=(env, sent))
    child.start()
    try:
        assert received.poll(WAIT), "the child waits for ever"
        result: object = received.recv()
        child.join(WAIT)
        assert child.exitcode == 0
    finally:
        child.kill()
    return result


@linux
@pytest.mark.parametrize("make", [one, many])
def test_fork_goes_on(make: Callable[[], Env]) -> None:
    """A child steps the worms of its parent as that does, and so does the parent after it."""
    env = make()
    before = walk(env)
    np.testing.assert_array_equal(in_fork(env), before)
    np.testing.assert_array_equal(walk(env), before)


@linux
def test_fork_amid_a_step_of_another_thread_says_so(held: Held) -> None:
    """Forces half summed stay in the child, and a reset does not clear them; other worms go on in it."""
    env, other = many(), one()
    env.reset(seed=0)
    expected = walk(other)
    held.begin(env)
    assert str(in_fork(env)).startswith("engine: another thread is advancing these worms, or was when")
    np.testing.assert_array_equal(in_fork(other), expected)


def take_compiler_lock() -> None:
    """Do what every compilation begins with."""
    with global_compiler_lock:
        pass


@linux
def test_fork_waits_for_what_is_compiled() -> None:
    """Else the child would wait for a thread that it has not; and garbage is collected in it."""
    begun, go_on = threading.Event(), threading.Event()

    def compile_slowly(signature: object) -> None:
        begun.set()
        go_on.wait(WAIT)

    thread = threading.Thread(target=compiling._faster(compile_slowly), args=(None,))
    thread.start()
    assert begun.wait(WAIT)
    timer = threading.Timer(0.2, go_on.set)
    timer.start()
    child = multiprocessing.get_context("fork").Process(target=take_compiler_lock)
    child.start()
    assert go_on.is_set()
    child.join(WAIT)
    exitcode = child.exitcode
    child.kill()
    thread.join(WAIT)
    assert exitcode == 0
    assert gc.isenabled()


def test_worms_advance_where_no_thread_can_be_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where a process has as many as it may, or at the end of Python: one thread does it all."""
    expected, env = walk(many(num_threads=1)), many(num_threads=3)

    def refuse(self: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    np.testing.assert_array_equal(walk(env), expected)


def test_generators_are_of_their_environment() -> None:
    """Threads that draw commands in turn give each worm the episodes that it has alone."""

    def azimuths(env: gymnasium.Env[object, object]) -> list[float]:
        first = env.reset(seed=5)[1]["command"]["azimuth"]
        return [first] + [env.reset()[1]["command"]["azimuth"] for _ in range(20)]

    envs = [LatticeWormEnv("bending", fidelity="fast") for _ in range(3)]
    with ThreadPoolExecutor(3) as pool:
        drawn = list(pool.map(azimuths, envs))
    assert drawn[0] == drawn[1] == drawn[2]
    assert len(set(drawn[0])) == 21
