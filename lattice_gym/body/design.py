"""The parameters of a lattice worm, their units and their bounds."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from numbers import Integral
from typing import Any

import numpy as np

from lattice_gym.checks import TURN, FloatArray, IntArray, finite_number, shown, wrap_angle

# Phases [rad] and period ratios (relative) this close to ones that close are taken as those: far above rounding, far
# below anything that can be built.
CLOSING_TOLERANCE = 1e-9
# Shortest segment allowed, as a share of the mean one: the stable time step falls with the shortest element, so below
# this an uneven lattice would cost more than twenty times an even one.
MIN_SEGMENT_SHARE = 0.05
# Beyond this a phase in double precision no longer holds the closing tolerance with room to spare [rad].
MAX_PHASE = 1e3
# Most elements in the structure (the default has 480): a slip in a count must not exhaust the memory.
MAX_ELEMENTS = 100_000


def _real(low: float, high: float, unit: str, default: float) -> Any:
    """Dataclass field for a float between low and high (both included)."""
    return field(default=default, metadata={"low": low, "high": high, "unit": unit})


def _count(low: int, high: int, default: int) -> Any:
    """Dataclass field for a whole number between low and high (both included)."""
    return field(default=default, metadata={"low": low, "high": high, "unit": None})


@dataclass(frozen=True)
class PhasePattern:
    """Where the rods start around the base, with the rounding of the given phases taken out.

    The rods of one chirality, ranked by azimuth at the base, repeat `symmetry` times around it: rank i starts at
    ``offset[i % m] + 2 pi (i // m) / symmetry`` with ``m = len(offset)``. So do the rods of the other chirality.
    """

    offset: tuple[float, ...]  # [rad]
    symmetry: int
    rank: tuple[int, ...]  # one per rod

    def azimuth(self, rank: int) -> float:
        """Azimuth of a rank at the base [rad]; ranks beyond a turn go on counting up."""
        turn, index = divmod(rank, len(self.offset))
        return self.offset[index] + TURN * turn / self.symmetry

    def gaps(self) -> tuple[float, ...]:
        """Angles between neighbouring ranks [rad], over one repeat."""
        angles = [self.azimuth(rank) for rank in range(len(self.offset) + 1)]
        return tuple(b - a for a, b in pairwise(angles))


@dataclass(frozen=True, kw_only=True)
class LatticeDesign:
    """Every parameter of a lattice worm; the defaults are Table 1 of Schaffer, Pamu and Webster-Wood (2024).

    Rod i runs on a cylinder of the given diameter at the azimuth ``chirality[i] 2 pi z / T + phases[i]``. The paper's
    ratio of the period T to the height is not legible; 3/2 gives its 42 vertical muscles. Rise and decay times follow
    Thelen (2003). The rotational damping is ours, damping times radius^2 / 2: twist then decays as fast as motion. It
    changes no strain by 0.1 %, but with a tenth of it the twist of muscles under random activation grows within seconds
    until they turn over. Damping is stated per node, so that a finer mesh is damped more; with ``damping_mesh`` the
    structure rods have the damping per length of that mesh, whatever theirs is. Anything that cannot be built is a
    ValueError that names field, value and bound.
    """

    # Shape
    height: float = _real(1e-6, 1e3, "m", 0.1)
    diameter: float = _real(1e-6, 1e3, "m", 0.075)
    n_pairs: int = _count(2, MAX_ELEMENTS, 6)
    phases: tuple[float, ...] | None = None  # [rad], one a rod; None: evenly spaced
    chirality: tuple[int, ...] | None = None  # +1 right-handed, -1 left-handed; None: the first half is right-handed
    period_ratio: float = _real(1e-6, 1e6, "1", 1.5)
    # Mesh
    elements_per_segment: int = _count(1, MAX_ELEMENTS, 5)
    elements_per_muscle: int = _count(2, 1000, 2)
    damping_mesh: int | None = None  # elements per segment that the rods' damping is stated for; None: this mesh's
    # Material
    structure_radius: float = _real(1e-9, 1e3, "m", 5e-3)
    structure_density: float = _real(1e-3, 1e6, "kg/m^3", 1070.0)
    structure_youngs_modulus: float = _real(1e-3, 1e13, "Pa", 70e3)
    structure_poisson_ratio: float = 0.5
    muscle_radius: float = _real(1e-9, 1e3, "m", 5e-3)
    muscle_density: float = _real(1e-3, 1e6, "kg/m^3", 1060.0)
    muscle_youngs_modulus: float = _real(1e-3, 1e13, "Pa", 25e3)
    muscle_poisson_ratio: float = 0.5
    muscle_model: str = "rod"  # "rod", or "line": no nodes of its own, cheaper
    # Actuation
    max_tension: float = _real(0.0, 1e6, "N", 0.5)
    rise_time: float = _real(1e-6, 1e6, "s", 0.015)
    decay_time: float = _real(1e-6, 1e6, "s", 0.05)
    # Connections, damping, base
    joint_stiffness: float = _real(1e-6, 1e12, "N/m", 100.0)
    joint_damping: float = _real(0.0, 1e6, "N s/m", 0.0)
    damping: float = _real(0.0, 1e6, "N s/m per node", 0.03)
    rotational_damping: float = _real(0.0, 1e6, "N m s per element", 3.75e-7)
    base: str = "clamped"

    def __post_init__(self) -> None:
        """Check every field, then whether the lattice closes and its rods have room."""
        for spec in fields(self):
            if "unit" in spec.metadata:
                self._check_bounds(spec.name, **spec.metadata)
        for name in ("structure_poisson_ratio", "muscle_poisson_ratio"):
            value = self._number(name, getattr(self, name), "1")
            if not -1.0 < value <= 0.5:
                raise self._error(name, value, "must be above -1 and at most 0.5")
            self._set(name, value)
        for name, choices in (("muscle_model", ("rod", "line")), ("base", ("clamped", "free"))):
            value = getattr(self, name)
            if not isinstance(value, str) or value not in choices:
                raise self._error(name, value, f'must be "{choices[0]}" or "{choices[1]}"')
        if self.damping_mesh is not None:
            if not 1 <= (mesh := self._whole("damping_mesh", self.damping_mesh)) <= MAX_ELEMENTS:
                bound = f"must be None or a whole number from 1 to {MAX_ELEMENTS}"
                raise self._error("damping_mesh", self.damping_mesh, bound)
            self._set("damping_mesh", mesh)
        if 2 * self.n_pairs * self.elements_per_segment * max(1.0, 2 * self.n_pairs / self.period_ratio) > MAX_ELEMENTS:
            others = f"period_ratio = {self.period_ratio!r} and elements_per_segment = {self.elements_per_segment}"
            raise self._error("n_pairs", self.n_pairs, f"with {others} makes more than {MAX_ELEMENTS} elements")
        self._check_chirality()
        self._check_phases()
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
                phases[self.rod_chirality == sign] = TURN / self.n_pairs * np.arange(self.n_pairs)
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
        angle = self.rod_phases % TURN
        for hand, family in (("right", right), ("left", left)):
            order = family[np.argsort(angle[family], kind="stable")]
            gap = np.diff(angle[order], append=angle[order[0]] + TURN)
            closest = int(np.argmin(gap))
            if gap[closest] <= 2 * CLOSING_TOLERANCE:
                pair = f"{order[closest]} and {order[(closest + 1) % self.n_pairs]}"
                bound = f"{hand}-handed rods {pair} coincide; phases of one chirality must differ (modulo 2 pi)"
                raise self._error("phases", self.phases, bound)
            if hand == "right":
                right = order
        base = angle[right]
        after = np.searchsorted(base, angle[left]) % self.n_pairs
        apart = np.stack([np.abs(wrap_angle(angle[left] - base[near])) for near in (after - 1, after)])
        if np.any(stray := apart.min(axis=0) > CLOSING_TOLERANCE):
            rod = left[np.argmax(stray)]
            bound = f"left-handed rod {rod} starts where no right-handed rod does; every rod must start at a crossing"
            raise self._error("phases", self.phases, bound)
        rank = np.empty(self.n_rod, dtype=np.int64)
        rank[right] = np.arange(self.n_pairs)
        rank[left] = np.where(apart[0] < apart[1], after - 1, after) % self.n_pairs
        for symmetry in range(self.n_pairs, 0, -1):
            if self.n_pairs % symmetry == 0:
                repeat = self.n_pairs // symmetry
                shifted = np.append(base[repeat:], base[:repeat] + TURN) - TURN / symmetry
                if np.all(np.abs(shifted - base) <= CLOSING_TOLERANCE):
                    break
        return PhasePattern(tuple(base[:repeat].tolist()), symmetry, tuple(rank.tolist()))

    def to_dict(self) -> dict[str, Any]:
        """Fields as JSON-safe values."""
        values = {spec.name: getattr(self, spec.name) for spec in fields(self)}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> LatticeDesign:
        """Design from some or all of its fields; an unknown name is a ValueError."""
        if not isinstance(values, Mapping):
            raise ValueError(
                f"LatticeDesign.from_dict: values = {values!r}: must be a mapping of field names to values"
            )
        known = [spec.name for spec in fields(cls)]
        for name in values:
            if name not in known:
                raise ValueError(f"LatticeDesign has no field {name!r}; its fields are {', '.join(known)}")
        return cls(**values)

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

    def _check_bounds(self, name: str, low: float, high: float, unit: str | None) -> None:
        given = getattr(self, name)
        if unit is None:
            value: float = self._whole(name, given)
            bound = f"must be a whole number from {low} to {high}"
        else:
            value = self._number(name, given, unit)
            sign = "not be negative" if low == 0.0 else "be positive"
            bound = f"must {sign} [{unit}], from {low:g} to {high:g}"
        if not low <= value <= high:
            raise self._error(name, given, bound)
        self._set(name, value)

    def _check_chirality(self) -> None:
        if self.chirality is not None:
            signs = tuple(self._whole("chirality", sign) for sign in self._sequence("chirality", self.chirality))
            if any(sign not in (1, -1) for sign in signs) or sum(signs) != 0:
                raise self._error(
                    "chirality", self.chirality, "must hold +1 (right-handed) and -1 (left-handed) equally often"
                )
            self._set("chirality", signs)

    def _check_phases(self) -> None:
        if self.phases is not None:
            phases = tuple(self._number("phases", phase, "rad") for phase in self._sequence("phases", self.phases))
            if any(abs(phase) > MAX_PHASE for phase in phases):
                raise self._error("phases", self.phases, f"each must be from -{MAX_PHASE:g} to {MAX_PHASE:g} [rad]")
            self._set("phases", phases)

    def _check_closing(self) -> None:
        """Every rod's last node must be a crossing: turned by 4 pi height / T, the phases fall on themselves."""
        steps = 2 * self.phase_pattern.symmetry
        exact = steps / self.period_ratio
        if abs(exact - round(exact)) > CLOSING_TOLERANCE * exact:
            nearest = [Fraction(steps, count) for count in (math.floor(exact) + 1, math.floor(exact)) if count > 0]
            named = " and ".join(f"{ratio} ({float(ratio)!r})" for ratio in nearest)
            raise self._error(
                "period_ratio", self.period_ratio, f"the lattice does not close; the nearest that close it: {named}"
            )
        if self.n_segment * self.elements_per_segment < 2:
            bound = "must be at least 2 where a rod has one segment: PyElastica takes no rod of one element"
            raise self._error("elements_per_segment", self.elements_per_segment, bound)

    def _check_room(self) -> None:
        """Crossings must not crowd, nor rods of one chirality overlap; other rods either cross or are further apart."""
        gap = min(self.phase_pattern.gaps())
        share = gap * self.n_pairs / TURN
        if share < MIN_SEGMENT_SHARE:
            bound = f"the shortest segment is {share:.3g} of the mean one, at least {MIN_SEGMENT_SHARE} is needed"
            raise self._error("phases", self.phases, bound)
        largest = self._rod_distance(gap) / 2
        if self.structure_radius > largest:
            bound = f"rods that never cross would overlap at rest; at most {largest!r} [m]"
            raise self._error("structure_radius", self.structure_radius, bound)

    def _rod_distance(self, gap: float) -> float:
        """Least distance between two rods of one chirality whose phases differ by gap [m].

        A point and one further up the other rod, by which its lead shrinks to the angle a, are d apart,
        d^2 = diameter^2 sin^2(a/2) + (T/(2 pi))^2 (gap - a)^2. Its slope changes sign at most once within 0 < a < gap.
        """
        pitch = self.period / TURN
        low, high = max(0.0, gap - self.height / pitch), gap
        for _ in range(100):
            middle = (low + high) / 2
            rising = self.diameter**2 * math.sin(middle) / 4 > pitch**2 * (gap - middle)
            low, high = (low, middle) if rising else (middle, high)
        return math.hypot(self.diameter * math.sin(low / 2), pitch * (gap - low))

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _error(self, name: str, value: object, bound: str) -> ValueError:
        return ValueError(f"LatticeDesign.{name} = {shown(value)}: {bound}")

    def _number(self, name: str, value: object, unit: str) -> float:
        number = finite_number(value)
        if number is None:
            raise self._error(name, value, f"must be a finite number [{unit}]")
        return number

    def _whole(self, name: str, value: object) -> int:
        """Whole number; 3.0, as other programs write 3 in JSON, is one."""
        if isinstance(value, Integral) and not isinstance(value, bool):
            return int(value)
        if isinstance(value, float) and value.is_integer():
            return int(value)
        raise self._error(name, value, "must be a whole number")

    def _sequence(self, name: str, value: object) -> tuple[object, ...]:
        if (
            isinstance(value, (Sequence, np.ndarray))
            and not isinstance(value, (str, bytes))
            and getattr(value, "ndim", 1) > 0
            and len(value) == self.n_rod
        ):
            return tuple(value)
        raise self._error(name, value, f"must be a sequence of 2 n_pairs = {self.n_rod} numbers")
