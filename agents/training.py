"""PPO training that writes a run folder, survives being killed and continues where it stopped."""

from __future__ import annotations

import itertools
import re
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from tqdm import tqdm

from agents import checkpoints, run_folder
from agents.command_line import LINE_EVERY, Stopped, command, on_signal
from agents.config import OBSERVATION_CLIP, OBSERVATION_EPSILON, InputError, TrainConfig
from agents.environments import make_env, make_vector_env
from agents.logs import Board, ProgressTable
from agents.run_folder import Run, set_aside
from lattice_gym.engines.health import Status
from lattice_gym.policies.evaluation import gather
from lattice_gym.recording import files

_DIVERGED = "worm/diverged_episodes"
_NEW_ONLY = ("design", "muscles", "environment", "run_dir")
_MAY_CHANGE = ("total_steps", "time_limit", "num_threads", "resume", "allow", *_NEW_ONLY)


def train(config: TrainConfig) -> Path:
    """Train, or continue `config.resume`, until total_steps or time_limit; returns the run folder.

    Training ends with a whole update, so it may take up to n_envs * n_steps - 1 steps more than asked for. Raises
    InputError if the settings, the design or the run folder cannot be used, and Stopped, after a checkpoint, on ctrl-C
    or termination; a second one ends it at once.
    """
    began = time.monotonic()
    config = config.resolved()
    torch.set_num_threads(config.torch_threads)
    path = create_run(config) if config.resume is None else config.resume
    again = command("python", "train.py", "--resume", path) + Run.open(path).allowance
    try:
        with files.claimed(path):
            run = Run.open(path) if config.resume is None else reopen_run(config)
            files.prepare(path / run_folder.CHECKPOINTS)
            done = f"{path}: {run.steps} of {config.total_steps} steps done"
            if run.steps >= config.total_steps:
                print(f"{done}: nothing to do; raise --total-steps", flush=True)
                return path
            print(done, flush=True)
            log = _run_training(run, config, began, again)
            if log.signal is not None:
                raise Stopped(log.signal)
    except Stopped as stopped:
        raise Stopped(stopped.number, again) from None
    if log.stop_reason is not None and log.num_timesteps < config.total_steps:
        print(f"stopped by {log.stop_reason}; continue with: {again}", flush=True)
    return path


def _run_training(run: Run, config: TrainConfig, began: float, again: str) -> TrainingLog:
    """Log of the run after training, of which the last checkpoint is written; an OSError says how to go on."""
    print(f"starting {config.n_envs} worm{'s' if config.n_envs > 1 else ''}", flush=True)
    venv = make_vector_env(run.env_arguments, config.n_envs, config.num_threads)
    try:
        model = restored_model(run, venv) if run.steps else new_model(config, venv)
        run_folder.write_json(run.path / run_folder.CONFIG, config.to_dict())
        log = TrainingLog(run, model, began)
        with on_signal(log.stop):
            model.learn(config.total_steps - model.num_timesteps, callback=log, reset_num_timesteps=False)
            log.save()
        model.logger.close()
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, f"{error.strerror}; continue with: {again}", error.filename) from error
    finally:
        venv.close()
    return log


def create_run(config: TrainConfig) -> Path:
    """Make the run folder with everything but a model; raises InputError if it exists or the worm cannot be built."""
    arguments = run_folder.requested_arguments(config)
    env = make_env(arguments)
    worm: Any = env.unwrapped
    env.close()
    # As it was given: the worm's own has the mesh of the fidelity, from which another one could not tell this.
    contents: dict[str, object] = {
        run_folder.DESIGN: arguments["design"],
        run_folder.MUSCLES: worm.layout.to_dict(),
        run_folder.VERSIONS: [run_folder.session(0)],
        run_folder.CONFIG: config.to_dict(),
    }
    if config.environment is not None:
        contents[run_folder.ENVIRONMENT] = run_folder.read_environment(config.environment)
    for path in _places(config):
        with suppress(FileExistsError):
            run_folder.make(path, contents)
            return path
    must = f"must be a new or empty folder; to continue that run give {command('--resume', path)}"
    raise InputError(f"run_dir = {path}: {must}")


def _places(config: TrainConfig) -> Iterator[Path]:
    """Run folders to try one after another: that which was given, or others until one is new."""
    if config.run_dir is not None:
        yield config.run_dir
        return
    task = re.sub(r"[^\w.-]", "-", config.task_class.name)[:100]
    name = f"{task}-{config.seed}-{datetime.now():%Y%m%d-%H%M%S}"
    yield Path("runs") / name
    for number in itertools.count(2):
        yield Path("runs") / f"{name}-{number}"


def resume_settings(path: Path) -> TrainConfig:
    """Read the settings with which `train` continues a run folder; some of them may be replaced."""
    return replace(Run.open(path).config, resume=path)


def reopen_run(config: TrainConfig) -> Run:
    """Open `config.resume` to continue it; raises InputError if a setting differs from the run's own."""
    assert config.resume is not None
    run = Run.open(config.resume)
    for field in fields(config):
        given, stored = getattr(config, field.name), getattr(run.config, field.name)
        if field.name not in _MAY_CHANGE and given != stored:
            raise InputError(f"{field.name} = {given!r}: must be {stored!r}, as {run.path} keeps its settings")
    if any(getattr(config, name) is not None for name in _NEW_ONLY):
        raise InputError(f"{', '.join(_NEW_ONLY)}: must not be given with --resume, as {run.path} keeps its own")
    if config.total_steps < run.steps and config.total_steps != run.config.total_steps:
        raise InputError(f"total_steps = {config.total_steps}: must be {run.steps} or more, which {run.path} has done")
    return replace(run, config=config)


def step_size(config: TrainConfig) -> float | LinearSchedule:
    """Step size of Adam, or what gives it: linear in the steps done before the rollout of an update.

    Stable-Baselines3 counts those of that rollout as well, with which the last update would learn nothing: hence the
    end one rollout later.
    """
    if not config.anneal:
        return config.learning_rate
    end = 1.0 + config.n_envs * config.n_steps / config.total_steps
    return LinearSchedule(config.learning_rate * end, 0.0, end)


def worm_seeds(config: TrainConfig, from_step: int) -> range:
    """Seeds of the worms' first episodes in the session of training that started after so many steps.

    The first session has that of the settings, a later one others, lest it repeat what the first has seen.
    """
    first = config.seed
    if from_step:
        first = int(np.random.SeedSequence([config.seed, from_step]).generate_state(1)[0])
    return range(first, first + config.n_envs)


def new_model(config: TrainConfig, venv: VecEnv) -> PPO:
    """Untrained PPO on worms whose observations and rewards are normalised."""
    return PPO(
        "MlpPolicy",
        VecNormalize(venv, gamma=config.resolved_gamma, clip_obs=OBSERVATION_CLIP, epsilon=OBSERVATION_EPSILON),
        learning_rate=step_size(config),
        n_steps=config.n_steps,
        batch_size=config.batch_size,
        n_epochs=config.n_epochs,
        gamma=config.resolved_gamma,
        gae_lambda=config.gae_lambda,
        clip_range=config.clip_range,
        ent_coef=config.entropy_coefficient,
        vf_coef=config.value_coefficient,
        max_grad_norm=config.max_gradient_norm,
        use_sde=config.gsde,
        policy_kwargs={"net_arch": list(config.hidden_sizes), "log_std_init": config.log_std_init},
        seed=config.seed,
        device="cpu",
    )


def restored_model(run: Run, venv: VecEnv) -> PPO:
    """Model of the newest checkpoint that can be read, with noise of its own; raises InputError if there is none."""
    damaged: list[Path] = []
    trouble = InputError(f"{run.path / run_folder.CHECKPOINTS}: no checkpoint to continue from")
    model = new_model(run.config, venv)
    for folder in run.checkpoints():
        try:
            checkpoints.restore(model, folder)
        except InputError as error:
            damaged.append(folder)
            trouble = error
            continue
        model.num_timesteps = int(folder.name)
        model._n_updates = model.num_timesteps // (model.n_envs * model.n_steps) * model.n_epochs
        for other in damaged:
            aside = set_aside(other)
            print(f"continuing from an older checkpoint, {folder}: the newer {aside} cannot be read", file=sys.stderr)
        model.set_random_seed(worm_seeds(run.config, model.num_timesteps)[0])
        path = run.path / run_folder.VERSIONS
        run_folder.write_json(path, [*run_folder.read_sessions(path), run_folder.session(model.num_timesteps)])
        return model
    raise trouble


class TrainingLog(BaseCallback):
    """Writes logs, checkpoints and progress of a run, and ends it between two updates when asked to."""

    model: PPO

    def __init__(self, run: Run, model: PPO, began: float) -> None:
        """Give the model a log that continues the run's progress.csv from the model's steps."""
        super().__init__()
        path = run.path / run_folder.PROGRESS
        rows = [row for row in run.rows() if row[run_folder.STEPS] <= model.num_timesteps] if path.exists() else []
        board = Board(run.path / run_folder.TENSORBOARD)
        model.set_logger(Logger(str(run.path), [ProgressTable(path, rows), board]))
        self.model = model
        self.stop_reason: str | None = None
        self.signal: int | None = None
        self._run = run
        self._began = began
        self._line_at = began
        self._saved_at = model.num_timesteps
        self._diverged = int(rows[-1].get(_DIVERGED, 0)) if rows else 0
        self._finished: list[dict[str, Any]] = []

    def stop(self, number: int) -> None:
        """End training in good order on a first signal, at once on a second."""
        if self.signal is not None:
            raise Stopped(number)
        self.signal = number

    def save(self) -> None:
        """Write a checkpoint of the model as it is now."""
        self._saved_at = self.model.num_timesteps
        run_folder.save_checkpoint(self._run.path, self._saved_at, checkpoints.files(self.model))

    def _on_training_start(self) -> None:
        total = self._run.config.total_steps
        hidden = not sys.stderr.isatty()
        self._bar = tqdm(total=total, initial=self.model.num_timesteps, unit="step", disable=hidden)

    def _on_rollout_start(self) -> None:
        if self.model.num_timesteps - self._saved_at >= self._run.config.checkpoint_every:
            self.save()
        limit = self._run.config.time_limit
        if limit is not None and time.monotonic() - self._began > limit:
            self.stop_reason = f"time limit of {limit:g} s"

    def _on_step(self) -> bool:
        for info, done in zip(self.locals["infos"], self.locals["dones"], strict=True):
            if done:
                self._finished.append(info)
                self._diverged += info["status"] != Status.OK
        self._bar.update(self.locals["env"].num_envs)
        return self.stop_reason is None and self.signal is None

    def _on_rollout_end(self) -> None:
        returns = [info["episode"]["r"] for info in self._finished]
        if returns:
            self.logger.record("worm/return_mean", float(np.mean(returns)))
            self.logger.record("worm/return_std", float(np.std(returns)))
            for name, values in gather([info["outcome_errors"] for info in self._finished]).items():
                self.logger.record(f"worm/outcome_{name}", float(np.mean(values)))
        self.logger.record(_DIVERGED, self._diverged)
        self._finished.clear()
        if returns and self._bar.disable and time.monotonic() - self._line_at > LINE_EVERY:
            self._line_at = time.monotonic()
            seconds = self._line_at - self._began
            print(
                f"{seconds:6.0f} s  {self.num_timesteps:8d} of {self._run.config.total_steps} steps"
                f"  return {np.mean(returns):8.3f}  diverged {self._diverged}",
                flush=True,
            )
        elif returns:
            self._bar.set_postfix({"return": f"{np.mean(returns):.3f}", "diverged": self._diverged})

    def _on_training_end(self) -> None:
        self._bar.close()
