"""Layouts and groups against counts and closed forms worked out by hand."""

from __future__ import annotations

import json
import math
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import (
    LAYOUTS,
    Muscle,
    MuscleLayout,
    bending_layout,
    control_groups,
    diagonal,
    horizontal,
    named_layout,
    resolve_layout,
    tie,
    vertical,
)
from lattice_gym.checks import TAU, FloatArray, IntArray, wrap_angle

LATTICE = build_lattice(LatticeDesign())
UNEVEN = build_lattice(LatticeDesign(n_pairs=3, phases=(0.0, 1.0, 3.0) * 2, period_ratio=2.0))
EVEN = [
    build_lattice(LatticeDesign(n_pairs=n_pairs, period_ratio=2 * n_pairs / n_segment, structure_radius=1e-3))
    for n_pairs, n_segment in ((2, 2), (2, 5), (3, 4), (5, 9), (6, 12), (6, 9), (6, 7))
] + [build_lattice(LatticeDesign(phases=tuple(LatticeDesign().rod_phases + shift))) for shift in (-1e-6, 1.0, -1e-10)]


def _ends(layout: MuscleLayout, values: FloatArray | IntArray) -> FloatArray:
    """Site values at both ends of each active muscle, shape (n, 2)."""
    return np.array([[values[muscle.start], values[muscle.end]] for muscle in layout.active], dtype=np.float64)


@pytest.mark.parametrize(("name", "count"), [("extension", 48), ("compression", 42), ("all", 90)])
def test_named_layouts_of_the_paper(name: str, count: int) -> None:
    """48 muscles around, 42 along (the number in the paper's sequel), 90 in all."""
    layout = named_layout(name, LATTICE)
    assert len(layout) == len(layout.muscles) == count
    assert resolve_layout(name, LATTICE) == layout


@pytest.mark.parametrize(
    "build",
    [
        horizontal,
        vertical,
        lambda design: horizontal(design, levels=[1]),
        lambda design: tie(design, [(0, 17)]),
        bending_layout,
        lambda design: named_layout("all", design),
        lambda design: resolve_layout(vertical(LATTICE), design),
        lambda design: vertical(LATTICE).select(design, "vertical"),
        lambda design: control_groups("ring", vertical(LATTICE), design),
    ],
)
def test_a_design_is_no_lattice(build: Callable[[Any], object]) -> None:
    """One error names the argument and what makes a lattice of a design."""
    with pytest.raises(ValueError, match=r"^lattice = LatticeDesign\(.*: must be Lattice, .* build_lattice\(design\)"):
        build(LatticeDesign())


@pytest.mark.parametrize("lattice", [LATTICE, *EVEN])
def test_horizontal_muscles(lattice: Lattice) -> None:
    """Rings above the base, each closed: every site ties two muscles of one length (one where a ring has two sites)."""
    layout = horizontal(lattice)
    per_ring = lattice.design.n_pairs if lattice.design.n_pairs > 2 else 1
    assert len(layout) == per_ring * (lattice.n_level - 1)
    level = _ends(layout, lattice.site_level)
    np.testing.assert_array_equal(level[:, 0], level[:, 1])
    assert set(level[:, 0]) == set(range(1, lattice.n_level))
    ends = np.concatenate([[muscle.start, muscle.end] for muscle in layout.active])
    used = np.bincount(ends, minlength=lattice.n_site)
    assert np.all(used[lattice.site_level > 0] == (2 if lattice.design.n_pairs > 2 else 1))
    assert np.all(used[lattice.site_level == 0] == 0)
    chord = lattice.design.diameter * math.sin(math.pi / lattice.design.n_pairs)
    length = [math.dist(*lattice.site_position[[muscle.start, muscle.end]]) for muscle in layout.active]
    np.testing.assert_allclose(length, chord, rtol=1e-12)


@pytest.mark.parametrize("lattice", [LATTICE, *EVEN])
def test_vertical_muscles(lattice: Lattice) -> None:
    """Straight up from every site that has another two levels above, four where asked."""
    for span in range(2, lattice.n_level, 2):
        layout = vertical(lattice, span)
        assert len(layout) == lattice.design.n_pairs * (lattice.n_level - span)
        start, end = np.array([[muscle.start, muscle.end] for muscle in layout.active]).T
        rise = lattice.site_position[end] - lattice.site_position[start]
        np.testing.assert_allclose(rise[:, :2], 0.0, atol=1e-12 * lattice.design.diameter)
        np.testing.assert_allclose(rise[:, 2], lattice.level_height[span], rtol=1e-12)
        assert resolve_layout(layout, lattice) is layout


@pytest.mark.parametrize("span", [0, 1, 3, 10, -2, 2.5, True, "2"])
def test_span_is_checked(span: Any) -> None:
    """Odd spans meet no site of the same azimuth, and ten levels are more than there are."""
    with pytest.raises(ValueError, match="span = "):
        vertical(LATTICE, span)


def test_diagonal_muscles(lattice: Lattice) -> None:
    """Each runs along a rod from one level to the next, right-handed ones first, none twice."""
    layout = diagonal(lattice)
    start, end = np.array([(muscle.start, muscle.end) for muscle in layout.muscles]).T
    assert len(layout) == lattice.n_rod * (lattice.n_level - 1)
    np.testing.assert_array_equal(lattice.site_level[end], lattice.site_level[start] + 1)
    lean = wrap_angle(lattice.site_azimuth[end] - lattice.site_azimuth[start])
    np.testing.assert_allclose(lean, np.repeat([1.0, -1.0], len(layout) // 2) * np.pi / lattice.design.n_pairs)


def test_horizontal_levels() -> None:
    """Only the levels asked for, the base among them; others are refused."""
    assert set(_ends(horizontal(LATTICE, [0, 3]), LATTICE.site_level).ravel()) == {0, 3}
    assert len(horizontal(LATTICE, [3, 3])) == 6
    for wrong in (9, -1, 1.5, True):
        levels: Any = [wrong]
        with pytest.raises(ValueError, match="levels"):
            horizontal(LATTICE, levels)


@pytest.mark.parametrize("azimuth", [0.0, TAU / 12, 2.0, math.pi])
def test_bending_layout(azimuth: float) -> None:
    """Muscles along on the side bent to, around on the other, and a mirror image across the plane of bending."""
    layout = bending_layout(LATTICE, azimuth)
    for muscle in layout.active:
        apart = wrap_angle(LATTICE.site_azimuth[[muscle.start, muscle.end]] - azimuth)
        assert np.all(np.cos(apart) > 0.0) if muscle.orientation == "vertical" else np.all(np.cos(apart) < 0.3)
    assert {muscle.orientation for muscle in layout.active} == {"vertical", "horizontal"}
    if azimuth != 2.0:  # planes through sites are planes of symmetry
        position = LATTICE.site_position
        mirror = np.array([[math.cos(2 * azimuth), math.sin(2 * azimuth), 0.0]] * 3)
        mirror[1] = [math.sin(2 * azimuth), -math.cos(2 * azimuth), 0.0]
        mirror[2] = [0.0, 0.0, 1.0]
        image = np.linalg.norm((position @ mirror)[:, None] - position, axis=2).argmin(axis=1)
        sites = {muscle.sites for muscle in layout.active}
        assert {frozenset((int(image[muscle.start]), int(image[muscle.end]))) for muscle in layout.active} == sites


def test_bending_layout_turns_with_its_azimuth() -> None:
    """A sixth of a turn later the muscles are the next ones round."""
    one, other = bending_layout(LATTICE), bending_layout(LATTICE, TAU / 6)
    assert named_layout("bending", LATTICE) == one
    turned = {tuple(sorted(6 * (site // 6) + (site + 1) % 6 for site in muscle.sites)) for muscle in one.active}
    assert turned == {tuple(sorted(muscle.sites)) for muscle in other.active}


@pytest.mark.parametrize("wrong", [math.nan, math.inf, "0", None, True])
def test_bending_azimuth_is_checked(wrong: Any) -> None:
    """An azimuth is a finite number."""
    with pytest.raises(ValueError, match="azimuth = "):
        bending_layout(LATTICE, wrong)


def test_lattice_without_levels() -> None:
    """Rings and columns need levels; muscles by hand do not."""
    for make in (horizontal, vertical, bending_layout):
        with pytest.raises(ValueError, match=r"tie\(\)"):
            make(UNEVEN)
    for name in LAYOUTS:
        with pytest.raises(ValueError, match=r"tie\(\)"):
            resolve_layout(name, UNEVEN)
    layout = tie(UNEVEN, [(0, 4), (1, 7)])
    assert [muscle.orientation for muscle in layout.active] == ["custom", "custom"]
    np.testing.assert_array_equal(control_groups("muscle", layout, UNEVEN), [0, 1])
    assert layout.select(UNEVEN, "custom").all()
    with pytest.raises(ValueError, match="levels"):
        layout.select(UNEVEN, levels=[0])
    with pytest.raises(ValueError, match='control = "ring"'):
        control_groups("ring", layout, UNEVEN)


def test_a_lattice_too_short_for_vertical_muscles() -> None:
    """One segment leaves no two levels to span: an error, not an empty layout."""
    short = build_lattice(LatticeDesign(period_ratio=12.0, structure_radius=1e-3))
    assert len(named_layout("extension", short)) == 6
    with pytest.raises(ValueError, match="span = 2"):
        named_layout("compression", short)


def test_union_keeps_the_first_of_equal_muscles() -> None:
    """Either way round, and whether on or off."""
    first = MuscleLayout((Muscle("custom", 7, 3, on=False), Muscle("custom", 1, 2)))
    union = first | tie(LATTICE, [(3, 7), (2, 1), (4, 5)])
    assert union.muscles == (*first.muscles, Muscle("custom", 4, 5))
    assert len(union) == 2
    every = named_layout("all", LATTICE)
    assert every | horizontal(LATTICE) | vertical(LATTICE) == every


def test_select_and_switch() -> None:
    """Masks by orientation, lower level and azimuth count what they should and combine."""
    layout = named_layout("all", LATTICE)
    assert layout.select(LATTICE).sum() == 90
    assert layout.select(LATTICE, "vertical").sum() == 42
    assert layout.select(LATTICE, levels=[0]).sum() == 6
    assert layout.select(LATTICE, levels=range(7, 9)).sum() == 12
    assert layout.select(LATTICE, "vertical", azimuth=(0.0, 0.0)).sum() == 4
    assert layout.select(LATTICE, "horizontal", azimuth=(math.pi / 6, math.pi / 6)).sum() == 4
    mask = layout.select(LATTICE, "vertical", [2], (TAU, 1.1))
    assert {round(value, 9) for value in _ends(layout.switched(mask), LATTICE.site_azimuth).ravel()} == {
        round(value % TAU, 9) for value in (-math.pi / 3, 0.0, math.pi / 3)
    }
    some = layout.switched(mask)
    assert len(some) == 3
    assert len(some.muscles) == 90
    assert some.switched(~some.select(LATTICE, "vertical")).active == horizontal(LATTICE).active


def test_a_layout_is_shown_in_one_line() -> None:
    """How many of its muscles are on, and of which kinds."""
    layout = named_layout("all", LATTICE)
    assert repr(layout) == "MuscleLayout(90 of 90 muscles on: 48 horizontal, 42 vertical)"
    assert repr(layout.switched(layout.select(LATTICE, "vertical"))) == "MuscleLayout(42 of 90 muscles on: 42 vertical)"
    assert repr(MuscleLayout()) == "MuscleLayout(0 of 0 muscles on)"


@pytest.mark.parametrize("mask", [[True], np.ones(90), np.ones((90, 1), dtype=bool), True, "yes"])
def test_mask_is_checked(mask: Any) -> None:
    """One bool a muscle."""
    with pytest.raises(ValueError, match=r"must be bool with shape \(90,\)"):
        named_layout("all", LATTICE).switched(mask)


def test_select_arguments_are_checked() -> None:
    """Unknown orientations, absent levels and azimuths that are no two numbers are refused."""
    layout = named_layout("all", LATTICE)
    wrong: list[dict[str, Any]] = [{"orientation": "up"}, {"levels": [9]}, {"azimuth": (0.0, math.nan)}]
    wrong += [{"azimuth": (0.0,)}, {"azimuth": 1.0}, {"azimuth": (0.0, -1.0)}, {"levels": 3}]
    for values in wrong:
        with pytest.raises(ValueError, match=next(iter(values))):
            layout.select(LATTICE, **values)


@pytest.mark.parametrize(
    ("values", "named"),
    [
        (("up", 0, 1), "orientation = 'up'"),
        (("custom", -1, 1), "start = -1"),
        (("custom", 0, 1.5), "end = 1.5"),
        (("custom", 0, True), "end = True"),
        (("custom", 2, 2), "end = 2: must differ from start"),
        (("custom", 0, 1, 1), "on = 1"),
    ],
)
def test_muscle_is_checked(values: tuple[Any, ...], named: str) -> None:
    """Each field by itself, and no muscle from a site to itself."""
    with pytest.raises(ValueError, match=named):
        Muscle(*values)


def test_layout_refuses_duplicates() -> None:
    """Two muscles between the same sites, either way round."""
    with pytest.raises(ValueError, match="more than one muscle ties sites 2 and 1"):
        MuscleLayout((Muscle("custom", 1, 2), Muscle("custom", 2, 1)))


@pytest.mark.parametrize(
    ("muscles", "named"),
    [
        (MuscleLayout((Muscle("custom", 0, 54),)), "site 54 does not exist; the lattice has sites 0 to 53"),
        (MuscleLayout((Muscle("horizontal", 6, 12),)), "is not horizontal"),
        (MuscleLayout((Muscle("vertical", 0, 6),)), "is not vertical"),
        (MuscleLayout((Muscle("vertical", 6, 7),)), "is not vertical"),
        ("contraction", "must be one of extension, compression, bending, all"),
        (3, "a layout as a mapping must be"),
        ({}, "a layout as a mapping must be"),
        ({"muscles": 3}, "muscles = 3: must be a sequence"),
        ({"muscles": ["vertical"]}, r"^muscles\[0\] = 'vertical': must be a mapping of orientation, start, end, on"),
        ({"muscles": [{"orientation": "custom", "start": 0}]}, "must be a mapping of orientation, start, end, on"),
        ({"muscles": [{"orientation": "custom", "start": 0, "end": 0}]}, "must differ from start"),
    ],
)
def test_resolve_layout_is_checked(muscles: Any, named: str) -> None:
    """Names, objects and dicts that do not fit the lattice say why."""
    with pytest.raises(ValueError, match=named):
        resolve_layout(muscles, LATTICE)


def test_tie_is_checked() -> None:
    """Pairs of sites of the lattice."""
    for pairs in ([(0, 60)], [(1, 1)], [(0,)], [0, 1], 5, [("a", 1)]):
        wrong: Any = pairs
        with pytest.raises(ValueError, match=r"pairs|site|Muscle"):
            tie(LATTICE, wrong)


@given(pairs=st.sets(st.frozensets(st.integers(0, 53), min_size=2, max_size=2), max_size=20), data=st.data())
@settings(max_examples=50, deadline=None)
def test_round_trips(pairs: set[frozenset[int]], data: st.DataObject) -> None:
    """Dicts survive JSON, layouts pickling, and a switched-off muscle stays off."""
    layout = tie(LATTICE, [(min(pair), max(pair)) for pair in pairs]) | named_layout("bending", LATTICE)
    mask = data.draw(st.lists(st.booleans(), min_size=len(layout), max_size=len(layout)))
    layout = layout.switched(np.array(mask, dtype=bool))
    assert resolve_layout(json.loads(json.dumps(layout.to_dict())), LATTICE) == layout
    assert pickle.loads(pickle.dumps(layout)) == layout
    assert len(layout) == sum(mask)


@pytest.mark.parametrize(
    ("name", "control", "count"),
    [
        ("all", "muscle", 90),
        ("all", "ring", 15),
        ("all", "column", 24),
        ("extension", "ring", 8),
        ("extension", "column", 12),
        ("compression", "ring", 7),
        ("compression", "column", 12),
    ],
)
def test_number_of_groups(name: str, control: str, count: int) -> None:
    """The default worm has 15 rings and 24 columns."""
    layout = named_layout(name, LATTICE)
    groups = control_groups(control, layout, LATTICE)
    assert groups.shape == (len(layout),)
    np.testing.assert_array_equal(np.unique(groups), np.arange(count))


@pytest.mark.parametrize("lattice", [LATTICE, *EVEN])
def test_groups_hold_what_belongs_together(lattice: Lattice) -> None:
    """Same orientation and level in a ring, same orientation and azimuth in a column, and no two groups alike."""
    layout = named_layout("all", lattice)
    middle = lattice.site_position[[[muscle.start, muscle.end] for muscle in layout.active]].mean(axis=1)
    level = _ends(layout, lattice.site_level).min(axis=1)
    for control in ("ring", "column"):
        kinds = []
        for group in range(int(control_groups(control, layout, lattice).max()) + 1):
            inside = control_groups(control, layout, lattice) == group
            orientation = {muscle.orientation for muscle, k in zip(layout.active, inside, strict=True) if k}
            places = set(level[inside].tolist())
            if control == "column" and (lattice.design.n_pairs > 2 or orientation == {"vertical"}):
                azimuth = np.arctan2(middle[inside, 1], middle[inside, 0])
                np.testing.assert_allclose(wrap_angle(azimuth - azimuth[0]), 0.0, atol=1e-9)
                places = {int(np.rint(azimuth[0] * lattice.design.n_pairs / math.pi * 100))}
            elif control == "column":
                # On a ring of two sites a muscle passes through the axis: even and odd levels differ.
                places = {int(value) % 2 for value in level[inside]}
            assert len(orientation) == len(places) == 1
            kinds.append((orientation.pop(), places.pop()))
        assert len(set(kinds)) == len(kinds)


def test_ring_is_that_of_the_lower_end() -> None:
    """Muscles of two and of four levels from one level share a ring."""
    layout = vertical(LATTICE, 2) | vertical(LATTICE, 4)
    lower = _ends(layout, LATTICE.site_level)[:, 0]
    np.testing.assert_array_equal(control_groups("ring", layout, LATTICE), lower)


def test_column_is_that_of_the_middle() -> None:
    """Muscles along, across to the left and across to the right about one azimuth share a column, at azimuth 0 too."""
    ring = [[6 * level + place for place in range(6)] for level in range(9)]
    pairs = []
    for place in range(6):
        # Level 1 stands half a place further round than level 0 and level 2.
        pairs += [
            (ring[0][place], ring[2][place]),
            (ring[1][place - 1], ring[1][place]),
            (ring[3][place], ring[3][place - 1]),
        ]
    groups = control_groups("column", tie(LATTICE, pairs), LATTICE).reshape(6, 3)
    np.testing.assert_array_equal(groups, np.repeat(np.arange(6), 3).reshape(6, 3))


def test_groups_of_active_muscles_only() -> None:
    """Muscles that are off have no group; with none on there is nothing to control."""
    layout = named_layout("all", LATTICE)
    half = layout.switched(layout.select(LATTICE, levels=[1, 2]))
    np.testing.assert_array_equal(np.bincount(control_groups("ring", half, LATTICE)), [6, 6, 6, 6])
    with pytest.raises(ValueError, match="at least one muscle must be on"):
        control_groups("muscle", layout.switched(np.zeros(90, dtype=bool)), LATTICE)


def test_partition() -> None:
    """Any sequence of groups, every one used."""
    layout = tie(LATTICE, [(0, 9), (1, 10), (2, 11)])
    np.testing.assert_array_equal(control_groups([1, 0, 1], layout, LATTICE), [1, 0, 1])
    np.testing.assert_array_equal(control_groups(np.array([0, 0, 0]), layout, LATTICE), [0, 0, 0])
    wrong: list[Any] = ["rings", [0, 2, 2], [1, 1, 1], [0, 1], [0, 1, -1], [0, 1, 0.5], None, 3, [[0], [0], [0]], []]
    wrong += [[0, 1, 10**12]]
    for control in wrong:
        with pytest.raises(ValueError, match="control"):
            control_groups(control, layout, LATTICE)
