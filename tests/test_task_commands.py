"""Commands of tasks: their bounds, how they are drawn, fixed, listed and refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from task_scenes import LATTICE, REST, observed

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.tasks.base import Task
from lattice_gym.tasks.registry import TASKS

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("height", [0.1, 0.03, 0.07, 0.11, 0.3, 0.7, 1.3])
def test_bounds_of_commands_are_reached(height: float) -> None:
    """Each may be given exactly as documented, however its arithmetic rounds; a thousandth beyond is refused."""
    lattice = build_lattice(LatticeDesign(height=height, diameter=0.75 * height, structure_radius=0.05 * height))
    spacing = float(lattice.level_height[1] - lattice.level_height[0])
    still, long = {"speed": height}, {"wavelength": 10 * height}
    for name, value, outwards, rest in (
        ("speed", 0.1 * height, 0.999, {}),
        ("speed", height / 10, 0.999, {}),
        ("speed", -0.1 * height, 0.999, {}),
        ("speed", 10 * height, 1.001, long),
        ("speed", -height / 0.1, 1.001, long),
        ("wavelength", 3 * spacing, 0.999, still),
        ("wavelength", 3 * height / 8, 0.999, still),
        ("wavelength", 0.375 * height, 0.999, still),
        ("wavelength", height / 0.1, 1.001, {}),
        ("amplitude", 0.001, 0.999, {}),
        ("amplitude", 0.5, 1.001, {}),
        ("phase", 2 * np.pi, 1.001, {}),
        ("phase", -2 * np.pi, 1.001, {}),
    ):
        task = TASKS["peristalsis"](lattice, 0.05, rest | {name: value})
        task.begin(np.random.default_rng(0), {name: value})
        assert np.all(np.abs(observed(task, REST, 0.0).astype(np.float32)) <= np.array(task.bounds, dtype=np.float32))
        with pytest.raises(ValueError, match=rf"^command\['{name}'\]"):
            TASKS["peristalsis"](lattice, 0.05, rest | {name: outwards * value})
    for azimuth in (2 * np.pi, -2 * np.pi):
        task = TASKS["bending"](lattice, 0.05, {"azimuth": azimuth})
        task.begin(np.random.default_rng(0), {})
        assert task.command == {"azimuth": azimuth}


@pytest.mark.parametrize("command", [{"speed": 0.01, "wavelength": 0.1}, {"wavelength": 0.0375, "speed": 0.1}])
def test_bounds_of_the_default_design(command: dict[str, float]) -> None:
    """A tenth of a height a second, and three level spacings."""
    task = TASKS["peristalsis"](LATTICE, 0.05, command)
    task.begin(np.random.default_rng(0), {})
    assert {name: task.command[name] for name in command} == command


def test_commands_are_drawn_within_their_ranges(task: Task) -> None:
    """Seeded, and spread over the range."""
    drawn = []
    for seed in range(50):
        task.begin(np.random.default_rng(seed), {})
        drawn.append(task.command)
    for name, bounds in task.commands.items():
        values = [command[name] for command in drawn]
        assert bounds.minimum <= bounds.low <= min(values) < max(values) <= bounds.high <= bounds.maximum
        assert max(values) - min(values) > 0.8 * (bounds.high - bounds.low)
    task.begin(np.random.default_rng(7), None)
    assert task.command == drawn[7]


def test_lists_are_drawn_from() -> None:
    """Every number of them, and nothing else; the others stay as they were."""
    free, few = TASKS["bending"](LATTICE, 0.05), TASKS["bending"](LATTICE, 0.05, {"azimuth": [0.0, 1.0, 2.0]})
    drawn = []
    for seed in range(30):
        few.begin(np.random.default_rng(seed), None)
        drawn.append(few.command["azimuth"])
        free.begin(np.random.default_rng(seed), {"azimuth": (4.0,)})
        assert free.command == {"azimuth": 4.0}
    assert set(drawn) == {0.0, 1.0, 2.0}
    hostile: list[Any] = [[], [0.0, 7.0], [[0.0]], ["north"]]
    for wrong in hostile:
        with pytest.raises(ValueError, match=r"^command\['azimuth'\](\[[01]\])? = "):
            TASKS["bending"](LATTICE, 0.05, {"azimuth": wrong})
    with pytest.raises(ValueError, match=r"^command: .*4 control steps"):
        TASKS["peristalsis"](LATTICE, 0.05, {"speed": [0.1, 0.9]})


def test_fixed_commands_leave_the_others_alone() -> None:
    """The constructor fixes for good, options for one episode, and what is drawn does not shift."""
    free, held = TASKS["peristalsis"](LATTICE, 0.05), TASKS["peristalsis"](LATTICE, 0.05, {"speed": -0.09})
    for task in (free, held):
        task.begin(np.random.default_rng(3), {"wavelength": 0.11})
    assert held.command == free.command | {"speed": -0.09, "wavelength": 0.11}
    held.begin(np.random.default_rng(3), {"speed": 0.1})
    assert held.command["speed"] == 0.1
    held.begin(np.random.default_rng(3), None)
    assert held.command["speed"] == -0.09
    assert held.command["wavelength"] != 0.11


@pytest.mark.parametrize(
    ("name", "command", "message"),
    [
        ("extension", {"azimuth": 0.0}, r"^command: there is no 'azimuth'; there are none"),
        ("bending", {"speed": 0.1}, r"^command: there is no 'speed'; there are azimuth"),
        ("bending", {"azimuth": 7.0}, r"^command\['azimuth'\] = 7.0: must be a number from -6.28"),
        ("bending", {"azimuth": 10**400}, r"^command\['azimuth'\]"),
        ("bending", {"azimuth": True}, r"^command\['azimuth'\] = True"),
        ("bending", {"azimuth": "north"}, r"^command\['azimuth'\] = 'north'"),
        ("bending", [0.0], r"^command = \[0.0\]: must be a mapping"),
        ("peristalsis", {"speed": 0.0}, r"^command\['speed'\] = 0: at least 0.01"),
        ("peristalsis", {"speed": float("nan")}, r"^command\['speed'\] = nan"),
        ("peristalsis", {"speed": 1.0}, r"^command: .* 4 control steps"),
        ("peristalsis", {"wavelength": 0.03}, r"^command\['wavelength'\] = 0.03: must be a number from 0.0375"),
        ("peristalsis", {"amplitude": -0.1}, r"^command\['amplitude'\]"),
    ],
)
def test_wrong_commands(name: str, command: Any, message: str) -> None:
    """At construction and, under its other name, at reset; a refused reset leaves the task as it was."""
    with pytest.raises(ValueError, match=message):
        TASKS[name](LATTICE, 0.05, command)
    task = TASKS[name](LATTICE, 0.05)
    before = dict(task.command)
    with pytest.raises(ValueError, match=message.replace("command", "options", 1)):
        task.begin(np.random.default_rng(0), command)
    assert task.command == before


@pytest.mark.parametrize(
    ("name", "design", "message"),
    [
        ("bending", LatticeDesign(n_pairs=2, period_ratio=1.0), r"^lattice: 2 sites at the top span no plane"),
        ("peristalsis", LatticeDesign(n_pairs=2, period_ratio=2.0), r"^design: peristalsis needs at least 3 levels"),
        (
            "extension",
            LatticeDesign(n_pairs=2, period_ratio=1.0, base="free"),
            r"^lattice: 2 sites at the bottom span no plane",
        ),
        (
            "peristalsis",
            LatticeDesign(phases=(0.0, 0.9, 2.0, 3.1, 4.3, 5.2) * 2, period_ratio=1.0),
            r"^design: peristalsis needs at least 3 levels .* got 0",
        ),
    ],
)
def test_lattices_that_cannot(name: str, design: LatticeDesign, message: str) -> None:
    """The error says what the lattice lacks."""
    with pytest.raises(ValueError, match=message):
        TASKS[name](build_lattice(design), 0.05)
