"""Arithmetic that rounds the same way in every lane: fused multiply-add, scalar product, series."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
from numba import float64
from numba.extending import intrinsic

from lattice_gym.checks import FloatArray
from lattice_gym.engines.fused.kernels.compiling import inlined


def _fma(_: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once.

    Where the processor has no such instruction the C library does it: to the same bits, but many times slower.
    """
    return float64(float64, float64, float64), lambda context, builder, signature, values: builder.fma(*values)


fma = cast(Callable[[float, float, float], float], intrinsic(_fma))


@inlined
def dot(a0: float, a1: float, a2: float, b0: float, b1: float, b2: float) -> float:
    """Scalar product of two vectors."""
    return float(fma(a2, b2, fma(a1, b1, a0 * b0)))


def series(function: Callable[[FloatArray], FloatArray], degree: int, top: float) -> tuple[float, ...]:
    """Coefficients of the polynomial through a function at the Chebyshev points of [0, top]."""
    fit = np.polynomial.Chebyshev.interpolate(function, degree, (0.0, top))
    return tuple(fit.convert(kind=np.polynomial.Polynomial, domain=(-1.0, 1.0), window=(-1.0, 1.0)).coef.tolist())
