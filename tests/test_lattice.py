"""Rods, crossings and levels against the helices they are made from."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.checks import TAU, FloatArray, wrap_angle

FIELDS = tuple(LatticeDesign().to_dict())


@st.composite
def _designs(draw: st.DrawFn) -> LatticeDesign:
    """Designs that close: even or with a repeated pattern of uneven phases, turned, shuffled, of any proportions."""
    symmetry = draw(st.integers(1, 6))
    # A pattern of one rod that does not repeat would be a single pair.
    repeat = draw(st.integers(1 if symmetry > 1 else 2, 3))
    gaps = np.array(draw(st.lists(st.floats(0.2, 1.0), min_size=repeat, max_size=repeat)))
    offset = np.cumsum(gaps / gaps.sum()) * TAU / symmetry + draw(st.floats(-7.0, 7.0))
    family = (offset + TAU / symmetry * np.arange(symmetry)[:, None]).ravel()
    n_pairs = symmetry * repeat
    rods = draw(st.permutations([(phase, sign) for sign in (1, -1) for phase in family.tolist()]))
    return LatticeDesign(
        n_pairs=n_pairs,
        phases=tuple(phase + TAU * draw(st.integers(-2, 2)) for phase, _ in rods),
        chirality=tuple(sign for _, sign in rods),
        period_ratio=2 * symmetry / draw(st.integers(1, 9)),
        height=draw(st.floats(0.01, 1.0)),
        diameter=draw(st.floats(0.01, 1.0)),
        elements_per_segment=draw(st.integers(2, 6)),
        structure_radius=1e-7,
    )


def _crossings(design: LatticeDesign) -> FloatArray:
    """Heights at which each right-handed rod meets each left-handed one, sorted rows (right, left, z)."""
    found = []
    most = 2 + math.ceil(2 * design.height / design.period + np.abs(design.rod_phases).max())
    for right in np.flatnonzero(design.rod_chirality == 1):
        for left in np.flatnonzero(design.rod_chirality == -1):
            for turn in range(-most, most + 1):
                lead = design.rod_phases[left] - design.rod_phases[right] + TAU * turn
                z = design.period / (2 * TAU) * lead
                if -1e-7 * design.height <= z <= (1 + 1e-7) * design.height:
                    found.append((right, left, z))
    return np.array(sorted(found))


def _check(lattice: Lattice) -> None:
    """Assert what must hold of every lattice, whatever its design."""
    design = lattice.design
    count = design.elements_per_segment
    shape = (design.n_rod, design.n_segment * count + 1)
    assert (lattice.n_rod, lattice.n_node) == shape
    assert lattice.n_site == design.n_pairs * (design.n_segment + 1)
    assert all(np.all(np.isfinite(value)) for value in vars(lattice).values() if isinstance(value, np.ndarray))

    # Both rods' nodes lie at their site, each rod is met once a segment, and segments have a length.
    for side, sign in enumerate((1, -1)):
        rod, node = lattice.site_rod[:, side], lattice.site_node[:, side]
        assert np.all(design.rod_chirality[rod] == sign)
        assert np.abs(lattice.position[rod, node] - lattice.site_position).max() <= 1e-12 * design.height
        met = sorted(zip(rod.tolist(), node.tolist(), strict=True))
        rods = np.flatnonzero(design.rod_chirality == sign).tolist()
        assert met == [(one, count * segment) for one in rods for segment in range(design.n_segment + 1)]
    crossing_height = lattice.position[:, ::count, 2]
    assert np.all(np.diff(crossing_height, axis=1) > 0.0)
    np.testing.assert_array_equal(crossing_height[:, [0, -1]], np.tile([0.0, design.height], (design.n_rod, 1)))

    # Nodes lie on the helix of their rod, evenly spaced within a segment.
    z = lattice.position[:, :, 2]
    angle = design.rod_phases[:, None] + design.rod_chirality[:, None] * TAU * z / design.period
    helix = design.diameter / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=2)
    np.testing.assert_allclose(lattice.position[:, :, :2], helix, atol=3e-9 * design.diameter)
    length = np.linalg.norm(np.diff(lattice.position, axis=1), axis=2).reshape(design.n_rod, design.n_segment, count)
    np.testing.assert_allclose(length, np.broadcast_to(length[:, :, :1], length.shape), rtol=1e-6)

    # Directors: right-handed triads along the elements, d1 pointing straight away from the axis.
    identity = np.broadcast_to(np.eye(3), (*lattice.directors.shape[:2], 3, 3))
    np.testing.assert_allclose(lattice.directors @ np.swapaxes(lattice.directors, 2, 3), identity, atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(lattice.directors), 1.0, atol=1e-14)
    chord = np.diff(lattice.position, axis=1)
    chord /= np.linalg.norm(chord, axis=2, keepdims=True)
    np.testing.assert_allclose(lattice.directors[:, :, 2], chord, atol=1e-14)
    middle = (lattice.position[:, 1:] + lattice.position[:, :-1]) / 2
    outward = np.append(
        middle[:, :, :2] / np.linalg.norm(middle[:, :, :2], axis=2, keepdims=True), 0 * z[:, 1:, None], 2
    )
    np.testing.assert_allclose(lattice.directors[:, :, 0], outward, atol=1e-7)

    # Sites are sorted, and levels are what they say.
    azimuth = np.arctan2(lattice.site_position[:, 1], lattice.site_position[:, 0])
    np.testing.assert_allclose(wrap_angle(azimuth - lattice.site_azimuth), 0.0, atol=1e-12)
    assert np.all((lattice.site_azimuth >= 0.0) & (lattice.site_azimuth < TAU))
    order = np.lexsort((lattice.site_azimuth, lattice.site_position[:, 2]))
    np.testing.assert_array_equal(order, np.arange(lattice.n_site))
    if lattice.n_level:
        np.testing.assert_array_equal(lattice.site_level, np.repeat(np.arange(design.n_segment + 1), design.n_pairs))
        np.testing.assert_array_equal(lattice.site_position[:, 2], lattice.level_height[lattice.site_level])
    else:
        assert np.all(lattice.site_level == -1)


def test_default_lattice() -> None:
    """54 sites on 9 levels of six, each turned by half the angle between two rods."""
    lattice = build_lattice(LatticeDesign())
    _check(lattice)
    assert (lattice.n_rod, lattice.n_node, lattice.n_site, lattice.n_level) == (12, 41, 54, 9)
    np.testing.assert_allclose(lattice.level_height, 0.1 * np.arange(9) / 8, rtol=1e-15)
    for level in range(9):
        expected = (np.arange(6) + (level % 2) / 2) * TAU / 6
        np.testing.assert_allclose(lattice.site_azimuth[lattice.site_level == level], expected, atol=1e-15)
    np.testing.assert_array_equal(np.unique(lattice.site_node), np.arange(0, 41, 5))
    even = lattice.site_azimuth.reshape(9, 6)[::2]
    np.testing.assert_array_equal(even, np.broadcast_to(even[0], even.shape))


def test_it_is_shown_in_one_line() -> None:
    """Counts, not arrays."""
    assert repr(build_lattice(LatticeDesign())) == "Lattice(6 pairs, 12 rods of 41 nodes, 54 sites, 9 levels)"
    uneven = build_lattice(LatticeDesign(n_pairs=3, phases=(0.0, 1.0, 3.0) * 2, period_ratio=2.0))
    assert repr(uneven) == "Lattice(3 pairs, 6 rods of 16 nodes, 12 sites, no levels)"


def test_arrays_are_read_only() -> None:
    """No caller can change a lattice that others hold."""
    lattice = build_lattice(LatticeDesign())
    arrays = {name: value for name, value in vars(lattice).items() if isinstance(value, np.ndarray)}
    assert len(arrays) == 8
    for value in arrays.values():
        with pytest.raises(ValueError, match="read-only"):
            value[0] = 0


@pytest.mark.parametrize("n_pairs", [2, 3, 6, 9])
@pytest.mark.parametrize("n_segment", [1, 2, 7, 8, 13])
def test_any_even_lattice(n_pairs: int, n_segment: int) -> None:
    """Any number of pairs and any period that closes gives n_segment + 1 levels of n_pairs sites."""
    values: dict[str, Any] = {"n_pairs": n_pairs, "period_ratio": 2 * n_pairs / n_segment}
    for count in (1, 2, 5):
        if n_segment * count > 1:
            lattice = build_lattice(LatticeDesign(**values, elements_per_segment=count, structure_radius=1e-3))
            _check(lattice)
            assert lattice.n_level == n_segment + 1


@pytest.mark.parametrize("shift", [1e-10, -1e-10, 0.4, -2.0, math.pi])
def test_turned_lattice_has_levels(shift: float) -> None:
    """All phases shifted: the same lattice, turned about its axis."""
    straight = build_lattice(LatticeDesign())
    turned = build_lattice(LatticeDesign(phases=tuple(straight.design.rod_phases + shift)))
    _check(turned)
    assert turned.n_level == 9
    turn = np.array([[math.cos(shift), -math.sin(shift), 0.0], [math.sin(shift), math.cos(shift), 0.0], [0, 0, 1]])
    np.testing.assert_allclose(turned.position, straight.position @ turn.T, atol=1e-12)
    np.testing.assert_allclose(turned.directors, straight.directors @ turn.T, atol=1e-9)


def test_uneven_lattice_has_no_levels() -> None:
    """Crossings at heights of their own, n_segment of them on every rod nevertheless."""
    design = LatticeDesign(n_pairs=4, phases=(0.0, 1.0, math.pi, math.pi + 1.0) * 2, period_ratio=1.0)
    lattice = build_lattice(design)
    _check(lattice)
    assert (lattice.n_level, lattice.n_site) == (0, 4 * 9)
    # On the right-handed rod of phase 0: leads of 0, 1, pi, pi + 1, 2 pi, ... times T / (4 pi).
    rod = lattice.site_position[lattice.site_rod[:, 0] == 0, 2]
    expected = np.array([0, 1, math.pi, math.pi + 1, TAU, TAU + 1, TAU + math.pi, TAU + math.pi + 1, 2 * TAU])
    np.testing.assert_allclose(rod, design.period / (2 * TAU) * expected, atol=1e-15)


@given(design=_designs())
@settings(max_examples=120, deadline=None)
def test_random_lattices(design: LatticeDesign) -> None:
    """The crossings are all those of the helices and no others, found here rod by rod from their phases."""
    lattice = build_lattice(design)
    _check(lattice)
    assert lattice.n_level == (design.n_segment + 1 if design.phase_pattern.symmetry == design.n_pairs else 0)
    expected = _crossings(design)
    found = np.array(sorted(zip(*lattice.site_rod.T, lattice.site_position[:, 2], strict=True)))
    np.testing.assert_array_equal(found[:, :2], expected[:, :2])
    np.testing.assert_allclose(found[:, 2], expected[:, 2], atol=1e-7 * design.height)


@given(
    values=st.fixed_dictionaries(
        {},
        optional={
            "n_pairs": st.one_of(st.integers(-1, 8), st.floats(), st.booleans()),
            "period_ratio": st.one_of(st.floats(), st.integers(1, 24).map(lambda count: 12 / count)),
            "phases": st.one_of(
                st.none(), st.lists(st.floats(-10, 10), max_size=16), st.lists(st.floats(), max_size=4)
            ),
            "chirality": st.one_of(st.none(), st.lists(st.sampled_from([1, -1, 0, True]), max_size=16)),
            "height": st.one_of(st.floats(), st.floats(1e-6, 1e3)),
            "diameter": st.one_of(st.floats(), st.floats(1e-6, 1e3)),
            "structure_radius": st.one_of(st.floats(), st.floats(1e-9, 1e-2)),
            "elements_per_segment": st.one_of(st.integers(0, 5), st.floats()),
            "structure_poisson_ratio": st.floats(),
            "max_tension": st.one_of(st.floats(), st.text(max_size=3)),
            "joint_damping": st.floats(),
            "base": st.one_of(st.sampled_from(["clamped", "free"]), st.text(max_size=3)),
        },
    )
)
@settings(max_examples=400, deadline=None)
def test_hostile_designs(values: dict[str, Any]) -> None:
    """Either a sound lattice or a ValueError that names a field; nothing else, and never a NaN."""
    message = ""
    try:
        design = LatticeDesign(**values)
    except ValueError as error:
        message = str(error)
    if message:
        assert re.match(rf"LatticeDesign\.({'|'.join(FIELDS)})(\[\d+\])? = ", message)
        return
    assume(design.n_rod * design.n_segment * design.elements_per_segment < 20_000)
    _check(build_lattice(design))


@pytest.mark.parametrize("height", [1e-6, 1e3])
@pytest.mark.parametrize("diameter", [1e-6, 1e3])
def test_extreme_proportions(height: float, diameter: float) -> None:
    """The bounds of the lengths are inside what double precision holds."""
    _check(build_lattice(LatticeDesign(height=height, diameter=diameter, structure_radius=1e-9)))
