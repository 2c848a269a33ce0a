"""Array types, and the one way in which arguments are checked.

A check takes an argument's name and what was given for it. It returns a plain number, text, bool, tuple or array, or
raises a ValueError like "LatticeDesign.height = -1: must be a number from 1e-06 to 1000 [m]".
`Parameters` is the base of dataclasses whose fields declare their checks.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, dataclass, field, fields
from functools import cache, partial
from inspect import getattr_static
from math import inf
from numbers import Real
from pkgutil import resolve_name
from typing import Any, Self, TypeGuard, TypeVar

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
TAU = 2.0 * math.pi

T = TypeVar("T")
Text = TypeVar("Text", bound=str)


def wrap_angle(angle: FloatArray) -> FloatArray:
    """Angles brought into [-pi, pi) [rad]."""
    return (angle + math.pi) % TAU - math.pi


def brief(value: object) -> str:
    """Repr of a value for a message, cut where it is long."""
    text = repr(value)
    return text if len(text) <= 200 else text[:200] + "..."


def invalid_value(name: str, value: object, must: str) -> ValueError:
    """Return the error to raise for a value: must says what it must be."""
    return ValueError(f"{name} = {brief(value)}: {must}")


def require(condition: bool, message: str) -> None:
    """Raise ValueError with a message unless the condition holds."""
    if not condition:
        raise ValueError(message)


def number(
    name: str, value: object, low: float = -inf, high: float = inf, unit: str = "", *, above: bool = False
) -> float:
    """Finite real number from low to high, both included unless it must lie above low; True and False are none."""
    given = _real(value)
    if math.isfinite(given) and (low < given if above else low <= given) and given <= high:
        return given
    raise invalid_value(name, value, _must_be("number", low, high, unit, above))


def whole(name: str, value: object, low: float = -inf, high: float = inf) -> int:
    """Whole number from low to high; 3.0, as other programs write 3 in JSON, is one, True and False are none."""
    given = value if isinstance(value, int | np.integer) and not isinstance(value, bool) else _real(value)
    if (not isinstance(given, float) or given.is_integer()) and low <= (exact := int(given)) <= high:
        return exact
    raise invalid_value(name, value, _must_be("whole number", low, high))


def choice(name: str, value: object, choices: Iterable[Text], *others: str) -> Text:
    """One of some texts; others say in words what else the argument takes."""
    known = tuple(choices)
    for text in known:
        if isinstance(value, str) and value == text:
            return text
    raise invalid_value(name, value, f"must be one of {', '.join((*known, *others))}")


def flag(name: str, value: object) -> bool:
    """Return True or False; numpy's count too."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    raise invalid_value(name, value, "must be True or False")


def instance(name: str, value: object, kind: type[T], how: str = "") -> T:
    """Object of a class; how says in words where to get one."""
    if isinstance(value, kind):
        return value
    raise invalid_value(name, value, f"must be {kind.__name__}{how}")


def subclass(name: str, value: object, kind: type[T], known: Mapping[str, type[T]]) -> type[T]:
    """Class by its name among the known ones, by "module:Class", or itself."""
    found = known.get(value, value) if isinstance(value, str) else value
    if isinstance(found, str) and ":" in found:
        found = import_code(name, found)
    if isinstance(found, type) and issubclass(found, kind):
        return found
    raise invalid_value(
        name, value, f'must be one of {", ".join(known)}, a subclass of {kind.__name__} or "module:Class"'
    )


def import_code(name: str, value: str) -> object:
    """Import what a module, "module:Class" or "module:" names; a ValueError where it cannot be."""
    try:
        return resolve_name(value if ":" in value else f"{value}:")
    except Exception as error:  # whatever the module raises
        must = f"cannot be imported: {type(error).__name__}: {error}"
        if isinstance(error, ModuleNotFoundError) and f"{value.split(':')[0]}.".startswith(f"{error.name}."):
            must += "; put the folder that holds it on PYTHONPATH, or run from there"
        raise invalid_value(name, value, must) from error


def code_names(name: str, values: object) -> Iterator[tuple[str, str]]:
    """Texts that name code, as "module:Class", in values as JSON has them, each with its place."""
    if isinstance(values, Mapping):
        for key, value in values.items():
            yield from code_names(f"{name}{': ' * bool(name)}{key}", value)
    elif isinstance(values, list | tuple):
        for place, value in enumerate(values):
            yield from code_names(f"{name}[{place}]", value)
    elif isinstance(values, str) and ":" in values:
        yield name, values


def without_imports(name: str, values: object) -> None:
    """Refuse what was read from a file where it names code that is not imported already.

    Reading a file never imports anything: whoever trusts it imports its modules first.
    """
    for place, text in code_names(name, values):
        module, _, path = text.partition(":")
        if module not in sys.modules:
            must = (
                f"names code, and reading a file imports none; if you trust it, import {module} first, or start the "
                f"program with --allow {module}"
            )
            raise invalid_value(place, text, must)
        found: object = sys.modules[module]
        for part in path.split("."):
            found = getattr_static(found, part, None)  # It runs nothing, such as a module's own __getattr__.
        if not isinstance(found, type):
            raise invalid_value(place, text, f"must be a class of {module}")


def array(
    name: str,
    values: npt.ArrayLike,
    shape: tuple[int | str, ...] | None = None,
    low: float = -inf,
    high: float = inf,
    unit: str = "",
    *,
    above: bool = False,
    spread: bool = False,
    read_only: bool = False,
    dtype: npt.DTypeLike = np.float64,
) -> npt.NDArray[Any]:
    """Copy of values as an array of finite numbers, each as `number` takes it.

    A name in the shape stands for any length. With spread, values of fewer axes are repeated to the shape.
    """
    try:
        given = np.asarray(values)
    except (TypeError, ValueError):
        given = np.array([None])
    if given.size and given.dtype.kind not in "fiu":
        raise invalid_value(name, values, "must be an array of real numbers")
    if given.dtype == dtype:
        copy = given.copy(order="K")
    else:
        with np.errstate(over="ignore"):  # What the type cannot hold becomes infinite, and is refused below.
            copy = given.astype(dtype) if given.size else np.zeros(given.shape, dtype)
    if spread:
        with suppress(ValueError):
            copy = np.array(np.broadcast_to(copy, [int(length) for length in shape or ()]))
    if shape is not None and (len(shape) != copy.ndim or any(map(_differ, copy.shape, shape))):
        wanted = f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})"
        raise ValueError(f"{name} has shape {copy.shape}: must have {wanted}{', or spread to it' * spread}")
    sound = np.isfinite(copy)
    if low > -inf:
        sound &= copy > low if above else copy >= low
    if high < inf:
        sound &= copy <= high
    if not sound.all():
        place = tuple(np.argwhere(~sound)[0].tolist())
        label = f"{name}[{', '.join(map(str, place))}]" if place else name
        raise invalid_value(label, copy[place].item(), _must_be("number", low, high, unit, above))
    if read_only:
        copy.flags.writeable = False
    return copy


def items(
    name: str, values: object, each: Callable[[str, Any], T], count: int | None = None, what: str = "values"
) -> tuple[T, ...]:
    """Items of a sequence, each checked under its own name, as many as count says."""
    unordered = isinstance(values, set | frozenset)
    sequence = isinstance(values, Iterable) and not isinstance(values, str | bytes | type | Mapping)
    if sequence and not unordered and getattr(values, "ndim", 1) > 0:
        given: tuple[Any, ...] = tuple(values)  # type: ignore[arg-type]
        if count is None or len(given) == count:
            return tuple(each(f"{name}[{k}]", value) for k, value in enumerate(given))
    number_of = what if count is None else f"{count} {what}"
    raise invalid_value(name, values, f"must be a sequence of {number_of}{'; a set has no order' * unordered}")


def is_list(value: object) -> TypeGuard[Sequence[Any]]:
    """Tell whether a value is a list of others: a list, tuple, range or NumPy array, but no text and no single number.

    What has no order, or can be read only once, is none.
    """
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def names(name: str, values: object, known: Collection[str], what: str = "values") -> Mapping[str, Any]:
    """Return a mapping of which every name is known."""
    if not isinstance(values, Mapping):
        raise invalid_value(name, values, f"must be a mapping of names to {what}")
    for given in values:
        if given not in known:
            raise ValueError(f"{name}: there is no {brief(given)}; there are {', '.join(known) or 'none'}")
    return values


def optional(check: Callable[..., T], name: str, value: object, *bounds: Any, **options: Any) -> T | None:
    """None, or what a check takes."""
    if value is None:
        return None
    try:
        return check(name, value, *bounds, **options)
    except ValueError as error:
        raise ValueError(f"{error}, or None") from None


def _real(value: object) -> float:
    """Value as a float; what is no real number, or too large for one, is not finite."""
    try:
        return float(value) if isinstance(value, Real) and not isinstance(value, bool) else math.nan
    except OverflowError:
        return math.inf


def _differ(length: int, wanted: int | str) -> bool:
    return isinstance(wanted, int) and length != wanted


def _must_be(kind: str, low: float, high: float, unit: str = "", above: bool = False) -> str:
    least, most = (f"{bound:g}" if isinstance(bound, float) else str(bound) for bound in (low, high))
    if kind == "number" and inf in (-low, high):
        kind = "finite number"
    if low == -inf:
        within = "" if high == inf else f", at most {most}"
    elif above:
        within = f" above {least}" + ("" if high == inf else f" and at most {most}")
    else:
        within = f", at least {least}" if high == inf else f" from {least} to {most}"
    return f"must be a {kind}{within}{f' [{unit}]' if unit else ''}"


REQUIRED: Any = MISSING
"""Default of a field of `Parameters` that must be given."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Parameters:
    """Values given by name, each checked as its field declares by `real`, `count` or `checked`."""

    def __post_init__(self) -> None:
        """Check every field that declares how; a subclass goes on with what must hold between them."""
        for name, label, check in _checks(type(self)):  # type: ignore[arg-type]
            object.__setattr__(self, name, check(label, getattr(self, name)))

    @classmethod
    def _label(cls, name: str) -> str:
        return f"{cls.__name__}.{name}"

    def _refused(self, name: str, must: str) -> ValueError:
        return invalid_value(self._label(name), getattr(self, name), must)

    def to_dict(self) -> dict[str, Any]:
        """Fields by name as JSON-safe values."""
        return {item.name: _plain(getattr(self, item.name)) for item in fields(self)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Make it from its fields by name; those that are missing have their defaults."""
        return cls(**names(cls.__name__, values, [item.name for item in fields(cls)]))

    @classmethod
    def resolve(cls, name: str, given: object) -> Self | None:
        """Take an object, its dict form or None."""
        if given is None:
            return None
        if isinstance(given, Mapping):
            return cls.from_dict(given)
        return instance(name, given, cls, ", its dict form or None")


@cache
def _checks(kind: type[Parameters]) -> list[tuple[str, str, Callable[[str, Any], Any]]]:
    """Name, label in messages and check of every field that declares how it is checked."""
    declared = (item for item in fields(kind) if "check" in item.metadata)
    return [(item.name, kind._label(item.name), item.metadata["check"]) for item in declared]


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value.to_dict() if isinstance(value, Parameters) else value


def checked(default: Any, check: Callable[..., Any], *, none: bool = False, **bounds: Any) -> Any:
    """Field of `Parameters` that holds what a check takes within bounds, or None; its metadata holds the bounds."""
    within = partial(check, **bounds)
    return field(default=default, metadata={"check": partial(optional, within) if none else within, **bounds})


def real(default: float | None, low: float, high: float, unit: str, *, above: bool = False, none: bool = False) -> Any:
    """Field that holds a `number`."""
    return checked(default, number, low=low, high=high, unit=unit, above=above, none=none)


def count(default: int | None, low: int = 0, high: float = inf, *, none: bool = False) -> Any:
    """Field that holds a `whole` number."""
    return checked(default, whole, low=low, high=high, none=none)
