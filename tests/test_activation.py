"""Activation laws against closed forms, small steps and what every such law must keep."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lattice_gym.body.design import LatticeDesign
from lattice_gym.checks import FloatArray
from lattice_gym.physics.laws.activation import (
    ACTIVATIONS,
    Activation,
    FirstOrder,
    Thelen,
    Twitch,
    advance_activation,
    resolve_activation,
)

SHARE = st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3).map(np.array)


def _stepped(law: Activation, state: FloatArray, command: FloatArray, duration: float) -> FloatArray:
    """State after Runge-Kutta steps, so small that their error is below 1e-9, of the equations in the docstrings."""
    u = command

    def slope(y: FloatArray) -> FloatArray:
        a = y[0]
        if isinstance(law, Twitch):
            time = law.contraction_time
            return np.stack([y[1], (u - a - 2.0 * time * y[1]) / time**2])
        assert isinstance(law, FirstOrder | Thelen)
        share = 0.5 + 1.5 * a if isinstance(law, Thelen) else np.ones_like(a)
        rate: FloatArray = (u - a) / np.where(u > a, law.rise_time * share, law.decay_time / share)
        return rate[None]

    n_step = 800
    y, h = state, duration / n_step
    for _ in range(n_step):
        one = slope(y)
        two = slope(y + h / 2 * one)
        three = slope(y + h / 2 * two)
        y = y + h / 6 * (one + 2 * two + 2 * three + slope(y + h * three))
    return y


@pytest.mark.parametrize("law", [FirstOrder(), Thelen(), Thelen(rise_time=0.03, decay_time=0.01), Twitch()])
@given(commands=st.lists(SHARE, min_size=1, max_size=3), duration=st.floats(0.0, 0.1))
@settings(max_examples=20, deadline=None)
def test_laws_solve_their_equations(law: Activation, commands: list[FloatArray], duration: float) -> None:
    """Over a few commands from rest; in two parts as in one; never out of bounds; the state is left alone."""
    state = law.rest(3)
    assert state.shape == (law.n_state, 3)
    for command in commands:
        kept = state.copy()
        after = law.advance(state, command, duration)
        np.testing.assert_allclose(after, _stepped(law, state, command, duration), rtol=1e-6, atol=1e-8)
        halves = law.advance(law.advance(state, command, 0.5 * duration), command, 0.5 * duration)
        np.testing.assert_allclose(halves, after, rtol=1e-9, atol=1e-13)
        assert np.array_equal(state, kept)
        assert (after[0] >= 0.0).all()
        assert (after[0] <= 1.0).all()
        if not isinstance(law, Twitch):
            assert (np.abs(after[0] - command) <= np.abs(state[0] - command)).all()
            assert ((after[0] - command) * (state[0] - command) >= 0.0).all()
        state = after


@pytest.mark.parametrize("law", [kind() for kind in ACTIVATIONS.values()])
@pytest.mark.parametrize("duration", [0.0, 1e-9, 10.0, 1e9])
def test_laws_bear_any_duration(law: Activation, duration: float) -> None:
    """None changes nothing; the longest ends at the command; shapes of batches are kept."""
    command = np.linspace(0.0, 1.0, 8).reshape(2, 4)
    start = law.advance(law.rest((2, 4)), command[::-1], 0.02)
    after = law.advance(start, command, duration)
    assert after.shape == (law.n_state, 2, 4)
    if duration == 0.0:
        np.testing.assert_allclose(after, start, rtol=1e-14, atol=1e-15)
    if duration >= 10.0:
        np.testing.assert_allclose(after[0], command, rtol=1e-8, atol=1e-8)


def test_first_order_is_followed_to_the_last_bit() -> None:
    """The checked function and the law are one."""
    rng = np.random.default_rng(0)
    now, command = rng.random((2, 5, 7))
    law = FirstOrder(rise_time=0.02, decay_time=0.07)
    assert np.array_equal(law.advance(now[None], command, 0.05)[0], advance_activation(now, command, 0.05, 0.02, 0.07))


def test_thelen_has_its_time_constants() -> None:
    """The slopes at 0 and 1 are those of 0.5 and 2 times the constants."""
    law, short = Thelen(rise_time=0.02, decay_time=0.06), 1e-7
    for now, command, time in (
        (0.0, 1.0, 0.5 * 0.02),
        (0.9, 1.0, 1.85 * 0.02),
        (1.0, 0.0, 0.06 / 2.0),
        (0.1, 0.0, 0.06 / 0.65),
    ):
        after = law.advance(np.array([[now]]), np.array([command]), short)[0, 0]
        assert (after - now) / short == pytest.approx((command - now) / time, rel=1e-4)


def test_a_twitch_peaks_after_its_contraction_time() -> None:
    """A short command leaves an activation that peaks at 1 / e of its area over the time."""
    law = Twitch(contraction_time=0.05)
    state = law.advance(law.rest(1), np.ones(1), 1e-5)
    trace = [float((state := law.advance(state, np.zeros(1), 1e-3))[0, 0]) for _ in range(200)]
    assert np.argmax(trace) == pytest.approx(49, abs=1)
    assert max(trace) == pytest.approx(1e-5 / 0.05 / math.e, rel=1e-3)
    assert sum(trace) * 1e-3 == pytest.approx(1e-5, rel=0.1)


@dataclass(frozen=True, kw_only=True)
class Late(Activation):
    """A law from outside: the command as it was one control step ago."""

    n_state = 2

    def advance(self, state: FloatArray, command: FloatArray, duration: float) -> FloatArray:
        """Pass on."""
        return np.stack([state[1], command])


def test_laws_are_resolved() -> None:
    """None, objects, names, dicts and laws from outside; times that are not given are the design's."""
    design = LatticeDesign(rise_time=0.02, decay_time=0.03)
    own = FirstOrder(rise_time=0.02, decay_time=0.03)
    late = f"{__name__}:Late"
    for given_, expected in (
        (None, own),
        ("first_order", own),
        ({"law": "first_order"}, own),
        ({"law": "first_order", "rise_time": 0.5}, replace(own, rise_time=0.5)),
        ("thelen", Thelen(rise_time=0.02, decay_time=0.03)),
        ({"law": "thelen", "decay_time": 1}, Thelen(rise_time=0.02, decay_time=1.0)),
        (Thelen(), Thelen()),
        ({"law": "twitch", "contraction_time": 0.1}, Twitch(contraction_time=0.1)),
    ):
        assert resolve_activation(given_, design) == expected
    for outside in (late, {"law": late}):
        law = resolve_activation(outside, design)
        assert type(law).__name__ == "Late"
        assert law.advance(law.rest(2), np.ones(2), 0.1).tolist() == [[0.0, 0.0], [1.0, 1.0]]


@pytest.mark.parametrize("law", [FirstOrder(), Thelen(rise_time=0.2), Twitch(), Late()])
def test_dict_forms_are_resolved(law: Activation) -> None:
    """That of the law itself, and that which dataclasses, and so gymnasium, make of it."""
    for form in (law.to_dict(), asdict(law)):
        assert resolve_activation(json.loads(json.dumps(form)), LatticeDesign()) == law


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        (3, r"activation = 3: must be one of 'first_order', 'thelen', 'twitch', 'module:Class'"),
        ({}, r"activation = \{\}"),
        ({"law": 1}, "activation = "),
        ({"law": "thelen", "speed": 1.0}, "Thelen: there is no 'speed'"),
        ({"law": "thelen", "rise_time": 0.0}, r"Thelen.rise_time = 0.0: must be a number from 1e-06 to 1e\+06 \[s\]"),
        ("twich", "activation law = 'twich': must be one of"),
        ("no_such_module:Law", "activation law = 'no_such_module:Law': cannot be imported"),
        ("math:pi", "activation law = 'math:pi': must be one of"),
        ("math:", "activation law = 'math:'"),
        (Thelen, "activation = "),
        (
            "lattice_gym.physics.laws.activation:Activation",
            r"activation law = 'lattice_gym.physics.laws.activation:Activation': lacks advance",
        ),
    ],
)
def test_wrong_laws_are_refused(wrong: Any, named: str) -> None:
    """The error says what there is."""
    with pytest.raises(ValueError, match=named):
        resolve_activation(wrong, LatticeDesign())


@given(
    activation=st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3),
    command=st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3),
    duration=st.floats(0.0, 0.2),
    rise_time=st.floats(0.005, 0.1),
    decay_time=st.floats(0.005, 0.1),
)
@settings(max_examples=50, deadline=None)
def test_activation_solves_its_equation(
    activation: list[float], command: list[float], duration: float, rise_time: float, decay_time: float
) -> None:
    """Against Runge-Kutta in small steps; in two parts as in one; and never past the command."""
    start, target = np.array(activation), np.array(command)
    exact = advance_activation(start, target, duration, rise_time, decay_time)

    def slope(value: FloatArray) -> FloatArray:
        return (target - value) / np.where(target > value, rise_time, decay_time)

    value, step = start, duration / 400
    for _ in range(400):
        one = slope(value)
        two = slope(value + step / 2 * one)
        three = slope(value + step / 2 * two)
        value = value + step / 6 * (one + 2 * two + 2 * three + slope(value + step * three))
    np.testing.assert_allclose(exact, value, atol=1e-7)
    half = advance_activation(start, target, duration / 2, rise_time, decay_time)
    again = advance_activation(half, target, duration / 2, rise_time, decay_time)
    np.testing.assert_allclose(again, exact, atol=1e-14)
    assert np.all(np.where(target > start, exact <= target, exact >= target))
    assert np.all((exact >= np.minimum(start, target) - 1e-15) & (exact <= np.maximum(start, target) + 1e-15))
    assert np.all((exact >= 0.0) & (exact <= 1.0))


def test_activation_time_constants() -> None:
    """After one time constant 1 - 1/e is done: the rise time on the way up, the decay time on the way down."""
    up = advance_activation(np.array([0.0]), np.array([1.0]), 0.015, 0.015, 0.05)
    down = advance_activation(np.array([1.0]), np.array([0.0]), 0.05, 0.015, 0.05)
    np.testing.assert_allclose([up[0], down[0]], [1 - math.exp(-1), math.exp(-1)], rtol=1e-15)


def test_activation_input_is_left_alone() -> None:
    """A new array comes back, even for no time at all."""
    start = np.array([0.25, 0.5])
    result = advance_activation(start, np.array([1.0, 0.0]), 0.0, 0.015, 0.05)
    np.testing.assert_array_equal(result, start)
    assert not np.shares_memory(result, start)


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"activation": np.array([math.nan])}, r"activation\[0\] = nan"),
        ({"command": np.array([math.inf])}, r"command\[0\] = inf"),
        ({"command": np.zeros(2)}, r"command has shape \(2,\)"),
        ({"duration": -1.0}, "duration = -1.0"),
        ({"duration": math.nan}, "duration = nan"),
        ({"rise_time": 0.0}, "rise_time = 0.0"),
        ({"decay_time": math.inf}, "decay_time = inf"),
    ],
)
def test_activation_is_checked(values: dict[str, Any], named: str) -> None:
    """Nothing that is not a number gets through to a tension."""
    good: dict[str, Any] = {"activation": np.zeros(1), "command": np.ones(1), "duration": 0.1}
    with pytest.raises(ValueError, match=named):
        advance_activation(**{**good, "rise_time": 0.015, "decay_time": 0.05, **values})
