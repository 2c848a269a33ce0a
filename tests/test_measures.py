"""Measures against shapes and waves whose answer is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.joints import Joint
from lattice_gym.physics.measures import (
    base_frame,
    bend_angle,
    bend_direction,
    bend_vector,
    centreline_projection,
    dilatation,
    joint_gap,
    mass_centre,
    muscle_lengths,
    muscle_strain,
    ring_radii,
    site_positions,
    straightness,
    strain,
    top_centre,
    top_normal,
    travelling_wave,
    twist_angle,
)
from lattice_gym.physics.rod import straight_rod
from lattice_gym.physics.worm import build_model

LATTICE = build_lattice(LatticeDesign())
REST = LATTICE.position.reshape(-1, 3)
FREE = build_lattice(LatticeDesign(base="free"))
HEIGHTS = np.arange(1, 9) / 80.0
"""Eight levels, 1/80 m apart: they span one wavelength of 0.1 m."""


def _turned(position: FloatArray, angle: float, azimuth: float) -> FloatArray:
    """Positions turned about the horizontal axis through the origin that tips the z axis towards an azimuth."""
    axis = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    cross = np.cross(np.eye(3), axis)
    rotation = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    turned: FloatArray = position @ rotation.T
    return turned


def _wave(forward: float, backward: float, wavelength: float, period: float, n_step: int, dt: float) -> FloatArray:
    """Radii of one wave running up and one running down, over n_step steps."""
    angle = 2.0 * np.pi * dt / period * np.arange(n_step)[:, None]
    place = 2.0 * np.pi * HEIGHTS / wavelength
    return 0.0375 + 1e-3 * (forward * np.cos(angle - place) + backward * np.cos(angle + place))


def test_sites_at_rest() -> None:
    """Both nodes of a site stand on it."""
    np.testing.assert_allclose(site_positions(LATTICE, REST), LATTICE.site_position, atol=1e-15)


def test_sites_are_the_mean_of_two_nodes() -> None:
    """Moving one rod of a site by d moves the site by d / 2."""
    moved = REST.copy()
    moved[LATTICE.site_rod[7, 1] * LATTICE.n_node + LATTICE.site_node[7, 1]] += [0.0, 0.0, 0.01]
    rise = (site_positions(LATTICE, moved) - site_positions(LATTICE, REST))[:, 2]
    assert rise[7] == pytest.approx(0.005)
    assert np.count_nonzero(rise) == 1


@given(stretch=st.floats(-0.9, 3.0), away=st.floats(-1.0, 1.0))
def test_strain(stretch: float, away: float) -> None:
    """A body stretched evenly has that strain, wherever it is; muscles' nodes, which follow, do not count."""
    position = np.concatenate([REST * [1.0, 1.0, 1.0 + stretch] + [0.0, 0.0, away], np.full((9, 3), 5.0)])
    assert strain(LATTICE, position) == pytest.approx(stretch, abs=1e-12)


@given(angle=st.floats(1e-6, np.pi - 1e-6), azimuth=st.floats(0.0, 2 * np.pi - 1e-6))
def test_bend(angle: float, azimuth: float) -> None:
    """A body tipped by an angle towards an azimuth has that bend, and its normal tells so."""
    position = _turned(REST, angle, azimuth)
    assert bend_angle(LATTICE, position) == pytest.approx(angle, abs=1e-9)
    towards = np.array([np.cos(azimuth), np.sin(azimuth)])
    np.testing.assert_allclose(bend_vector(LATTICE, position), angle * towards, atol=1e-8)
    np.testing.assert_allclose(top_normal(LATTICE, position)[:2], np.sin(angle) * towards, atol=1e-9)
    direction = bend_direction(LATTICE, position)
    assert 0.0 <= direction < 2 * np.pi
    assert np.cos(direction - azimuth) == pytest.approx(1.0, abs=1e-9)


@given(
    angle=st.floats(-np.pi, np.pi),
    azimuth=st.floats(0.0, 6.28),
    turn=st.floats(-np.pi, np.pi),
    away=st.floats(-1.0, 1.0),
    seed=st.integers(0, 100),
)
def test_rigid_motions_of_a_free_body(angle: float, azimuth: float, turn: float, away: float, seed: int) -> None:
    """Any shape, turned and moved whole, keeps its bend, its direction, its strain and its ring radii."""
    shape = REST * [1.0, 1.0, 1.3] + 1e-3 * np.random.default_rng(seed).standard_normal(REST.shape)
    shape += np.outer((REST[:, 2] / 0.1) ** 2, [0.03, 0.02, 0.0]) + REST[:, :1] * (REST[:, 2:] / 0.1) ** 2 * [
        0,
        0,
        -0.5,
    ]
    spin = np.array([[np.cos(turn), np.sin(turn), 0.0], [-np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    moved = _turned(shape @ spin, angle, azimuth) + away
    assert bend_angle(FREE, shape) > 0.3
    np.testing.assert_allclose(bend_vector(FREE, moved), bend_vector(FREE, shape), atol=1e-9)
    assert strain(FREE, moved) == pytest.approx(strain(FREE, shape), abs=1e-9)
    np.testing.assert_allclose(ring_radii(FREE, moved), ring_radii(FREE, shape), rtol=1e-9)
    np.testing.assert_allclose(base_frame(FREE, moved) @ base_frame(FREE, moved).T, np.eye(3), atol=1e-12)


@given(angle=st.floats(-np.pi, np.pi), azimuth=st.floats(0.0, 6.28))
def test_a_tilted_free_body_is_at_rest(angle: float, azimuth: float) -> None:
    """No bend, no strain; upside down too."""
    moved = _turned(REST, angle, azimuth)
    assert bend_angle(FREE, moved) < 1e-9
    assert strain(FREE, moved) == pytest.approx(0.0, abs=1e-12)


def test_a_base_that_cannot_tell_how_it_is_turned() -> None:
    """A ring of no area is refused, and one of two sites."""
    with pytest.raises(ValueError, match=r"position: the bottom ring must enclose"):
        strain(FREE, np.zeros_like(REST))
    narrow = build_lattice(LatticeDesign(n_pairs=2, period_ratio=1.0, base="free"))
    with pytest.raises(ValueError, match=r"lattice: 2 sites at the bottom"):
        strain(narrow, narrow.position.reshape(-1, 3))


@given(turn=st.floats(-3.1, 3.1), away=st.floats(-1.0, 1.0), azimuth=st.floats(0.0, 6.28))
def test_twist(turn: float, away: float, azimuth: float) -> None:
    """A body twisted in proportion to height: the top's share of it, wherever the body stands."""
    angle = turn * REST[:, 2] / LATTICE.design.height
    place = (REST[:, 0] + 1j * REST[:, 1]) * np.exp(1j * angle)
    twisted = np.stack([place.real, place.imag, REST[:, 2]], axis=1)
    assert twist_angle(LATTICE, twisted + np.array([away, 0.0, 0.0])) == pytest.approx(turn, abs=1e-9)
    assert twist_angle(FREE, _turned(twisted, 0.7, azimuth)) == pytest.approx(turn, abs=1e-9)


def test_an_upright_top_has_no_direction() -> None:
    """Rounding has a direction, but no meaning; upside down is half a turn."""
    noisy = REST + 1e-14 * np.random.default_rng(1).standard_normal(REST.shape)
    assert bend_angle(LATTICE, noisy) == 0.0
    assert bend_direction(LATTICE, noisy) == 0.0
    assert bend_angle(LATTICE, REST * [1.0, -1.0, -1.0]) == pytest.approx(np.pi)


def test_bend_needs_a_plane() -> None:
    """Two sites at the top span none, nor does a ring shrunk to a point."""
    narrow = build_lattice(LatticeDesign(n_pairs=2, period_ratio=1.0))
    with pytest.raises(ValueError, match=r"lattice: 2 sites at the top"):
        bend_angle(narrow, narrow.position.reshape(-1, 3))
    with pytest.raises(ValueError, match=r"position: the top ring"):
        bend_angle(LATTICE, np.zeros_like(REST))


def test_ring_radii_at_rest(lattice: Lattice) -> None:
    """Every ring has the design's radius."""
    np.testing.assert_allclose(ring_radii(lattice, REST), 0.5 * lattice.design.diameter, rtol=1e-13)


@given(st.lists(st.floats(0.2, 3.0), min_size=9, max_size=9), st.floats(-1.0, 1.0), st.floats(0.0, 3.0))
def test_ring_radii_of_a_wavy_body(widths: list[float], away: float, angle: float) -> None:
    """Widening each level by its own factor gives these factors, wherever the body is and however it is turned."""
    at = REST[:, 2] / LATTICE.design.height * 8
    width = np.interp(at, np.arange(9), widths)[:, None]
    position = _turned(REST * np.concatenate([width, width, np.ones_like(width)], axis=1), angle, 1.0) + away
    np.testing.assert_allclose(ring_radii(LATTICE, position), 0.0375 * np.array(widths), rtol=1e-9)


def test_ring_radii_need_levels() -> None:
    """Uneven phases leave no common levels."""
    gap = np.array([0.0, 0.9, 2.0, 3.1, 4.3, 5.2])
    uneven = build_lattice(LatticeDesign(phases=tuple(np.tile(gap, 2)), period_ratio=1.0))
    with pytest.raises(ValueError, match=r"lattice: .* no common levels"):
        ring_radii(uneven, uneven.position.reshape(-1, 3))


@given(
    half_waves=st.integers(1, 7),
    n_period=st.integers(1, 4),
    steps=st.integers(8, 40),
    up=st.booleans(),
    period=st.floats(0.1, 10.0),
)
def test_a_pure_wave(half_waves: int, n_period: int, steps: int, up: bool, period: float) -> None:
    """Whole periods over whole half wavelengths: index 1, the right way, at the right speed."""
    wavelength, dt = 0.2 / half_waves, period / steps
    radii = _wave(float(up), float(not up), wavelength, period, n_period * steps, dt)
    index, direction, speed = travelling_wave(radii, dt, HEIGHTS)
    assert index > 0.99
    assert direction == (1 if up else -1)
    assert speed == pytest.approx(wavelength / period, rel=1e-6)


@given(backward=st.floats(0.0, 0.95))
def test_a_mixed_wave(backward: float) -> None:
    """Of waves of amplitude 1 up and b down, [Re u, Im u] has the condition number (1 + b) / (1 - b)."""
    wave = travelling_wave(_wave(1.0, backward, 0.1, 1.0, 40, 0.05), 0.05, HEIGHTS)
    assert wave.index == pytest.approx((1.0 - backward) / (1.0 + backward), abs=1e-9)
    assert wave.direction == (1 if wave.index >= 0.05 else 0)


def test_a_standing_wave() -> None:
    """It has no direction and no speed."""
    wave = travelling_wave(_wave(1.0, 1.0, 0.1, 1.0, 40, 0.05), 0.05, HEIGHTS)
    assert wave.index < 1e-6
    assert (wave.direction, wave.speed) == (0, 0.0)


def test_broken_periods_and_wavelengths() -> None:
    """A pure wave of 2.3 periods over 5/6 of a wavelength is still told apart, within the docstring's bounds."""
    wave = travelling_wave(_wave(1.0, 0.0, 0.12, 1.0, 40, 0.05), 0.05, HEIGHTS)
    assert wave.index == pytest.approx(0.84, abs=0.01)
    wave = travelling_wave(_wave(1.0, 0.0, 0.12, 1.0, 46, 0.05), 0.05, HEIGHTS)
    assert wave.index > 0.7
    assert wave.direction == 1
    assert wave.speed == pytest.approx(0.12, rel=0.1)


def test_still_levels_are_left_out() -> None:
    """A clamped level, or one that hardly moves, changes nothing."""
    radii, level_height = _wave(1.0, 0.0, 0.1, 1.0, 40, 0.05), np.concatenate([[0.0], HEIGHTS])
    noise = 1e-6 * np.random.default_rng(0).standard_normal((40, 1))
    expected = travelling_wave(radii, 0.05, HEIGHTS)
    wave = travelling_wave(np.hstack([0.0375 + noise, radii]), 0.05, level_height)
    assert tuple(wave) == tuple(expected)
    assert wave.amplitude == pytest.approx(expected.amplitude * np.sqrt(8.0 / 9.0))


@pytest.mark.parametrize("moving", [0, 1])
def test_no_wave(moving: int) -> None:
    """No motion, rounding alone, or one moving level: all defined, all zero."""
    radii = 0.0375 + 1e-17 * np.random.default_rng(0).standard_normal((40, 8))
    radii[:, :moving] += 1e-3 * np.sin(np.arange(40))[:, None]
    assert tuple(travelling_wave(radii, 0.05, HEIGHTS)) == (0.0, 0, 0.0)
    assert tuple(travelling_wave(np.zeros((4, 8)), 0.05, HEIGHTS)) == (0.0, 0, 0.0)


@given(amplitude=st.floats(1e-4, 0.03))
def test_amplitude(amplitude: float) -> None:
    """Exact for a pure wave; a standing one has 1 / sqrt 2 of it at its crests on average."""
    radii = 0.0375 + amplitude * 1e3 * (_wave(1.0, 0.0, 0.1, 1.0, 40, 0.05) - 0.0375)
    assert travelling_wave(radii, 0.05, HEIGHTS).amplitude == pytest.approx(amplitude, rel=1e-9)
    radii = 0.0375 + amplitude * 1e3 * (_wave(0.5, 0.5, 0.1, 1.0, 40, 0.05) - 0.0375)
    assert travelling_wave(radii, 0.05, HEIGHTS).amplitude == pytest.approx(amplitude / np.sqrt(2.0), rel=1e-9)


@given(seed=st.integers(0, 2**32 - 1), n_time=st.integers(16, 80), size=st.floats(1e-6, 1.0))
def test_noise_is_no_wave(seed: int, n_time: int, size: float) -> None:
    """White noise of any size has an amplitude, and nothing that travels."""
    radii = 1.0 + size * np.random.default_rng(seed).standard_normal((n_time, 8))
    wave = travelling_wave(radii, 0.05, HEIGHTS)
    assert tuple(wave) == (0.0, 0, 0.0)
    assert wave.amplitude > 0.3 * size


@pytest.mark.parametrize(("noise", "travels"), [(0.1, True), (0.2, True), (0.5, False), (2.0, False)])
def test_a_wave_in_noise(noise: float, travels: bool) -> None:
    """Noise of a share of the amplitude in every radius: a ninth of the power is the floor, 0.24 of the amplitude."""
    radii = _wave(1.0, 0.0, 0.1, 1.0, 40, 0.05)
    radii += noise * 1e-3 * np.random.default_rng(3).standard_normal(radii.shape)
    wave = travelling_wave(radii, 0.05, HEIGHTS)
    assert (wave.direction == 1) == travels
    if travels:
        assert wave.speed == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize(("size", "travels"), [(1e-3, True), (6e-4, True), (4e-4, False), (1e-9, False)])
def test_a_vanishing_wave_is_none(size: float, travels: bool) -> None:
    """Below half a thousandth of the radius nothing travels."""
    radii = 1.0 + 1e3 * size * (_wave(1.0, 0.0, 0.1, 1.0, 40, 0.05) - 0.0375)
    wave = travelling_wave(radii, 0.05, HEIGHTS)
    assert (wave.index > 0.99) == (wave.direction == 1) == travels
    assert wave.amplitude == pytest.approx(size, rel=1e-5)


@given(seed=st.integers(0, 2**32 - 1), n_time=st.integers(4, 60), n_level=st.integers(1, 9), size=st.floats(0.0, 1e3))
def test_any_recording_has_an_answer(seed: int, n_time: int, n_level: int, size: float) -> None:
    """No recording gives NaN or leaves [0, 1]."""
    radii = 1.0 + size * np.random.default_rng(seed).standard_normal((n_time, n_level))
    index, direction, speed = travelling_wave(radii, 0.05, np.linspace(0.1, 1.0, n_level))
    assert 0.0 <= index <= 1.0
    assert direction in (-1, 0, 1)
    assert np.isfinite(speed)
    assert (speed > 0.0) == (direction != 0)


@pytest.mark.parametrize(
    ("radii", "dt", "level_height", "message"),
    [
        (np.ones(8), 0.05, HEIGHTS, "radii"),
        (np.ones((3, 8)), 0.05, HEIGHTS, "radii"),
        (np.full((9, 8), np.nan), 0.05, HEIGHTS, "radii"),
        (np.ones((9, 8)), 0.0, HEIGHTS, "dt"),
        (np.ones((9, 8)), np.inf, HEIGHTS, "dt"),
        (np.ones((9, 8)), 0.05, HEIGHTS[:-1], "level_height"),
        (np.ones((9, 8)), 0.05, HEIGHTS[::-1], "level_height"),
        (np.ones((9, 8)), 0.05, np.full(8, np.nan), "level_height"),
    ],
)
def test_wrong_recordings(radii: FloatArray, dt: float, level_height: FloatArray, message: str) -> None:
    """The error names the argument."""
    with pytest.raises(ValueError, match=rf"^{message}\b"):
        travelling_wave(radii, dt, level_height)


@pytest.mark.parametrize("muscle_model", ["rod", "line"])
@pytest.mark.parametrize("base", ["clamped", "free"])
def test_worms_side_by_side_are_measured_as_alone(base: str, muscle_model: str) -> None:
    """Any leading axes, to the last bit: what a worm is beside changes nothing."""
    lattice = build_lattice(LatticeDesign(base=base, muscle_model=muscle_model))
    model = build_model(lattice, named_layout("all", lattice))
    rng = np.random.default_rng(0)
    position = model.rest_state().position + 1e-3 * rng.standard_normal((3, 2, model.n_node, 3))
    point = rng.uniform(-0.05, 0.1, (3, 2, 3))
    of_lattice = (site_positions, strain, top_centre, top_normal, bend_vector, bend_angle, bend_direction, ring_radii)
    of_model = (joint_gap, mass_centre, muscle_lengths, muscle_strain, dilatation)

    def measured(x: FloatArray, p: FloatArray) -> list[FloatArray]:
        place = centreline_projection(lattice, x, p)
        found = [measure(lattice, x) for measure in of_lattice] + [measure(model, x) for measure in of_model]
        return [
            *found,
            straightness(lattice, model, x),
            place.height,
            *(np.array(part, dtype=np.float64) for part in (place.beside, place.end)),
        ]

    together = measured(position, point)
    for index in np.ndindex(3, 2):
        for values, alone in zip(together, measured(position[index], point[index]), strict=True):
            np.testing.assert_array_equal(values[index], alone)
    frames = np.broadcast_to(base_frame(lattice, position), (3, 2, 3, 3))
    np.testing.assert_array_equal(frames[1, 1], base_frame(lattice, position[1, 1]))


def test_joint_gap() -> None:
    """Zero at rest, then as far as a node was moved; none without joints."""
    model = build_model(LATTICE, named_layout("all", LATTICE))
    position = model.rest_state().position
    assert joint_gap(model, position) < 1e-15
    joint = model.joints[-1]
    position[model.node_offset[joint.rod_b] + joint.node_b] += [0.0, 3e-3, 4e-3]
    assert joint_gap(model, position) == pytest.approx(5e-3)
    rod = straight_rod([0, 0, 0], [0, 0, 1], 2, radius=0.1, density=1.0, youngs_modulus=1.0, shear_modulus=1.0)
    assert joint_gap(RodModel(rods=(rod,)), np.zeros((3, 3))) == 0.0


def test_dilatation() -> None:
    """Rods of different element counts, each stretched by its own factor."""
    ends = [([0, 0, 0], [0, 0, 1], 4), ([1, 0, 0], [1, 2, 0], 2), ([5, 0, 0], [8, 0, 0], 3)]
    rods = tuple(
        straight_rod(a, b, n, radius=0.1, density=1.0, youngs_modulus=1.0, shear_modulus=1.0) for a, b, n in ends
    )
    model = RodModel(rods=rods, joints=(Joint(0, 4, 1, 0, 1.0),))
    position = np.concatenate([factor * rod.position for factor, rod in zip((0.5, 2.0, 3.0), rods, strict=True)])
    np.testing.assert_allclose(dilatation(model, position), [0.5] * 4 + [2.0] * 2 + [3.0] * 3)


def test_a_broken_lattice_does_not_look_whole(lattice: Lattice) -> None:
    """NaN in one crossing shows in every measure of what held."""
    model = build_model(lattice, named_layout("extension", lattice))
    position = model.rest_state().position
    position[5] = np.nan
    assert np.isnan(joint_gap(model, position))
    assert np.isnan(straightness(lattice, model, position))
    assert np.isnan(dilatation(model, position).min())


@given(
    place=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(-0.03, 0.13)),
    turn=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    shift=st.floats(-1.0, 1.0),
)
def test_lodging_moves_with_the_body(place: tuple[float, ...], turn: tuple[float, ...], shift: float) -> None:
    """Upright it is height and distance from the axis; a rigid motion of body and point changes nothing."""
    point, off, height = np.array(place), np.hypot(place[0], place[1]), place[2]
    if min(abs(height), abs(height - 0.1), abs(off - 0.0375)) < 1e-9:
        return
    end = -1 if height < 0.0 else 1 if height > 0.1 else 0
    expected = (np.clip(height, 0.0, 0.1), end == 0 and off > 0.0375, end)
    rotation = np.linalg.qr(np.cross(np.eye(3), turn) + 10.0 * np.eye(3))[0]
    rotation *= np.linalg.det(rotation)
    rest = LATTICE.position.reshape(-1, 3)
    for x, p in ((rest, point), (rest @ rotation.T + shift, rotation @ point + shift)):
        found = centreline_projection(LATTICE, x, p)
        assert found.height == pytest.approx(expected[0], abs=1e-9)
        assert (bool(found.beside), int(found.end)) == expected[1:]


@pytest.mark.parametrize("muscle_model", ["rod", "line"])
def test_muscle_lengths(muscle_model: str) -> None:
    """At rest the distance between the two sites of each, and in proportion when all is blown up."""
    lattice = build_lattice(LatticeDesign(muscle_model=muscle_model))
    layout = named_layout("all", lattice)
    model = build_model(lattice, layout)
    ends = np.array([(muscle.start, muscle.end) for muscle in layout.active])
    expected = np.linalg.norm(np.diff(lattice.site_position[ends], axis=1)[:, 0], axis=1)
    for size in (1.0, 1.7):
        lengths = muscle_lengths(model, size * model.rest_state().position)
        np.testing.assert_allclose(lengths, size * expected, rtol=1e-12)


def test_centres() -> None:
    """Of mass and of the top ring, on the axis of the lattice at rest."""
    model = build_model(LATTICE, named_layout("all", LATTICE))
    rest = model.rest_state().position
    np.testing.assert_allclose(top_centre(LATTICE, rest), [0.0, 0.0, 0.1], atol=1e-12)
    centre = mass_centre(model, rest)
    np.testing.assert_allclose(centre[:2], 0.0, atol=1e-12)
    assert 0.045 < centre[2] < 0.056  # rings from level 1 up weigh on the upper half
