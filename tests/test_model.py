"""RodModel: constants of a rod, refused input and the lattice's assembly."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.joints import Joint
from lattice_gym.physics.laws.lines import Line
from lattice_gym.physics.laws.loads import PointForce, PointTorque
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.rod import Rod, rotation_between, straight_frames, straight_rod
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model

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
        ({"joints": (Joint(0, 1, 0, 1, 1.0),)}, r"joints\[0\]"),
        ({"clamps": (Clamp(0, node=0), Clamp(1, element=3))}, r"clamps\[1\]"),
        ({"torques": (PointTorque(1, 3, (0.0, 0.0, 0.0)),)}, r"torques\[0\]"),
        ({"muscles": (1, 1)}, "muscles"),
        ({"lines": (Line(0, 0, 1, 9, 1.0, 1.0),)}, r"lines\[0\]"),
        ({"lines": (Line(0, 0, 1, 1, 1.0, 1.0), Line(0, 0, 0, 0, 1.0, 1.0))}, r"lines\[1\]: .* at one place"),
        ({"lines": (Line(0, 2, 1, 2, 1.0, 1.0),)}, r"lines\[0\]: .* at one place"),
        ({"muscles": (5,)}, r"muscles\[0\]"),
        ({"gravity": (0.0, -9.81)}, "gravity"),
        ({"gravity": (0.0, np.nan, 0.0)}, "gravity"),
        ({"gravity": (0.0, 0.0, 1e308), "medium_density": 1e9}, "gravity, medium_density"),
        ({"medium_density": -1.0}, "medium_density"),
        ({"medium_drag": np.inf}, "medium_drag"),
        ({"ground": {"stiffness": 1.0}}, "ground"),
    ],
)
def test_refused_assemblies(part: dict[str, Any], name: str) -> None:
    """The error names the part."""
    with pytest.raises(ValueError, match=name):
        RodModel(**({"rods": (rod(), rod())} | part))


@pytest.mark.parametrize(
    ("kind", "given", "name"),
    [
        (Joint, (0, -1, 1, 0, 1.0), "Joint.node_a"),
        (Joint, (0, 1.7, 1, 0, 1.0), "Joint.node_a"),
        (Joint, (0, 1, 1, 1, -1.0), "Joint.stiffness"),
        (Joint, (0, 1, 1, 1, 1.0, np.nan), "Joint.damping"),
        (PointForce, (1, 0, (np.nan, 0.0, 0.0)), "PointForce.force"),
        (PointTorque, (1, 0, (0.0, 0.0)), "PointTorque.torque"),
        (Clamp, (0,), "Clamp: needs"),
        (Line, (0, 0, 1, 1, 0.0, 1.0), "Line.rest_length"),
        (Line, (0, 0, 1, 1, 1e-9, 1e300), "Line.rest_length"),
        (Line, (0, 0, 1, 1, 1.0, 1.0, np.nan), "Line.mass"),
        (Line, (0, 0, 1, 1, 1.0, 1.0, 0.0, 0.0, 0.0), "Line.density"),
    ],
)
def test_refused_parts(kind: type, given: tuple[Any, ...], name: str) -> None:
    """What is wrong without an assembly is refused where the part is made."""
    with pytest.raises(ValueError, match=name):
        kind(*given)


def test_indices_are_whole() -> None:
    """An index that was given as a float is kept as an int."""
    model = RodModel(rods=(rod(), rod()), joints=(Joint(0, cast(int, 3.0), 1, 0, 1.0),), muscles=(cast(int, 1.0),))
    assert [type(index) for index in (model.joints[0].node_a, model.muscles[0])] == [int, int]


@pytest.mark.parametrize("shift", [1e-15, 1e-200])
def test_lines_between_places_that_rounding_parts(shift: float) -> None:
    """Nodes so close that their direction is lost make no line either."""
    near = replace(rod(), position=rod().position + np.array([0.0, 0.0, shift]))
    with pytest.raises(ValueError, match=r"lines\[0\]: .* at one place"):
        RodModel(rods=(rod(), near), lines=(Line(0, 0, 1, 0, 1.0, 1.0),))


def test_tie_nodes() -> None:
    """Rows of nodes over all rods, for joints and for lines, or for none."""
    joints = (Joint(0, 3, 1, 0, 1.0), Joint(1, 2, 0, 1, 1.0))
    model = RodModel(rods=(rod(), rod()), joints=joints, lines=(Line(1, 1, 0, 0, 1.0, 1.0),))
    for ties, ends in ((model.joints, ([3, 6], [4, 1])), (model.lines, ([5], [0])), ((), ([], []))):
        found = model.tie_nodes(ties)
        assert tuple(rows.tolist() for rows in found) == ends
        assert {rows.dtype for rows in found} == {np.dtype(np.int64)}


def test_refused_states() -> None:
    """Frames must be right-handed, not just orthonormal."""
    model = RodModel(rods=(rod(), rod()))
    state = model.rest_state()
    state.check(model)
    mirrored = state.directors.copy()
    mirrored[4, 0] *= -1.0
    with pytest.raises(ValueError, match=r"RodState\.directors: must be right-handed"):
        replace(state, directors=mirrored).check(model)


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


def test_muscles_as_lines_keep_mass_and_damping() -> None:
    """The same body with muscles as lines: no nodes of theirs, but their mass and drag on the crossings."""
    models = []
    for kind in ("rod", "line"):
        lattice = build_lattice(LatticeDesign(muscle_model=kind))
        models.append(build_model(lattice, named_layout("all", lattice)))
    rods, lines = models
    assert (lines.n_rod, lines.n_muscle, len(lines.joints)) == (12, 90, 54)
    assert lines.node_mass.sum() == pytest.approx(rods.node_mass.sum(), rel=1e-12)
    assert lines.node_damping.sum() == pytest.approx(rods.node_damping.sum(), rel=1e-12)


@pytest.mark.parametrize("kind", ["rod", "line"])
def test_a_world_around_the_lattice(kind: str) -> None:
    """Weight less what the medium carries, drag by length, and the axis laid along x with the lowest surface at 0."""
    lattice = build_lattice(LatticeDesign(base="free", muscle_model=kind, muscle_radius=3e-3, structure_radius=4e-3))
    layout = named_layout("all", lattice)
    plain = build_model(lattice, layout)
    ground = Ground(stiffness=7.0)
    world = World(medium=Medium(gravity=3.0, density=900.0, drag=0.2), ground=ground, lying=True)
    model = build_model(lattice, layout, world)
    assert model.ground == ground
    assert plain.ground is None
    assert plain.gravity is None
    assert not plain.node_weight.any()
    structure, muscles = model.rods[: lattice.n_rod], build_model(lattice, layout).rods[lattice.n_rod :]
    volume = sum(float((rod.area * rod.rest_length).sum()) for rod in structure)
    length = sum(float(rod.rest_length.sum()) for rod in structure)
    for k, muscle in enumerate(layout.active):
        apart = lattice.site_position[muscle.end] - lattice.site_position[muscle.start]
        length += (own := float(np.linalg.norm(apart)))
        volume += own * np.pi * 3e-3**2
        assert kind == "line" or muscles[k].rest_length.sum() == pytest.approx(own)
    weight = 3.0 * (model.node_mass.sum() - 900.0 * volume)
    np.testing.assert_allclose(model.node_weight.sum(axis=0), [0.0, 0.0, -weight], rtol=1e-12)
    added = model.node_damping - plain.node_damping
    assert added.sum() == pytest.approx(0.2 * length)
    assert added[1] == pytest.approx(0.2 * structure[0].rest_length[0], rel=1e-9) or kind == "line"
    rest, upright = model.rest_state(), plain.rest_state()
    np.testing.assert_allclose(rest.position[:, 0], upright.position[:, 2], atol=1e-15)
    np.testing.assert_allclose(rest.position[:, 1], upright.position[:, 1], atol=1e-15)
    assert (rest.position[:, 2] - model.node_radius).min() == pytest.approx(0.0, abs=1e-15)
    assert np.ptp(rest.position[:, 2]) == pytest.approx(np.ptp(upright.position[:, 0]))
    rest.check(model)
    for laid, stood in zip(model.rods, plain.rods, strict=True):
        np.testing.assert_allclose(laid.rest_kappa, stood.rest_kappa, rtol=1e-9, atol=1e-12)


def test_lines_hold_no_ball() -> None:
    """They touch nothing: a ball would pass through them."""
    lattice = build_lattice(LatticeDesign(muscle_model="line"))
    with pytest.raises(ValueError, match=r'^design.muscle_model = "line": world.ball needs muscles as rods'):
        build_model(lattice, named_layout("all", lattice), World(ball=Ball(radius=0.02)))


def test_node_radii() -> None:
    """The mean of the elements at a node."""
    uneven = replace(rod(), radius=np.array([1.0, 2.0, 4.0]))
    np.testing.assert_allclose(RodModel(rods=(uneven,)).node_radius, [1.0, 1.5, 3.0, 4.0])


def test_natural_curvature() -> None:
    """None means that of the shape; otherwise it is taken as given, checked and locked."""
    rod = straight_rod((0, 0, 0), (0, 0, 1), 4, radius=0.1, density=1.0, youngs_modulus=1.0, shear_modulus=1.0)
    assert np.abs(rod.rest_kappa).max() == 0.0
    bent = replace(rod, natural_curvature=np.tile((0.1, 0.0, 0.2), (3, 1)))
    assert bent.rest_kappa == pytest.approx(np.tile((0.1, 0.0, 0.2), (3, 1)))
    assert not bent.rest_kappa.flags.writeable
    with pytest.raises(ValueError, match=r"Rod\.natural_curvature"):
        replace(rod, natural_curvature=np.zeros((4, 3)))
    with pytest.raises(ValueError, match=r"Rod\.natural_curvature"):
        replace(rod, natural_curvature=np.full((3, 3), np.nan))
