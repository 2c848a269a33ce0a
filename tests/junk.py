"""What hostile callers send, and the small worm that they send it to."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
from hypothesis import strategies as st
from small_worms import SMALL, SMALL_WAVE

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.worm import build_model

NUMBERS = st.one_of(
    st.sampled_from([0, 1, 2, 3, 5, -1, 0.0, -0.0, 0.5, 1.5, 1e-9, -1e-9, 1e-320, 1e308, -1e308, 2**31, 2**63, 10**400,
                     float("nan"), float("inf"), -float("inf"), True, False]),
    st.integers(-3, 40), st.floats(), st.floats(1e-6, 10.0),
    st.sampled_from([np.float32(0.1), np.float64("nan"), np.int8(-1), np.int64(3), np.uint8(200), np.bool_(True),
                     np.float16(2.0), np.array(1.5), Fraction(1, 3), Fraction(3, 2), Decimal("0.1"), 1j]),
)  # fmt: skip
ARRAYS = st.builds(
    lambda shape, dtype, fill: np.full(shape, fill).astype(dtype),
    st.lists(st.integers(0, 4), max_size=3).map(tuple),
    st.sampled_from([np.float64, np.float32, np.int64, np.bool_, np.complex128, np.object_]),
    st.sampled_from([0.0, 1.0, -1.0, 0.5]),
)
_ODD = st.sampled_from([None, "", "all", "nan", "1", b"1", object(), print, range(3), {1, 2}, ..., type, np.float64])
JUNK: st.SearchStrategy[Any] = st.one_of(
    NUMBERS, st.text(max_size=6), _ODD, ARRAYS, st.lists(NUMBERS, max_size=4),
    st.dictionaries(st.text(max_size=4), NUMBERS, max_size=2), st.tuples(NUMBERS, NUMBERS),
)  # fmt: skip


def damaged(good: Mapping[str, Any], least: int = 1, most: int = 3) -> st.SearchStrategy[dict[str, Any]]:
    """Draw good arguments of which some are replaced by junk."""
    names = st.lists(st.sampled_from(sorted(good)), min_size=least, max_size=most, unique=True)

    def some(chosen: list[str]) -> st.SearchStrategy[dict[str, Any]]:
        return st.fixed_dictionaries(dict.fromkeys(chosen, JUNK))

    return names.flatmap(some).map(lambda junk: {**good, **junk})


def finite(*arrays: Any) -> None:
    """Refuse what is not finite."""
    for array in arrays:
        assert np.isfinite(array).all(), "not finite"


@cache
def small() -> Lattice:
    """Build a lattice of three sites on each of five levels."""
    return build_lattice(LatticeDesign(**SMALL))


@cache
def small_env() -> LatticeWormEnv:
    """Make an environment that is stepped but never damaged."""
    return LatticeWormEnv(design=SMALL, command=SMALL_WAVE)


@cache
def small_model() -> RodModel:
    """Build the model of the small lattice."""
    return build_model(small(), named_layout("all", small()))
