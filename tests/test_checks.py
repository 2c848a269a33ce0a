"""Each check returns a plain value, or names the argument, the value, the bound and the unit."""

from __future__ import annotations

import ast
import inspect
import json
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from lattice_gym.body.design import LatticeDesign
from lattice_gym.checks import (
    Parameters,
    array,
    checked,
    choice,
    count,
    flag,
    instance,
    items,
    names,
    number,
    optional,
    real,
    whole,
)
from lattice_gym.physics.laws.activation import FirstOrder, Thelen, Twitch
from lattice_gym.physics.laws.adaptation import Adaptation
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.laws.base import tuple_of
from lattice_gym.physics.laws.contact import Contact
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.world import World

SHARE = partial(number, low=0.0, high=1.0)


@dataclass(frozen=True, kw_only=True)
class Wheel(Parameters):
    """A field of every kind."""

    radius: float = real(0.3, 0.0, 2.0, "m", above=True)
    spokes: int = count(8, 3, 100)
    load: float | None = real(None, 0.0, math.inf, "N", none=True)
    spring: str = checked("coil", choice, choices=("coil", "leaf"))
    braked: bool = checked(False, flag)
    holes: tuple[float, ...] = checked((0.1, 0.2), items, each=SHARE, what="shares")


@dataclass(frozen=True, kw_only=True)
class Cart(Parameters):
    """Parameters within parameters."""

    wheel: Wheel | None = checked(None, Wheel.resolve)


@pytest.mark.parametrize(
    ("check", "given", "taken"),
    [
        (partial(number, low=0.0), Fraction(1, 2), 0.5),
        (number, np.float32(0.5), 0.5),
        (number, 3, 3.0),
        (whole, 3.0, 3),
        (whole, np.uint8(200), 200),
        (whole, 10**400, 10**400),
        (partial(choice, choices=("a", "b")), "b", "b"),
        (flag, np.bool_(True), True),
        (partial(optional, flag), None, None),
        (partial(items, each=whole), iter([1, 2.0]), (1, 2)),
        (partial(items, each=whole, count=2), np.array([1, 2]), (1, 2)),
    ],
)
def test_what_is_taken_becomes_plain(check: Callable[..., Any], given: Any, taken: Any) -> None:
    """A value of Python's own type, whatever number or sequence stood for it."""
    value = check("x", given)
    assert (value, type(value)) == (taken, type(taken))


@pytest.mark.parametrize(
    ("check", "given", "message"),
    [
        (partial(number, low=0.0, high=1e3, unit="m"), -1, "x = -1: must be a number from 0 to 1000 [m]"),
        (partial(number, low=0.0, above=True, unit="s"), 0, "x = 0: must be a finite number above 0 [s]"),
        (partial(number, low=-1.0, high=0.5, above=True), -1, "x = -1: must be a number above -1 and at most 0.5"),
        (number, math.nan, "x = nan: must be a finite number"),
        (number, True, "x = True: must be a finite number"),
        (partial(number, high=2.0), math.inf, "x = inf: must be a finite number, at most 2"),
        (partial(whole, low=1), 0, "x = 0: must be a whole number, at least 1"),
        (partial(whole, low=0, high=2**32 - 1), 0.5, "x = 0.5: must be a whole number from 0 to 4294967295"),
        (whole, True, "x = True: must be a whole number"),
        (partial(choice, choices=("a", "b")), "c", "x = 'c': must be one of a, b"),
        (lambda name, value: choice(name, value, ("a",), "a file"), 1, "x = 1: must be one of a, a file"),
        (flag, 1, "x = 1: must be True or False"),
        (partial(optional, whole, low=0), -1, "x = -1: must be a whole number, at least 0, or None"),
        (partial(instance, kind=Wheel, how=", as Wheel() is"), 3, "x = 3: must be Wheel, as Wheel() is"),
        (partial(items, each=whole, what="sites"), "ab", "x = 'ab': must be a sequence of sites"),
        (partial(items, each=whole, count=2), {1, 2}, "x = {1, 2}: must be a sequence of 2 values; a set has no order"),
        (
            partial(items, each=whole),
            frozenset([1]),
            "x = frozenset({1}): must be a sequence of values; a set has no order",
        ),
        (tuple_of(Wheel), set(), "x = set(): must be a sequence of Wheel; a set has no order"),
        (partial(items, each=whole), [0, 0.5], "x[1] = 0.5: must be a whole number"),
        (partial(names, known=("a", "b")), {"c": 1}, "x: there is no 'c'; there are a, b"),
        (partial(names, known=("a",), what="numbers"), 3, "x = 3: must be a mapping of names to numbers"),
        (array, [1j], "x = [1j]: must be an array of real numbers"),
        (array, [[1.0], 2.0], "x = [[1.0], 2.0]: must be an array of real numbers"),
        (array, [0.0, math.nan], "x[1] = nan: must be a finite number"),
        (partial(array, low=0.0, unit="N"), [[1.0, -2.0]], "x[0, 1] = -2.0: must be a finite number, at least 0 [N]"),
        (partial(array, dtype=np.float32), 1e300, "x = inf: must be a finite number"),
        (partial(array, shape=("n_node", 3)), np.zeros(3), "x has shape (3,): must have (n_node, 3)"),
        (partial(array, shape=(2,), spread=True), np.zeros(3), "x has shape (3,): must have (2,), or spread to it"),
    ],
)
def test_what_is_refused_is_named(check: Callable[..., Any], given: Any, message: str) -> None:
    """Messages are fit to be shown as they are."""
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        check("x", given)


def test_arrays_are_copies() -> None:
    """Of the type, the shape and the axes asked for, and the caller's own array stays as it is."""
    given = np.arange(6).reshape(2, 3)
    copy = array("x", given, ("n", 3), low=0.0, high=5.0)
    copy[0, 0] = 9.0
    assert given[0, 0] == 0
    assert copy.dtype == np.float64
    np.testing.assert_array_equal(array("x", 0.5, (2, 1), spread=True), [[0.5], [0.5]])
    assert array("x", [], dtype=np.float32).dtype == np.float32


def test_fields_are_checked_and_survive_json() -> None:
    """Each as it declares; what is nested goes with it."""
    wheel = Wheel.from_dict({"radius": 1, "spokes": 6.0, "holes": [0.5]})
    assert (wheel.radius, wheel.spokes, wheel.holes) == (1.0, 6, (0.5,))
    assert [type(value) for value in (wheel.radius, wheel.spokes)] == [float, int]
    cart = Cart.from_dict({"wheel": {"load": 2}})
    assert cart.wheel == Wheel(load=2.0)
    assert Cart.from_dict(json.loads(json.dumps(cart.to_dict()))) == cart
    assert Cart.resolve("cart", None) is None
    assert Cart.resolve("cart", cart) is cart
    assert fields(Wheel)[0].metadata["unit"] == "m"


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"radius": 0}, "Wheel.radius = 0: must be a number above 0 and at most 2 [m]"),
        ({"load": "1"}, "Wheel.load = '1': must be a finite number, at least 0 [N], or None"),
        ({"holes": [0.5, 2]}, "Wheel.holes[1] = 2: must be a number from 0 to 1"),
        ({"tyre": 1}, "Wheel: there is no 'tyre'; there are radius, spokes, load, spring, braked, holes"),
        ([1], "cart = [1]: must be Wheel, its dict form or None"),
    ],
)
def test_fields_name_themselves(values: Any, message: str) -> None:
    """By class and field."""
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        Wheel.resolve("cart", values)


@pytest.mark.parametrize(
    "kind", [LatticeDesign, World, Medium, Ground, Ball, Contact, Hill, Adaptation, FirstOrder, Thelen, Twitch]
)
def test_every_parameter_of_a_scene_has_a_docstring_of_its_own(kind: type[Parameters]) -> None:
    """One a field: a reader looks for it under the field's name."""
    (tree,) = ast.parse(inspect.getsource(kind)).body
    assert isinstance(tree, ast.ClassDef)
    own = [(part, after) for part, after in pairwise(tree.body) if isinstance(part, ast.AnnAssign)]
    assert own
    assert [ast.unparse(part.target) for part, after in own if not isinstance(after, ast.Expr)] == []
