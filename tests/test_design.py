"""Every field is checked, and what cannot be built is refused with the field, the value and the bound."""

from __future__ import annotations

import json
import math
import pickle
import re
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lattice_gym.body.design import CLOSING_TOLERANCE, MIN_SEGMENT_SHARE, LatticeDesign
from lattice_gym.checks import TAU, wrap_angle

COUNTS = ("n_pairs", "elements_per_segment", "elements_per_muscle")
REALS = tuple(spec.name for spec in fields(LatticeDesign) if spec.type == "float")
MAY_BE_ZERO = ("max_tension", "joint_damping", "damping", "rotational_damping")
POISSON = ("structure_poisson_ratio", "muscle_poisson_ratio")


def _build(**values: Any) -> LatticeDesign:
    """Design from values of any type, right or wrong."""
    return LatticeDesign(**values)


def test_defaults_are_the_papers_table_1() -> None:
    """Table 1 of Schaffer, Pamu and Webster-Wood (2024), in SI units."""
    design = LatticeDesign()
    assert (design.height, design.diameter) == (0.100, 0.075)
    assert (design.n_rod, design.n_segment * design.elements_per_segment, design.elements_per_muscle) == (12, 40, 2)
    assert (design.structure_youngs_modulus, design.muscle_youngs_modulus) == (70e3, 25e3)
    assert (design.structure_poisson_ratio, design.muscle_poisson_ratio) == (0.5, 0.5)
    assert (design.structure_density, design.muscle_density) == (1070.0, 1060.0)
    assert (design.structure_radius, design.muscle_radius) == (5e-3, 5e-3)
    assert (design.damping, design.max_tension, design.joint_stiffness) == (0.03, 0.5, 100.0)
    assert (design.joint_damping, design.base) == (0.0, "clamped")
    assert design.period == pytest.approx(0.15, rel=1e-15)


def test_error_says_field_value_and_bound() -> None:
    """The message is fit to be shown as it is."""
    expected = "LatticeDesign.height = -1.0: must be a number from 1e-06 to 1000 [m]"
    with pytest.raises(ValueError, match=f"^{re.escape(expected)}$"):
        LatticeDesign(height=-1.0)


@pytest.mark.parametrize("name", [*COUNTS, *REALS])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, True, "1", None, 1j, [1.0], np.array([1.0]), 10**400])
def test_what_is_no_number_is_refused(name: str, value: object) -> None:
    """Neither kind of number field takes NaN, infinity, bool, text, None, complex, arrays or numbers too large."""
    with pytest.raises(ValueError, match=rf"LatticeDesign\.{name} = "):
        _build(**{name: value})


@pytest.mark.parametrize("name", [*COUNTS, *REALS])
def test_bounds(name: str) -> None:
    """Negative is refused everywhere but Poisson's ratio, zero where it means nothing, 1e300 everywhere."""
    refused = [1e300] if name in POISSON else [-1, -1e-12, 1e300] + ([] if name in MAY_BE_ZERO else [0])
    for value in refused:
        with pytest.raises(ValueError, match=rf"LatticeDesign\.{name} = "):
            _build(**{name: value})
    if name in MAY_BE_ZERO:
        assert getattr(_build(**{name: 0}), name) == 0.0


@pytest.mark.parametrize("name", POISSON)
def test_poisson_ratio_bounds(name: str) -> None:
    """Isotropic materials have ratios in (-1, 0.5]."""
    for value in (-1.0, 0.5000001, -2):
        with pytest.raises(ValueError, match=f"{name} = .*above -1 and at most 0.5"):
            _build(**{name: value})
    assert getattr(_build(**{name: -0.999}), name) == -0.999


def test_numbers_are_normalised() -> None:
    """Whole floats count, numpy numbers become Python's, and 0.5 pairs are refused."""
    design = _build(n_pairs=6.0, height=np.float32(0.5), period_ratio=np.int64(2))
    assert [type(value) for value in (design.n_pairs, design.height, design.period_ratio)] == [int, float, float]
    with pytest.raises(ValueError, match=r"n_pairs = 6\.5: must be a whole number"):
        _build(n_pairs=6.5)


@pytest.mark.parametrize("base", ["pinned", None, 1])
def test_base_choices(base: Any) -> None:
    """Only clamped and free bases exist."""
    with pytest.raises(ValueError, match=r"LatticeDesign\.base = .*: must be one of clamped, free$"):
        LatticeDesign(base=base)


@pytest.mark.parametrize("chirality", [[1] * 12, [1, -1], [1, 0] * 6, [True, -1] * 6, "+-" * 6, 1, [1.5, -1] * 6])
def test_chirality_is_checked(chirality: Any) -> None:
    """As many of each, one a rod, nothing but +1 and -1."""
    with pytest.raises(ValueError, match=r"LatticeDesign\.chirality(\[\d+\])? = "):
        LatticeDesign(chirality=chirality)


@pytest.mark.parametrize("phases", [[0.0], "abcdefghijkl", 3, [math.nan] * 12, [None] * 12, [[0.0]] * 12, [1e4] * 12])
def test_phases_are_checked(phases: Any) -> None:
    """One finite number of moderate size a rod."""
    with pytest.raises(ValueError, match=r"LatticeDesign\.phases(\[\d+\])? = "):
        LatticeDesign(phases=phases)


def test_default_phases_follow_the_chirality() -> None:
    """Each chirality is spread evenly by itself, in the order of its rods."""
    design = LatticeDesign(n_pairs=3, chirality=(1, -1, -1, 1, -1, 1))
    np.testing.assert_allclose(design.rod_phases, np.array([0, 0, 1, 1, 2, 2]) * TAU / 3)
    assert not design.rod_phases.flags.writeable
    assert not design.rod_chirality.flags.writeable


@pytest.mark.parametrize(("ratio", "n_segment"), [(1.5, 8), (4 / 3, 9), (1.0, 12), (2.0, 6), (12 / 7, 7), (12.0, 1)])
def test_ratios_that_close(ratio: float, n_segment: int) -> None:
    """T / h = 2 n_pairs / L gives L segments."""
    assert LatticeDesign(period_ratio=ratio).n_segment == n_segment


@pytest.mark.parametrize(
    ("ratio", "named"),
    [
        (1.4, "4/3 (1.3333333333333333) and 3/2 (1.5)"),
        (1.7, "3/2 (1.5) and 12/7 (1.7142857142857142)"),
        (100.0, "12 (12.0)"),
        (1.5 + 1e-8, "3/2 (1.5) and 12/7 (1.7142857142857142)"),
        (1.5 - 1e-8, "4/3 (1.3333333333333333) and 3/2 (1.5)"),
    ],
)
def test_other_ratios_name_the_nearest_that_close(ratio: float, named: str) -> None:
    """The message names the ratio and its neighbours, and these do close."""
    with pytest.raises(ValueError, match=re.escape(f"LatticeDesign.period_ratio = {ratio!r}: ")) as caught:
        LatticeDesign(period_ratio=ratio)
    assert named in str(caught.value)
    for nearest in re.findall(r"\((\d[\d.]*)\)", named):
        LatticeDesign(period_ratio=float(nearest))


@given(n_pairs=st.integers(2, 12), ratio=st.floats(0.3, 30.0))
@settings(max_examples=100, deadline=None)
def test_nearest_ratios_enclose_the_one_given(n_pairs: int, ratio: float) -> None:
    """Below and above, and no closing ratio lies between."""
    try:
        LatticeDesign(n_pairs=n_pairs, period_ratio=ratio, structure_radius=1e-4)
    except ValueError as error:
        named = sorted(float(number) for number in re.findall(r"\(([\d.]+)\)", str(error)))
        closing = [2 * n_pairs / count for count in range(1, 200)]
        expected = [max(value for value in closing if value < ratio)]
        expected += [min(value for value in closing if value > ratio)] if ratio < 2 * n_pairs else []
        np.testing.assert_allclose(named, expected, rtol=1e-15)
    else:
        count = 2 * n_pairs / ratio
        assert abs(count - round(count)) <= CLOSING_TOLERANCE * count


def test_coincident_rods_are_named() -> None:
    """Equal phases modulo a turn are an error that names the two rods."""
    phases = [*range(6), *range(6)]
    phases[3] = 1
    with pytest.raises(ValueError, match=r"phases = .*right-handed rods 1 and 3 coincide"):
        LatticeDesign(phases=tuple(phases))
    with pytest.raises(ValueError, match=r"phases = .*left-handed rods 6 and 9 coincide"):
        LatticeDesign(phases=(*range(6), 0, 1, 2, TAU, 4, 5))


def test_a_rod_that_meets_none_at_the_base_is_refused() -> None:
    """Left-handed rods turned against the right-handed ones do not start at crossings."""
    even = TAU / 6 * np.arange(6)
    with pytest.raises(ValueError, match=r"phases = .*rod 8 starts where no right-handed rod does"):
        LatticeDesign(phases=(*even, 0.0, even[1], 2.5, *even[3:]))


@pytest.mark.parametrize("shift", [0.0, 1e-10, -1e-10, 0.3, -1.0, TAU / 12, 100.0])
def test_a_turned_lattice_is_even(shift: float) -> None:
    """A shift of all phases turns the lattice and changes nothing else, wherever the circle is cut."""
    phases = tuple(TAU / 6 * np.tile(np.arange(6), 2) + shift)
    pattern = LatticeDesign(phases=phases).phase_pattern
    assert pattern.symmetry == 6
    starts = np.array([pattern.azimuth(rank) for rank in pattern.rank])
    np.testing.assert_allclose(wrap_angle(starts - phases), 0.0, atol=2e-9)
    assert pattern.rank[:6] == pattern.rank[6:]


def test_uneven_phases_close_where_they_repeat() -> None:
    """Phases that repeat twice a turn close at T / h = 4 / L, phases that never repeat at 2 / L."""
    twice = (0.0, 1.0, math.pi, math.pi + 1.0)
    assert LatticeDesign(n_pairs=4, phases=twice * 2, period_ratio=4 / 3).n_segment == 6
    with pytest.raises(ValueError, match=re.escape("close it: 4/3 (1.3333333333333333) and 2 (2.0)")):
        LatticeDesign(n_pairs=4, phases=twice * 2, period_ratio=1.6)
    never = (0.0, 1.0, 2.5, 4.0)
    assert LatticeDesign(n_pairs=4, phases=never * 2, period_ratio=2.0).n_segment == 4
    with pytest.raises(ValueError, match=re.escape("close it: 1 (1.0) and 2 (2.0)")):
        LatticeDesign(n_pairs=4, phases=never * 2, period_ratio=4 / 3)


def test_shortest_segment() -> None:
    """The stated share is the limit."""
    for share, fits in ((MIN_SEGMENT_SHARE * 1.01, True), (MIN_SEGMENT_SHARE * 0.99, False)):
        phases = (0.0, share * TAU / 3, 3.0)
        values: dict[str, Any] = {"n_pairs": 3, "phases": phases * 2, "period_ratio": 2.0, "structure_radius": 1e-4}
        if fits:
            _build(**values)
        else:
            with pytest.raises(ValueError, match=r"phases = .*shortest segment is 0\.0495 of the mean one"):
                _build(**values)


def _distance_of_rods_that_never_cross(design: LatticeDesign, count: int = 801) -> float:
    """Least distance between points of rods that share no crossing [m], by looking everywhere."""
    z = np.linspace(0.0, design.height, count)
    angle = design.rod_phases[:, None] + design.rod_chirality[:, None] * TAU / design.period * z
    radius = design.diameter / 2
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.broadcast_to(z, angle.shape)], axis=2)
    least = math.inf
    for one in range(design.n_rod):
        for other in range(one):
            if design.rod_chirality[one] != design.rod_chirality[other]:
                turns = np.sort((angle[one] - angle[other])[[0, -1]]) / TAU
                if math.ceil(turns[0] - 1e-9) <= turns[1] + 1e-9:
                    continue
            apart = np.linalg.norm(points[one][:, None] - points[other], axis=2)
            least = min(least, float(apart.min()))
    return least


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"n_pairs": 2, "period_ratio": 4.0},
        {"n_pairs": 2, "period_ratio": 1.0},
        {"n_pairs": 3, "period_ratio": 6.0, "height": 0.02},
        {"n_pairs": 3, "period_ratio": 0.25},
        {"n_pairs": 3, "phases": (0.0, 1.0, 3.0) * 2, "period_ratio": 2.0},
    ],
)
def test_thickest_rods(values: dict[str, Any]) -> None:
    """The named radius is half the least distance between rods that never cross; it builds and 0.1 % more does not."""
    with pytest.raises(ValueError, match=r"LatticeDesign\.structure_radius = 1\.0: .*would overlap at rest") as caught:
        _build(**values, structure_radius=1.0)
    largest = float(str(caught.value).split("at most ")[1].split(" ")[0])
    design = _build(**values, structure_radius=largest)
    assert 2 * largest == pytest.approx(_distance_of_rods_that_never_cross(design), rel=1e-4)
    with pytest.raises(ValueError, match="structure_radius"):
        _build(**values, structure_radius=largest * 1.001)


def test_too_many_elements() -> None:
    """A slip in a count is refused before anything is allocated."""
    for values in ({"n_pairs": 50_000}, {"period_ratio": 1e-5}, {"elements_per_segment": 10_000}):
        with pytest.raises(ValueError, match=r"n_pairs = .*more than 100000 elements"):
            _build(**values)


def test_a_rod_has_two_elements() -> None:
    """One segment of one element is one too few."""
    with pytest.raises(ValueError, match="elements_per_segment = 1: must be at least 2"):
        LatticeDesign(period_ratio=12.0, elements_per_segment=1)
    assert LatticeDesign(period_ratio=12.0, elements_per_segment=2).n_segment == 1


@given(
    n_pairs=st.integers(2, 8),
    shift=st.floats(-10.0, 10.0),
    height=st.floats(0.05, 1.0),
    poisson=st.floats(-0.9, 0.5),
    explicit=st.booleans(),
    base=st.sampled_from(["clamped", "free"]),
)
@settings(max_examples=60, deadline=None)
def test_round_trips(n_pairs: int, shift: float, height: float, poisson: float, explicit: bool, base: str) -> None:
    """JSON, dict and pickle give back an equal design with an equal hash."""
    phases = tuple(TAU / n_pairs * np.tile(np.arange(n_pairs), 2) + shift) if explicit else None
    design = LatticeDesign(
        n_pairs=n_pairs,
        phases=phases,
        chirality=(1,) * n_pairs + (-1,) * n_pairs if explicit else None,
        period_ratio=n_pairs / 4,
        height=height,
        structure_radius=1e-4,
        structure_poisson_ratio=poisson,
        base=base,
    )
    text = design.to_json()
    for copy in (
        LatticeDesign.from_json(text),
        LatticeDesign.from_dict(json.loads(json.dumps(design.to_dict()))),
        pickle.loads(pickle.dumps(design)),
    ):
        assert copy == design
        assert hash(copy) == hash(design)
        assert copy.to_json() == text


@pytest.mark.parametrize(
    "text", ["", "{", "[1]", "3", "null", '{"heigth": 0.1}', '{"height": NaN}', '{"n_pairs": "6"}']
)
def test_damaged_json(text: str) -> None:
    """Whatever is not a design's JSON is a ValueError that says so."""
    with pytest.raises(ValueError, match="LatticeDesign"):
        LatticeDesign.from_json(text)


def test_unknown_field_names_the_known_ones() -> None:
    """A misspelt field is not dropped."""
    with pytest.raises(ValueError, match=r"^LatticeDesign: there is no 'heigth'; there are height, diameter"):
        LatticeDesign.from_dict({"heigth": 0.1})
