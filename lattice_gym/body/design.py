"""The parameters of a lattice worm, their units and their bounds."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np

from lattice_gym.checks import (
    TAU,
    FloatArray,
    IntArray,
    Parameters,
    checked,
    choice,
    count,
    items,
    number,
    real,
    whole,
    wrap_angle,
)

CLOSING_TOLERANCE = 1e-9
"""Phases [rad] and period ratios (relative) this close to ones that close are taken as those.

Far above rounding, and far below anything that can be built.
"""
MIN_SEGMENT_SHARE = 0.05
"""Shortest segment allowed, as a share of the mean one.

The critical time step falls with the shortest element: below this an uneven lattice would cost more than twenty times
an even one.
"""
MAX_PHASE = 1e3
"""Largest phase [rad]: beyond it double precision does not hold the closing tolerance with room to spare."""
MAX_ELEMENTS = 100_000
"""Most elements in the structure (the default has 480): a slip in a count must not exhaust the memory."""


@dataclass(frozen=True)
class PhasePattern:
    """Where the rods start around the base, with the rounding of the given phases taken out.

    The rods of one chirality, ranked by azimuth at the base, repeat `symmetry` times around it: rank i starts at
    ``offset[i % m] + 2 pi (i // m) / symmetry`` with ``m = len(offset)``. So do the rods of the other chirality.
    """

    offset: tuple[float, ...]
    """Azimuths at the base of the ranks of one repeat [rad]."""
    symmetry: int
    """How often the pattern repeats around the base."""
    rank: tuple[int, ...]
    """Rank of each rod among those of its chirality."""

    def azimuth(self, rank: int) -> float:
        """Azimuth of a rank at the base [rad]; ranks beyond a turn go on counting up."""
        turn, index = divmod(rank, len(self.offset))
        return self.offset[index] + TAU * turn / self.symmetry

    def gaps(self) -> tuple[float, ...]:
        """Angles between neighbouring ranks [rad], over one repeat."""
        angles = [self.azimuth(rank) for rank in range(len(self.offset) + 1)]
        return tuple(b - a for a, b in pairwise(angles))


@dataclass(frozen=True, kw_only=True)
class LatticeDesign(Parameters):
    """Every parameter of a lattice worm; the defaults are Table 1 of Schaffer, Pamu and Webster-Wood (2024).

    Rod i runs on a cylinder of the given diameter at the azimuth ``chirality[i] 2 pi z / T + phases[i]``. The paper's
    ratio of the period T to the height is not legible; 3/2 gives its 42 vertical muscles.

    Raises
    ------
    ValueError
        What cannot be built, with the field, its value and the bound. Where the lattice does not close the message has
        the nearest period ratios that do, where rods overlap the largest radius that fits.
    """

    height: float = real(0.1, 1e-6, 1e3, "m")
    """From the base to the tops of the rods [m]: the body length, in which distances and speeds are given."""
    diameter: float = real(0.075, 1e-6, 1e3, "m")
    """Of the cylinder on which the rods' centre lines lie [m]."""
    n_pairs: int = count(6, 2, MAX_ELEMENTS)
    """Right-handed rods, of which there are as many as left-handed ones."""
    phases: tuple[float, ...] | None = None
    """Azimuth of each rod at the base [rad], shape (n_rod,); None: each chirality evenly spaced."""
    chirality: tuple[int, ...] | None = None
    """+1 (right-handed) or -1 (left-handed) for each rod, shape (n_rod,); None: the first half is right-handed."""
    period_ratio: float = real(1.5, 1e-6, 1e6, "1")
    """Height over which a rod turns once, over the height of the lattice."""

    elements_per_segment: int = count(5, 1, MAX_ELEMENTS)
    """Elements of a structure rod between two crossings."""
    elements_per_muscle: int = count(2, 2, 1000)
    """Elements of a muscle that is a rod."""
    damping_mesh: int | None = count(None, 1, MAX_ELEMENTS, none=True)
    """Elements per segment that the damping of the structure rods is stated for; None: those of this mesh.

    Damping is stated per node, so that a finer mesh is damped more; with this, rods have the damping per length of the
    mesh named here.
    """

    structure_radius: float = real(5e-3, 1e-9, 1e3, "m")
    """Of the structure rods [m]."""
    structure_density: float = real(1070.0, 1e-3, 1e6, "kg/m^3")
    """Of the structure rods [kg/m^3]."""
    structure_youngs_modulus: float = real(70e3, 1e-3, 1e13, "Pa")
    """Of the structure rods [Pa]."""
    structure_poisson_ratio: float = real(0.5, -1.0, 0.5, "1", above=True)
    """Of the structure rods."""
    muscle_radius: float = real(5e-3, 1e-9, 1e3, "m")
    """Of the muscles at rest [m]."""
    muscle_density: float = real(1060.0, 1e-3, 1e6, "kg/m^3")
    """Of the muscles [kg/m^3]."""
    muscle_youngs_modulus: float = real(25e3, 1e-3, 1e13, "Pa")
    """Of the muscles [Pa]."""
    muscle_poisson_ratio: float = real(0.5, -1.0, 0.5, "1", above=True)
    """Of the muscles."""
    muscle_model: str = checked("rod", choice, choices=("rod", "line"))
    """A Cosserat "rod", or a "line": straight, without nodes of its own, cheaper."""

    max_tension: float = real(0.5, 0.0, 1e6, "N")
    """Pull of a muscle whose activation is 1 [N]."""
    rise_time: float = real(0.015, 1e-6, 1e6, "s")
    """Time constant with which activation rises to its command [s] (Thelen 2003)."""
    decay_time: float = real(0.05, 1e-6, 1e6, "s")
    """Time constant with which activation falls to its command [s] (Thelen 2003)."""

    joint_stiffness: float = real(100.0, 1e-6, 1e12, "N/m")
    """Of the springs between the two nodes of a crossing, and between a muscle's ends and theirs [N/m]."""
    joint_damping: float = real(0.0, 0.0, 1e6, "N s/m")
    """Of the dashpots beside these springs [N s/m]."""
    damping: float = real(0.03, 0.0, 1e6, "N s/m per node")
    """Of the motion of every node [N s/m per node]."""
    rotational_damping: float = real(3.75e-7, 0.0, 1e6, "N m s per element")
    """Of the rotation of every element [N m s per element]; the paper has none.

    The default is damping times radius^2 / 2: twist decays as fast as motion. It changes no strain by 0.1 %, but with a
    tenth of it the twist of muscles under random activation grows within seconds until they turn over.
    """
    base: str = checked("clamped", choice, choices=("clamped", "free"))
    """Whether the lowest nodes and elements are "clamped", or the worm is "free"."""

    def __post_init__(self) -> None:
        """Check every field, then whether the lattice closes and its rods have room."""
        super().__post_init__()
        if 2 * self.n_pairs * self.elements_per_segment * max(1.0, 2 * self.n_pairs / self.period_ratio) > MAX_ELEMENTS:
            others = f"period_ratio = {self.period_ratio!r} and elements_per_segment = {self.elements_per_segment}"
            raise self._refused("n_pairs", f"with {others} makes more than {MAX_ELEMENTS} elements")
        if self.chirality is not None:
            self._check_rods("chirality", partial(whole, low=-1, high=1), "+1 or -1, one a rod")
            if self.chirality.count(1) != self.n_pairs or 0 in self.chirality:
                raise self._refused("chirality", "must hold +1 (right-handed) and -1 (left-handed) equally often")
        if self.phases is not None:
            each = partial(number, low=-MAX_PHASE, high=MAX_PHASE, unit="rad")
            self._check_rods("phases", each, "numbers, one a rod")
        self._check_closing()
        self._check_room()

    @property
    def n_rod(self) -> int:
        """Number of structure rods."""
        return 2 * self.n_pairs

    @property
    def n_segment(self) -> int:
        """Number of segments between consecutive crossings on every rod."""
        return round(2 * self.n_pairs / self.period_ratio)

    @property
    def period(self) -> float:
        """Height T over which a rod turns once [m]; period_ratio times height, to rounding exactly what closes."""
        return 2 * self.n_pairs / self.n_segment * self.height

    @property
    def damping_share(self) -> float:
        """Share of the stated damping that a node, or element, of a structure rod takes on this mesh."""
        return 1.0 if self.damping_mesh is None else self.damping_mesh / self.elements_per_segment

    @cached_property
    def rod_phases(self) -> FloatArray:
        """Azimuth of each rod at the base [rad], shape (n_rod,)."""
        if self.phases is None:
            phases = np.empty(self.n_rod)
            for sign in (1, -1):
                phases[self.rod_chirality == sign] = TAU / self.n_pairs * np.arange(self.n_pairs)
        else:
            phases = np.array(self.phases)
        phases.setflags(write=False)
        return phases

    @cached_property
    def rod_chirality(self) -> IntArray:
        """Chirality of each rod, +1 right-handed or -1 left-handed, shape (n_rod,)."""
        chirality = np.repeat([1, -1], self.n_pairs) if self.chirality is None else np.array(self.chirality)
        chirality = chirality.astype(np.int64)
        chirality.setflags(write=False)
        return chirality

    @cached_property
    def phase_pattern(self) -> PhasePattern:
        """Ranks and symmetry of the phases; coinciding rods, or a rod that meets none at the base, are a ValueError."""
        right, left = (np.flatnonzero(self.rod_chirality == sign) for sign in (1, -1))
        angle = self.rod_phases % TAU
        for hand, family in (("right", right), ("left", left)):
            order = family[np.argsort(angle[family], kind="stable")]
            gap = np.diff(angle[order], append=angle[order[0]] + TAU)
            closest = int(np.argmin(gap))
            if gap[closest] <= 2 * CLOSING_TOLERANCE:
                pair = f"{order[closest]} and {order[(closest + 1) % self.n_pairs]}"
                bound = f"{hand}-handed rods {pair} coincide; phases of one chirality must differ (modulo 2 pi)"
                raise self._refused("phases", bound)
            if hand == "right":
                right = order
        base = angle[right]
        after = np.searchsorted(base, angle[left]) % self.n_pairs
        apart = np.stack([np.abs(wrap_angle(angle[left] - base[near])) for near in (after - 1, after)])
        if np.any(stray := apart.min(axis=0) > CLOSING_TOLERANCE):
            rod = left[np.argmax(stray)]
            bound = f"left-handed rod {rod} starts where no right-handed rod does; every rod must start at a crossing"
            raise self._refused("phases", bound)
        rank = np.empty(self.n_rod, dtype=np.int64)
        rank[right] = np.arange(self.n_pairs)
        rank[left] = np.where(apart[0] < apart[1], after - 1, after) % self.n_pairs
        for symmetry in range(self.n_pairs, 0, -1):
            if self.n_pairs % symmetry == 0:
                repeat = self.n_pairs // symmetry
                shifted = np.append(base[repeat:], base[:repeat] + TAU) - TAU / symmetry
                if np.all(np.abs(shifted - base) <= CLOSING_TOLERANCE):
                    break
        return PhasePattern(tuple(base[:repeat].tolist()), symmetry, tuple(rank.tolist()))

    def to_json(self) -> str:
        """Fields as JSON text."""
        return json.dumps(self.to_dict(), indent=1)

    @classmethod
    def from_json(cls, text: str) -> LatticeDesign:
        """Design from JSON text; text that is not JSON is a ValueError."""
        try:
            values = json.loads(text)
        except (TypeError, ValueError, RecursionError) as error:
            raise ValueError(f"LatticeDesign.from_json: text is not JSON: {error}") from None
        return cls.from_dict(values)

    def _check_rods(self, name: str, each: Callable[[str, Any], float], what: str) -> None:
        """Check what is given for each rod."""
        values = items(self._label(name), getattr(self, name), each, self.n_rod, what)
        object.__setattr__(self, name, values)

    def _check_closing(self) -> None:
        """Every rod's last node must be a crossing: turned by 4 pi height / T, the phases fall on themselves."""
        steps = 2 * self.phase_pattern.symmetry
        exact = steps / self.period_ratio
        if abs(exact - round(exact)) > CLOSING_TOLERANCE * exact:
            nearest = [Fraction(steps, count) for count in (math.floor(exact) + 1, math.floor(exact)) if count > 0]
            named = " and ".join(f"{ratio} ({float(ratio)!r})" for ratio in nearest)
            raise self._refused("period_ratio", f"the lattice does not close; the nearest that close it: {named}")
        if self.n_segment * self.elements_per_segment < 2:
            bound = "must be at least 2 where a rod has one segment: PyElastica takes no rod of one element"
            raise self._refused("elements_per_segment", bound)

    def _check_room(self) -> None:
        """Crossings must not crowd, nor rods of one chirality overlap; other rods either cross or are further apart."""
        gap = min(self.phase_pattern.gaps())
        share = gap * self.n_pairs / TAU
        if share < MIN_SEGMENT_SHARE:
            bound = f"the shortest segment is {share:.3g} of the mean one, at least {MIN_SEGMENT_SHARE} is needed"
            raise self._refused("phases", bound)
        largest = self._rod_distance(gap) / 2
        if self.structure_radius > largest:
            bound = f"rods that never cross would overlap at rest; at most {largest!r} [m]"
            raise self._refused("structure_radius", bound)

    def _rod_distance(self, gap: float) -> float:
        """Least distance between two rods of one chirality whose phases differ by gap [m].

        A point and one further up the other rod, by which its lead shrinks to the angle a, are d apart,
        d^2 = diameter^2 sin^2(a/2) + (T/(2 pi))^2 (gap - a)^2. Its slope changes sign at most once within 0 < a < gap.
        """
        pitch = self.period / TAU
        low, high = max(0.0, gap - self.height / pitch), gap
        for _ in range(100):
            middle = (low + high) / 2
            rising = self.diameter**2 * math.sin(middle) / 4 > pitch**2 * (gap - middle)
            low, high = (low, middle) if rising else (middle, high)
        return math.hypot(self.diameter * math.sin(low / 2), pitch * (gap - low))
