"""Activation dynamics: how a muscle follows its command.

An activation a, from 0 to 1, follows the command u; the tension of a muscle is proportional to it. These laws act
between control steps: a command is held, and each gives the exact answer after that time, so that the length of a
control step changes nothing. A law from outside is a subclass of `Activation`, named "module:Class".
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Self

import numpy as np

from lattice_gym.body.design import LatticeDesign
from lattice_gym.checks import FloatArray, Parameters, array, invalid_value, number, real, subclass

_NEWTON = 30
"""Newton's steps at most; from the start that is taken the last bit is reached in under ten."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Activation(Parameters, ABC):
    """How activations follow commands; its parameters are fields as of any `Parameters`.

    A state has the shape (n_state, ...), where the activations are state[0] and have the shape of the commands.
    """

    n_state: ClassVar[int] = 1
    """Numbers that are the state of one muscle."""
    law: str = field(default="", init=False, repr=False, compare=False)
    """Name by which `resolve_activation` finds its class: one of `ACTIVATIONS` or "module:Class"."""

    def __init_subclass__(cls, **arguments: Any) -> None:
        """Name a law from outside by its place, so that its dict form finds it again."""
        super().__init_subclass__(**arguments)
        if "law" not in vars(cls):
            cls.law = f"{cls.__module__}:{cls.__qualname__}"

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Make it from its fields by name, "law" aside; those that are missing have their defaults."""
        return super().from_dict({name: value for name, value in values.items() if name != "law"})

    def rest(self, shape: int | tuple[int, ...]) -> FloatArray:
        """State of muscles long at rest, shape (n_state, *shape)."""
        return np.zeros((self.n_state, *np.atleast_1d(shape)))

    @abstractmethod
    def advance(self, state: FloatArray, command: FloatArray, duration: float) -> FloatArray:
        """State after a command was held.

        Parameters
        ----------
        state
            State before, shape (n_state, ...); it is left alone.
        command
            From 0 to 1, shape (...).
        duration
            [s], not negative
        """


@dataclass(frozen=True, kw_only=True)
class FirstOrder(Activation):
    """First-order response with two time constants.

    da/dt = (u - a) / tau, where tau is the rise time while u > a, and else the decay time.
    """

    law = "first_order"

    rise_time: float = real(0.015, 1e-6, 1e6, "s")
    """[s]"""
    decay_time: float = real(0.05, 1e-6, 1e6, "s")
    """[s]"""

    def advance(self, state: FloatArray, command: FloatArray, duration: float) -> FloatArray:
        """Follow the command by exponentials."""
        rising, falling = (math.exp(-duration / time) for time in (self.rise_time, self.decay_time))
        return relax(state[0], command, rising, falling)[None]


@dataclass(frozen=True, kw_only=True)
class Thelen(Activation):
    """First-order response whose time constants depend on the activation (Thelen 2003, J. Biomech. Eng. 125:70).

    da/dt = (u - a) / tau(a, u), with tau = rise_time (0.5 + 1.5 a) while u > a, and else
    decay_time / (0.5 + 1.5 a): the more active a muscle is, the slower it rises and the faster it falls. The defaults
    are his for young adults.

    With p = 0.5 + 1.5 a, q = 0.5 + 1.5 u and t in time constants, w = p / q - 1 obeys w exp(w) = w0 exp(w0 - t / q)
    while it rises; while it falls, p = q / (1 + (q / p0 - 1) exp(-q t)).
    """

    law = "thelen"

    rise_time: float = real(0.015, 1e-6, 1e6, "s")
    """Where the activation is 1/3 [s]."""
    decay_time: float = real(0.05, 1e-6, 1e6, "s")
    """Where the activation is 1/3 [s]."""

    def advance(self, state: FloatArray, command: FloatArray, duration: float) -> FloatArray:
        """Solve the equation exactly."""
        now = state[0]
        p, q = 0.5 + 1.5 * now, 0.5 + 1.5 * command
        down = q / (1.0 + (q / p - 1.0) * np.exp(-q * (duration / self.decay_time)))
        start = np.minimum(p / q - 1.0, 0.0)
        goal = start * np.exp(start - duration / self.rise_time / q)
        up = q * (1.0 + _product_log(goal))
        after = (np.where(command > now, up, down) - 0.5) / 1.5
        # Rounding shall carry it neither past the command nor back.
        return np.clip(after, np.minimum(now, command), np.maximum(now, command))[None]


@dataclass(frozen=True, kw_only=True)
class Twitch(Activation):
    """Critically damped second-order response: a short command gives a twitch that peaks after a while.

    T^2 a'' + 2 T a' + a = u, with T the contraction time. The answer to an impulse is the twitch t / T^2 exp(-t / T),
    which is how motor units are described since Milner-Brown, Stein and Yemm (1973, J. Physiol. 228:285). The state is
    the activation and its rate [1/s].
    """

    law = "twitch"
    n_state = 2

    contraction_time: float = real(0.05, 1e-6, 1e6, "s")
    """From an impulse to the peak of the twitch [s]."""

    def advance(self, state: FloatArray, command: FloatArray, duration: float) -> FloatArray:
        """Solve the equation exactly."""
        time = duration / self.contraction_time
        left, apart = math.exp(-time), state[0] - command
        slope = apart + self.contraction_time * state[1]
        # What follows commands from 0 to 1 stays there but for rounding.
        activation = np.clip(command + (apart + slope * time) * left, 0.0, 1.0)
        return np.stack([activation, (state[1] - slope * time / self.contraction_time) * left])


ACTIVATIONS: dict[str, type[Activation]] = {kind.law: kind for kind in (FirstOrder, Thelen, Twitch)}
"""Laws by name."""


def resolve_activation(given: object, design: LatticeDesign) -> Activation:
    """Activation law from what a caller gives.

    Parameters
    ----------
    given
        None: first order with the design's times. Else an object; a name of `ACTIVATIONS` or "module:Class"; or a dict
        of "law", such a string, and the law's own fields. A rise or decay time that is not given is the design's.
    design
        Whose `rise_time` and `decay_time` are taken.

    Raises
    ------
    ValueError
        Anything else, or a field out of bounds.
    """
    if isinstance(given, Activation):
        return given
    values = {"law": "first_order"} if given is None else {"law": given} if isinstance(given, str) else given
    if not isinstance(values, Mapping) or not isinstance(law := values.get("law"), str):
        choices = ", ".join(map(repr, ACTIVATIONS))
        must = f"must be one of {choices}, 'module:Class', an Activation, None or a dict whose 'law' is such a string"
        raise invalid_value("activation", given, must)
    kind = subclass("activation law", law, Activation, ACTIVATIONS)  # type: ignore[type-abstract]
    if missing := sorted(kind.__abstractmethods__):
        raise invalid_value("activation law", law, f"lacks {', '.join(missing)}")
    own = {item.name for item in fields(kind)}
    times: dict[str, Any] = {name: getattr(design, name) for name in ("rise_time", "decay_time") if name in own}
    return kind.from_dict({**times, **values})


def advance_activation(
    activation: FloatArray, command: FloatArray, duration: float, rise_time: float, decay_time: float
) -> FloatArray:
    """Activation after a command was held for a duration [s], as `FirstOrder` has it, of input that is checked.

    Activation and command have one shape, kept.
    """
    times = (("rise_time", rise_time), ("decay_time", decay_time))
    rise, decay = (number(name, value, 0.0, unit="s", above=True) for name, value in times)
    time = number("duration", duration, 0.0, unit="s")
    now = array("activation", activation)
    return relax(now, array("command", command, now.shape), math.exp(-time / rise), math.exp(-time / decay))


def relax(now: FloatArray, towards: FloatArray, rising: float, falling: float) -> FloatArray:
    """Relax towards a command; `rising` and `falling` are the shares of the difference that remain."""
    left = np.where(towards > now, rising, falling)
    # Written from the command, not the activation: so no rounding carries the result past the command.
    return towards + left * (now - towards)


def _product_log(value: FloatArray) -> FloatArray:
    """Solve w exp(w) = value for w from -0.75 to 0, by Newton's method from above the solution (Lambert's W)."""
    w = np.zeros_like(value)
    for _ in range(_NEWTON):
        step = (w - value * np.exp(-w)) / (1.0 + w)
        w = w - step
        if not (np.abs(step) > 4e-16).any():
            break
    return w
