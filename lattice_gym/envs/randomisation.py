"""Factors by which worms differ from their design and from each other, drawn anew for every episode."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np

from lattice_gym.checks import FloatArray, invalid_value, items, names, number
from lattice_gym.physics.assembly import RodModel

BODY = ("structure_youngs_modulus", "muscle_youngs_modulus", "damping")
"""What changes the body; elastic and shear moduli go together, and so do damping and rotational damping."""
NAMES = (*BODY, "max_tension", "strength")
MIN_FACTOR, MAX_FACTOR = 0.01, 100.0
"""Bounds of every factor."""
_factor = partial(number, low=MIN_FACTOR, high=MAX_FACTOR)
_PAIR = f"factors from {MIN_FACTOR:g} to {MAX_FACTOR:g}, the lower first"

Factors = Mapping[str, float | FloatArray]
"""Factors of a worm by name; that of "strength" holds one for each muscle, shape (n_muscle,)."""


@dataclass(frozen=True)
class Randomisation:
    """Ranges that factors are drawn from, uniformly."""

    ranges: Mapping[str, tuple[float, float]]
    """Least and most of each factor, by its name."""

    @classmethod
    def resolve(cls, given: object) -> Randomisation | None:
        """Ranges from a mapping of names to pairs; None and an empty one are none.

        Raises
        ------
        ValueError
            Another name, or what is no pair of factors, the lower first, from 0.01 to 100.
        """
        if given is None:
            return None
        ranges = {}
        for name, pair in names("randomise", given, NAMES, "pairs of factors").items():
            low, high = items(f"randomise[{name!r}]", pair, _factor, 2, _PAIR)
            if low > high:
                raise invalid_value(f"randomise[{name!r}]", pair, "must have the lower first")
            ranges[name] = (low, high)
        return cls(ranges) if ranges else None

    @property
    def max_tension_factor(self) -> float:
        """Largest factor on the tension of a muscle."""
        return float(np.prod([self.ranges[name][1] for name in ("max_tension", "strength") if name in self.ranges]))

    def draw(self, rng: np.random.Generator, n_muscle: int) -> dict[str, float | FloatArray]:
        """Factors of one worm."""
        factors: dict[str, float | FloatArray] = {}
        for name in NAMES:
            # Drawn whether used or not, so that one more range leaves the other factors as they were.
            share = rng.random(n_muscle) if name == "strength" else rng.random()
            if name in self.ranges:
                low, high = self.ranges[name]
                factors[name] = low + share * (high - low)
        return factors

    def corners(self, model: RodModel) -> list[RodModel]:
        """Bodies at all ends of the ranges."""
        ranges = {name: sorted(set(self.ranges[name])) for name in BODY if name in self.ranges}
        return [apply_factors(model, dict(zip(ranges, ends, strict=True))) for ends in product(*ranges.values())]


def apply_factors(model: RodModel, factors: Factors) -> RodModel:
    """Return the assembly with its moduli and damping multiplied by the factors."""
    structure, muscle, damping = (float(factors.get(name, 1.0)) for name in BODY)
    return model.scaled(structure, muscle, damping)


def tension_factor(factors: Factors) -> float | FloatArray:
    """Factor on the tension of every muscle, shape (n_muscle,) or ()."""
    return factors.get("max_tension", 1.0) * factors.get("strength", 1.0)
