"""What the worm is asked to do: a command, reward terms and an outcome, one small final class a task.

A task reads named quantities of the state (measures.py) and keeps nothing between episodes but what it was built with.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import product
from typing import Any, ClassVar, NamedTuple, final

import numpy as np
import numpy.typing as npt

from lattice_gym.design import TURN, FloatArray, is_number, shown
from lattice_gym.lattice import Lattice
from lattice_gym.measures import (
    Lodging,
    TravellingWave,
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
from lattice_gym.model import RodModel, RodState, build_model
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
    """Strength of every muscle in the step that ends, over the design's; the environment puts it here."""

    def __init__(
        self, lattice: Lattice, control_dt: float, command: Given | None = None, model: RodModel | None = None
    ) -> None:
        self.lattice = lattice
        self.control_dt = control_dt
        if model is not None:
            self.model = model
        self._prepare()
        self.commands = self._commands()
        self.among = {name: bounds.among for name, bounds in self.commands.items() if bounds.among}
        self.among |= self._checked("command", command)
        """Numbers that are drawn from a few, or held: those few, by name."""
        self.command = {
            name: self.among[name][0] if name in self.among else 0.5 * (bounds.low + bounds.high)
            for name, bounds in self.commands.items()
        }
        """The numbers now commanded, by name."""

    @classmethod
    def surroundings(cls, lattice: Lattice) -> World:
        """Return its own world around a body."""
        return World()

    @cached_property
    def model(self) -> RodModel:
        """The assembly: as given, or that of the task's own muscles and world."""
        layout = named_layout(self.layout, self.lattice)
        return build_model(self.lattice, layout, self.surroundings(self.lattice))

    def begin(self, rng: np.random.Generator, options: Mapping[str, object] | None) -> None:
        """Start an episode: draw the command, with what the constructor or the options give (the latter win)."""
        self.command = self._drawn(rng, options)

    @cached_property
    def rest(self) -> RodState:
        """State that episodes start from; the environment puts the settled one here."""
        return self.model.rest_state()

    @abstractmethod
    def observe(self, state: RodState, time: float) -> FloatArray:
        """Return what is asked for at a time [s], scaled to order one, shape (len(bounds),)."""

    @abstractmethod
    def terms(self, state: RodState, activation: FloatArray, time: float) -> dict[str, float]:
        """Signed reward terms at the end of a control step; called once for each, in order."""

    @abstractmethod
    def outcome(self, state: RodState) -> dict[str, float]:
        """Return what the motion came to by now, apart from the reward."""

    def over(self, state: RodState) -> bool:
        """Tell whether nothing more can come of the episode."""
        return False

    @abstractmethod
    def caption(self, state: RodState) -> str:
        """Return the outcome as a line with units, beside what was asked; empty while there is nothing to tell."""

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
    def achieved(self, state: RodState) -> npt.NDArray[np.float32]:
        """Goal that a state has reached, shape (n_goal,)."""

    @abstractmethod
    def desired(self) -> npt.NDArray[np.float32]:
        """Goal that is asked for, shape (n_goal,)."""

    @abstractmethod
    def goal_reward(self, achieved: npt.NDArray[Any], desired: npt.NDArray[Any]) -> FloatArray:
        """Term `goal_term` for goals of shape (..., n_goal), shape (...)."""


def _effort(activation: FloatArray) -> float:
    return -EFFORT_WEIGHT * float(np.mean(activation**2))


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

    def observe(self, state: RodState, time: float) -> FloatArray:
        """Nothing is commanded."""
        return np.empty(0)

    def terms(self, state: RodState, activation: FloatArray, time: float) -> dict[str, float]:
        """Strain, positive where it is asked for, and effort."""
        return {"strain": self.sign * strain(self.lattice, state.position), "effort": _effort(activation)}

    def outcome(self, state: RodState) -> dict[str, float]:
        """Strain, positive when longer."""
        return {"strain": strain(self.lattice, state.position)}

    def caption(self, state: RodState) -> str:
        """Strain in per cent."""
        return f"strain {100.0 * strain(self.lattice, state.position):+.1f} %"

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

    def observe(self, state: RodState, time: float) -> FloatArray:
        """Cosine and sine of the commanded azimuth."""
        return self._towards()

    def terms(self, state: RodState, activation: FloatArray, time: float) -> dict[str, float]:
        """Bend towards the commanded azimuth, sideways bend and effort."""
        bend, towards = bend_vector(self.lattice, state.position), self._towards()
        along = float(bend @ towards)
        across = float(bend[1] * towards[0] - bend[0] * towards[1])
        return {"bend": along, "sideways": -abs(across), "effort": _effort(activation)}

    def outcome(self, state: RodState) -> dict[str, float]:
        """Bend angle and its direction [rad]."""
        bend = bend_vector(self.lattice, state.position)
        return {"bend_angle": float(np.hypot(*bend)), "bend_direction": azimuth_of(bend)}

    def caption(self, state: RodState) -> str:
        """Bend angle, its direction and the one asked for, in degrees."""
        bend = bend_vector(self.lattice, state.position)
        angle, towards, asked = np.degrees([np.hypot(*bend), azimuth_of(bend), self.command["azimuth"] % TURN])
        # What leans by less than is printed leans no way.
        way = f"towards {_whole(towards)} deg " if angle >= 0.05 else ""
        return f"bend {angle:.1f} deg {way}(asked: {_whole(asked)} deg)"

    def _towards(self) -> FloatArray:
        azimuth = self.command["azimuth"]
        return np.array([np.cos(azimuth), np.sin(azimuth)])

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

    def __init__(
        self, lattice: Lattice, control_dt: float, command: Given | None = None, model: RodModel | None = None
    ) -> None:
        super().__init__(lattice, control_dt, command, model)
        drawn = {name: (bounds.low, bounds.high) for name, bounds in self.commands.items()} | self.among
        for speed, wavelength in product(drawn["speed"], drawn["wavelength"]):
            self._check_wave("command", {"speed": speed, "wavelength": wavelength})

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
        self.recorded: deque[FloatArray] = deque()

    def begin(self, rng: np.random.Generator, options: Mapping[str, object] | None) -> None:
        """Start an episode: draw the command and forget the recording."""
        command = self._drawn(rng, options)
        self._check_wave("options", command)
        self.command = command
        self.recorded = deque(maxlen=round(self.RECORDED_PERIODS * self._period() / self.control_dt))

    def observe(self, state: RodState, time: float) -> FloatArray:
        """Cosine and sine of the wave's phase at the base; speed, wavelength and amplitude over what is typical."""
        angle = self._phase(time)
        height = self.lattice.design.height
        speed, wavelength, amplitude = (self.command[name] for name in ("speed", "wavelength", "amplitude"))
        return np.array(
            [np.cos(angle), np.sin(angle), speed / height, wavelength / height, amplitude / self.TYPICAL_AMPLITUDE]
        )

    def target(self, time: float) -> FloatArray:
        """Deviation asked of every level that can move, as a share of the rest radius, shape (n_level - first,)."""
        angle = self._phase(time) - TURN * self.height / self.command["wavelength"]
        wave: FloatArray = self.command["amplitude"] * np.cos(angle)
        return wave

    def terms(self, state: RodState, activation: FloatArray, time: float) -> dict[str, float]:
        """Share of the commanded wave that is followed, and effort."""
        deviation = (ring_radii(self.lattice, state.position) / self.rest_radius - 1.0)[self.first :]
        self.recorded.append(deviation)
        target = self.target(time)
        # sum target^2 - sum (deviation - target)^2, without the rounding of a difference
        followed = float((2.0 * target - deviation) @ deviation)
        error = float(np.sum((deviation - target) ** 2))
        tracking = followed / (0.5 * len(target) * self.command["amplitude"] ** 2 + error)
        return {"tracking": tracking, "effort": _effort(activation)}

    def outcome(self, state: RodState) -> dict[str, float]:
        """Index, direction, speed [m/s] and amplitude (a share of the rest radius) of the wave.

        Measured over the last two commanded periods; 0 until two have passed.
        """
        wave = self._wave() or TravellingWave(0.0, 0, 0.0)
        return {
            "wave_index": wave.index,
            "wave_direction": float(wave.direction),
            "wave_speed": wave.speed,
            "wave_amplitude": wave.amplitude,
        }

    def caption(self, state: RodState) -> str:
        """Index, way, speed and amplitude beside those asked for; empty until two commanded periods have passed."""
        wave = self._wave()
        if wave is None:
            return ""
        speed = self.command["speed"]
        way = f"{WAYS[wave.direction]} at {wave.speed:.3f} m/s" if wave.direction else "going nowhere"
        asked = f"{WAYS[int(np.sign(speed))]} at {abs(speed):.3f} m/s, {100.0 * self.command['amplitude']:.1f} %"
        return f"wave index {wave.index:.2f}, {way}, amplitude {100.0 * wave.amplitude:.1f} % (asked: {asked})"

    def _wave(self) -> TravellingWave | None:
        """Wave over the last two commanded periods; None until two have passed."""
        if len(self.recorded) != self.recorded.maxlen:
            return None
        return travelling_wave(1.0 + np.array(self.recorded), self.control_dt, self.height)

    def _phase(self, time: float) -> float:
        return TURN * self.command["speed"] / self.command["wavelength"] * time + self.command["phase"]

    def _period(self) -> float:
        return abs(self.command["wavelength"] / self.command["speed"])

    def _check_wave(self, argument: str, command: Mapping[str, float]) -> None:
        """Refuse a wave that stands, or that is too fast to be sampled by control steps."""
        speed, slowest = abs(command["speed"]), self.SLOWEST * self.lattice.design.height
        if speed < slowest * (1.0 - BOUND_SLACK):
            raise ValueError(f"{argument}['speed'] = {command['speed']:g}: at least {slowest:g} [m/s], up or down")
        period, shortest = command["wavelength"] / speed, self.LEAST_STEPS * self.control_dt
        if period < shortest * (1.0 - BOUND_SLACK):
            raise ValueError(
                f"{argument}: a wave of speed {speed:g} m/s and wavelength {command['wavelength']:g} m has a period of "
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
        self.reach_time = 0.0

    def begin(self, rng: np.random.Generator, options: Mapping[str, object] | None) -> None:
        """Start an episode: draw the target, which is not reached yet."""
        super().begin(rng, options)
        self.reach_time = 0.0

    def achieved(self, state: RodState) -> npt.NDArray[np.float32]:
        """Displacement of the top's centre over GOAL_SCALE heights, shape (3,)."""
        moved = self.axes @ (top_centre(self.lattice, state.position) - self.origin)
        unit = GOAL_SCALE * self.lattice.design.height
        return np.clip(moved / unit, -COMMAND_BOUND, COMMAND_BOUND).astype(np.float32)

    def desired(self) -> npt.NDArray[np.float32]:
        """Displacement that is asked for over GOAL_SCALE heights, shape (3,)."""
        azimuth, radius, rise = (self.command[name] for name in ("azimuth", "radius", "rise"))
        return (np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), rise]) / GOAL_SCALE).astype(np.float32)

    def goal_reward(self, achieved: npt.NDArray[Any], desired: npt.NDArray[Any]) -> FloatArray:
        """Distance of the target from rest less that from the top's centre [heights]."""
        target = np.asarray(desired, dtype=np.float64)
        nearer: FloatArray = GOAL_SCALE * (np.linalg.norm(target, axis=-1) - np.linalg.norm(target - achieved, axis=-1))
        return nearer

    def observe(self, state: RodState, time: float) -> FloatArray:
        """Way from the top's centre to the target, over GOAL_SCALE heights."""
        way: FloatArray = np.clip(self.desired() - self.achieved(state), -COMMAND_BOUND, COMMAND_BOUND).astype(float)
        return way

    def terms(self, state: RodState, activation: FloatArray, time: float) -> dict[str, float]:
        """How much nearer the target is than at rest, and effort."""
        if self.reach_time == 0.0 and self._distance(state) <= self.REACHED:
            self.reach_time = time
        approach = float(self.goal_reward(self.achieved(state), self.desired()))
        return {"approach": approach, "effort": _effort(activation)}

    def outcome(self, state: RodState) -> dict[str, float]:
        """Distance from the target [m], whether it was reached at all (1 or 0), and when [s], 0 if not."""
        return {
            "distance": self._distance(state) * self.lattice.design.height,
            "reached": float(self.reach_time > 0.0),
            "reach_time": self.reach_time,
        }

    def caption(self, state: RodState) -> str:
        """Distance from the target, and when it was reached."""
        reached = f", reached after {self.reach_time:.2f} s" if self.reach_time > 0.0 else ""
        return f"{1000.0 * self.outcome(state)['distance']:.1f} mm from the target{reached}"

    def _distance(self, state: RodState) -> float:
        """Distance of the top's centre from the target [heights]."""
        return GOAL_SCALE * float(np.linalg.norm(self.desired().astype(np.float64) - self.achieved(state)))

    def _commands(self) -> dict[str, Command]:
        return {
            "azimuth": Command(0.0, TURN, -TURN, TURN, "rad"),
            "radius": Command(0.05, 0.2, 0.0, 1.5, "heights"),
            "rise": Command(-0.08, 0.0, -1.0, 1.5, "heights"),
        }


@final
class Crawl(Task):
    """Crawl along +x or -x on the ground: the reward is the way the centre of mass went along the commanded direction.

    A free worm lies along x, in a medium nearly as dense as it is, and moves only by friction. Its rods are damped a
    tenth as much as the default design's: that damping resists every motion, 23 N s/m in all, and at a centimetre a
    second takes more than the 0.13 N that friction can give.
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
        """Return a ground to lie on in a medium of the density of water."""
        return World(medium=Medium(), ground=Ground(), lying=True)

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
        self._begin()

    def _begin(self) -> None:
        self.start = mass_centre(self.model, self.rest.position)
        self.centre = self.start
        self.length = muscle_lengths(self.model, self.rest.position)
        self.activation = np.zeros(len(self.length))
        self.work = self.time = 0.0

    def begin(self, rng: np.random.Generator, options: Mapping[str, object] | None) -> None:
        """Start an episode: draw the direction, from rest."""
        super().begin(rng, options)
        self._begin()

    def observe(self, state: RodState, time: float) -> FloatArray:
        """Commanded direction along x, and how far the body is off course, to +y, in heights."""
        aside = float((mass_centre(self.model, state.position) - self.start)[1]) / self.lattice.design.height
        return np.array([self.command["direction"], np.clip(aside, -COMMAND_BOUND, COMMAND_BOUND)])

    def terms(self, state: RodState, activation: FloatArray, time: float) -> dict[str, float]:
        """Way along the commanded direction in this step, and effort."""
        centre, length = mass_centre(self.model, state.position), muscle_lengths(self.model, state.position)
        way = float(centre[0] - self.centre[0]) * self.command["direction"] / self.lattice.design.height
        # Tension is linear in time over the step, so its mean is that of its ends.
        tension = 0.5 * self.lattice.design.max_tension * self.strength * (self.activation + activation)
        self.work += float(tension @ np.maximum(self.length - length, 0.0))
        self.centre, self.length, self.activation, self.time = centre, length, activation, time
        return {"progress": WAY_WEIGHT * way, "effort": _effort(activation)}

    def outcome(self, state: RodState) -> dict[str, float]:
        """Speed along the command [body lengths a minute], drift off it [rad] and cost of transport, see env.py."""
        way = (mass_centre(self.model, state.position) - self.start)[:2] / self.lattice.design.height
        along = float(way[0]) * self.command["direction"]
        moved = float(np.hypot(*way)) >= self.LEAST_WAY
        gravity = 0.0 if self.model.gravity is None else float(np.linalg.norm(self.model.gravity))
        haul = float(self.model.node_mass.sum()) * gravity * along * self.lattice.design.height
        return {
            "speed": 60.0 * along / self.time if self.time > 0.0 else 0.0,
            "drift": float(np.arctan2(abs(way[1]), along)) if moved else 0.0,
            "cost_of_transport": self.work / haul if along >= self.LEAST_WAY and haul > 0.0 else 0.0,
        }

    def caption(self, state: RodState) -> str:
        """Speed along the command and drift."""
        outcome, way = self.outcome(state), "+x" if self.command["direction"] > 0.0 else "-x"
        return (
            f"{outcome['speed']:+.1f} body lengths/min along {way}, {np.degrees(outcome['drift']):.0f} deg off course"
        )

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
        self._begin()

    def _begin(self) -> None:
        self.start = self.height = self._lodging(self.rest).height
        self.time = 0.0

    def begin(self, rng: np.random.Generator, options: Mapping[str, object] | None) -> None:
        """Start an episode: draw the direction, with the ball where it settled."""
        super().begin(rng, options)
        self._begin()

    def observe(self, state: RodState, time: float) -> FloatArray:
        """Direction; the ball's way from its start over GOAL_SCALE heights, and its velocity in heights a second."""
        height = self.lattice.design.height
        moved = (state.bolus_position[0] - self.rest.bolus_position[0]) / (GOAL_SCALE * height)
        moving = np.concatenate([moved, state.bolus_velocity[0] / height])
        return np.concatenate([[self.command["direction"]], np.clip(moving, -COMMAND_BOUND, COMMAND_BOUND)])

    def terms(self, state: RodState, activation: FloatArray, time: float) -> dict[str, float]:
        """Way of the ball along the command in this step, the price of losing it, and effort."""
        height = self._lodging(state).height
        way = self.command["direction"] * (height - self.height) / self.lattice.design.height
        self.height, self.time = height, time
        lost = -self.LOST if self._lost(state) else 0.0
        return {"progress": WAY_WEIGHT * way, "lost": lost, "effort": _effort(activation)}

    def over(self, state: RodState) -> bool:
        """Tell whether the ball has left the body."""
        place = self._lodging(state)
        return place.outside or place.end != 0

    def outcome(self, state: RodState) -> dict[str, float]:
        """Distance along the command [m], mean speed [m/s], whether it is held or lost, and delivered (1 or 0)."""
        distance = self.command["direction"] * (self._lodging(state).height - self.start)
        lost = self._lost(state)
        return {
            "distance": distance,
            "speed": distance / self.time if self.time > 0.0 else 0.0,
            "held": float(not lost),
            "delivered": float(self.over(state) and not lost),
        }

    def caption(self, state: RodState) -> str:
        """Distance, speed, and what became of the ball."""
        outcome, way = self.outcome(state), "up" if self.command["direction"] > 0.0 else "down"
        end = "" if outcome["held"] else ", lost"
        end = ", delivered" if outcome["delivered"] else end
        return f"{1e3 * outcome['distance']:+.1f} mm {way} at {1e3 * outcome['speed']:.1f} mm/s{end}"

    def _lodging(self, state: RodState) -> Lodging:
        return lodging(self.lattice, state.position, state.bolus_position[0])

    def _lost(self, state: RodState) -> bool:
        """Whether the ball has left the body other than by the commanded end."""
        place = self._lodging(state)
        return place.outside or place.end == -self.command["direction"]

    def _commands(self) -> dict[str, Command]:
        return {"direction": Command(-1.0, 1.0, -1.0, 1.0, "1", (-1.0, 1.0))}


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
) -> Task:
    """Task by name; see Task for the arguments."""
    if not isinstance(name, str) or name not in TASKS:
        raise ValueError(f"task = {name!r}: must be one of {', '.join(TASKS)}")
    return TASKS[name](lattice, control_dt, command, model)
