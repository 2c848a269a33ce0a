"""`TrainConfig`: every setting of a training run; its fields are the options of `python train.py`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, get_args

from lattice_gym.body.muscles import LAYOUTS
from lattice_gym.envs.fidelity import FidelityName
from lattice_gym.tasks.base import Task
from lattice_gym.tasks.registry import resolve_task

Control = Literal["muscle", "ring", "column"]
Engine = Literal["fused", "pyelastica"]
Observation = Literal["sites", "nodes"]

_CHOICES: dict[str, tuple[str, ...]] = {
    "control": get_args(Control),
    "engine": get_args(Engine),
    "observation": get_args(Observation),
    "fidelity": get_args(FidelityName),
}
_WHOLE = {
    "total_steps": "[1, inf)",
    "seed": "[0, 4294967295]",
    "n_envs": "[1, 256]",
    "n_steps": "[2, inf)",
    "batch_size": "[2, inf)",
    "n_epochs": "[1, inf)",
    "checkpoint_every": "[1, inf)",
    "num_threads": "[1, 256]",
    "torch_threads": "[1, 256]",
}
_REAL = {
    "rhythm": "(0, inf)",
    "control_dt": "(0, inf)",
    "learning_rate": "(0, 1]",
    "gamma": "(0, 1]",
    "gae_lambda": "[0, 1]",
    "clip_range": "(0, 1]",
    "entropy_coefficient": "[0, inf)",
    "value_coefficient": "[0, inf)",
    "max_gradient_norm": "(0, inf)",
    "log_std_init": "[-10, 2]",
    "time_limit": "(0, inf)",
}
_WIDTH = "[1, 65536]"
_SWITCHES = ("anneal", "gsde")
_HINTS = {"control": "muscle", "gamma": 0.9}  # for a task that says nothing of how to learn it
_OPTIONAL = ("control", "rhythm", "gamma", "time_limit", "num_threads")
_PLACES = ("design", "muscles", "environment", "run_dir", "resume")  # files of this machine, kept out of config.json


class InputError(ValueError):
    """Input that cannot be used; the command lines print it without a traceback."""


def within(value: float, interval: str) -> bool:
    """Whether `value` lies in an interval written as in mathematics, such as "(0, 1]"; NaN never does."""
    match = re.fullmatch(r"([\[(])(\S+), (\S+)([\])])", interval)
    if match is None:
        raise ValueError(f"interval = {interval!r}: must be of the form '(low, high]'")
    opening, low, high, closing = match.groups()
    above = value >= float(low) if opening == "[" else value > float(low)
    below = value <= float(high) if closing == "]" else value < float(high)
    return above and below


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """One training run of PPO on a lattice worm.

    Raises InputError, a ValueError, that names the field, the value and the bound or choices.
    """

    task: str = "peristalsis"
    """What the worm learns to do: a task of the package by name, or anybody's as module:Class."""
    total_steps: int = 100_000
    """Environment steps to train for, over all worms together [control steps]."""
    seed: int = 0
    """Seed of the policy, the noise and the worms."""
    control: Control | None = None
    """What one action drives: muscle, level (ring) or side (column); by default what the task says."""
    rhythm: float | None = None
    """Frequency of a clock whose sine and cosine join the observation [Hz]; none by default."""
    design: Path | None = None
    """JSON file of a LatticeDesign, or of the fields that differ from the task's own; the task's own if not given."""
    muscles: str | None = None
    """Name of a muscle layout (extension, compression, bending, all) or its JSON file; the task's own if not given."""
    environment: Path | None = None
    """JSON file of further arguments of LatticeWormEnv by name, such as world, command, hill, adaptation, randomise."""
    engine: Engine = "fused"
    """What integrates the rods."""
    control_dt: float = 0.05
    """Time between two actions [s]."""
    observation: Observation = "sites"
    """What the policy sees of the rods: the nodes where they cross, or all nodes."""
    fidelity: FidelityName = "default"
    """How finely the worm is computed: fast is three times cheaper, to be scored on default or fine."""

    n_envs: int = 8
    """Worms simulated side by side, in this process."""
    num_threads: int | None = None
    """Threads that the worms share; one a core by default. They change nothing but the time it takes."""
    n_steps: int = 128
    """Steps of each worm between two updates [control steps]."""
    batch_size: int = 256
    """Samples in a gradient step [control steps]; divides n_envs * n_steps."""
    n_epochs: int = 10
    """Passes over the samples at an update."""
    learning_rate: float = 1e-3
    """Step size of Adam."""
    anneal: bool = True
    """Let the step size fall linearly over total_steps, to that share which the last rollout is of them."""
    gamma: float | None = None
    """Discount of the reward, each control step; by default what the task says."""
    gae_lambda: float = 0.95
    """Decay of the generalised advantage estimate, each control step."""
    clip_range: float = 0.2
    """Largest change of an action's probability ratio at an update."""
    entropy_coefficient: float = 0.0
    """Weight of the entropy bonus in the loss."""
    value_coefficient: float = 0.5
    """Weight of the value error in the loss."""
    max_gradient_norm: float = 0.5
    """Gradients longer than this are shortened to it."""
    hidden_sizes: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers of policy and value function [units]."""
    log_std_init: float = -1.0
    """Natural logarithm of the first standard deviation of the actions, which span [-1, 1]."""
    gsde: bool = False
    """Explore with noise that depends on the state (gSDE) instead of white noise."""

    checkpoint_every: int = 10_000
    """Environment steps between two checkpoints [control steps]; written after the update that follows."""
    time_limit: float | None = None
    """Stop after this much wall time [s], with a checkpoint, but not annealed: anneal goes by total_steps alone."""
    torch_threads: int = 1
    """Threads of the learner, which works while the worms wait."""
    run_dir: Path | None = None
    """Run folder; runs/<task>-<seed>-<time> if not given."""
    resume: Path | None = None
    """Run folder to continue, with its own settings; total-steps, time-limit and num-threads may be given beside it."""

    def __post_init__(self) -> None:
        """Check every field."""
        if not isinstance(self.task, str):
            raise InputError(f'task = {self.task!r}: must be a name or "module:Class"')
        hints = self._hints()
        for name, choices in _CHOICES.items():
            value = getattr(self, name)
            chosen = isinstance(value, str) and value in choices
            if not chosen and not (name in _OPTIONAL and value is None):
                raise InputError(f"{name} = {value!r}: must be one of {', '.join(choices)}")
        for name in _SWITCHES:
            if not isinstance(getattr(self, name), bool):
                raise InputError(f"{name} = {getattr(self, name)!r}: must be true or false")
        for name, interval in (_WHOLE | _REAL).items():
            value, whole = getattr(self, name), name in _WHOLE
            if not (value is None and name in _OPTIONAL) and not _is_number(value, interval, whole):
                raise InputError(f"{name} = {value!r}: must be a {'whole ' if whole else ''}number in {interval}")
        if hints["control"] == "column" and self.control == "ring" and not (self.muscles or "").endswith(".json"):
            raise InputError(
                f"control = 'ring': must be column or muscle for {self.task}; rings contract alike all around"
            )
        sizes = self.hidden_sizes
        if not isinstance(sizes, tuple) or not sizes or not all(_is_number(n, _WIDTH, True) for n in sizes):
            raise InputError(f"hidden_sizes = {sizes!r}: must be a tuple of whole numbers in {_WIDTH}")
        if self.n_envs * self.n_steps % self.batch_size:
            samples = f"{self.n_envs} * {self.n_steps} = {self.n_envs * self.n_steps}"
            raise InputError(
                f"batch_size = {self.batch_size}: must divide n_envs * n_steps = {samples}; change one of the three"
            )
        for name in ("design", "environment", "run_dir", "resume"):
            if not isinstance(getattr(self, name), Path | None):
                raise InputError(f"{name} = {getattr(self, name)!r}: must be a path")
        if self.muscles is not None and not (isinstance(self.muscles, str) and _is_layout(self.muscles)):
            raise InputError(f"muscles = {self.muscles!r}: must be one of {', '.join(LAYOUTS)}, or a file *.json")

    @property
    def task_class(self) -> type[Task]:
        """The task itself."""
        try:
            return resolve_task(self.task)
        except ValueError as error:
            raise InputError(str(error)) from error

    @property
    def driven(self) -> Control:
        """What one action drives: as given, or the grouping with which the task can be learned fast."""
        driven: Control = self.control or self._hints()["control"]
        return driven

    @property
    def discount(self) -> float:
        """Discount of the reward: as given, or one that sees as far ahead as the task needs."""
        discount: float = self._hints()["gamma"] if self.gamma is None else self.gamma
        return discount

    def resolved(self) -> TrainConfig:
        """Return the settings with what depends on the task filled in, as a run folder keeps them."""
        return replace(self, control=self.driven, gamma=self.discount)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON-safe values, without the places on this machine (design, run_dir, ...)."""
        settings = {name: value for name, value in asdict(self).items() if name not in _PLACES}
        return settings | {"hidden_sizes": list(self.hidden_sizes)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> TrainConfig:
        """Build settings from `to_dict`; an unknown name raises InputError."""
        if not isinstance(values, Mapping):
            raise InputError(f"settings = {values!r}: must be a mapping of names to values")
        known = {field.name for field in fields(cls)} - set(_PLACES)
        if unknown := sorted(set(values) - known):
            raise InputError(f"{unknown[0]}: unknown setting; known are {', '.join(sorted(known))}")
        settings = dict(values)
        if isinstance(settings.get("hidden_sizes"), list):
            settings["hidden_sizes"] = tuple(settings["hidden_sizes"])
        return cls(**settings)

    def _hints(self) -> dict[str, Any]:
        """Return what the task says of how to learn it."""
        return _HINTS | dict(self.task_class.training)


def _is_layout(muscles: str) -> bool:
    return muscles in LAYOUTS or muscles.endswith(".json")


def _is_number(value: object, interval: str, whole: bool) -> bool:
    kinds = int if whole else (int, float)
    return isinstance(value, kinds) and not isinstance(value, bool) and within(value, interval)
