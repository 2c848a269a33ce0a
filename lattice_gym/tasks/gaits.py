"""Open-loop activations over time: a hand-made answer to every task.

They are baselines and starting points, not optima: each follows from one idea about the body, and its few numbers were
read from the default design.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import MuscleLayout
from lattice_gym.checks import TURN, FloatArray, IntArray, is_number, shown

RING_SHARE = 0.7
"""Drive of ring muscles over that of vertical ones: held back this much, a wave leaves the mean radius where it was."""
TOP_SHARE = 0.5
"""Further share for the rings of the top level: nothing holds it from above, so less gives the same amplitude."""
LEAD = 0.07
"""How far a wave runs ahead of what it follows [s]: a command is held for a control step, and muscles lag behind it."""
FULL_DRIVE_AMPLITUDE = 0.06
"""Amplitude of the ring radii over the rest radius that the wave reaches at full drive in the default design."""
LEAST, MOST = 1e-9, 1e9
"""Sizes that the numbers of a gait lie between, wide enough for any body in SI units; some may also be 0."""

CRAWL_FREQUENCY, CRAWL_WAVELENGTH = 1.0, 1.0
"""Of the crawling wave [Hz], [heights]: the best of wavelengths from 0.6 to 2; at 2 Hz it is a quarter faster."""
CARRY_FREQUENCY, CARRY_WAVELENGTH, CARRY_VERTICAL_SHARE = 0.2, 0.5, 0.5
"""Of the carrying wave [Hz], [heights]: what it holds rides it, at a tenth of a height a second."""
CARRY_START = 0.565
"""Where the ball of the task has come to rest [heights]."""
REACH_SHARPNESS = (3.8, 44.0)
REACH_LENGTHENING = (6.7, 5.5)
"""Coefficients of `reaching_gait`: least squares over what the default design reached."""

TASKS_WITH_GAITS = ("extension", "compression", "bending", "peristalsis", "reach", "crawl", "transport")


@dataclass(frozen=True, kw_only=True, eq=False)
class Gait:
    """A wave of muscle commands: ``offset + swing cos(2 pi frequency (t + lead) - phase)``, clipped to [0, 1].

    Called with a time [s] it returns the command of every active muscle, shape (n_muscle,).
    """

    offset: FloatArray
    """Mean command of each muscle, shape (n_muscle,)."""
    swing: FloatArray
    """Amplitude of each muscle's command, shape (n_muscle,)."""
    phase: FloatArray
    """Lag of each muscle [rad], shape (n_muscle,)."""
    frequency: float = 0.0
    """Cycles a second [Hz]; negative runs the wave backwards."""
    lead: float = LEAD
    """Time by which the commands run ahead [s]."""

    def __post_init__(self) -> None:
        for name in ("offset", "swing", "phase"):
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"{name} = {getattr(self, name)}: must be finite")
        _check(-MOST, frequency=self.frequency, lead=self.lead)

    def __call__(self, time: float) -> FloatArray:
        """Commands at a time [s], shape (n_muscle,), in [0, 1]."""
        _check(-MOST, time=time)
        angle = TURN * self.frequency * (time + self.lead)
        command: FloatArray = np.clip(self.offset + self.swing * np.cos(angle - self.phase), 0.0, 1.0)
        return command


def gait(task: str, lattice: Lattice, layout: MuscleLayout, command: Mapping[str, float]) -> Gait:
    """Hand-made gait for a task by name, given what the task commands; muscles of no use to it rest.

    A command is the task's own (`env.unwrapped.task.command`): bending needs `azimuth`, reach `azimuth`,
    `radius` and `rise`, crawl and transport `direction`, peristalsis `speed`, `wavelength`, `amplitude` and `phase`.
    """
    if not isinstance(task, str) or task not in TASKS_WITH_GAITS:
        raise ValueError(f"task = {shown(task)}: must be one of {', '.join(TASKS_WITH_GAITS)}")
    if task == "extension":
        return extension_gait(lattice, layout)
    if task == "compression":
        return compression_gait(lattice, layout)
    if task == "bending":
        return bending_gait(lattice, layout, **_only(task, command, "azimuth"))
    if task == "crawl":
        return crawling_gait(lattice, layout, **_only(task, command, "direction"))
    if task == "transport":
        return carrying_gait(lattice, layout, **_only(task, command, "direction"))
    if task == "reach":
        return reaching_gait(lattice, layout, **_only(task, command, "azimuth", "radius", "rise"))
    return peristalsis_gait(lattice, layout, **_only(task, command, "speed", "wavelength", "amplitude", "phase"))


def extension_gait(lattice: Lattice, layout: MuscleLayout) -> Gait:
    """Every ring muscle fully active: narrower rings make a longer body."""
    return _hold(np.where(_longitudinal(lattice, layout), 0.0, 1.0))


def compression_gait(lattice: Lattice, layout: MuscleLayout) -> Gait:
    """Every vertical muscle fully active."""
    return _hold(np.where(_longitudinal(lattice, layout), 1.0, 0.0))


def bending_gait(lattice: Lattice, layout: MuscleLayout, azimuth: float, sharpness: float = 2.0) -> Gait:
    """Shorten the side that faces the azimuth [rad] with vertical muscles, lengthen the other with ring muscles.

    Activation follows the cosine of the angle from the azimuth (rings: from its opposite) times the sharpness, up to 1.
    """
    _check(-MOST, azimuth=azimuth)
    _check(0.0, sharpness=sharpness)
    middle = _middle(lattice, layout)
    facing = np.cos(np.arctan2(middle[:, 1], middle[:, 0]) - azimuth)
    return _hold(sharpness * np.where(_longitudinal(lattice, layout), facing, -facing))


def reaching_gait(lattice: Lattice, layout: MuscleLayout, azimuth: float, radius: float, rise: float) -> Gait:
    """Hold a bend towards the azimuth [rad], and the verticals or the rings all round to lower or raise the top.

    Sharpness of the bend s = p radius + q radius^3, where the bend alone lowers the top by about 5.5 / 6.7 radius^2,
    and lengthening b = u rise + v radius^2; radius and rise in heights. Verticals take s cos + max(-b, 0), rings
    -s cos + max(b, 0), with the cosine of the angle from the azimuth.
    """
    _check(-MOST, azimuth=azimuth, rise=rise)
    _check(0.0, radius=radius)
    sharpness = REACH_SHARPNESS[0] * radius + REACH_SHARPNESS[1] * radius**3
    lengthening = REACH_LENGTHENING[0] * rise + REACH_LENGTHENING[1] * radius**2
    middle = _middle(lattice, layout)
    bend = sharpness * np.cos(np.arctan2(middle[:, 1], middle[:, 0]) - azimuth)
    shorten, lengthen = max(-lengthening, 0.0), max(lengthening, 0.0)
    return _hold(np.where(_longitudinal(lattice, layout), bend + shorten, lengthen - bend))


def crawling_gait(
    lattice: Lattice,
    layout: MuscleLayout,
    direction: float,
    frequency: float = CRAWL_FREQUENCY,
    wavelength: float = CRAWL_WAVELENGTH,
    ring_share: float = 1.0,
) -> Gait:
    """Rings and vertical muscles in antiphase, as a wave that runs along the body against the direction it crawls in.

    Where vertical muscles contract the body is thick and stands, where rings do it is thin and moves on, as in an
    earthworm. The direction is +1 towards the top end, -1 towards the base; the frequency in Hz, the wavelength in
    heights.
    """
    _check(-MOST, direction=direction)
    _check(LEAST, frequency=frequency, wavelength=wavelength)
    _check(0.0, ring_share=ring_share)
    if direction == 0.0:
        raise ValueError(f"direction = {direction!r}: must not be 0")
    longitudinal, height = _longitudinal(lattice, layout), _middle(lattice, layout)[:, 2]
    drive = 0.5 * np.where(longitudinal, 1.0, ring_share)
    return Gait(
        offset=drive,
        swing=np.where(longitudinal, drive, -drive),
        phase=TURN * height / (wavelength * lattice.design.height),
        frequency=-float(np.sign(direction)) * frequency,
    )


def carrying_gait(
    lattice: Lattice,
    layout: MuscleLayout,
    direction: float,
    frequency: float = CARRY_FREQUENCY,
    wavelength: float = CARRY_WAVELENGTH,
    vertical_share: float = CARRY_VERTICAL_SHARE,
    start: float = CARRY_START,
) -> Gait:
    """Rings that contract as a wave along the body in the commanded direction, with what they hold in its trough.

    Verticals contract in antiphase, where rings let go. The direction is +1 towards the top end, -1 towards the base;
    frequency in Hz, wavelength in heights; at time 0 a trough is at the height `start` [heights].
    """
    _check(-MOST, direction=direction, start=start)
    _check(LEAST, frequency=frequency, wavelength=wavelength)
    _check(0.0, vertical_share=vertical_share)
    if direction == 0.0:
        raise ValueError(f"direction = {direction!r}: must not be 0")
    longitudinal = _longitudinal(lattice, layout)
    above = _middle(lattice, layout)[:, 2] / lattice.design.height - start
    drive = 0.5 * np.where(longitudinal, vertical_share, 1.0)
    return Gait(
        offset=drive,
        swing=np.where(longitudinal, drive, -drive),
        phase=TURN * above / wavelength,
        frequency=float(np.sign(direction)) * frequency,
        lead=0.0,
    )


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
    _check(-MOST, speed=speed, phase=phase, lead=lead)
    _check(LEAST, wavelength=wavelength, amplitude=amplitude)
    _check(0.0, ring_share=ring_share, top_share=top_share)
    if speed == 0.0:
        raise ValueError(f"speed = {speed!r}: must not be 0, a wave that stands")
    longitudinal, height = _longitudinal(lattice, layout), _middle(lattice, layout)[:, 2]
    at_top = ~longitudinal & (height > lattice.design.height * (1.0 - 1e-9))
    share = np.where(longitudinal, 1.0, ring_share) * np.where(at_top, top_share, 1.0)
    drive = 0.5 * min(1.0, amplitude / FULL_DRIVE_AMPLITUDE) * share
    return Gait(
        offset=drive,
        swing=np.where(longitudinal, drive, -drive),
        phase=TURN * height / wavelength - phase,
        frequency=speed / wavelength,
        lead=lead,
    )


def grouped(command: FloatArray, groups: IntArray) -> FloatArray:
    """Turn commands of muscles into the action of an environment that drives groups: their means, shape (n_group,).

    `command` and `groups` have shape (n_muscle,), the latter as in `env.unwrapped.groups`.
    """
    if np.shape(command) != np.shape(groups) or np.ndim(groups) != 1:
        raise ValueError(f"command has shape {np.shape(command)}: must be one a muscle, {np.shape(groups)}")
    mean: FloatArray = np.bincount(groups, command) / np.bincount(groups)
    return mean


def _check(least: float, **values: object) -> None:
    """Refuse what is no number from `least` to MOST, by its name."""
    for name, value in values.items():
        if not is_number(value) or not least <= value <= MOST:
            raise ValueError(f"{name} = {shown(value)}: must be a number from {least:g} to {MOST:g}")


def _hold(offset: FloatArray) -> Gait:
    return Gait(offset=offset, swing=np.zeros_like(offset), phase=np.zeros_like(offset))


def _ends(lattice: Lattice, layout: MuscleLayout) -> tuple[FloatArray, FloatArray]:
    active = layout.active
    sites = np.array([(muscle.start, muscle.end) for muscle in active], dtype=np.int64).reshape(-1, 2)
    return lattice.site_position[sites[:, 0]], lattice.site_position[sites[:, 1]]


def _middle(lattice: Lattice, layout: MuscleLayout) -> FloatArray:
    """Rest position of every active muscle's middle [m], shape (n_muscle, 3)."""
    start, end = _ends(lattice, layout)
    return 0.5 * (start + end)


def _longitudinal(lattice: Lattice, layout: MuscleLayout) -> npt.NDArray[np.bool_]:
    """Mask of the active muscles that run along the body rather than around it, ones tied by hand included."""
    start, end = _ends(lattice, layout)
    along = end - start
    return np.asarray(np.abs(along[:, 2]) > np.hypot(along[:, 0], along[:, 1]))


def _only(task: str, command: Mapping[str, float], *names: str) -> dict[str, float]:
    if not isinstance(command, Mapping):
        raise ValueError(f"command = {shown(command)}: must be a mapping of names to numbers")
    missing = [name for name in names if name not in command]
    if missing:
        raise ValueError(f"command: {task} needs {', '.join(names)}; missing {', '.join(missing)}")
    return {name: command[name] for name in names}
