"""What the worm is asked to do: a command, reward terms and an outcome, one small final class a task.

A task reads named quantities of the motion (measures.py) of one worm or of several side by side, all at once: whatever
it keeps and gives has a row a worm. It keeps nothing between episodes but what it was built with.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray, IntArray, is_number, shown
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.measures import base_frame
from lattice_gym.physics.state import Motion, RodState
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model

EFFORT_WEIGHT = 0.01
"""Price of holding every muscle fully active, per control step: small against what any task pays."""
BOUND_SLACK = 1e-9
"""Share of a bound by which a commanded number may lie beyond it: a bound that is reached by arithmetic is rounded."""
COMMAND_BOUND = 10.0
"""Bound of what a task adds to the observation."""
Given = Mapping[str, float | Sequence[float]]
"""Commanded numbers by name, or lists to draw one from."""
WAY_WEIGHT = 10.0
"""Reward for a way of one height: a hand-made gait earns ten times what the effort of it costs."""
GOAL_SCALE = 0.2
"""Goals are given and observed in units of this share of the height: about as far as a top can be brought."""


class Command(NamedTuple):
    """Bounds of one commanded number."""

    low: float
    high: float
    """Drawn uniformly from [low, high] where it is not given."""
    least: float
    most: float
    """What may be given lies in [least, most], to rounding."""
    unit: str
    among: tuple[float, ...] = ()
    """Where there are any, only these may be drawn or given."""

    def allows(self, value: float) -> bool:
        """Tell whether a number may be given."""
        slack = BOUND_SLACK
        if self.among:
            return value in self.among
        return self.least - slack * abs(self.least) <= value <= self.most + slack * abs(self.most)


class Task(ABC):
    """A command that is drawn once an episode, signed reward terms and an outcome for every control step.

    Parameters
    ----------
    lattice
        The body.
    control_dt
        Time between control steps [s].
    command
        Numbers to hold, or lists to draw one from for every episode, by name; the others are drawn from their ranges.
    model
        The assembly that moves; None: see `model`.
    n_worm
        Number of worms; each has episodes of its own.

    """

    name: ClassVar[str]
    """As in `LatticeWormEnv(task=...)`."""
    layout: ClassVar[str]
    """Muscles it is meant for, by name."""
    term_names: ClassVar[tuple[str, ...]]
    """Names of its reward terms, in order."""
    bounds: ClassVar[tuple[float, ...]] = ()
    """Sizes that what it adds to the observation stays within, one a number."""
    design: ClassVar[Mapping[str, Any]] = {}
    """Its own changes to the default design."""
    settles: ClassVar[bool] = False
    """Whether worm and ball come to rest in their surroundings, muscles slack, before the first episode."""
    travels: ClassVar[bool] = False
    """Whether the body goes elsewhere: points are then observed from their mean, but for its height."""
    strength: FloatArray | float = 1.0
    """Strength of every muscle in the step that ends, over the design's, shape (n_worm, n_muscle) or ().

    The environment puts it here.
    """

    def __init__(
        self,
        lattice: Lattice,
        control_dt: float,
        command: Given | None = None,
        model: RodModel | None = None,
        n_worm: int = 1,
    ) -> None:
        self.lattice = lattice
        self.control_dt = control_dt
        self.n_worm = n_worm
        if model is not None:
            self.model = model
        self._prepare()
        self.commands = self._commands()
        self.among = {name: bounds.among for name, bounds in self.commands.items() if bounds.among}
        self.among |= self._checked("command", command)
        """Numbers that are drawn from a few, or held: those few, by name."""
        self.commanded = {
            name: np.full(n_worm, self.among[name][0] if name in self.among else 0.5 * (bounds.low + bounds.high))
            for name, bounds in self.commands.items()
        }
        """The numbers now commanded, by name, shape (n_worm,) each."""
        self.memory = {name: np.repeat(value[None], n_worm, axis=0) for name, value in self._blank().items()}
        """What an episode is remembered by, by name, a row a worm."""

    @classmethod
    def surroundings(cls, lattice: Lattice) -> World:
        """Return its own world around a body."""
        return World()

    @cached_property
    def model(self) -> RodModel:
        """The assembly: as given, or that of the task's own muscles and world."""
        layout = named_layout(self.layout, self.lattice)
        return build_model(self.lattice, layout, self.surroundings(self.lattice))

    def check(self, options: Mapping[str, object] | None) -> None:
        """Raise the ValueError of `begin` for options that it would refuse."""
        self._checked("options", options)

    def begin(self, rng: np.random.Generator, options: Mapping[str, object] | None, worm: int = 0) -> None:
        """Start an episode of a worm: draw its command, with what constructor or options give (the latter win)."""
        command = self._drawn(rng, options)
        for name, number in command.items():
            self.commanded[name][worm] = number
        for name, value in self._blank().items():
            self.memory[name][worm] = value

    @property
    def command(self) -> dict[str, float]:
        """The numbers now commanded of the first worm, by name."""
        return self.command_of(0)

    def command_of(self, worm: int) -> dict[str, float]:
        """Return the numbers now commanded of a worm, by name."""
        return {name: float(values[worm]) for name, values in self.commanded.items()}

    @cached_property
    def rest(self) -> RodState:
        """State that episodes start from; the environment puts the settled one here."""
        return self.model.rest_state()

    @abstractmethod
    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Return what is asked for at times [s], shape (n_worm,), scaled to order one, shape (n_worm, len(bounds))."""

    @abstractmethod
    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Signed reward terms at the end of a control step, shape (n_worm,) each; called once for each, in order.

        Parameters
        ----------
        motion
            Of all worms.
        activation
            Of every muscle, shape (n_worm, n_muscle).
        time
            Since the start of each worm's episode [s], shape (n_worm,).

        """

    @abstractmethod
    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Return what the motion came to by now, apart from the reward, shape (n,) each.

        Motion and rows are those of n of the worms.
        """

    def over(self, motion: Motion) -> npt.NDArray[np.bool_]:
        """Tell for each worm of a motion whether nothing more can come of its episode, shape (n,)."""
        return np.zeros(len(motion.position), dtype=np.bool_)

    def caption(self, state: RodState | Motion, worm: int = 0) -> str:
        """Outcome of a worm as a line with units, beside what was asked; empty while there is nothing to tell.

        The state is that worm's, or its row of a motion.
        """
        motion = state if isinstance(state, Motion) else Motion.of(state)
        outcome = self.outcome(motion, np.array([worm]))
        return self._caption({name: float(values[0]) for name, values in outcome.items()}, worm)

    def markers(self, worm: int) -> FloatArray:
        """Places that are asked of a worm [m], to mark in pictures, shape (n_marker, 3); none in most tasks."""
        return np.empty((0, 3))

    @abstractmethod
    def _caption(self, outcome: Mapping[str, float], worm: int) -> str:
        """Line for an outcome of a worm."""

    def _blank(self) -> dict[str, FloatArray]:
        """Memory of one worm at the start of its episode."""
        return {}

    def remembered(self, worms: IntArray) -> dict[str, FloatArray]:
        """Copy of the memory of some worms."""
        return {name: values[worms] for name, values in self.memory.items()}

    def remind(self, worms: IntArray, memory: Mapping[str, FloatArray]) -> None:
        """Put back what `remembered` gave, as if the step since had not been."""
        for name, values in memory.items():
            self.memory[name][worms] = values

    @abstractmethod
    def _commands(self) -> dict[str, Command]:
        """Bounds of every commanded number."""

    @abstractmethod
    def _prepare(self) -> None:
        """Refuse a body that cannot do it, and measure it at rest."""

    def _drawn(self, rng: np.random.Generator, options: Mapping[str, object] | None) -> dict[str, float]:
        among = self.among | self._checked("options", options)
        drawn = {}
        for name, bounds in self.commands.items():
            # Drawn whether used or not, so that fixing one number leaves the others as they were.
            share, few = float(rng.random()), among.get(name)
            drawn[name] = few[int(share * len(few))] if few else bounds.low + share * (bounds.high - bounds.low)
        return drawn

    def _checked(self, argument: str, values: Mapping[str, object] | None) -> dict[str, tuple[float, ...]]:
        """Numbers to draw from by name; a number alone is held."""
        if values is None:
            return {}
        if not isinstance(values, Mapping):
            raise ValueError(f"{argument} = {shown(values)}: must be a mapping of names to numbers")
        checked: dict[str, tuple[float, ...]] = {}
        for name, value in values.items():
            if name not in self.commands:
                known = ", ".join(self.commands) or "nothing"
                raise ValueError(f"{argument}: {self.name} commands no {name!r}; it commands {known}")
            bounds = self.commands[name]
            numbers = tuple(value) if isinstance(value, list | tuple) else (value,)
            if not numbers or not all(is_number(number) and bounds.allows(number) for number in numbers):
                span = f"a number from {bounds.least:g} to {bounds.most:g} [{bounds.unit}]"
                kind = " or ".join(f"{number:g}" for number in bounds.among) or span
                raise ValueError(f"{argument}[{name!r}] = {shown(value)}: must be {kind}, or a list of them")
            checked[name] = tuple(float(number) for number in numbers)
        return checked


class GoalTask(Task):
    """A task that asks for a place: what was reached and what was asked for are goals, and can be exchanged."""

    n_goal: ClassVar[int]
    """Numbers in a goal; each lies within COMMAND_BOUND."""
    goal_term: ClassVar[str]
    """The reward term that goals alone decide."""

    @abstractmethod
    def achieved(self, motion: Motion) -> npt.NDArray[np.float32]:
        """Goals that n worms have reached, shape (n, n_goal)."""

    @abstractmethod
    def desired(self) -> npt.NDArray[np.float32]:
        """Goals that are asked for, shape (n_worm, n_goal)."""

    @abstractmethod
    def goal_reward(self, achieved: npt.NDArray[Any], desired: npt.NDArray[Any]) -> FloatArray:
        """Term `goal_term` for goals of shape (..., n_goal), shape (...)."""


def effort(activation: FloatArray) -> FloatArray:
    """Price of activations, shape (n_worm, n_muscle), for every worm."""
    price: FloatArray = -EFFORT_WEIGHT / activation.shape[-1] * (activation * activation).sum(axis=-1)
    return price


def quotient(over: FloatArray, under: FloatArray, where: npt.NDArray[np.bool_]) -> FloatArray:
    """Quotient, or 0 where there is none to give."""
    return np.where(where, over / np.where(where, under, 1.0), 0.0)


def check_base(lattice: Lattice) -> None:
    """Refuse a free body whose base cannot tell how it is tilted."""
    base_frame(lattice, lattice.position.reshape(-1, 3))
