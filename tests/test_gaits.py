"""Gaits: which muscles pull when; what they earn is measured in test_tasks.py."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import MuscleLayout, control_groups, named_layout, tie
from lattice_gym.tasks.axial import AxialTask
from lattice_gym.tasks.bending import bending_gait
from lattice_gym.tasks.crawl import crawling_gait
from lattice_gym.tasks.gait import LEAD, Gait, group_means
from lattice_gym.tasks.peristalsis import FULL_DRIVE_AMPLITUDE, peristalsis_gait
from lattice_gym.tasks.registry import TASKS, gait
from lattice_gym.tasks.transport import carrying_gait

LATTICE = build_lattice(LatticeDesign())
ALL = named_layout("all", LATTICE)
VERTICAL = np.array([muscle.orientation == "vertical" for muscle in ALL.active])
MIDDLE = np.array([LATTICE.site_position[[m.start, m.end]].mean(axis=0) for m in ALL.active])
WAVE = {"speed": 0.1, "wavelength": 0.1, "amplitude": FULL_DRIVE_AMPLITUDE, "phase": 0.0}


@pytest.mark.parametrize(("task", "expected"), [("extension", ~VERTICAL), ("compression", VERTICAL)])
def test_length(task: str, expected: np.ndarray) -> None:
    """Rings lengthen, vertical muscles shorten, at any time."""
    for time in (0.0, 1.7):
        np.testing.assert_array_equal(gait(task, LATTICE, ALL, {})(time), expected)


@given(azimuth=st.floats(-10.0, 10.0))
def test_bending(azimuth: float) -> None:
    """Vertical muscles on the near side, rings on the far side, mirrored when the azimuth is turned half round."""
    command = gait("bending", LATTICE, ALL, {"azimuth": azimuth})(0.3)
    near = np.cos(np.arctan2(MIDDLE[:, 1], MIDDLE[:, 0]) - azimuth) > 0.0
    assert np.all(command[VERTICAL & ~near] == 0.0)
    assert np.all(command[~VERTICAL & near] == 0.0)
    assert command[VERTICAL & near].max() == 1.0
    opposite = bending_gait(LATTICE, ALL, azimuth + np.pi)(0.0)
    np.testing.assert_allclose(np.sort(opposite), np.sort(command), atol=1e-9)


@given(time=st.floats(0.0, 10.0), speed=st.sampled_from([-0.12, 0.08]), phase=st.floats(-6.0, 6.0))
def test_peristalsis_is_an_antiphase_wave(time: float, speed: float, phase: float) -> None:
    """Rings pull where the commanded wave, a lead ahead, is narrow, vertical muscles where it is wide."""
    command = peristalsis_gait(LATTICE, ALL, speed, 0.12, FULL_DRIVE_AMPLITUDE, phase, ring_share=1.0, top_share=1.0)
    wide = 0.5 + 0.5 * np.cos(2 * np.pi * (speed * (time + LEAD) - MIDDLE[:, 2]) / 0.12 + phase)
    np.testing.assert_allclose(command(time), np.where(VERTICAL, wide, 1.0 - wide), atol=1e-9)


def test_peristalsis_moves_up() -> None:
    """A quarter period later the pattern stands a quarter wavelength higher; half the amplitude is half the drive."""
    wave = gait("peristalsis", LATTICE, ALL, WAVE)
    for time in np.linspace(0.0, 1.0, 7):
        now, later = wave(time)[VERTICAL], wave(time + 0.25)[VERTICAL]
        height = MIDDLE[VERTICAL, 2]
        for low in np.unique(height)[:-2]:
            high = np.isclose(height, low + 0.025)
            np.testing.assert_allclose(later[high], now[height == low][0], atol=1e-9)
    half = gait("peristalsis", LATTICE, ALL, WAVE | {"amplitude": FULL_DRIVE_AMPLITUDE / 2})
    np.testing.assert_allclose(half(0.4), wave(0.4) / 2)


@given(
    task=st.sampled_from(list(TASKS)),
    layout=st.sampled_from(["extension", "compression", "bending", "all"]),
    time=st.floats(0.0, 1e4),
    amplitude=st.floats(0.001, 0.5),
)
def test_commands_are_activations(task: str, layout: str, time: float, amplitude: float) -> None:
    """Any gait on any layout stays within [0, 1], one command a muscle."""
    muscles = named_layout(layout, LATTICE)
    given = WAVE | {"azimuth": 1.0, "radius": 0.1, "rise": -0.1, "direction": -1.0, "amplitude": amplitude}
    command = gait(task, LATTICE, muscles, given)(time)
    assert command.shape == (len(muscles),)
    assert command.min() >= 0.0
    assert command.max() <= 1.0


def test_muscles_tied_by_hand() -> None:
    """They count by the way they run; those switched off get no command."""
    steep, flat = (0, int(np.flatnonzero(LATTICE.site_level == 2)[0])), (6, 8)
    layout = tie(LATTICE, [steep, flat])
    assert gait("compression", LATTICE, layout, {})(0.0).tolist() == [1.0, 0.0]
    assert gait("compression", LATTICE, layout.switched([False, True]), {})(0.0).tolist() == [0.0]
    assert gait("bending", LATTICE, MuscleLayout(()), {"azimuth": 0.0})(0.0).shape == (0,)


@pytest.mark.parametrize("control", ["muscle", "ring", "column"])
def test_grouped(control: str) -> None:
    """Means of groups; a wave along the body is alike within a ring, so nothing is lost."""
    groups = control_groups(control, ALL, LATTICE)
    command = gait("peristalsis", LATTICE, ALL, WAVE)(0.3)
    action = group_means(command, groups)
    assert action.shape == (groups.max() + 1,)
    assert action[3] == pytest.approx(command[groups == 3].mean())
    if control != "column":
        np.testing.assert_allclose(action[groups], command)


@pytest.mark.parametrize(
    ("task", "command", "message"),
    [
        ("swimming", {}, r"^task = 'swimming': must be one of extension, compression"),
        ("bending", {}, r"^command: bending needs azimuth; missing azimuth"),
        ("peristalsis", {"speed": 0.1, "phase": 0.0}, r"missing wavelength, amplitude"),
    ],
)
def test_wrong_arguments(task: str, command: Mapping[str, float], message: str) -> None:
    """The error names what is wrong."""
    with pytest.raises(ValueError, match=message):
        gait(task, LATTICE, ALL, command)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 10**400, "x", None, True])
@pytest.mark.parametrize("name", ["speed", "wavelength", "amplitude", "phase", "azimuth", "time", "lead", "ring_share",
                                  "top_share", "sharpness", "radius", "rise", "direction",
                                  "frequency", "vertical_share", "start"])  # fmt: skip
def test_numbers_must_be_finite(name: str, value: Any) -> None:
    """The error names the field, and nothing becomes NaN."""
    calls: dict[str, Callable[[], object]] = {
        "time": lambda: gait("extension", LATTICE, ALL, {})(value),
        "azimuth": lambda: gait("bending", LATTICE, ALL, {"azimuth": value}),
        "sharpness": lambda: bending_gait(LATTICE, ALL, 1.0, value),
        "radius": lambda: gait("reach", LATTICE, ALL, {"azimuth": 0.0, "radius": value, "rise": 0.0}),
        "direction": lambda: gait("crawl", LATTICE, ALL, {"direction": value}),
        "vertical_share": lambda: carrying_gait(LATTICE, ALL, 1.0, vertical_share=value),
        "start": lambda: carrying_gait(LATTICE, ALL, 1.0, start=value),
        "frequency": lambda: crawling_gait(LATTICE, ALL, 1.0, frequency=value),
        "rise": lambda: gait("reach", LATTICE, ALL, {"azimuth": 0.0, "radius": 0.1, "rise": value}),
    }
    with pytest.raises(ValueError, match=rf"^(Gait\.)?{name} = "):
        calls.get(name, lambda: peristalsis_gait(LATTICE, ALL, **(WAVE | {name: value})))()


@pytest.mark.parametrize("name", ["speed", "wavelength", "amplitude"])
def test_waves_need_a_speed_a_length_and_an_amplitude(name: str) -> None:
    """None may be 0."""
    with pytest.raises(ValueError, match=r"^direction = 0"):
        gait("crawl", LATTICE, ALL, {"direction": 0.0})
    with pytest.raises(ValueError, match=r"^direction = 0"):
        gait("transport", LATTICE, ALL, {"direction": 0.0})
    with pytest.raises(ValueError, match=rf"^{name} = 0"):
        gait("peristalsis", LATTICE, ALL, WAVE | {name: 0.0})


def test_gaits_made_by_hand_must_be_finite() -> None:
    """Arrays and numbers alike."""
    one = np.ones(3)
    with pytest.raises(ValueError, match=r"^Gait\.swing\[0\] = nan"):
        Gait(offset=one, swing=one * np.nan, phase=one)
    with pytest.raises(ValueError, match=r"^Gait\.frequency = nan"):
        Gait(offset=one, swing=one, phase=one, frequency=float("nan"))


def test_a_task_without_a_gait() -> None:
    """The error says so."""

    class Still(AxialTask):
        """Nothing made by hand."""

        name = "still"
        sign = 1.0

    with pytest.raises(ValueError, match=r"^task = .*Still'>: still has no gait"):
        gait(Still, LATTICE, ALL, {})


def test_grouped_needs_one_command_a_muscle() -> None:
    """Shapes must agree."""
    with pytest.raises(ValueError, match=r"^command has shape \(3,\)"):
        group_means(np.zeros(3), np.zeros(4, dtype=np.int64))
