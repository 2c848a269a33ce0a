"""What the worm is asked to do: a command, reward terms and an outcome, one small final class a task.

A task reads named quantities of the state (measures.py) and keeps nothing between episodes but what it was built with.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from typing import ClassVar, NamedTuple, final

import numpy as np

from lattice_gym.design import TURN, FloatArray, is_number
from lattice_gym.lattice import Lattice
from lattice_gym.measures import (
    TravellingWave,
    azimuth_of,
    base_frame,
    bend_vector,
    ring_radii,
    strain,
    top_sites,
    travelling_wave,
)

EFFORT_WEIGHT = 0.01
"""Price of holding every muscle fully active, per control step: small against what any task pays."""
BOUND_SLACK = 1e-9
"""Share of a bound by which a commanded number may lie beyond it: a bound that is reached by arithmetic is rounded."""
COMMAND_BOUND = 10.0
"""Bound of what a task adds to the observation."""
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

    def allows(self, value: float) -> bool:
        """Tell whether a number may be given."""
        slack = BOUND_SLACK
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
        Commanded numbers to hold fixed; the others are drawn anew for every episode.

    """

    name: ClassVar[str]
    """As in `LatticeWormEnv(task=...)`."""
    layout: ClassVar[str]
    """Muscles it is meant for, by name."""
    term_names: ClassVar[tuple[str, ...]]
    """Names of its reward terms, in order."""
    bounds: ClassVar[tuple[float, ...]] = ()
    """Sizes that what it adds to the observation stays within, one a number."""

    def __init__(self, lattice: Lattice, control_dt: float, command: Mapping[str, float] | None = None) -> None:
        self.lattice = lattice
        self.control_dt = control_dt
        self.commands = self._commands()
        self.fixed = self._checked("command", command)
        self.command: dict[str, float] = {
            name: 0.5 * (bounds.low + bounds.high) for name, bounds in self.commands.items()
        } | self.fixed
        """The numbers now commanded, by name."""

    def begin(self, rng: np.random.Generator, options: Mapping[str, object] | None) -> None:
        """Start an episode: draw the command, hold what the constructor or the options fix (the latter win)."""
        self.command = self._drawn(rng, options)

    @abstractmethod
    def observe(self, time: float) -> FloatArray:
        """Return what is commanded at a time [s], scaled to order one, shape (len(bounds),)."""

    @abstractmethod
    def terms(self, position: FloatArray, activation: FloatArray, time: float) -> dict[str, float]:
        """Signed reward terms at the end of a control step; called once for each, in order."""

    @abstractmethod
    def outcome(self, position: FloatArray) -> dict[str, float]:
        """Return what the motion came to by now, apart from the reward."""

    @abstractmethod
    def caption(self, position: FloatArray) -> str:
        """Return the outcome as a line with units, beside what was asked; empty while there is nothing to tell."""

    @abstractmethod
    def _commands(self) -> dict[str, Command]:
        """Bounds of every commanded number."""

    def _drawn(self, rng: np.random.Generator, options: Mapping[str, object] | None) -> dict[str, float]:
        given = self._checked("options", options)
        # Drawn whether used or not, so that fixing one number leaves the others as they were.
        drawn = {name: float(rng.uniform(bounds.low, bounds.high)) for name, bounds in self.commands.items()}
        return drawn | self.fixed | given

    def _checked(self, argument: str, values: Mapping[str, object] | None) -> dict[str, float]:
        if values is None:
            return {}
        if not isinstance(values, Mapping):
            raise ValueError(f"{argument} = {values!r}: must be a mapping of names to numbers")
        checked: dict[str, float] = {}
        for name, value in values.items():
            if name not in self.commands:
                known = ", ".join(self.commands) or "nothing"
                raise ValueError(f"{argument}: {self.name} commands no {name!r}; it commands {known}")
            bounds = self.commands[name]
            span = f"must be a number from {bounds.least:g} to {bounds.most:g} [{bounds.unit}]"
            if not is_number(value) or not bounds.allows(value):
                raise ValueError(f"{argument}[{name!r}] = {value!r}: {span}")
            checked[name] = float(value)
        return checked


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

    def __init__(self, lattice: Lattice, control_dt: float, command: Mapping[str, float] | None = None) -> None:
        _check_base(lattice)
        super().__init__(lattice, control_dt, command)

    def observe(self, time: float) -> FloatArray:
        """Nothing is commanded."""
        return np.empty(0)

    def terms(self, position: FloatArray, activation: FloatArray, time: float) -> dict[str, float]:
        """Strain, positive where it is asked for, and effort."""
        return {"strain": self.sign * strain(self.lattice, position), "effort": _effort(activation)}

    def outcome(self, position: FloatArray) -> dict[str, float]:
        """Strain, positive when longer."""
        return {"strain": strain(self.lattice, position)}

    def caption(self, position: FloatArray) -> str:
        """Strain in per cent."""
        return f"strain {100.0 * strain(self.lattice, position):+.1f} %"

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

    def __init__(self, lattice: Lattice, control_dt: float, command: Mapping[str, float] | None = None) -> None:
        top_sites(lattice)  # refuses a lattice whose top is no plane
        _check_base(lattice)
        super().__init__(lattice, control_dt, command)

    def observe(self, time: float) -> FloatArray:
        """Cosine and sine of the commanded azimuth."""
        return self._towards()

    def terms(self, position: FloatArray, activation: FloatArray, time: float) -> dict[str, float]:
        """Bend towards the commanded azimuth, sideways bend and effort."""
        bend, towards = bend_vector(self.lattice, position), self._towards()
        along = float(bend @ towards)
        across = float(bend[1] * towards[0] - bend[0] * towards[1])
        return {"bend": along, "sideways": -abs(across), "effort": _effort(activation)}

    def outcome(self, position: FloatArray) -> dict[str, float]:
        """Bend angle and its direction [rad]."""
        bend = bend_vector(self.lattice, position)
        return {"bend_angle": float(np.hypot(*bend)), "bend_direction": azimuth_of(bend)}

    def caption(self, position: FloatArray) -> str:
        """Bend angle, its direction and the one asked for, in degrees."""
        bend = bend_vector(self.lattice, position)
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

    def __init__(self, lattice: Lattice, control_dt: float, command: Mapping[str, float] | None = None) -> None:
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
        super().__init__(lattice, control_dt, command)
        drawn = {"speed": self.commands["speed"].high, "wavelength": self.commands["wavelength"].low}
        self._check_wave("command", drawn | self.fixed)

    def begin(self, rng: np.random.Generator, options: Mapping[str, object] | None) -> None:
        """Start an episode: draw the command and forget the recording."""
        command = self._drawn(rng, options)
        self._check_wave("options", command)
        self.command = command
        self.recorded = deque(maxlen=round(self.RECORDED_PERIODS * self._period() / self.control_dt))

    def observe(self, time: float) -> FloatArray:
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

    def terms(self, position: FloatArray, activation: FloatArray, time: float) -> dict[str, float]:
        """Share of the commanded wave that is followed, and effort."""
        deviation = (ring_radii(self.lattice, position) / self.rest_radius - 1.0)[self.first :]
        self.recorded.append(deviation)
        target = self.target(time)
        # sum target^2 - sum (deviation - target)^2, without the rounding of a difference
        followed = float((2.0 * target - deviation) @ deviation)
        error = float(np.sum((deviation - target) ** 2))
        tracking = followed / (0.5 * len(target) * self.command["amplitude"] ** 2 + error)
        return {"tracking": tracking, "effort": _effort(activation)}

    def outcome(self, position: FloatArray) -> dict[str, float]:
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

    def caption(self, position: FloatArray) -> str:
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


TASKS: dict[str, type[Task]] = {task.name: task for task in (Extension, Compression, Bending, Peristalsis)}
"""Every task by name."""


def make_task(name: str, lattice: Lattice, control_dt: float, command: Mapping[str, float] | None = None) -> Task:
    """Task by name; see Task for the arguments."""
    if not isinstance(name, str) or name not in TASKS:
        raise ValueError(f"task = {name!r}: must be one of {', '.join(TASKS)}")
    return TASKS[name](lattice, control_dt, command)
