"""`TrainConfig`: every setting of a training run; its fields are the options of `python train.py`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import partial
from math import inf
from pathlib import Path
from typing import Any, Literal, get_args

from lattice_gym.body.muscles import LAYOUTS
from lattice_gym.checks import (
    Parameters,
    checked,
    choice,
    count,
    flag,
    import_code,
    instance,
    items,
    names,
    real,
    require,
    whole,
)
from lattice_gym.engines.registry import ENGINES, EngineName
from lattice_gym.envs.fidelity import FidelityName
from lattice_gym.tasks.base import Task
from lattice_gym.tasks.registry import resolve_task

Control = Literal["muscle", "ring", "column"]

LEARNER_RANGE = (-1.0, 1.0)
"""Range in which the learner acts."""
LEARNER_ACTIVATION = "tanh"
"""What its hidden layers apply, as Stable-Baselines3's MlpPolicy has it."""
OBSERVATION_CLIP, OBSERVATION_EPSILON = 10.0, 1e-8
"""Bound of normalised observations, and what is added to their variances."""

_HINTS = {"control": "muscle", "gamma": 0.9}  # for a task that says nothing of how to learn it
_PLACES = ("design", "muscles", "environment", "run_dir", "resume")  # files of this machine, kept out of config.json
_OUTSIDE = (*_PLACES, "allow")  # nor may config.json allow anything


class InputError(ValueError):
    """Input that cannot be used; the command lines print it without a traceback."""


class TaskError(InputError):
    """Task that cannot be imported or used."""


@contextmanager
def input_errors() -> Iterator[None]:
    """Raise a ValueError of the body as an InputError."""
    try:
        yield
    except InputError:
        raise
    except ValueError as error:
        raise InputError(str(error)) from error


def allow_modules(modules: Iterable[str]) -> None:
    """Import modules, so that files may name what is in them; raises InputError where one cannot be."""
    with input_errors():
        for module in modules:
            import_code("allow", module)


class Settings(Parameters):
    """Parameters that are options of a command line: an InputError names one as it is given there."""

    def __post_init__(self) -> None:
        with input_errors():
            super().__post_init__()

    @classmethod
    def _label(cls, name: str) -> str:
        return name


def _is_file(muscles: object) -> bool:
    return isinstance(muscles, str) and muscles.endswith(".json")


def _muscles(name: str, given: object) -> str:
    return str(given) if _is_file(given) else choice(name, given, LAYOUTS, "a file *.json")


def _terms(name: str, given: object) -> tuple[str, ...]:
    terms = items(name, given, partial(instance, kind=str), what="names of terms")
    require(len(terms) > 0, f"{name} = (): must name at least one term")
    return terms


@dataclass(frozen=True, kw_only=True)
class TrainConfig(Settings):
    """One training run of PPO on a lattice worm.

    Raises InputError, a ValueError, that names the field, the value and the bound or choices.
    """

    task: str = checked("peristalsis", instance, kind=str, how=", a task's name or module:Class")
    """What the worm learns to do: a task of the package by name, or anybody's as module:Class."""
    total_steps: int = count(100_000, 1)
    """Environment steps to train for, over all worms together [control steps]."""
    seed: int = count(0, 0, 2**32 - 1)
    """Seed of the policy, the noise and the worms."""
    control: Control | None = checked(None, choice, choices=get_args(Control), none=True)
    """What one action drives: muscle, level (ring) or side (column); by default what the task says."""
    rhythm: float | None = real(None, 0.0, inf, "Hz", above=True, none=True)
    """Frequency of a clock whose sine and cosine join the observation [Hz]; none by default."""
    design: Path | None = checked(None, instance, kind=Path, none=True)
    """JSON file of a LatticeDesign, or of the fields that differ from the task's own; the task's own if not given."""
    muscles: str | None = checked(None, _muscles, none=True)
    """Name of a muscle layout (extension, compression, bending, all) or its JSON file; the task's own if not given."""
    environment: Path | None = checked(None, instance, kind=Path, none=True)
    """JSON file of further arguments of LatticeWormEnv by name, such as world, command, hill, adaptation, randomise."""
    engine: EngineName = checked("fused", choice, choices=tuple(ENGINES))
    """What integrates the rods: fused, or pyelastica, the reference."""
    control_dt: float = real(0.05, 0.0, inf, "s", above=True)
    """Time between two actions [s]."""
    observation: tuple[str, ...] | None = checked(None, _terms, none=True)
    """What the policy sees: terms by name, or module:Class; by default what the task says, most often sites (where
    rods cross), activation and command, and then the clock if there is a rhythm."""
    fidelity: FidelityName = checked("default", choice, choices=get_args(FidelityName))
    """How finely the worm is computed: fast is three times cheaper, to be scored on default or fine."""

    n_envs: int = count(8, 1, 256)
    """Worms simulated side by side, in this process."""
    num_threads: int | None = count(None, 1, 256, none=True)
    """Threads that the worms share; one a core by default. They change nothing but the time it takes."""
    n_steps: int = count(128, 2)
    """Steps of each worm between two updates [control steps]."""
    batch_size: int = count(256, 2)
    """Samples in a gradient step [control steps]; divides n_envs * n_steps."""
    n_epochs: int = count(10, 1)
    """Passes over the samples at an update."""
    learning_rate: float = real(1e-3, 0.0, 1.0, "", above=True)
    """Step size of Adam."""
    anneal: bool = checked(True, flag)
    """Let the step size fall linearly over total_steps, to that share which the last rollout is of them."""
    gamma: float | None = real(None, 0.0, 1.0, "", above=True, none=True)
    """Discount of the reward, each control step; by default what the task says."""
    gae_lambda: float = real(0.95, 0.0, 1.0, "")
    """Decay of the generalised advantage estimate, each control step."""
    clip_range: float = real(0.2, 0.0, 1.0, "", above=True)
    """Largest change of an action's probability ratio at an update."""
    entropy_coefficient: float = real(0.0, 0.0, inf, "")
    """Weight of the entropy bonus in the loss."""
    value_coefficient: float = real(0.5, 0.0, inf, "")
    """Weight of the value error in the loss."""
    max_gradient_norm: float = real(0.5, 0.0, inf, "", above=True)
    """Gradients longer than this are shortened to it."""
    hidden_sizes: tuple[int, ...] = checked((64, 64), items, each=partial(whole, low=1, high=65536), what="widths")
    """Widths of the hidden layers of policy and value function [units]."""
    log_std_init: float = real(-1.0, -10.0, 2.0, "")
    """Natural logarithm of the first standard deviation of the actions, which span [-1, 1]."""
    gsde: bool = checked(False, flag)
    """Explore with noise that depends on the state (gSDE) instead of white noise."""

    checkpoint_every: int = count(10_000, 1)
    """Environment steps between two checkpoints [control steps]; written after the update that follows."""
    time_limit: float | None = real(None, 0.0, inf, "s", above=True, none=True)
    """Stop after this much wall time [s], with a checkpoint, but not annealed: anneal goes by total_steps alone."""
    torch_threads: int = count(1, 1, 256)
    """Threads of the learner, which works while the worms wait."""
    run_dir: Path | None = checked(None, instance, kind=Path, none=True)
    """Run folder; runs/<task>-<seed>-<time> if not given."""
    resume: Path | None = checked(None, instance, kind=Path, none=True)
    """Run folder to continue, with its own settings; total-steps, time-limit and num-threads may be given beside it."""
    allow: tuple[str, ...] = checked((), items, each=partial(instance, kind=str), what="names of modules")
    """Modules that files may name, such as that of a task of your own in a run folder to continue: their code runs."""

    def __post_init__(self) -> None:
        """Check every field, and what must hold between them."""
        super().__post_init__()
        allow_modules(self.allow)
        if self._hints()["control"] == "column" and self.control == "ring" and not _is_file(self.muscles):
            must = f"must be column or muscle for {self.task}; rings contract alike all around"
            raise InputError(f"control = 'ring': {must}")
        if not self.hidden_sizes:
            raise InputError("hidden_sizes = (): must have at least one layer")
        if self.n_envs * self.n_steps % self.batch_size:
            samples = f"{self.n_envs} * {self.n_steps} = {self.n_envs * self.n_steps}"
            raise InputError(
                f"batch_size = {self.batch_size}: must divide n_envs * n_steps = {samples}; change one of the three"
            )

    @property
    def task_class(self) -> type[Task]:
        """The task itself; raises TaskError if there is none of that name."""
        try:
            return resolve_task(self.task)
        except ValueError as error:
            raise TaskError(str(error)) from error

    @property
    def resolved_control(self) -> Control:
        """What one action drives: `control`, or by default what the task says."""
        driven: Control = self.control or self._hints()["control"]
        return driven

    @property
    def resolved_gamma(self) -> float:
        """Discount of the reward: `gamma`, or by default what the task says."""
        discount: float = self._hints()["gamma"] if self.gamma is None else self.gamma
        return discount

    def resolved(self) -> TrainConfig:
        """Return the settings with what depends on the task filled in, as a run folder keeps them."""
        return replace(self, control=self.resolved_control, gamma=self.resolved_gamma)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON-safe values, without the places on this machine (design, run_dir, ...)."""
        return {name: value for name, value in super().to_dict().items() if name not in _OUTSIDE}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> TrainConfig:
        """Build settings from `to_dict`; an unknown name raises InputError."""
        with input_errors():
            return cls(**names("settings", values, [item.name for item in fields(cls) if item.name not in _OUTSIDE]))

    def _hints(self) -> dict[str, Any]:
        """Return what the task says of how to learn it."""
        return _HINTS | dict(self.task_class.training)
