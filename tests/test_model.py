"""RodModel: constants of a rod, refused input, the lattice's assembly, and the predicted stable step."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lattice_gym.design import LatticeDesign
from lattice_gym.engines import make_engine
from lattice_gym.lattice import Lattice, build_lattice
from lattice_gym.model import (
    Clamp,
    Joint,
    PointForce,
    PointTorque,
    Rod,
    RodModel,
    build_model,
    default_dt,
    rotation_between,
    stable_dt,
    straight_frames,
    straight_rod,
)
from lattice_gym.muscles import named_layout

STEEL: dict[str, Any] = {"radius": 0.05, "density": 1000.0, "youngs_modulus": 1e6, "shear_modulus": 4e5}


def rod(**changes: object) -> Rod:
    """Build a rod of three elements, with changes."""
    position = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.2], [0.1, 0.1, 0.4], [0.0, 0.1, 0.7]])
    values: dict[str, Any] = {"position": position, "directors": straight_frames(position, (0.0, 1.0, 0.0)), **STEEL}
    return Rod(**(values | changes))


def test_constants_of_a_rod() -> None:
    """Mass, volume and stiffness add up to those of the body."""
    made = rod()
    volume = np.pi * 0.05**2 * made.rest_length.sum()
    assert made.mass.sum() == pytest.approx(1000.0 * volume)
    assert made.inertia.sum() == pytest.approx(1000.0 * volume * 0.05**2 / 4.0)
    assert made.bend_stiffness == pytest.approx(1e6 * np.pi / 4.0 * 0.05**4)
    assert made.twist_stiffness == pytest.approx(2.0 * 4e5 * np.pi / 4.0 * 0.05**4)
    assert made.shear_stiffness == pytest.approx(27.0 / 28.0 * 4e5 * np.pi * 0.05**2)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"position": np.zeros((2, 3))}, "position"),
        ({"position": np.zeros((4, 3))}, "position"),
        ({"position": np.full((4, 3), np.nan)}, "position"),
        ({"directors": np.zeros((3, 3, 3))}, "directors"),
        ({"directors": np.tile(np.eye(3), (3, 1, 1))}, "directors"),
        ({"radius": [0.1, 0.1]}, "radius"),
        ({"radius": -0.1}, "radius"),
        ({"radius": "thick"}, "radius"),
        ({"density": 0.0}, "density"),
        ({"youngs_modulus": np.inf}, "youngs_modulus"),
        ({"shear_modulus": -1.0}, "shear_modulus"),
        ({"damping": -1.0}, "damping"),
        ({"rotational_damping": np.nan}, "rotational_damping"),
    ],
)
def test_refused_rods(change: dict[str, object], name: str) -> None:
    """The error names the property."""
    with pytest.raises(ValueError, match=rf"Rod\.{name}"):
        rod(**change)


@pytest.mark.parametrize(
    ("part", "name"),
    [
        ({"rods": ()}, "rods"),
        ({"joints": (Joint(0, 0, 2, 0, 1.0),)}, r"joints\[0\]"),
        ({"joints": (Joint(0, 4, 1, 0, 1.0),)}, r"joints\[0\]"),
        ({"joints": (Joint(0, -1, 1, 0, 1.0),)}, r"joints\[0\]"),
        ({"joints": (Joint(0, 1, 0, 1, 1.0),)}, r"joints\[0\]"),
        ({"joints": (Joint(0, 1, 1, 1, -1.0),)}, r"joints\[0\].stiffness"),
        ({"joints": (Joint(0, 1, 1, 1, 1.0, np.nan),)}, r"joints\[0\].damping"),
        ({"clamps": (Clamp(0, node=0), Clamp(1, element=3))}, r"clamps\[1\]"),
        ({"forces": (PointForce(1, 0, (np.nan, 0.0, 0.0)),)}, r"forces\[0\]"),
        ({"torques": (PointTorque(1, 3, (0.0, 0.0, 0.0)),)}, r"torques\[0\]"),
        ({"joints": (Joint(0, cast(int, 1.7), 1, 0, 1.0),)}, r"joints\[0\]"),
        ({"clamps": (Clamp(0),)}, r"clamps\[0\]"),
        ({"muscles": (1, 1)}, "muscles"),
        ({"muscles": (5,)}, r"muscles\[0\]"),
    ],
)
def test_refused_assemblies(part: dict[str, Any], name: str) -> None:
    """The error names the part."""
    with pytest.raises(ValueError, match=name):
        RodModel(**({"rods": (rod(), rod())} | part))


def test_refused_straight_rods() -> None:
    """Length and element count are checked before anything is built."""
    with pytest.raises(ValueError, match="end"):
        straight_rod((0, 0, 0), (0, 0, 0), 3, **STEEL)
    with pytest.raises(ValueError, match="n_elem"):
        straight_rod((0, 0, 0), (0, 0, 1), 1, **STEEL)
    with pytest.raises(ValueError, match="normal"):
        straight_rod((0, 0, 0), (0, 0, 1), 3, normal=(0, 0, 2), **STEEL)


@settings(deadline=None, max_examples=100)
@given(st.lists(st.floats(-1.7, 1.7), min_size=3, max_size=3))
def test_rotation_between_undoes_rodrigues(vector: list[float]) -> None:
    """The rotation vector comes back from the frame it made, up to its sign convention, below half a turn."""
    v = np.array(vector)
    angle = np.linalg.norm(v)
    k = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    turn = np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2 * k @ k
    start = straight_frames(np.array([[0.0, 0.0, 0.0], [0.3, 0.2, 0.9]]), (1.0, 0.0, 0.0))
    recovered = rotation_between(start, turn.T[None] @ start)[0]
    assert recovered == pytest.approx(v, abs=1e-12)


def test_the_lattice_model(lattice: Lattice) -> None:
    """Twelve structure rods, then muscles between their sites; two ties a muscle, one joint a site, closed at rest."""
    layout = named_layout("all", lattice)
    model = build_model(lattice, layout)
    assert model.n_rod == 12 + 90
    assert model.n_muscle == 90
    assert len(model.joints) == 54 + 180
    assert model.n_node == 12 * 41 + 90 * 3
    rest = model.rest_state().position
    for joint in model.joints:
        a, b = rest[model.nodes(joint.rod_a)][joint.node_a], rest[model.nodes(joint.rod_b)][joint.node_b]
        assert np.abs(a - b).max() < 1e-13
    for muscle, index in zip(layout.active, model.muscles, strict=True):
        ends = model.rods[index].position[[0, -1]]
        assert ends == pytest.approx(lattice.site_position[[muscle.start, muscle.end]], abs=1e-15)
    assert len(model.clamps) == 12
    free = build_lattice(LatticeDesign(base="free"))
    assert build_model(free, named_layout("extension", free)).clamps == ()


def test_every_parameter_reaches_the_model() -> None:
    """A design with no two parameters alike: each rod and joint has its own."""
    design = LatticeDesign(
        structure_radius=4e-3,
        structure_density=1001.0,
        structure_youngs_modulus=5e4,
        structure_poisson_ratio=0.4,
        muscle_radius=3e-3,
        muscle_density=1002.0,
        muscle_youngs_modulus=2e4,
        muscle_poisson_ratio=0.3,
        elements_per_muscle=3,
        joint_stiffness=90.0,
        joint_damping=0.01,
        damping=0.02,
        rotational_damping=1e-8,
    )
    lattice = build_lattice(design)
    model = build_model(lattice, named_layout("all", lattice))
    assert {(joint.stiffness, joint.damping) for joint in model.joints} == {(90.0, 0.01)}
    for index, made in enumerate(model.rods):
        structure = index < 12
        assert made.n_elem == (40 if structure else 3)
        assert set(made.radius) == {4e-3 if structure else 3e-3}
        assert made.density == (1001.0 if structure else 1002.0)
        assert made.youngs_modulus == (5e4 if structure else 2e4)
        assert made.shear_modulus == pytest.approx(5e4 / 2.8 if structure else 2e4 / 2.6)
        assert (made.damping, made.rotational_damping) == (0.02, 1e-8)


def holds_still(model: RodModel, dt: float) -> bool:
    """Whether 2,000 steps from a slightly shaken rest stay finite and small."""
    engine = make_engine("fused", model, dt)
    rest = model.rest_state()
    shake = 1e-6 * np.random.default_rng(0).standard_normal(rest.velocity.shape)
    for clamp in model.clamps:
        shake[model.nodes(clamp.rod)][clamp.node or 0] = 0.0
    engine.restore(replace(rest, velocity=shake))
    return engine.advance(np.zeros(model.n_muscle), 2000).ok and bool(np.abs(engine.state.velocity).max() < 1e-3)


def measured_dt(model: RodModel) -> float:
    """Largest step that holds still, by bisection to 1 %."""
    low, high = 0.2 * stable_dt(model), 4.0 * stable_dt(model)
    while high / low > 1.01:
        middle = np.sqrt(low * high)
        low, high = (middle, high) if holds_still(model, middle) else (low, middle)
    return low


@pytest.mark.parametrize(("n_elem", "radius"), [(4, 0.05), (20, 0.05), (20, 0.005), (10, 0.2)])
def test_stable_step_of_a_straight_rod(n_elem: int, radius: float) -> None:
    """The prediction is not above the measured limit (known to 1 %) and within a tenth of it."""
    made = straight_rod((0, 0, 0), (0, 0, 1), n_elem, **(STEEL | {"radius": radius}))
    model = RodModel(rods=(made,))
    assert 0.9 < stable_dt(model) / measured_dt(model) < 1.01


@pytest.mark.parametrize("radii", [[0.05] * 5 + [0.01] * 5, [0.05] * 9 + [0.005], [0.05, 0.01] + [0.05] * 8])
def test_stable_step_of_a_rod_of_varying_radius(radii: list[float]) -> None:
    """A stiff region beside a light element decides; the prediction stays below the measured limit."""
    position = np.linspace(0.0, 1.0, 11)[:, None] * [0.0, 0.0, 1.0]
    made = rod(position=position, directors=straight_frames(position, (0.0, 1.0, 0.0)), radius=radii)
    model = RodModel(rods=(made,))
    assert 0.6 < stable_dt(model) / measured_dt(model) < 1.01


def test_stable_step_of_joints_and_dashpots() -> None:
    """Two nodes on a stiff spring: 2 / sqrt(2 k / m); a lagged dashpot lowers it."""
    made = straight_rod((0, 0, 0), (0, 0, 1), 2, **(STEEL | {"youngs_modulus": 1.0, "shear_modulus": 1.0}))
    for damping in (0.0, 300.0):
        model = RodModel(rods=(made, made), joints=(Joint(0, 0, 1, 0, 1e6, damping),))
        assert 0.95 < stable_dt(model) / measured_dt(model) < 1.01
    undamped = RodModel(rods=(made, made), joints=(Joint(0, 0, 1, 0, 1e6),))
    assert stable_dt(undamped) == pytest.approx(2.0 / np.sqrt(2e6 / made.mass[0]), rel=1e-3)


def test_stable_step_of_the_lattice(lattice: Lattice) -> None:
    """At rest the prediction is a lower bound within a third; the default step divides the control period below it."""
    model = build_model(lattice, named_layout("all", lattice))
    assert 0.66 < stable_dt(model) / measured_dt(model) < 1.0
    dt = default_dt(model, 0.05)
    assert dt <= 0.5 * stable_dt(model)
    assert 0.05 / dt == pytest.approx(round(0.05 / dt), abs=1e-9)
