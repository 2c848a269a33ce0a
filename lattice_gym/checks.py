"""Array types, and the checks that turn what a caller gives into what it is, or into a ValueError that names it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from numbers import Integral, Real
from typing import Any, ClassVar, Self, TypeGuard

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
TURN = 2.0 * math.pi


def is_number(value: object) -> TypeGuard[float]:
    """Tell whether a value is a real number; True and False are not."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def wrap_angle(angle: FloatArray) -> FloatArray:
    """Angles brought into [-pi, pi) [rad]."""
    return (angle + math.pi) % TURN - math.pi


def finite_number(value: object) -> float | None:
    """Finite real number as a float, or None; True and False are none."""
    if isinstance(value, Real) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            return None
        if math.isfinite(number):
            return number
    return None


def whole_number(value: object) -> int | None:
    """Whole number as an int, or None; True and False are none."""
    return int(value) if isinstance(value, Integral) and not isinstance(value, bool) else None


def real_array(name: str, values: npt.ArrayLike) -> FloatArray:
    """Copy of values as an array of floats; a ValueError of that name if they are not all finite real numbers."""
    try:
        given = np.asarray(values)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: must be an array of real numbers, got {shown(values)}") from None
    if given.dtype.kind not in "fiu" and given.size:
        raise ValueError(f"{name}: must be an array of real numbers, got {shown(values)}")
    with np.errstate(over="ignore"):
        array = given.astype(np.float64) if given.size else np.zeros(given.shape)
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: must be finite")
    return array


def shown(value: object) -> str:
    """Repr of a value for a message, cut where it is long."""
    text = repr(value)
    return text if len(text) <= 200 else text[:200] + "..."


Bounds = dict[str, tuple[float, float, str]]


def known_fields(kind: type, values: Mapping[str, Any], what: str) -> Mapping[str, Any]:
    """Values whose names are all fields of a kind; anything else is a ValueError."""
    if not isinstance(values, Mapping):
        raise ValueError(f"{kind.__name__}: must be a mapping of names to {what}, got {shown(values)}")
    known = [item.name for item in fields(kind)]
    unknown = [name for name in values if name not in known]
    if unknown:
        raise ValueError(f"{kind.__name__}: has no {unknown[0]!r}; it has {', '.join(known)}")
    return values


@dataclass(frozen=True, kw_only=True)
class Part:
    """Numbers within bounds, given by name; anything else is a ValueError that names the field."""

    bounds: ClassVar[Bounds]
    """Least and largest value of every number, both included, and its unit."""
    optional: ClassVar[tuple[str, ...]] = ()
    """Numbers that may be None."""

    def __post_init__(self) -> None:
        for name, (low, high, unit) in self.bounds.items():
            given = getattr(self, name)
            if given is None and name in self.optional:
                continue
            number = finite_number(given)
            if number is None or not low <= number <= high:
                label = f"{type(self).__name__}.{name} = {shown(given)}"
                raise ValueError(f"{label}: must be a number from {low:g} to {high:g} [{unit}]")
            object.__setattr__(self, name, number)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Make it from its fields by name; those that are missing have their defaults."""
        return cls(**known_fields(cls, values, "numbers"))

    @classmethod
    def resolve(cls, name: str, given: object) -> Self | None:
        """Take an object, its dict form or None; anything else is a ValueError of that name."""
        if given is None or isinstance(given, cls):
            return given
        if isinstance(given, Mapping):
            return cls.from_dict(given)
        raise ValueError(f"{name} = {shown(given)}: must be {cls.__name__}, its dict form or None")
