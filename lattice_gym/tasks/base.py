"""What the worm is asked to do: a command, reward terms and an outcome, one small class a task.

A task reads named quantities of the motion (measures.py) of one worm or of several side by side, all at once: whatever
it keeps and gives has a row a worm. It keeps nothing between episodes but what it was built with. All that is known of
a task stands in its class, so a task from outside the package is as good as one of its own.
"""

from __future__ import annotations

import math
import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from numbers import Real
from typing import Any, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import MuscleLayout, named_layout
from lattice_gym.checks import FloatArray, IntArray, invalid_value, is_list, items, names, number, optional, whole
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.elasticity import MAX_DILATATION
from lattice_gym.physics.measures import base_frame
from lattice_gym.physics.state import Motion, RodState
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model
from lattice_gym.tasks.gait import Gait

EFFORT, DIVERGENCE = "effort", "divergence"
"""Reward terms of every task, after its own: the price of activation, and that of physics that diverged."""
EFFORT_WEIGHT = 0.01
"""Price of holding every muscle fully active, per control step: small against what any task pays."""
REWARD_ROUNDING = 1e-9
"""Share of the largest declared reward by which a sum of terms may leave its bounds."""
MIN_PENALTY = 1000.0
"""What a divergence costs at least."""
MAX_WEIGHT = 1e6
"""Bound of the size of a reward weight."""
BOUND_TOLERANCE = 1e-9
"""Relative tolerance on the bounds of commanded numbers, for bounds that were computed and so rounded."""
COMMAND_BOUND = 10.0
"""Bound of what a task adds to the observation."""
CommandValues = Mapping[str, float | Sequence[float] | FloatArray | IntArray]
"""Commanded numbers by name, or lists to draw one from."""
MAX_STRAIN = MAX_DILATATION + 1.0
"""Bound of the displacement of any point of a clamped body from rest [body lengths]: rods over-stretch sooner."""
GOAL_SCALE = 0.2
"""Unit of goals [body lengths]: about as far as the top can be moved."""


class Command(NamedTuple):
    """Bounds of one commanded number."""

    low: float
    high: float
    """Drawn uniformly from [low, high] where it is not given."""
    minimum: float
    maximum: float
    """What may be given lies in [minimum, maximum], to rounding."""
    unit: str
    choices: Sequence[float] = ()
    """Where there are any, only these may be drawn or given."""

    def check(self, name: str, value: object) -> float:
        """Take a number that may be given; anything else is a ValueError of that name."""
        if len(self.choices) and not (isinstance(value, Real) and value in self.choices):
            raise invalid_value(name, value, f"must be {' or '.join(f'{few:g}' for few in self.choices)}")
        tolerance = BOUND_TOLERANCE
        least, most = self.minimum - tolerance * abs(self.minimum), self.maximum + tolerance * abs(self.maximum)
        return number(name, value, least, most, self.unit)


class RewardTerm(NamedTuple):
    """Weight of a reward term, and the range of its value before that is weighted."""

    weight: float
    low: float = -math.inf
    high: float = math.inf
    """Least and largest value in one control step."""
    per_episode: bool = False
    """Whether that is the range of its sum over an episode instead."""

    def span(self, steps: int, weight: float) -> float:
        """Largest difference of its weighted sums over any two episodes of at most so many steps."""
        # An episode may end before anything was earned or lost.
        return (1 if self.per_episode else steps) * abs(weight) * (max(self.high, 0.0) - min(self.low, 0.0))

    def step_bounds(self, weight: float) -> tuple[float, float]:
        """Least of its weighted values in one control step, or 0 if that is less, and largest, or 0 if that is more."""
        if weight == 0.0:
            return 0.0, 0.0
        if self.per_episode:  # A step is the difference of two sums, each within the range.
            return -self.span(1, weight), self.span(1, weight)
        low, high = sorted((weight * self.low, weight * self.high))
        return min(low, 0.0), max(high, 0.0)


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
    reward_weights
        Weights of reward terms by name, in place of the task's own.
    time_limit
        Control steps that an episode may last, for `penalty`; None, or fewer: those of the class.

    Warns
    -----
    UserWarning
        A reward term without a range: then `penalty` may be too low.

    """

    name: ClassVar[str]
    """In messages, captions and files; of a task of this package also the value of `LatticeWormEnv(task=...)`."""
    time_limit: int
    """Control steps of an episode; of a task object those of the longest, where more were given."""
    rewards: ClassVar[Mapping[str, RewardTerm]]
    """Its reward terms by name, in order; "effort" comes after them by itself."""
    training: ClassVar[Mapping[str, Any]] = {}
    """What suits a learner: "control" as in `LatticeWormEnv`, and "gamma", the discount in each control step."""
    layout: ClassVar[str] = "all"
    """Muscles it is meant for, by name; see `muscles`."""
    observation: ClassVar[Sequence[Any]] = ("sites", "activation", "command")
    """What is observed by default, as in `LatticeWormEnv(observation=...)`."""
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
        command: CommandValues | None = None,
        model: RodModel | None = None,
        n_worm: int = 1,
        reward_weights: Mapping[str, float] | None = None,
        time_limit: int | None = None,
    ) -> None:
        self.time_limit = max(type(self).time_limit, optional(whole, "time_limit", time_limit, 1) or 0)
        self.lattice = lattice
        self.control_dt = control_dt
        self.n_worm = n_worm
        self._all_rewards = {**self.rewards, EFFORT: RewardTerm(EFFORT_WEIGHT, -1.0, 0.0)}
        self.weights = self._resolve_weights(reward_weights)
        """Weights of the reward terms by name."""
        self._warn_of_ranges()
        if model is not None:
            self.model = model
        self.prepare()
        self.commands = self.command_ranges()
        self.choices = {name: tuple(bounds.choices) for name, bounds in self.commands.items() if len(bounds.choices)}
        self.choices |= self._check_numbers("command", command)
        """Numbers that are drawn from a few, or held: those few, by name."""
        self.commanded = {
            name: np.full(n_worm, self.choices[name][0] if name in self.choices else 0.5 * (bounds.low + bounds.high))
            for name, bounds in self.commands.items()
        }
        """The numbers now commanded, by name, shape (n_worm,) each."""
        self.memory = {name: np.repeat(value[None], n_worm, axis=0) for name, value in self.initial_memory().items()}
        """What a task keeps within an episode, by name, a row a worm; only `begin` and `remember` change it."""

    @classmethod
    def world(cls, lattice: Lattice) -> World:
        """Return its own world around a body."""
        return World()

    @classmethod
    def muscles(cls, lattice: Lattice) -> MuscleLayout:
        """Return the muscles of a body that it is meant for."""
        return named_layout(cls.layout, lattice)

    @classmethod
    def gait(cls, lattice: Lattice, layout: MuscleLayout, command: Mapping[str, float]) -> Gait | None:
        """Open-loop gait for what is commanded, a baseline and a starting point; None: it has none."""
        return None

    @cached_property
    def model(self) -> RodModel:
        """The assembly: as given, or that of the task's own muscles and world."""
        return build_model(self.lattice, self.muscles(self.lattice), self.world(self.lattice))

    @cached_property
    def penalty(self) -> float:
        """What a divergence costs: more than lies between the best and the worst sound episode within `time_limit`.

        At least MIN_PENALTY, and else the sum over all terms of how far their weighted sums over an episode can be
        apart, by the ranges in `rewards`.
        """
        return max(MIN_PENALTY, self._spread(self.time_limit))

    @cached_property
    def penalised_steps(self) -> float:
        """Control steps that episodes may last for `penalty` to be more than lies between any two; or infinite."""
        once = self._spread(0)
        each = self._spread(1) - once
        return max(self.time_limit, math.floor((self.penalty - once) / each)) if each > 0.0 else math.inf

    @cached_property
    def reward_bounds(self) -> tuple[float, float]:
        """Least and largest reward of one control step, by the ranges in `rewards` and to rounding."""
        bounds = [term.step_bounds(self.weights[name]) for name, term in self._all_rewards.items()]
        least, most = (math.fsum(ends) for ends in zip(*bounds, strict=True))
        slack = REWARD_ROUNDING * max((size for size in (-least, most) if math.isfinite(size)), default=0.0)
        return least - slack, most + slack

    def _spread(self, steps: int) -> float:
        """Largest difference of two sound episodes of at most so many steps, by the ranges that are known."""
        spans = [term.span(steps, self.weights[name]) for name, term in self._all_rewards.items()]
        return math.fsum(span for span in spans if math.isfinite(span))

    def check(self, options: Mapping[str, object] | None) -> None:
        """Raise the ValueError of `begin` for options that it would refuse."""
        self._check_numbers("options", options)

    def begin(self, rng: np.random.Generator, options: Mapping[str, object] | None, worm: int = 0) -> None:
        """Start an episode of a worm: draw its command, with what constructor or options give (the latter win)."""
        command = self._draw(rng, options)
        for name, drawn in command.items():
            self.commanded[name][worm] = drawn
        for name, value in self.initial_memory().items():
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

    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Return what is asked for at times [s], shape (n_worm,), scaled to order one, shape (n_worm, len(bounds))."""
        return np.empty((self.n_worm, 0))

    @abstractmethod
    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Values of `rewards` at the end of a control step, not yet weighted, shape (n_worm,) each.

        `memory` has that step already, see `remember`.

        Parameters
        ----------
        motion
            Of all worms.
        activation
            Of every muscle, shape (n_worm, n_muscle).
        time
            Since the start of each worm's episode [s], shape (n_worm,).

        """

    def reward_terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Signed parts of the reward, effort last, shape (n_worm,) each; arguments as those of `terms`."""
        values = self.terms(motion, activation, time)
        if values.keys() != self.rewards.keys():
            raise ValueError(
                f"{type(self).__name__}.terms gave {', '.join(values) or 'nothing'}: must give the terms of its "
                f"rewards, {', '.join(self.rewards)}"
            )
        paid = {name: self.weights[name] * values[name] for name in self.rewards}
        price = -self.weights[EFFORT] / activation.shape[-1]
        return paid | {EFFORT: price * (activation * activation).sum(axis=-1)}

    @abstractmethod
    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Return what the motion came to by now, apart from the reward, shape (n,) each.

        Motion and rows are those of n of the worms. Asked for at the start of an episode too.
        """

    @classmethod
    def errors(cls, outcome: Mapping[str, float], command: Mapping[str, float]) -> dict[str, float]:
        """Outcome of one worm measured by its command, so that a mean over different commands has a meaning.

        What has no value in this episode is left out. By default the outcome as it is.
        """
        return dict(outcome)

    def terminated(self, motion: Motion) -> npt.NDArray[np.bool_]:
        """Tell for each worm of a motion whether nothing more can come of its episode, shape (n,)."""
        return np.zeros(len(motion.position), dtype=np.bool_)

    def caption(self, state: RodState | Motion, worm: int = 0) -> str:
        """Outcome of a worm as a line with units, beside what was asked; empty while there is nothing to tell.

        The state is that worm's, or its row of a motion.
        """
        motion = state if isinstance(state, Motion) else Motion.of(state)
        outcome = self.outcome(motion, np.array([worm]))
        return self.describe({name: float(values[0]) for name, values in outcome.items()}, worm)

    def describe(self, outcome: Mapping[str, float], worm: int) -> str:
        """Line of text for an outcome of a worm; by default its names and numbers."""
        return ", ".join(f"{name} {value:.3g}" for name, value in outcome.items())

    def markers(self, worm: int) -> FloatArray:
        """Places that are asked of a worm [m], to mark in pictures, shape (n_marker, 3); none in most tasks."""
        return np.empty((0, 3))

    def initial_memory(self) -> dict[str, FloatArray]:
        """Memory of one worm at the start of its episode, by name; see `memory`."""
        return {}

    def remember(self, motion: Motion, activation: FloatArray, time: FloatArray) -> Mapping[str, FloatArray]:
        """Return what the control step that ends changes in `memory`, by name, a row a worm; arguments as of `terms`.

        Called once for each step, in order and before `terms`. It is taken over for worms whose physics did not fail.
        """
        return {}

    def command_ranges(self) -> dict[str, Command]:
        """Bounds of every commanded number, by name; none by default."""
        return {}

    def prepare(self) -> None:  # noqa: B027, most need none
        """Refuse a body that cannot do it with a ValueError, and measure it at rest."""

    def check_command(  # noqa: B027, most need none
        self, argument: str, numbers: Mapping[str, tuple[float, ...]]
    ) -> None:
        """Refuse commanded numbers that are wrong together with a ValueError that begins with `argument`.

        Each is drawn from those under its name, or from between the two ends of its range.
        """

    def _resolve_weights(self, given: object) -> dict[str, float]:
        """Weight of every reward term, the effort's last."""
        if taken := sorted({EFFORT, DIVERGENCE} & set(self.rewards)):
            raise ValueError(f"{type(self).__name__}.rewards: {taken[0]} is a term of every task, and not its own")
        weights = {name: float(term.weight) for name, term in self._all_rewards.items()}
        if given is None:
            return weights
        for name, value in names("reward_weights", given, weights, "numbers").items():
            weights[name] = number(f"reward_weights[{name!r}]", value, -MAX_WEIGHT, MAX_WEIGHT)
        return weights

    def _warn_of_ranges(self) -> None:
        """Warn of reward terms whose range is not known, as the price of a divergence cannot count them."""
        for name, term in self._all_rewards.items():
            if self.weights[name] and not math.isfinite(term.high - term.low):
                warnings.warn(
                    f"{self.name}: the range of reward term {name!r} is {term.low:g} to {term.high:g}, so a divergence "
                    f"may pay more than a sound episode, although it costs {self.penalty:g}; state the least and the "
                    f"largest value in a control step: {type(self).__name__}.rewards[{name!r}] = "
                    f"RewardTerm({term.weight:g}, low, high)",
                    stacklevel=3,
                )

    def _draw(self, rng: np.random.Generator, options: Mapping[str, object] | None) -> dict[str, float]:
        choices = self.choices | self._check_numbers("options", options)
        drawn = {}
        for name, bounds in self.commands.items():
            # Drawn whether used or not, so that fixing one number leaves the others as they were.
            share, few = float(rng.random()), choices.get(name)
            drawn[name] = few[int(share * len(few))] if few else bounds.low + share * (bounds.high - bounds.low)
        return drawn

    def _check_numbers(self, argument: str, values: Mapping[str, object] | None) -> dict[str, tuple[float, ...]]:
        """Numbers to draw from by name; a number alone is held."""
        checked: dict[str, tuple[float, ...]] = {}
        given = {} if values is None else names(argument, values, self.commands, "numbers, or lists of them")
        for name, value in given.items():
            label, bounds = f"{argument}[{name!r}]", self.commands[name]
            checked[name] = items(label, value, bounds.check) if is_list(value) else (bounds.check(label, value),)
            if not checked[name]:
                raise invalid_value(label, value, "must hold at least one number to draw from")
        drawn = {name: (bounds.low, bounds.high) for name, bounds in self.commands.items()}
        self.check_command(argument, drawn | self.choices | checked)
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
        """Value of `goal_term` for goals of shape (..., n_goal), not yet weighted, shape (...)."""


def quotient(over: FloatArray, under: FloatArray, where: npt.NDArray[np.bool_]) -> FloatArray:
    """Quotient, or 0 where there is none to give."""
    return np.where(where, over / np.where(where, under, 1.0), 0.0)


def check_base(lattice: Lattice) -> None:
    """Refuse a free body whose base cannot tell how it is tilted."""
    base_frame(lattice, lattice.position.reshape(-1, 3))
