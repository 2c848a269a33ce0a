"""What is legal, and costs or changes more than one would think, is told with its figures."""

from __future__ import annotations

import re
import warnings
from typing import Any

import gymnasium
import pytest

from lattice_gym import LatticeDesign
from lattice_gym.checks import TAU
from lattice_gym.envs.pitfalls import WORTH_A_WARNING

HILL = {"max_speed": 10.0}


def warned(*, batch: bool = False, **arguments: Any) -> list[str]:
    """Texts of the warnings when an environment, or two at once, are made."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        if batch:
            gymnasium.make_vec("LatticeWormExtension-v0", num_envs=2, **arguments).close()
        else:
            gymnasium.make("LatticeWormExtension-v0", **arguments).close()
    return [str(warning.message) for warning in caught]


@pytest.mark.parametrize("batch", [False, True], ids=["one", "batch"])
def test_an_option_that_shortens_the_step(batch: bool) -> None:
    """It is named, with the step, the step without it, and their ratio; what shortens it less is not."""
    (text,) = warned(batch=batch, hill=HILL, adaptation={}, randomise={"max_tension": (0.9, 1.1)})
    assert text.startswith("hill: ")
    short, ordinary, ratio = (float(number) for number in re.findall(r"[\d.]+(?:e-\d+)?(?= s|(?= times))", text))
    assert ratio == pytest.approx(ordinary / short, rel=0.02)
    assert ratio > WORTH_A_WARNING


def test_a_field_of_the_design_that_shortens_the_step() -> None:
    """The one of all changed fields that does it; the rest of the design stays."""
    (text,) = warned(design={"height": 0.11, "joint_stiffness": 1e6})
    assert text.startswith("design.joint_stiffness = 1000000.0: ")


def test_what_cannot_be_left_out_is_passed_over() -> None:
    """A field that other fields need: without it the design could not be built."""
    design = LatticeDesign(n_pairs=3, phases=(0.0, TAU / 3, TAU * 2 / 3) * 2, period_ratio=1.0, joint_stiffness=1e6)
    assert [text.split(" = ")[0] for text in warned(design=design)] == ["design.joint_stiffness"]


def test_who_sets_the_step_is_not_told() -> None:
    """Nor of the tasks' own scenes at any fidelity."""
    assert warned(hill=HILL, dt=5e-6) == []
    assert [text for fidelity in ("fast", "default", "fine") for text in warned(fidelity=fidelity)] == []


def test_joints_left_soft_beside_stiff_rods() -> None:
    """A lattice of 1.5 MPa on the springs of one of 70 kPa; with its proportion kept, nothing is said."""
    (text,) = warned(design={"structure_youngs_modulus": 1.5e6})
    assert "21 times" in text
    assert "2.14e+03 N/m" in text
    assert warned(design={"structure_youngs_modulus": 1.5e6, "joint_stiffness": 2143.0}) == []
