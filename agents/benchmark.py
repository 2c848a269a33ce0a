"""Environment steps a second, and what PPO spends its time on: `python -m agents.benchmark`."""

from __future__ import annotations

import shlex
import statistics
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial, wraps
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

from agents import run_folder
from agents.command_line import as_program, options
from agents.config import InputError, Settings, TrainConfig
from agents.environments import Env, make_env, make_vector_env
from agents.training import new_model
from lattice_gym.checks import checked, count, flag, items, whole
from lattice_gym.engines.base import Engine
from lattice_gym.recording.files import prepare
from lattice_gym.recording.provenance import footer

PARTS = ("physics", "environment", "adapter", "policy", "update")
"""What PPO spends its time on, each without those before it: integrating the rods; observations, rewards and whatever
else the environment does in a step; handing that over, checked for NaN and normalised; choosing actions; learning."""
PHYSICS = (Engine, "advance")
"""Whose method integrates the rods."""

Measured = dict[str, float]
"""Rates [steps/s] and shares of PPO's time, by name."""


@dataclass(frozen=True, kw_only=True)
class BenchmarkConfig(Settings):
    """What to time; every figure is the median over repeats that take turns."""

    train: TrainConfig = field(default_factory=TrainConfig)
    """Run whose worms and learner are timed; its total_steps, run_dir and checkpoints play no part."""
    throughput: bool = checked(False, flag)
    """Time runs of as many worms as `worms` says, in place of train.n_envs."""
    worms: tuple[int, ...] = checked((2, 8, 32), items, each=partial(whole, low=1), what="numbers of worms")
    """Numbers of worms for --throughput."""
    repeats: int = count(7, 1)
    """Times that everything is measured."""
    steps: int = count(200, 1)
    """Control steps of each worm in one measurement of stepping."""
    updates: int = count(2, 1)
    """Updates in one measurement of learning."""
    output: Path = Path("runs/benchmark.json")
    """Report to write."""

    def __post_init__(self) -> None:
        """Check every field, and the runs that they give."""
        super().__post_init__()
        if not self.worms:
            raise InputError("worms = (): must name at least one number of worms")
        _ = self.runs

    @property
    def runs(self) -> list[TrainConfig]:
        """Runs to time; raises InputError where their number of worms does not fit the batch."""
        return [replace(self.train, n_envs=n) for n in self.worms] if self.throughput else [self.train]


class Stopwatch:
    """Adds up the time spent in each part [s], without that in other parts inside it."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._inside: list[str] = []
        self._since = 0.0

    def timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Let calls of a function count as a part."""

        @wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            self._count()
            self._inside.append(part)
            try:
                return function(*arguments, **named)
            finally:
                self._count()
                self._inside.pop()

        return call

    def _count(self) -> None:
        now = time.perf_counter()
        if self._inside:
            part = self._inside[-1]
            self.seconds[part] = self.seconds.get(part, 0.0) + now - self._since
        self._since = now


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


def learning_split(model: PPO, steps: int) -> Measured:
    """Count the steps a second of PPO and the share of its time in each part; the rest is bookkeeping."""
    watch, venv = Stopwatch(), model.get_env()
    assert venv is not None
    worms: Any = venv.unwrapped
    owners = (PHYSICS, (worms.envs, "step"), (venv, "step"), (model.policy, "forward"), (model, "train"))
    with ExitStack() as timing:
        for part, (owner, method) in zip(PARTS, owners, strict=True):
            timing.enter_context(patch.object(owner, method, watch.timed(part, getattr(owner, method))))
        began = time.perf_counter()
        model.learn(steps, reset_num_timesteps=False)
        total = time.perf_counter() - began
    parts = {name: watch.seconds[name] / total for name in PARTS}
    return {"PPO": steps / total} | parts | {"rest": 1.0 - sum(parts.values())}


def benchmark(config: BenchmarkConfig, command: str = "") -> dict[str, Any]:
    """Measure, write the report and return it; each list of `measured` has a figure for every repeat."""
    torch.set_num_threads(config.train.torch_threads)
    prepare(config.output.parent)
    arguments = run_folder.requested_arguments(config.train)
    single: list[float] = []
    figures: list[dict[str, list[float]]] = [{} for _ in config.runs]
    with ExitStack() as stack:
        env = make_env(arguments)
        stack.callback(env.close)
        models = []
        for run in config.runs:
            venv = make_vector_env(arguments, run.n_envs, run.num_threads)
            stack.callback(venv.close)
            models.append((run, venv, new_model(run, venv)))
        for repeat in range(-1, config.repeats):
            rate = single_rate(env, config.steps)
            rows = [
                {"worms together": vector_rate(venv, config.steps)}
                | learning_split(model, config.updates * run.n_envs * run.n_steps)
                for run, venv, model in models
            ]
            if repeat >= 0:  # the first round warms up
                single.append(rate)
                for table, row in zip(figures, rows, strict=True):
                    for name, value in row.items():
                        table.setdefault(name, []).append(value)
    report = {
        "made": run_folder.made_by(command),
        "settings": config.train.to_dict(),
        "one worm": {"median": statistics.median(single), "measured": single},
        "runs": [
            {
                "n_envs": run.n_envs,
                "median": {name: statistics.median(values) for name, values in table.items()},
                "measured": table,
            }
            for run, table in zip(config.runs, figures, strict=True)
        ],
    }
    run_folder.write_json(config.output, report)
    return report


def format_runs(report: dict[str, Any]) -> str:
    """Medians as a plain text table: rates, and of PPO's time the share of each part."""
    shares = (*PARTS, "rest")
    lines = ["worms   steps/s   PPO steps/s, of its time:" + "".join(name.rjust(13) for name in shares)]
    for run in report["runs"]:
        medians = run["median"]
        rates = f"{run['n_envs']:5d}{medians['worms together']:10.0f}{medians['PPO']:14.0f}"
        lines.append(
            f"{rates:{len(lines[0]) - 13 * len(shares)}}" + "".join(f"{medians[name]:13.1%}" for name in shares)
        )
    return "\n".join(lines)


def main(config: BenchmarkConfig) -> None:
    """Print rates and shares, and what they were measured with."""
    command = shlex.join(["python", "-m", "agents.benchmark", *sys.argv[1:]])
    report = benchmark(config, command)
    print(f"one worm alone: {report['one worm']['median']:.0f} steps/s\n")
    print(format_runs(report))
    print(f"\nmedians of {config.repeats} interleaved repeats; written to {config.output}")
    print(footer(report["made"]))


if __name__ == "__main__":
    with as_program():
        main(options(BenchmarkConfig, "python -m agents.benchmark"))
