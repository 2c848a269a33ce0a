"""What the worm is asked to do: a command, reward terms and an outcome, one small final class a task.

A task reads named quantities of the motion (measures.py) of one worm or of several side by side, all at once: whatever
it keeps and gives has a row a worm. It keeps nothing between episodes but what it was built with.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import product
from typing import Any, ClassVar, NamedTuple, final

import numpy as np
import numpy.typing as npt

from lattice_gym.design import TURN, FloatArray, IntArray, is_number, shown
from lattice_gym.lattice import Lattice
from lattice_gym.measures import (
    Lodging,
    azimuth_of,
    base_frame,
    bend_vector,
    lodging,
    mass_centre,
    muscle_lengths,
    ring_radii,
    strain,
    top_centre,
    top_sites,
    travelling_wave,
)
from lattice_gym.model import Motion, RodModel, RodState, build_model
from lattice_gym.muscles import named_layout
from lattice_gym.world import Bolus, Ground, Medium, World

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
WAYS = {1: "up", -1: "down"}


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


def _effort(activation: FloatArray) -> FloatArray:
    price: FloatArray = -EFFORT_WEIGHT / activation.shape[-1] * (activation * activation).sum(axis=-1)
    return price


def _goal_distance(achieved: npt.NDArray[np.float32], desired: npt.NDArray[np.float32]) -> FloatArray:
    """Distances between goals of shape (n, 3), in heights."""
    apart: FloatArray = GOAL_SCALE * np.linalg.norm(desired.astype(np.float64) - achieved, axis=-1)
    return apart


def _ratio(over: FloatArray, under: FloatArray, where: npt.NDArray[np.bool_]) -> FloatArray:
    """Quotient, or 0 where there is none to give."""
    return np.where(where, over / np.where(where, under, 1.0), 0.0)


def _whole(degrees: float) -> int:
    """Whole degrees from 0 to 359."""
    return round(degrees) % 360


def _check_base(lattice: Lattice) -> None:
    """Refuse a free body whose base cannot tell how it is tilted."""
    base_frame(lattice, lattice.position.reshape(-1, 3))


class _AxialTask(Task):
    """Change the body's length: the reward is the strain times a sign."""

    term_names = ("strain", "effort")
    sign: ClassVar[float]
    """What longer is worth."""

    def _prepare(self) -> None:
        _check_base(self.lattice)

    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Nothing is commanded."""
        return np.empty((self.n_worm, 0))

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Strain, positive where it is asked for, and effort."""
        return {"strain": self.sign * strain(self.lattice, motion.position), "effort": _effort(activation)}

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Strain, positive when longer."""
        return {"strain": strain(self.lattice, motion.position)}

    def _caption(self, outcome: Mapping[str, float], worm: int) -> str:
        """Strain in per cent."""
        return f"strain {100.0 * outcome['strain']:+.1f} %"

    def _commands(self) -> dict[str, Command]:
        return {}


@final
class Extension(_AxialTask):
    """Grow longer: the reward is the strain."""

    name = "extension"
    layout = "extension"
    sign = 1.0


@final
class Compression(_AxialTask):
    """Grow shorter: the reward is the strain with its sign turned."""

    name = "compression"
    layout = "compression"
    sign = -1.0


@final
class Bending(Task):
    """Lean towards a commanded azimuth: the part of the bend that way counts, the part sideways counts against."""

    name = "bending"
    layout = "all"
    term_names = ("bend", "sideways", "effort")
    bounds = (1.0, 1.0)

    def _prepare(self) -> None:
        top_sites(self.lattice)  # refuses a lattice whose top is no plane
        _check_base(self.lattice)

    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Cosine and sine of the commanded azimuth."""
        return self._towards()

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Bend towards the commanded azimuth, sideways bend and effort."""
        x, y = bend_vector(self.lattice, motion.position).T
        cos, sin = self._towards().T
        return {"bend": x * cos + y * sin, "sideways": -np.abs(y * cos - x * sin), "effort": _effort(activation)}

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Bend angle and its direction [rad]."""
        bend = bend_vector(self.lattice, motion.position)
        return {"bend_angle": np.hypot(bend[:, 0], bend[:, 1]), "bend_direction": azimuth_of(bend)}

    def _caption(self, outcome: Mapping[str, float], worm: int) -> str:
        """Bend angle, its direction and the one asked for, in degrees."""
        asked = self.commanded["azimuth"][worm] % TURN
        angle, towards, asked = np.degrees([outcome["bend_angle"], outcome["bend_direction"], asked])
        # What leans by less than is printed leans no way.
        way = f"towards {_whole(towards)} deg " if angle >= 0.05 else ""
        return f"bend {angle:.1f} deg {way}(asked: {_whole(asked)} deg)"

    def _towards(self) -> FloatArray:
        azimuth = self.commanded["azimuth"]
        return np.array([np.cos(azimuth), np.sin(azimuth)]).T

    def _commands(self) -> dict[str, Command]:
        return {"azimuth": Command(0.0, TURN, -TURN, TURN, "rad")}


@final
class Peristalsis(Task):
    """Follow a commanded travelling wave of the ring radii.

    The ring at height z is asked for the deviation ``target = amplitude cos(2 pi (speed t - z) / wavelength + phase)``
    from its rest radius, as a share of it; a positive speed runs up, away from the base. The levels that can move
    count: all but the base, where that is clamped. The reward is the share of the commanded wave that is followed,

        tracking = (sum target^2 - sum (deviation - target)^2) / (n_level amplitude^2 / 2 + sum (deviation - target)^2),

    with sums over the levels. It is zero for doing nothing; for following perfectly it is the first sum over its mean
    n_level amplitude^2 / 2, which is 1 on average and at most 2; it is negative for motion that leads away, and never
    below -1, however far away that is.

    What is drawn was chosen from what the body can do: see FULL_DRIVE_AMPLITUDE in gaits.py, and the test
    `test_the_antiphase_gait_can_make_the_wave_that_is_drawn`, which measures it.
    """

    name = "peristalsis"
    layout = "all"
    term_names = ("tracking", "effort")
    bounds = (1.0, 1.0, COMMAND_BOUND, COMMAND_BOUND, COMMAND_BOUND)

    RECORDED_PERIODS: ClassVar[int] = 2
    """Periods of the commanded wave over which the outcome is measured."""
    LEAST_STEPS: ClassVar[int] = 4
    """Fewest control steps in a period of the commanded wave."""
    LEAST_LEVELS: ClassVar[int] = 3
    """Fewest levels that can carry a wave."""
    SLOWEST: ClassVar[float] = 0.1
    """Slowest wave [body heights a second]."""
    TYPICAL_AMPLITUDE: ClassVar[float] = 0.055
    """Scale of the observed amplitude."""

    def _prepare(self) -> None:
        lattice = self.lattice
        first = 1 if lattice.design.base == "clamped" else 0
        if lattice.n_level - first < self.LEAST_LEVELS:
            raise ValueError(
                f"design: peristalsis needs at least {self.LEAST_LEVELS} levels of sites that can move, got "
                f"{max(lattice.n_level - first, 0)}"
            )
        self.height = lattice.level_height[first:]
        self.rest_radius = ring_radii(lattice, lattice.position.reshape(-1, 3))
        self.first = first
        self._window = np.ones(self.n_worm, dtype=np.int64)

    def begin(self, rng: np.random.Generator, options: Mapping[str, object] | None, worm: int = 0) -> None:
        """Start an episode of a worm: draw its command and forget what was recorded of it."""
        super().begin(rng, options, worm)
        command = self.command_of(worm)
        window = round(self.RECORDED_PERIODS * abs(command["wavelength"] / command["speed"]) / self.control_dt)
        self._window[worm] = window
        record = self.memory["record"]
        if window > record.shape[1]:
            # Rows are counted modulo the window of their worm, so that those of others stay where they are.
            room = np.zeros((self.n_worm, window - record.shape[1], len(self.height)))
            self.memory["record"] = np.concatenate([record, room], axis=1)

    def _blank(self) -> dict[str, FloatArray]:
        return {"steps": np.zeros(()), "record": np.zeros((1, len(self.height)))}

    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Cosine and sine of the wave's phase at the base; speed, wavelength and amplitude over what is typical."""
        angle, height, typical = self._phase(time), self.lattice.design.height, self.TYPICAL_AMPLITUDE
        speed, wavelength, amplitude = (self.commanded[name] for name in ("speed", "wavelength", "amplitude"))
        seen = [np.cos(angle), np.sin(angle), speed / height, wavelength / height, amplitude / typical]
        return np.array(seen).T

    def target(self, time: FloatArray) -> FloatArray:
        """Deviation asked of every level that can move, over the rest radius, shape (n_worm, n_level - first)."""
        angle = self._phase(time)[:, None] - TURN * self.height / self.commanded["wavelength"][:, None]
        wave: FloatArray = self.commanded["amplitude"][:, None] * np.cos(angle)
        return wave

    def recorded(self, worm: int = 0) -> FloatArray:
        """Deviations of a worm over the last two commanded periods, or as far back as it goes, shape (n, n_level)."""
        steps, window = int(self.memory["steps"][worm]), int(self._window[worm])
        rows = np.arange(max(steps - window, 0), steps) % window
        found: FloatArray = self.memory["record"][worm, rows]
        return found

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Share of the commanded wave that is followed, and effort."""
        deviation = (ring_radii(self.lattice, motion.position) / self.rest_radius - 1.0)[:, self.first :]
        steps = self.memory["steps"]
        self.memory["record"][np.arange(self.n_worm), steps.astype(np.int64) % self._window] = deviation
        self.memory["steps"] = steps + 1.0
        target = self.target(time)
        error = deviation - target
        # sum target^2 - sum (deviation - target)^2, without the rounding of a difference
        followed = ((target - error) * deviation).sum(axis=-1)
        whole = 0.5 * len(self.height) * self.commanded["amplitude"] ** 2 + (error * error).sum(axis=-1)
        return {"tracking": followed / whole, "effort": _effort(activation)}

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Index, direction, speed [m/s] and amplitude (a share of the rest radius) of the wave.

        Measured over the last two commanded periods; 0 until two have passed.
        """
        found = np.zeros((len(worms), 4))
        for row, worm in zip(found, worms.tolist(), strict=True):
            if self._whole_record(worm):
                wave = travelling_wave(1.0 + self.recorded(worm), self.control_dt, self.height)
                row[:] = *wave, wave.amplitude
        return dict(zip(("wave_index", "wave_direction", "wave_speed", "wave_amplitude"), found.T, strict=True))

    def _caption(self, outcome: Mapping[str, float], worm: int) -> str:
        """Index, way, speed and amplitude beside those asked for; empty until two commanded periods have passed."""
        if not self._whole_record(worm):
            return ""
        index, direction, speed, amplitude = outcome.values()
        command = self.command_of(worm)
        wish, size = command["speed"], 100.0 * command["amplitude"]
        way = f"{WAYS[int(direction)]} at {speed:.3f} m/s" if direction else "going nowhere"
        asked = f"{WAYS[int(np.sign(wish))]} at {abs(wish):.3f} m/s, {size:.1f} %"
        return f"wave index {index:.2f}, {way}, amplitude {100.0 * amplitude:.1f} % (asked: {asked})"

    def _whole_record(self, worm: int) -> bool:
        """Whether two commanded periods have passed."""
        return bool(self.memory["steps"][worm] >= self._window[worm])

    def _phase(self, time: FloatArray) -> FloatArray:
        rate = TURN * self.commanded["speed"] / self.commanded["wavelength"]
        phase: FloatArray = rate * time + self.commanded["phase"]
        return phase

    def _checked(self, argument: str, values: Mapping[str, object] | None) -> dict[str, tuple[float, ...]]:
        """Refuse what any draw would make a wave that cannot be sampled."""
        checked = super()._checked(argument, values)
        drawn = {name: (bounds.low, bounds.high) for name, bounds in self.commands.items()} | self.among | checked
        for speed, wavelength in product(drawn["speed"], drawn["wavelength"]):
            self._check_wave(argument, speed, wavelength)
        return checked

    def _check_wave(self, argument: str, speed: float, wavelength: float) -> None:
        """Refuse a wave that stands, or that is too fast to be sampled by control steps."""
        slowest, shortest = self.SLOWEST * self.lattice.design.height, self.LEAST_STEPS * self.control_dt
        if abs(speed) < slowest * (1.0 - BOUND_SLACK):
            raise ValueError(f"{argument}['speed'] = {speed:g}: at least {slowest:g} [m/s], up or down")
        period = wavelength / abs(speed)
        if period < shortest * (1.0 - BOUND_SLACK):
            raise ValueError(
                f"{argument}: a wave of speed {abs(speed):g} m/s and wavelength {wavelength:g} m has a period of "
                f"{period:g} s; it must last {self.LEAST_STEPS} control steps, {shortest:g} s (control_dt = "
                f"{self.control_dt:g} s)"
            )

    def _commands(self) -> dict[str, Command]:
        height = self.lattice.design.height
        # Phases of neighbouring levels are told apart below half a turn; a third leaves room.
        shortest = 3.0 * float(np.diff(self.height).max())
        low = max(0.8 * height, shortest)
        return {
            "speed": Command(0.8 * height, 1.2 * height, -10.0 * height, 10.0 * height, "m/s"),
            "wavelength": Command(low, max(1.2 * height, low), shortest, 10.0 * height, "m"),
            "amplitude": Command(0.04, 0.07, 0.001, 0.5, "share of the rest radius"),
            "phase": Command(0.0, TURN, -TURN, TURN, "rad"),
        }


@final
class Reach(GoalTask):
    """Bring the centre of the top ring to a target: the reward is how much nearer it is than it was at rest.

    A goal is a displacement of that centre from rest, along the axes of the base at rest, in units of GOAL_SCALE
    heights. A target lies at `radius` from the axis, towards `azimuth`, and `rise` above the top at rest.

    Targets are drawn from what the default design reaches: held for 3 s, with verticals at clip(s cos + max(-b, 0)) and
    rings at clip(-s cos + max(b, 0)), cos that of the angle from the target's azimuth, s from 0 to 3, b from -1 to 1,
    the centre comes to within 0.02 heights of every target with a radius from 0.05 to 0.2 and a rise from -0.08 to 0.
    It gets no further out than 0.24 heights; at a radius of 0.2 the rise spans -0.09 to 0.01, on the axis -0.16 to
    0.11. The 100 mm of Schaffer et al. (arXiv 2408.16069), one height here, are far out of reach.
    """

    name = "reach"
    layout = "all"
    term_names = ("approach", "effort")
    goal_term = "approach"
    n_goal = 3
    bounds = (COMMAND_BOUND,) * n_goal

    REACHED: ClassVar[float] = 0.03
    """Distance within which a target counts as reached [heights]."""

    def _prepare(self) -> None:
        rest = self.model.rest_state().position
        self.origin = top_centre(self.lattice, rest)
        self.axes = base_frame(self.lattice, rest)

    def _blank(self) -> dict[str, FloatArray]:
        return {"reach_time": np.zeros(())}

    def achieved(self, motion: Motion) -> npt.NDArray[np.float32]:
        """Displacement of the top's centre over GOAL_SCALE heights, shape (n, 3)."""
        moved = top_centre(self.lattice, motion.position) - self.origin
        unit = GOAL_SCALE * self.lattice.design.height
        along = np.sum(self.axes * moved[:, None, :], axis=-1)
        return np.asarray(np.clip(along / unit, -COMMAND_BOUND, COMMAND_BOUND), dtype=np.float32)

    def desired(self) -> npt.NDArray[np.float32]:
        """Displacement that is asked for over GOAL_SCALE heights, shape (n_worm, 3)."""
        azimuth, radius, rise = (self.commanded[name] for name in ("azimuth", "radius", "rise"))
        target = np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), rise]).T
        return np.ascontiguousarray(target / GOAL_SCALE, dtype=np.float32)

    def markers(self, worm: int) -> FloatArray:
        """Return the target."""
        unit = GOAL_SCALE * self.lattice.design.height
        return np.atleast_2d(self.origin + unit * self.desired()[worm] @ self.axes)

    def goal_reward(self, achieved: npt.NDArray[Any], desired: npt.NDArray[Any]) -> FloatArray:
        """Distance of the target from rest less that from the top's centre [heights]."""
        target = np.asarray(desired, dtype=np.float64)
        nearer: FloatArray = GOAL_SCALE * (np.linalg.norm(target, axis=-1) - np.linalg.norm(target - achieved, axis=-1))
        return nearer

    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Way from the top's centre to the target, over GOAL_SCALE heights."""
        way = np.clip(self.desired() - self.achieved(motion), -COMMAND_BOUND, COMMAND_BOUND)
        return np.asarray(way, dtype=np.float64)

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """How much nearer the target is than at rest, and effort."""
        achieved, desired, reached = self.achieved(motion), self.desired(), self.memory["reach_time"]
        new = (reached == 0.0) & (_goal_distance(achieved, desired) <= self.REACHED)
        self.memory["reach_time"] = np.where(new, time, reached)
        return {"approach": self.goal_reward(achieved, desired), "effort": _effort(activation)}

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Distance from the target [m], whether it was reached at all (1 or 0), and when [s], 0 if not."""
        reach_time = self.memory["reach_time"][worms]
        distance = _goal_distance(self.achieved(motion), self.desired()[worms])
        return {
            "distance": distance * self.lattice.design.height,
            "reached": (reach_time > 0.0).astype(np.float64),
            "reach_time": reach_time,
        }

    def _caption(self, outcome: Mapping[str, float], worm: int) -> str:
        """Distance from the target, and when it was reached."""
        reached = f", reached after {outcome['reach_time']:.2f} s" if outcome["reached"] else ""
        return f"{1000.0 * outcome['distance']:.1f} mm from the target{reached}"

    def _commands(self) -> dict[str, Command]:
        return {
            "azimuth": Command(0.0, TURN, -TURN, TURN, "rad"),
            "radius": Command(0.05, 0.2, 0.0, 1.5, "heights"),
            "rise": Command(-0.08, 0.0, -1.0, 1.5, "heights"),
        }


@final
class Crawl(Task):
    """Crawl along +x or -x on the ground: the reward is the way the centre of mass went along the commanded direction.

    A free worm lies along x, in water, which is nearly as dense as it is, and moves only by friction. Its rods are
    damped a tenth as much as the default design's: that damping resists every motion, 23 N s/m in all, and at a
    centimetre a second takes more than the 0.13 N that friction can give.
    """

    name = "crawl"
    layout = "all"
    term_names = ("progress", "effort")
    bounds = (1.0, COMMAND_BOUND)
    design: ClassVar[Mapping[str, Any]] = {"base": "free", "damping": 0.003}
    settles = True
    travels = True

    LEAST_WAY: ClassVar[float] = 0.01
    """Way [heights] below which no course and no cost of transport is given."""

    @classmethod
    def surroundings(cls, lattice: Lattice) -> World:
        """Return a ground to lie on in water, which resists as it does a rod at 0.13 m/s.

        Across a flow of speed v a cylinder of diameter D has the drag Cd rho D v^2 / 2 per length, with Cd about 1.5 at
        the Reynolds numbers here: 7.5 v N s/m^2 per speed for the 10 mm of a rod. `Medium` is linear, and has that of
        about 0.13 m/s. Without it the nearly weightless worm can hop, and goes further by trembling at the control rate
        than by crawling.
        """
        return World(medium=Medium(drag=1.0), ground=Ground(), lying=True)

    def _prepare(self) -> None:
        if self.lattice.design.base == "clamped":
            raise ValueError('design.base = "clamped": a worm that crawls must be free')
        if self.model.ground is None:
            raise ValueError("world.ground = None: there is nothing to crawl on")
        if self.model.gravity is None or not self.model.gravity.any():
            raise ValueError("world.medium: has no gravity; a worm that crawls must lie on the ground by its weight")
        body = self.model.rods[0].position
        if not np.allclose(np.diff(body[:, 0]), np.diff(self.lattice.position[0, :, 2])):
            raise ValueError("world.lying = False: a worm that crawls must lie")

    def _blank(self) -> dict[str, FloatArray]:
        length = muscle_lengths(self.model, self.rest.position)
        start = mass_centre(self.model, self.rest.position)
        nothing = np.zeros(())
        moved = {"start": start, "centre": start, "length": length, "activation": 0.0 * length}
        return moved | {"work": nothing, "time": nothing}

    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Commanded direction along x, and how far the body is off course, to +y, in heights."""
        aside = self._way(motion, self.memory["start"])[:, 1]
        return np.array([self.commanded["direction"], np.minimum(np.maximum(aside, -COMMAND_BOUND), COMMAND_BOUND)]).T

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Way along the commanded direction in this step, and effort."""
        centre, length = mass_centre(self.model, motion.position), muscle_lengths(self.model, motion.position)
        before, design = self.memory, self.lattice.design
        way = (centre - before["centre"])[:, 0] * self.commanded["direction"] / design.height
        # Tension is linear in time over the step, so its mean is that of its ends.
        tension = 0.5 * design.max_tension * self.strength * (before["activation"] + activation)
        work = before["work"] + (tension * np.maximum(before["length"] - length, 0.0)).sum(axis=-1)
        self.memory |= {"centre": centre, "length": length, "activation": activation.copy(), "work": work}
        self.memory["time"] = time.copy()
        return {"progress": WAY_WEIGHT * way, "effort": _effort(activation)}

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Speed along the command [body lengths a minute], drift off it [rad] and cost of transport, see env.py."""
        start, time, work = (self.memory[name][worms] for name in ("start", "time", "work"))
        way = self._way(motion, start)
        along = way[:, 0] * self.commanded["direction"][worms]
        moved = np.hypot(way[:, 0], way[:, 1]) >= self.LEAST_WAY
        gravity = 0.0 if self.model.gravity is None else float(np.linalg.norm(self.model.gravity))
        haul = float(self.model.node_mass.sum()) * gravity * along * self.lattice.design.height
        return {
            "speed": _ratio(60.0 * along, time, time > 0.0),
            "drift": np.where(moved, np.arctan2(np.abs(way[:, 1]), along), 0.0),
            "cost_of_transport": _ratio(work, haul, (along >= self.LEAST_WAY) & (haul > 0.0)),
        }

    def _caption(self, outcome: Mapping[str, float], worm: int) -> str:
        """Speed along the command and drift."""
        way = "+x" if self.commanded["direction"][worm] > 0.0 else "-x"
        return (
            f"{outcome['speed']:+.1f} body lengths/min along {way}, {np.degrees(outcome['drift']):.0f} deg off course"
        )

    def _way(self, motion: Motion, start: FloatArray) -> FloatArray:
        """Way of the centre of mass along x and y since the start [heights], shape (n, 2)."""
        way: FloatArray = (mass_centre(self.model, motion.position) - start)[:, :2] / self.lattice.design.height
        return way

    def _commands(self) -> dict[str, Command]:
        return {"direction": Command(-1.0, 1.0, -1.0, 1.0, "1", (-1.0, 1.0))}


@final
class Transport(Task):
    """Carry the ball inside the lattice towards the top (+1) or the base (-1): the reward is the way it went there.

    Its way is measured along the body: from ring centre to ring centre, in rest heights, see `measures.lodging`. The
    episode is over once it has left the body: delivered, if by the commanded end, else lost. The ball is as heavy as
    the medium and starts between the two rings halfway up. Muscles of 0.5 N hardly move it.
    """

    name = "transport"
    layout = "all"
    term_names = ("progress", "lost", "effort")
    bounds = (1.0, *(COMMAND_BOUND,) * 6)
    design: ClassVar[Mapping[str, Any]] = {"max_tension": 1.0}
    settles = True

    LOST: ClassVar[float] = 5.0
    """Price of losing the ball: as much as it can gain, half a height."""
    SQUEEZE: ClassVar[float] = 1.09
    """Radius of the ball over that of the room the ring muscles leave at rest."""

    @classmethod
    def surroundings(cls, lattice: Lattice) -> World:
        """Return a ball of the medium's density that the rings hold, between the two halfway up."""
        design = lattice.design
        room = 0.5 * design.diameter * np.cos(np.pi / design.n_pairs) - design.muscle_radius
        most = 0.5 * design.diameter - design.structure_radius
        if not min(room, most) > 0.0:
            raise ValueError(f"design: {design.n_pairs} pairs of rods leave no room for a ball inside")
        radius = min(cls.SQUEEZE * float(room), most)
        return World(medium=Medium(), bolus=Bolus(radius=radius, level=design.n_segment // 2 + 0.5, friction=0.1))

    def _prepare(self) -> None:
        ring_radii(self.lattice, self.lattice.position.reshape(-1, 3))  # refuses a lattice without levels
        if self.model.n_bolus == 0:
            raise ValueError("world.bolus = None: there is nothing to carry")

    def _blank(self) -> dict[str, FloatArray]:
        height = self._lodging(Motion.of(self.rest)).height[0]
        return {"start": height, "height": height, "time": np.zeros(())}

    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Direction; the ball's way from its start over GOAL_SCALE heights, and its velocity in heights a second."""
        height = self.lattice.design.height
        moved = (motion.bolus_position[:, 0] - self.rest.bolus_position[0]) / (GOAL_SCALE * height)
        moving = np.clip(
            np.concatenate([moved, motion.bolus_velocity[:, 0] / height], axis=-1), -COMMAND_BOUND, COMMAND_BOUND
        )
        return np.concatenate([self.commanded["direction"][:, None], moving], axis=-1)

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Way of the ball along the command in this step, the price of losing it, and effort."""
        place, direction = self._lodging(motion), self.commanded["direction"]
        way = direction * (place.height - self.memory["height"]) / self.lattice.design.height
        self.memory |= {"height": place.height, "time": time.copy()}
        lost = np.where(_lost(place, direction), -self.LOST, 0.0)
        return {"progress": WAY_WEIGHT * way, "lost": lost, "effort": _effort(activation)}

    def over(self, motion: Motion) -> npt.NDArray[np.bool_]:
        """Tell whether the ball has left the body."""
        return self._lodging(motion).left

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Distance along the command [m], mean speed [m/s], whether it is held or lost, and delivered (1 or 0)."""
        place, direction, time = self._lodging(motion), self.commanded["direction"][worms], self.memory["time"][worms]
        distance = direction * (place.height - self.memory["start"][worms])
        lost = _lost(place, direction)
        return {
            "distance": distance,
            "speed": _ratio(distance, time, time > 0.0),
            "held": (~lost).astype(np.float64),
            "delivered": (place.left & ~lost).astype(np.float64),
        }

    def _caption(self, outcome: Mapping[str, float], worm: int) -> str:
        """Distance, speed, and what became of the ball."""
        way = "up" if self.commanded["direction"][worm] > 0.0 else "down"
        end = "" if outcome["held"] else ", lost"
        end = ", delivered" if outcome["delivered"] else end
        return f"{1e3 * outcome['distance']:+.1f} mm {way} at {1e3 * outcome['speed']:.1f} mm/s{end}"

    def _lodging(self, motion: Motion) -> Lodging:
        return lodging(self.lattice, motion.position, motion.bolus_position[:, 0])

    def _commands(self) -> dict[str, Command]:
        return {"direction": Command(-1.0, 1.0, -1.0, 1.0, "1", (-1.0, 1.0))}


def _lost(place: Lodging, direction: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether a ball has left the body other than by the commanded end."""
    lost: npt.NDArray[np.bool_] = place.outside | (place.end == -direction)
    return lost


EIGHT_TARGETS: Given = {"azimuth": [TURN * k / 8 for k in range(8)], "radius": 0.2, "rise": -0.05}
"""Command of `Reach` for eight targets on a circle, as in Schaffer et al. 2024 (arXiv 2408.16069), within reach."""

TASKS: dict[str, type[Task]] = {
    task.name: task for task in (Extension, Compression, Bending, Peristalsis, Reach, Crawl, Transport)
}
"""Every task by name."""


def make_task(
    name: str,
    lattice: Lattice,
    control_dt: float,
    command: Given | None = None,
    model: RodModel | None = None,
    n_worm: int = 1,
) -> Task:
    """Task by name; see Task for the arguments."""
    if not isinstance(name, str) or name not in TASKS:
        raise ValueError(f"task = {name!r}: must be one of {', '.join(TASKS)}")
    return TASKS[name](lattice, control_dt, command, model, n_worm)
