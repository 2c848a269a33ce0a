"""Which sites each muscle ties, and which muscles act together."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from lattice_gym.body.lattice import Lattice
from lattice_gym.checks import (
    TAU,
    FloatArray,
    IntArray,
    choice,
    flag,
    instance,
    invalid_value,
    items,
    number,
    require,
    whole,
    wrap_angle,
)

ORIENTATIONS = ("horizontal", "vertical", "custom")
CONTROLS = ("muscle", "ring", "column")
LAYOUTS = ("extension", "compression", "bending", "all")
AZIMUTH_TOLERANCE = 1e-6
"""Azimuths closer than this are one [rad]: far above rounding, far below the angle between two sites."""
BENDING_VERTICAL_HALF_WIDTH, BENDING_HORIZONTAL_HALF_WIDTH = math.radians(30.0), math.radians(60.0)
"""Half widths of the sectors of the bending layout [rad].

Vertical muscles shorten the side that the worm bends to, rings on the other side lengthen that one.
"""


@dataclass(frozen=True)
class Muscle:
    """A muscle between two sites: "vertical" (longitudinal), "horizontal" (circumferential) or "custom"; on or off."""

    orientation: str
    start: int
    end: int
    on: bool = True

    def __post_init__(self) -> None:
        """Check what can be checked without a lattice."""
        object.__setattr__(self, "orientation", choice("Muscle.orientation", self.orientation, ORIENTATIONS))
        object.__setattr__(self, "start", whole("Muscle.start", self.start, 0))
        object.__setattr__(self, "end", whole("Muscle.end", self.end, 0))
        if self.start == self.end:
            raise invalid_value("Muscle.end", self.end, "must differ from start, or the muscle has no length")
        object.__setattr__(self, "on", flag("Muscle.on", self.on))

    @property
    def sites(self) -> frozenset[int]:
        """The two sites, either way round."""
        return frozenset((self.start, self.end))


@dataclass(frozen=True)
class MuscleLayout:
    """Muscles in a fixed order, no two between the same sites; ``len`` counts those switched on."""

    muscles: tuple[Muscle, ...] = ()

    def __post_init__(self) -> None:
        """Refuse what is no muscle and a second muscle between the same two sites."""
        object.__setattr__(self, "muscles", items("MuscleLayout.muscles", self.muscles, _muscle, what="Muscle"))
        seen = set()
        for muscle in self.muscles:
            if muscle.sites in seen:
                tied = f"sites {muscle.start} and {muscle.end}"
                raise ValueError(f"MuscleLayout.muscles: more than one muscle ties {tied}; leave one out")
            seen.add(muscle.sites)

    def __repr__(self) -> str:
        kinds = Counter(muscle.orientation for muscle in self.active)
        listed = ", ".join(f"{kinds[kind]} {kind}" for kind in ORIENTATIONS if kinds[kind])
        return f"MuscleLayout({len(self)} of {len(self.muscles)} muscles on{': ' if listed else ''}{listed})"

    @property
    def active(self) -> tuple[Muscle, ...]:
        """The muscles that are on."""
        return tuple(muscle for muscle in self.muscles if muscle.on)

    def __len__(self) -> int:
        """Return the number of muscles that are on."""
        return len(self.active)

    def __or__(self, other: MuscleLayout) -> MuscleLayout:
        """Union: these muscles, then those of the other layout that tie other sites."""
        seen = {muscle.sites for muscle in self.muscles}
        return MuscleLayout(self.muscles + tuple(muscle for muscle in other.muscles if muscle.sites not in seen))

    def select(
        self,
        lattice: Lattice,
        orientation: str | None = None,
        levels: Iterable[int] | None = None,
        azimuth: tuple[float, float] | None = None,
    ) -> npt.NDArray[np.bool_]:
        """Mask of the muscles, on or off, that meet every condition given, shape (len(muscles),).

        ``levels`` compares the muscle's lower level. ``azimuth`` = (centre, half width) [rad] must hold both ends.
        """
        mask = np.ones(len(self.muscles), dtype=np.bool_)
        if orientation is not None:
            kind = choice("orientation", orientation, ORIENTATIONS)
            mask &= np.array([muscle.orientation == kind for muscle in self.muscles], dtype=np.bool_)
        sites = _sites(self.muscles, lattice)
        if levels is not None:
            _need_levels("levels", lattice)
            mask &= np.isin(lattice.site_level[sites].min(axis=1), _levels("levels", levels, lattice))
        if azimuth is not None:
            centre, half_width = items("azimuth", azimuth, _angle, 2, "angles [rad]: centre and half width")
            if half_width < 0.0:
                raise invalid_value("azimuth", azimuth, "the half width must not be negative [rad]")
            apart = np.abs(wrap_angle(lattice.site_azimuth[sites] - centre))
            mask &= np.all(apart <= half_width + AZIMUTH_TOLERANCE, axis=1)
        return mask

    def switched(self, mask: npt.ArrayLike) -> MuscleLayout:
        """Layout with exactly the masked muscles on; mask: bool, shape (len(muscles),)."""
        on, shape = np.asarray(mask), (len(self.muscles),)
        if on.dtype != np.bool_ or on.shape != shape:
            raise ValueError(f"mask of {on.dtype} with shape {on.shape}: must be bool with shape {shape}")
        return MuscleLayout(tuple(replace(muscle, on=bool(k)) for muscle, k in zip(self.muscles, on, strict=True)))

    def to_dict(self) -> dict[str, Any]:
        """Return JSON-safe values."""
        return {"muscles": [dict(vars(muscle)) for muscle in self.muscles]}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> MuscleLayout:
        """Layout from its dict form."""
        if not isinstance(values, Mapping) or set(values) != {"muscles"}:
            raise invalid_value("muscles", values, 'a layout as a mapping must be {"muscles": [...]}')
        return cls(items("muscles", values["muscles"], _muscle_of, what="mappings"))


def _muscle(name: str, value: object) -> Muscle:
    return instance(name, value, Muscle)


def _muscle_of(name: str, value: Any) -> Muscle:
    try:
        return Muscle(**value)
    except TypeError:
        raise invalid_value(name, value, "must be a mapping of orientation, start, end, on") from None


def horizontal(lattice: Lattice, levels: Iterable[int] | None = None) -> MuscleLayout:
    """Muscles between neighbours on the rings of the given levels, by default all but the base."""
    _need_levels("horizontal", lattice)
    muscles: list[Muscle] = []
    for level in _levels("levels", range(1, lattice.n_level) if levels is None else levels, lattice):
        ring = np.flatnonzero(lattice.site_level == level).tolist()
        pairs = list(zip(ring, ring[1:] + ring[:1], strict=True))
        # Both ways round a ring of two sites tie the same two.
        muscles += [Muscle("horizontal", start, end) for start, end in (pairs if len(ring) > 2 else pairs[:1])]
    return MuscleLayout(tuple(muscles))


def vertical(lattice: Lattice, span: int = 2) -> MuscleLayout:
    """Muscles from each site to the one of the same azimuth, span levels up.

    The span is even, as the sites of neighbouring levels alternate in azimuth.
    """
    _need_levels("vertical", lattice)
    highest = lattice.n_level - 1
    if (levels := whole("span", span)) % 2 or not 2 <= levels <= highest:
        must = f"a vertical muscle spans an even number of levels, from 2 to the {highest} there are"
        raise invalid_value("span", span, must)
    muscles: list[Muscle] = []
    for level in range(lattice.n_level - levels):
        lower, upper = (np.flatnonzero(lattice.site_level == at) for at in (level, level + levels))
        apart = np.abs(wrap_angle(lattice.site_azimuth[lower][:, None] - lattice.site_azimuth[upper]))
        ends = upper[apart.argmin(axis=1)]
        muscles += [Muscle("vertical", int(low), int(high)) for low, high in zip(lower, ends, strict=True)]
    return MuscleLayout(tuple(muscles))


def diagonal(lattice: Lattice) -> MuscleLayout:
    """Muscles along the rods: from each site to both of its neighbours one level up.

    They come hand by hand: first those that run as right-handed rods do, then the left-handed ones.
    """
    _need_levels("diagonal", lattice)
    muscles: list[Muscle] = []
    for hand in (0, 1):
        rod, node = lattice.site_rod[:, hand], lattice.site_node[:, hand]
        order = np.lexsort((node, rod))
        muscles += [
            Muscle("custom", int(low), int(high)) for low, high in pairwise(order.tolist()) if rod[low] == rod[high]
        ]
    return MuscleLayout(tuple(muscles))


def tie(lattice: Lattice, pairs: Iterable[tuple[int, int]]) -> MuscleLayout:
    """Make custom muscles between pairs of sites."""
    pair = partial(items, each=partial(whole, low=0), count=2, what="sites")
    tied = items("pairs", pairs, pair, what="pairs of sites")
    return resolve_layout(MuscleLayout(tuple(Muscle("custom", start, end) for start, end in tied)), lattice)


def bending_layout(lattice: Lattice, azimuth: float = 0.0) -> MuscleLayout:
    """Muscles that bend the worm towards an azimuth [rad], symmetric about the plane through it."""
    towards = (_angle("azimuth", azimuth), BENDING_VERTICAL_HALF_WIDTH)
    away = (towards[0] + math.pi, BENDING_HORIZONTAL_HALF_WIDTH)
    layout = horizontal(lattice) | vertical(lattice)
    mask = layout.select(lattice, "vertical", azimuth=towards) | layout.select(lattice, "horizontal", azimuth=away)
    return MuscleLayout(layout.switched(mask).active)


def named_layout(name: str, lattice: Lattice) -> MuscleLayout:
    """Layout by name: "extension" (rings), "compression" (vertical), "bending" or "all" (rings and vertical)."""
    name = choice("muscles", name, LAYOUTS, "a MuscleLayout or its dict form")
    if name == "extension":
        return horizontal(lattice)
    if name == "compression":
        return vertical(lattice)
    if name == "bending":
        return bending_layout(lattice)
    return horizontal(lattice) | vertical(lattice)


def resolve_layout(muscles: str | MuscleLayout | Mapping[str, Any], lattice: Lattice) -> MuscleLayout:
    """Layout from a name, an object or a dict, checked against the lattice."""
    if isinstance(muscles, str):
        return named_layout(muscles, lattice)
    layout = muscles if isinstance(muscles, MuscleLayout) else MuscleLayout.from_dict(muscles)
    start, end = _sites(layout.muscles, lattice).T
    level, apart = lattice.site_level, np.abs(wrap_angle(lattice.site_azimuth[start] - lattice.site_azimuth[end]))
    on_ring = (level[start] == level[end]) & (level[start] >= 0)
    in_column = (level[start] != level[end]) & (apart <= AZIMUTH_TOLERANCE)
    for muscle, ring, column in zip(layout.muscles, on_ring, in_column, strict=True):
        if not {"horizontal": ring, "vertical": column, "custom": True}[muscle.orientation]:
            raise ValueError(
                f"muscles: {muscle} is not {muscle.orientation} in this lattice: a horizontal muscle ties sites of one"
                " level, a vertical one sites of one azimuth; a custom one ties any two"
            )
    return layout


def control_groups(control: str | Sequence[int] | IntArray, layout: MuscleLayout, lattice: Lattice) -> IntArray:
    """Group that drives each active muscle, shape (len(layout),); groups count from 0.

    "muscle": each its own. "ring": one a level (the lower of a muscle's two) and orientation. "column": one an azimuth
    (of the muscle's middle) and orientation. Or any partition: the group of each active muscle, every group used.
    """
    muscles = layout.active
    require(len(muscles) > 0, "muscles: at least one muscle must be on to be controlled")
    if not isinstance(control, str):
        return _partition(control, len(muscles))
    control = choice("control", control, CONTROLS, "a sequence of groups")
    if control == "muscle":
        return np.arange(len(muscles), dtype=np.int64)
    sites = _sites(muscles, lattice)
    orientation = np.array([ORIENTATIONS.index(muscle.orientation) for muscle in muscles])
    if control == "ring":
        no_levels = 'control = "ring": the lattice has uneven phases and no levels; choose "muscle" or "column"'
        require(lattice.n_level > 0, no_levels)
        place = lattice.site_level[sites].min(axis=1)
    else:
        place = _columns(lattice.site_azimuth[sites])
    return np.unique(np.stack([orientation, place], axis=1), axis=0, return_inverse=True)[1].astype(np.int64)


_angle = partial(number, unit="rad")


def _need_lattice(lattice: Lattice) -> None:
    instance("lattice", lattice, Lattice, ", such as build_lattice(design) gives")


def _need_levels(name: str, lattice: Lattice) -> None:
    _need_lattice(lattice)
    no_levels = f"{name}: a lattice with uneven phases has no levels; tie its sites by hand with tie()"
    require(lattice.n_level > 0, no_levels)


def _levels(name: str, levels: Iterable[int], lattice: Lattice) -> list[int]:
    """Levels without repetition, each one of the lattice's."""
    given = items(name, levels, partial(whole, low=0, high=lattice.n_level - 1), what="levels")
    return list(dict.fromkeys(given))


def _sites(muscles: Sequence[Muscle], lattice: Lattice) -> IntArray:
    """Start and end sites, shape (n, 2), each one of the lattice's."""
    _need_lattice(lattice)
    sites = np.array([(muscle.start, muscle.end) for muscle in muscles], dtype=np.int64).reshape(-1, 2)
    if sites.size and sites.max() >= lattice.n_site:
        raise ValueError(f"muscles: site {sites.max()} does not exist; the lattice has sites 0 to {lattice.n_site - 1}")
    return sites


def _partition(control: Sequence[int] | IntArray, n_muscle: int) -> IntArray:
    groups = items("control", control, partial(whole, low=0), n_muscle, "groups, one for each active muscle")
    unused = [expected for expected, group in enumerate(sorted(set(groups))) if expected != group]
    if unused:
        raise ValueError(f"control: group {unused[0]} drives no muscle; groups must be 0 to n - 1, each used")
    return np.array(groups, dtype=np.int64)


def _columns(azimuth: FloatArray) -> IntArray:
    """Column of each muscle: those whose middles share an azimuth; azimuths of both ends [rad], shape (n, 2)."""
    start, end = azimuth.T
    middle = (start + wrap_angle(end - start) / 2) % TAU
    order = np.argsort(middle, kind="stable")
    column = np.empty(len(middle), dtype=np.int64)
    column[order] = np.cumsum(np.diff(middle[order], prepend=middle[order[0]]) > AZIMUTH_TOLERANCE)
    if middle[order[0]] + TAU - middle[order[-1]] <= AZIMUTH_TOLERANCE:
        column[column == column.max()] = 0
    return column
