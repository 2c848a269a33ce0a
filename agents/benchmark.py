"""Environment steps a second, and what PPO spends its time on: `python -m agents.benchmark`."""

from __future__ import annotations

import shlex
import statistics
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from agents import run_folder
from agents.command_line import as_program, options
from agents.config import InputError, TrainConfig
from agents.environments import Env, make_env, make_vector_env
from agents.training import new_model
from lattice_gym.reports.provenance import footer


@dataclass(frozen=True, kw_only=True)
class BenchmarkConfig:
    """What to time; every figure is the median over repeats that take turns."""

    train: TrainConfig = field(default_factory=TrainConfig)
    """Run whose worms and learner are timed; its total_steps, run_dir and checkpoints play no part."""
    repeats: int = 7
    """Times that everything is measured."""
    steps: int = 200
    """Control steps of each worm in one measurement of stepping."""
    updates: int = 2
    """Updates in one measurement of learning."""
    output: Path = Path("runs/benchmark.json")
    """Report to write."""

    def __post_init__(self) -> None:
        """Check the counts."""
        for name in ("repeats", "steps", "updates"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} = {getattr(self, name)}: must be 1 or more")


class Stopwatch:
    """Adds up the time between starts and stops of each name [s]."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._began: dict[str, float] = {}

    def start(self, name: str) -> None:
        """Begin to count."""
        self._began[name] = time.perf_counter()

    def stop(self, name: str) -> None:
        """Add the time since the start; does nothing without one."""
        if name in self._began:
            spent = time.perf_counter() - self._began.pop(name)
            self.seconds[name] = self.seconds.get(name, 0.0) + spent


class TimedVecEnv(VecEnvWrapper):
    """Counts, as "simulator", the time from sending actions to having every worm's answer."""

    def __init__(self, venv: VecEnv, watch: Stopwatch) -> None:
        super().__init__(venv)
        self.watch = watch

    def reset(self) -> VecEnvObs:
        """Start all worms anew."""
        return self.venv.reset()

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Send the actions."""
        self.watch.start("simulator")
        self.venv.step_async(actions)

    def step_wait(self) -> VecEnvStepReturn:
        """Wait for the slowest worm."""
        answer = self.venv.step_wait()
        self.watch.stop("simulator")
        return answer


class TimedUpdates(BaseCallback):
    """Counts, as "learning", the time between two rollouts."""

    def __init__(self, watch: Stopwatch) -> None:
        super().__init__()
        self.watch = watch

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        self.watch.start("learning")

    def _on_rollout_start(self) -> None:
        self.watch.stop("learning")

    def _on_training_end(self) -> None:
        self.watch.stop("learning")


def single_rate(env: Env, steps: int) -> float:
    """Count the steps a second of one worm under random actions."""
    env.reset(seed=0)
    env.action_space.seed(0)
    began = time.perf_counter()
    for _ in range(steps):
        *_, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()
    return steps / (time.perf_counter() - began)


def vector_rate(venv: VecEnv, steps: int) -> float:
    """Count the steps a second of all worms together under random actions."""
    generator = np.random.default_rng(0)
    shape = (venv.num_envs, *(venv.action_space.shape or ()))
    venv.reset()
    began = time.perf_counter()
    for _ in range(steps):
        venv.step(generator.uniform(-1.0, 1.0, shape).astype(np.float32))
    return steps * venv.num_envs / (time.perf_counter() - began)


def learning_split(model: PPO, watch: Stopwatch, steps: int) -> dict[str, float]:
    """Count the steps a second of PPO and the share of its time in each part."""
    watch.seconds.clear()
    began = time.perf_counter()
    model.learn(steps, callback=TimedUpdates(watch), reset_num_timesteps=False)
    total = time.perf_counter() - began
    parts = {name: watch.seconds[name] / total for name in ("simulator", "policy", "learning")}
    return {"PPO": steps / total} | parts | {"rest": 1.0 - sum(parts.values())}


def benchmark(config: BenchmarkConfig, command: str = "") -> dict[str, Any]:
    """Measure, write the report and return it: rates [steps/s] and shares of PPO's time."""
    torch.set_num_threads(config.train.torch_threads)
    arguments = run_folder.requested_arguments(config.train)
    env, venv, watch = make_env(arguments), make_vector_env(arguments, config.train.n_envs), Stopwatch()
    try:
        model = new_model(config.train, TimedVecEnv(venv, watch))
        model.policy.register_forward_pre_hook(lambda *_: watch.start("policy"))
        model.policy.register_forward_hook(lambda *_: watch.stop("policy"))
        figures: dict[str, list[float]] = {}
        rollout = config.train.n_envs * config.train.n_steps
        for repeat in range(-1, config.repeats):
            measured = {"one worm": single_rate(env, config.steps), "worms together": vector_rate(venv, config.steps)}
            measured |= learning_split(model, watch, config.updates * rollout)
            if repeat >= 0:  # the first round warms up
                for name, value in measured.items():
                    figures.setdefault(name, []).append(value)
    finally:
        venv.close()
        env.close()
    report = {
        "made": run_folder.made_by(command),
        "settings": config.train.to_dict(),
        "median": {name: statistics.median(values) for name, values in figures.items()},
        "measured": figures,
    }
    run_folder.write_json(config.output, report)
    return report


def main(config: BenchmarkConfig) -> None:
    """Print rates and shares, and what they were measured with."""
    command = shlex.join(["python", "-m", "agents.benchmark", *sys.argv[1:]])
    report = benchmark(config, command)
    medians = report["median"]
    n_envs = config.train.n_envs
    print(f"{'one worm':34}{medians['one worm']:8.0f} steps/s")
    print(f"{f'{n_envs} worms together':34}{medians['worms together']:8.0f} steps/s")
    print(f"{f'PPO on {n_envs} worms':34}{medians['PPO']:8.0f} steps/s, of its time:")
    for name in ("simulator", "policy", "learning", "rest"):
        print(f"    {name:30}{medians[name]:8.1%}")
    print(f"\nmedians of {config.repeats} interleaved repeats; written to {config.output}")
    print(footer(report["made"]))


if __name__ == "__main__":
    with as_program():
        main(options(BenchmarkConfig, "python -m agents.benchmark"))
