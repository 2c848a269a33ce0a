"""What the throughput report measures of one worm, of batches of worms and of the environment around them.

One worm is timed by the processor time of its thread, batches by the clock on the wall, as threads share them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from unittest.mock import patch

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import VectorEnv
from tqdm import tqdm

from lattice_gym.benchmarks.benchmark_scene import BENCHMARK_DT, ENGINES, TENSION, benchmark_model
from lattice_gym.benchmarks.throughput.features import FEATURES, Feature
from lattice_gym.benchmarks.throughput.plain_pyelastica import PlainPyElastica
from lattice_gym.benchmarks.timing import allocated, interleaved, seconds, seconds_per_step
from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.arguments import available_cores
from lattice_gym.engines.base import Engine
from lattice_gym.engines.registry import EngineName, make_engine
from lattice_gym.engines.simulation import Simulation, simulate

ENV_ID = "LatticeWormExtension-v0"
"""Environment with the muscles of the benchmark scene."""
N_SUBSTEPS = 100
"""Physics steps in a control step."""
EPISODE_STEPS = 40
"""Control steps of an episode of that environment."""
ENV_WORMS = 16
"""Worms of the targets."""
COURSE_STEPS = 100
"""Steps over which plain PyElastica is compared with the reference engine."""


@dataclass(frozen=True)
class Plan:
    """How much is measured."""

    repeats: int
    steps: dict[str, int]
    """Steps that are timed in a repeat, of one worm."""
    sizes: tuple[int, ...]
    """Worms in a batch."""
    meshes: tuple[int, ...]
    """Elements per segment; the default lattice has 8 segments."""
    muscles: tuple[int, ...]
    pairs: tuple[int, ...]
    """Pairs of rods."""
    starts: int
    """Cold starts of either kind."""
    n_control: int
    """Control steps that are timed in a repeat, of each feature."""
    features: tuple[Feature, ...] = FEATURES


FULL = Plan(
    repeats=11,
    steps={"fused": 2000, "pyelastica": 100, "plain": 100},
    sizes=(1, 2, 4, 8, 16, 32, 64, 128, 256),
    meshes=(5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25),
    muscles=(0, 8, 16, 24, 32, 40, 48, 56, 64, 72, 80, 90),
    pairs=(4, 6, 8, 10, 12, 14, 16, 18, 20),
    starts=7,
    n_control=4,
)
QUICK = Plan(
    repeats=3,
    steps={"fused": 400, "pyelastica": 20, "plain": 20},
    sizes=(1, 4, 16),
    meshes=(5, 10, 15, 20),
    muscles=(0, 32, 90),
    pairs=(4, 8, 12),
    starts=1,
    n_control=1,
)


@dataclass(frozen=True)
class Single:
    """One worm on one core."""

    times: dict[str, list[float]]
    """Seconds per step of "fused", "pyelastica" (our engine) and "plain" (PyElastica as its user would write it)."""
    step_difference: dict[str, float]
    """Fused against plain PyElastica after one step: positions and velocities, over their largest."""
    course_difference: float
    """Our PyElastica engine against plain PyElastica after `COURSE_STEPS`: positions, over their largest."""

    def ratios(self, slow: str) -> list[float]:
        """How many times faster the fused engine is, round by round."""
        return [other / own for other, own in zip(self.times[slow], self.times["fused"], strict=True)]


@dataclass(frozen=True)
class Batches:
    """Worms side by side; keys are the number of worms and that of threads, times are the wall's."""

    physics: dict[tuple[int, int], list[float]]
    """Seconds per step of one worm."""
    control: dict[tuple[int, int], list[float]]
    """Seconds per control step of one environment."""
    plain: list[float]
    """Seconds per step of plain PyElastica, in the same rounds."""
    overhead: dict[int, list[float]]
    """Share of the steps of `ENV_WORMS` environments that the physics is not, by threads."""
    reset: list[float]
    """Seconds to reset that many."""
    bytes_per_worm: float
    """Memory that a further worm takes in a batch."""


def thread_counts(cores: int | None = None) -> list[int]:
    """Powers of two up to the number of cores (default: those for this process), and that number."""
    if cores is None:
        cores = available_cores()
    return sorted({2**k for k in range(cores.bit_length()) if 2**k <= cores} | {cores})


def _relative(a: FloatArray, b: FloatArray) -> float:
    return float(np.abs(a - b).max() / np.abs(b).max())


def time_plain(n_steps: int, clock: Callable[[], float] = time.thread_time) -> float:
    """Seconds per step of plain PyElastica from rest."""
    plain = PlainPyElastica(benchmark_model(), TENSION, BENCHMARK_DT)
    return seconds(lambda: plain.advance(n_steps), clock) / n_steps


def single(plan: Plan) -> Single:
    """Compare and time one worm on all three."""
    model = benchmark_model()
    engines: dict[EngineName, Simulation] = {name: simulate(name, model, BENCHMARK_DT) for name in ENGINES}
    plain, pull = PlainPyElastica(model, TENSION, BENCHMARK_DT), np.full(model.n_muscle, TENSION)
    plain.advance(1)
    for engine in engines.values():
        engine.advance(pull, 1)
    state = engines["fused"].state
    step = {name: _relative(getattr(state, name), getattr(plain, name)) for name in ("position", "velocity")}
    plain.advance(COURSE_STEPS - 1)
    engines["pyelastica"].advance(pull, COURSE_STEPS - 1)
    course = _relative(engines["pyelastica"].state.position, plain.position)
    tasks: dict[str, Callable[[], float]] = {
        name: partial(seconds_per_step, engine, pull, plan.steps[name]) for name, engine in engines.items()
    }
    tasks["plain"] = partial(time_plain, plan.steps["plain"])
    return Single(interleaved(tasks, plan.repeats, "one worm"), step, course)


def _make_batch(n_worm: int, num_threads: int) -> Engine:
    return make_engine("fused", [benchmark_model()] * n_worm, BENCHMARK_DT, num_threads=num_threads)


def _make_env(n_worm: int, num_threads: int) -> VectorEnv:
    """Vector environment of the benchmark scene: its muscles, step and damping."""
    return gymnasium.make_vec(
        ENV_ID, num_envs=n_worm, num_threads=num_threads,
        dt=BENCHMARK_DT, control_dt=N_SUBSTEPS * BENCHMARK_DT, splitting="pyelastica",
    )  # fmt: skip


def _calls(n_worm: int) -> int:
    """Control steps in a repeat, after one that is not timed: few enough for one episode, long enough to time."""
    return max(1, min(EPISODE_STEPS - 1, 256 // n_worm))


def _time_batch(engine: Engine, n_worm: int, n_muscle: int) -> float:
    """Seconds per step of one worm."""
    pull, calls = np.full((n_worm, n_muscle), TENSION), _calls(n_worm)

    def advance() -> None:
        for _ in range(calls):
            if engine.advance(pull, N_SUBSTEPS).any():
                raise RuntimeError("the benchmark scene diverged in a batch")

    engine.advance(pull, N_SUBSTEPS)  # Caches hold what came between.
    return seconds(advance, time.perf_counter) / (calls * n_worm * N_SUBSTEPS)


def _time_env(env: VectorEnv, n_worm: int) -> float:
    """Seconds per control step of one environment, within an episode."""
    env.action_space.seed(0)
    action, calls = env.action_space.sample(), _calls(n_worm)
    env.reset(seed=0)
    env.step(action)

    def step() -> None:
        for _ in range(calls):
            env.step(action)

    return seconds(step, time.perf_counter) / (calls * n_worm)


def _time_overhead(env: VectorEnv) -> float:
    """Share of the steps of an episode that is not spent within `Engine.advance`."""
    advance, physics = Engine.advance, 0.0
    action = env.action_space.sample()

    def timed(engine: Engine, tension: npt.ArrayLike, n_substeps: int) -> IntArray:
        nonlocal physics
        start = time.perf_counter()
        status = advance(engine, tension, n_substeps)
        physics += time.perf_counter() - start
        return status

    def episode() -> None:
        for _ in range(EPISODE_STEPS):
            env.step(action)

    env.reset(seed=0)
    with patch.object(Engine, "advance", timed):
        total = seconds(episode, time.perf_counter)
    if physics == 0.0:
        raise RuntimeError("the environment does not step by Engine.advance")
    return 1.0 - physics / total


def bytes_per_worm(few: int = 16, more: int = 64) -> float:
    """Memory that each further worm takes in a batch [bytes]."""
    sizes = []
    for n_worm in (few, more):
        engine, size = allocated(partial(_make_batch, n_worm, 1))
        engine.close()
        sizes.append(size)
    return (sizes[1] - sizes[0]) / (more - few)


def batches(plan: Plan) -> Batches:
    """Time every size of batch and environment on every number of threads, plain PyElastica beside them."""
    n_muscle = benchmark_model().n_muscle
    keys = [(n_worm, threads) for n_worm in plan.sizes for threads in thread_counts()]
    engines, envs = {}, {}
    for key in tqdm(keys, desc="building batches", unit="batch"):
        engines[key], envs[key] = _make_batch(*key), _make_env(*key)
    tasks: dict[tuple[str, tuple[int, int]], Callable[[], float]] = {}
    for key in keys:
        tasks["physics", key] = partial(_time_batch, engines[key], key[0], n_muscle)
        tasks["control", key] = partial(_time_env, envs[key], key[0])
    tasks["plain", (1, 1)] = partial(time_plain, plan.steps["plain"], time.perf_counter)
    for threads in thread_counts():
        tasks["overhead", (ENV_WORMS, threads)] = partial(_time_overhead, envs[ENV_WORMS, threads])
    several = envs[ENV_WORMS, thread_counts()[0]]
    tasks["reset", (ENV_WORMS, 1)] = lambda: seconds(lambda: several.reset(seed=0), time.perf_counter)
    times = interleaved(tasks, plan.repeats, "batches")
    for key in keys:
        engines[key].close()
        envs[key].close()
    return Batches(
        physics={key: times["physics", key] for key in keys},
        control={key: times["control", key] for key in keys},
        plain=times["plain", (1, 1)],
        overhead={threads: times["overhead", (ENV_WORMS, threads)] for threads in thread_counts()},
        reset=times["reset", (ENV_WORMS, 1)],
        bytes_per_worm=bytes_per_worm(),
    )
