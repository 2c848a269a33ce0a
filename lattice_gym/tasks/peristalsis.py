"""Follow a commanded travelling wave of the ring radii."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any, ClassVar, final

import numpy as np

from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import MuscleLayout
from lattice_gym.checks import TAU, FloatArray, IntArray, invalid_value, number
from lattice_gym.physics.measures import ring_radii, travelling_wave
from lattice_gym.physics.state import Motion
from lattice_gym.tasks.base import BOUND_TOLERANCE, COMMAND_BOUND, Command, RewardTerm, Task
from lattice_gym.tasks.gait import LEAD, MAX_NUMBER, MIN_NUMBER, Gait, longitudinal, muscle_middles, required_commands

RING_SHARE = 0.7
"""Drive of ring muscles over that of vertical ones, with which a wave does not change the mean radius."""
TOP_SHARE = 0.5
"""Further factor for the rings of the top level: nothing above resists them, so less drive gives the same amplitude."""
FULL_DRIVE_AMPLITUDE = 0.06
"""Amplitude of the ring radii over the rest radius that the wave reaches at full drive in the default design."""
WAYS = {1: "up", -1: "down"}


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

    What is drawn was chosen from what the body can do: see FULL_DRIVE_AMPLITUDE, and the test
    `test_the_antiphase_gait_can_make_the_wave_that_is_drawn`, which measures it.
    """

    name = "peristalsis"
    layout = "all"
    time_limit = 200
    rewards: ClassVar[Mapping[str, RewardTerm]] = {"tracking": RewardTerm(1.0, -1.0, 2.0)}
    training: ClassVar[Mapping[str, Any]] = {"control": "ring", "gamma": 0.8}
    bounds = (1.0, 1.0, COMMAND_BOUND, COMMAND_BOUND, COMMAND_BOUND)

    RECORDED_PERIODS: ClassVar[int] = 2
    """Periods of the commanded wave over which the outcome is measured."""
    MIN_STEPS: ClassVar[int] = 4
    """Fewest control steps in a period of the commanded wave."""
    MIN_LEVELS: ClassVar[int] = 3
    """Fewest levels that can carry a wave."""
    MIN_SPEED: ClassVar[float] = 0.1
    """Slowest wave [body lengths a second]."""
    TYPICAL_AMPLITUDE: ClassVar[float] = 0.055
    """Scale of the observed amplitude."""

    def prepare(self) -> None:
        """Refuse a body with too few levels for a wave, and measure its rings."""
        lattice = self.lattice
        first = 1 if lattice.design.base == "clamped" else 0
        if lattice.n_level - first < self.MIN_LEVELS:
            raise ValueError(
                f"design: peristalsis needs at least {self.MIN_LEVELS} levels of sites that can move, got "
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

    def initial_memory(self) -> dict[str, FloatArray]:
        """Count of steps, and the latest deviations of the ring radii."""
        return {"steps": np.zeros(()), "record": np.zeros((1, len(self.height)))}

    def observe(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Cosine and sine of the wave's phase at the base; speed, wavelength and amplitude over what is typical."""
        angle, height, typical = self._phase(time), self.lattice.design.height, self.TYPICAL_AMPLITUDE
        speed, wavelength, amplitude = (self.commanded[name] for name in ("speed", "wavelength", "amplitude"))
        seen = [np.cos(angle), np.sin(angle), speed / height, wavelength / height, amplitude / typical]
        return np.array(seen).T

    def target(self, time: FloatArray) -> FloatArray:
        """Deviation asked of every level that can move, over the rest radius, shape (n_worm, n_level - first)."""
        angle = self._phase(time)[:, None] - TAU * self.height / self.commanded["wavelength"][:, None]
        wave: FloatArray = self.commanded["amplitude"][:, None] * np.cos(angle)
        return wave

    def record(self, worm: int = 0) -> FloatArray:
        """Deviations of a worm over the last two commanded periods, or as far back as it goes, shape (n, n_level)."""
        steps, window = int(self.memory["steps"][worm]), int(self._window[worm])
        rows = np.arange(max(steps - window, 0), steps) % window
        found: FloatArray = self.memory["record"][worm, rows]
        return found

    def remember(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Deviations of the ring radii in this step, in the place of those that lie a window back."""
        steps, record = self.memory["steps"], self.memory["record"].copy()
        deviation = ring_radii(self.lattice, motion.position) / self.rest_radius - 1.0
        record[self._rows(steps)] = deviation[:, self.first :]
        return {"steps": steps + 1.0, "record": record}

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Share of the commanded wave that is followed."""
        deviation = self.memory["record"][self._rows(self.memory["steps"] - 1.0)]
        target = self.target(time)
        error = deviation - target
        # sum target^2 - sum (deviation - target)^2, without the rounding of a difference
        followed = ((target - error) * deviation).sum(axis=-1)
        whole = 0.5 * len(self.height) * self.commanded["amplitude"] ** 2 + (error * error).sum(axis=-1)
        return {"tracking": followed / whole}

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Index, direction, speed [m/s] and amplitude (a share of the rest radius) of the wave.

        Measured over the last two commanded periods; 0 until two have passed.
        """
        found = np.zeros((len(worms), 4))
        for row, worm in zip(found, worms.tolist(), strict=True):
            if self._record_is_full(worm):
                wave = travelling_wave(1.0 + self.record(worm), self.control_dt, self.height)
                row[:] = *wave, wave.amplitude
        return dict(zip(("wave_index", "wave_direction", "wave_speed", "wave_amplitude"), found.T, strict=True))

    @classmethod
    def errors(cls, outcome: Mapping[str, float], command: Mapping[str, float]) -> dict[str, float]:
        """Index of the wave, and its speed and amplitude over those asked for: 1 is exact, 0 no wave.

        A speed below 0 is a wave that runs the wrong way.
        """
        velocity = outcome["wave_direction"] * outcome["wave_speed"]
        return {
            "wave_index": outcome["wave_index"],
            "speed_over_asked": velocity / command["speed"],
            "amplitude_over_asked": outcome["wave_amplitude"] / command["amplitude"],
        }

    def describe(self, outcome: Mapping[str, float], worm: int) -> str:
        """Index, way, speed and amplitude beside those asked for; empty until two commanded periods have passed."""
        if not self._record_is_full(worm):
            return ""
        index, direction, speed, amplitude = outcome.values()
        command = self.command_of(worm)
        wish, size = command["speed"], 100.0 * command["amplitude"]
        way = f"{WAYS[int(direction)]} at {speed:.3f} m/s" if direction else "going nowhere"
        asked = f"{WAYS[int(np.sign(wish))]} at {abs(wish):.3f} m/s, {size:.1f} %"
        return f"wave index {index:.2f}, {way}, amplitude {100.0 * amplitude:.1f} % (asked: {asked})"

    @classmethod
    def gait(cls, lattice: Lattice, layout: MuscleLayout, command: Mapping[str, float]) -> Gait:
        """Wave of rings and vertical muscles in antiphase, a lead ahead of the commanded one."""
        return peristalsis_gait(
            lattice, layout, **required_commands(cls.name, command, "speed", "wavelength", "amplitude", "phase")
        )

    def _rows(self, steps: FloatArray) -> tuple[IntArray, IntArray]:
        """Place in the record of the step that follows so many, of each worm."""
        return np.arange(self.n_worm), steps.astype(np.int64) % self._window

    def _record_is_full(self, worm: int) -> bool:
        """Whether two commanded periods have passed."""
        return bool(self.memory["steps"][worm] >= self._window[worm])

    def _phase(self, time: FloatArray) -> FloatArray:
        rate = TAU * self.commanded["speed"] / self.commanded["wavelength"]
        phase: FloatArray = rate * time + self.commanded["phase"]
        return phase

    def check_command(self, argument: str, numbers: Mapping[str, tuple[float, ...]]) -> None:
        """Refuse what any draw would make a wave that cannot be sampled."""
        for speed, wavelength in product(numbers["speed"], numbers["wavelength"]):
            self._check_wave(argument, speed, wavelength)

    def _check_wave(self, argument: str, speed: float, wavelength: float) -> None:
        """Refuse a wave that stands, or that is too fast to be sampled by control steps."""
        slowest, shortest = self.MIN_SPEED * self.lattice.design.height, self.MIN_STEPS * self.control_dt
        if abs(speed) < slowest * (1.0 - BOUND_TOLERANCE):
            raise ValueError(f"{argument}['speed'] = {speed:g}: at least {slowest:g} [m/s], up or down")
        period = wavelength / abs(speed)
        if period < shortest * (1.0 - BOUND_TOLERANCE):
            raise ValueError(
                f"{argument}: a wave of speed {abs(speed):g} m/s and wavelength {wavelength:g} m has a period of "
                f"{period:g} s; it must last {self.MIN_STEPS} control steps, {shortest:g} s (control_dt = "
                f"{self.control_dt:g} s)"
            )

    def command_ranges(self) -> dict[str, Command]:
        """Upward speed, length, amplitude and phase of the wave."""
        height = self.lattice.design.height
        # Phases of neighbouring levels are told apart below half a turn; a third leaves room.
        shortest = 3.0 * float(np.diff(self.height).max())
        low = max(0.8 * height, shortest)
        return {
            "speed": Command(0.8 * height, 1.2 * height, -10.0 * height, 10.0 * height, "m/s"),
            "wavelength": Command(low, max(1.2 * height, low), shortest, 10.0 * height, "m"),
            "amplitude": Command(0.04, 0.07, 0.001, 0.5, "share of the rest radius"),
            "phase": Command(0.0, TAU, -TAU, TAU, "rad"),
        }


def peristalsis_gait(
    lattice: Lattice,
    layout: MuscleLayout,
    speed: float,
    wavelength: float,
    amplitude: float,
    phase: float = 0.0,
    ring_share: float = RING_SHARE,
    top_share: float = TOP_SHARE,
    lead: float = LEAD,
) -> Gait:
    """Rings and vertical muscles in antiphase, as a wave along the body.

    Vertical muscles contract where the commanded wave is wide, ring muscles where it is narrow.

    Parameters
    ----------
    lattice, layout
        The body and its muscles.
    speed, wavelength, amplitude, phase
        The commanded wave of ring radii: upward speed [m/s], wavelength [m], amplitude over the rest radius, phase at
        the base at time 0 [rad].
    ring_share
        Drive of ring muscles over that of vertical ones.
    top_share
        Further share for the rings of the top level.
    lead
        Time by which commands run ahead of the wave [s].

    """
    speed = number("speed", speed, -MAX_NUMBER, MAX_NUMBER, "m/s")
    wavelength = number("wavelength", wavelength, MIN_NUMBER, MAX_NUMBER, "m")
    amplitude = number("amplitude", amplitude, MIN_NUMBER, MAX_NUMBER, "1")
    phase = number("phase", phase, -MAX_NUMBER, MAX_NUMBER, "rad")
    ring_share = number("ring_share", ring_share, 0.0, MAX_NUMBER, "1")
    top_share = number("top_share", top_share, 0.0, MAX_NUMBER, "1")
    if speed == 0.0:
        raise invalid_value("speed", speed, "must not be 0, a wave that stands")
    along, height = longitudinal(lattice, layout), muscle_middles(lattice, layout)[:, 2]
    at_top = ~along & (height > lattice.design.height * (1.0 - 1e-9))
    share = np.where(along, 1.0, ring_share) * np.where(at_top, top_share, 1.0)
    drive = 0.5 * min(1.0, amplitude / FULL_DRIVE_AMPLITUDE) * share
    return Gait(
        offset=drive,
        swing=np.where(along, drive, -drive),
        phase=TAU * height / wavelength - phase,
        frequency=speed / wavelength,
        lead=lead,
    )
