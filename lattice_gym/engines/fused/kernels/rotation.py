"""Rotations by series: directors turn by the exponential of a vector, and the logarithm tells how far they are turned.

Each series is exact to rounding up to where it ends; what lies beyond is done lane by lane with the functions.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lattice_gym.checks import FloatArray
from lattice_gym.engines.fused.kernels.arithmetic import dot, fma, series
from lattice_gym.engines.fused.kernels.compiling import compiled_strictly, inlined
from lattice_gym.engines.fused.kernels.layout import LANES, Cells

# Of y = sin^2(angle / 2), angle / sin(angle) up to 35 degrees:
_LARGE_Y = 0.09
_ARC = series(lambda y: np.arcsin(np.sqrt(y)) / np.sqrt(y * (1.0 - y)), 9, _LARGE_Y)
_LARGE_HALF = 0.25 * float(np.polynomial.polynomial.polyval(_LARGE_Y, _ARC))
# Of t^2, sin(t) / t and (1 - cos(t)) / t^2:
LARGE_T2 = 0.25
_SINE = series(lambda t2: np.sin(np.sqrt(t2)) / np.sqrt(t2), 5, LARGE_T2)
_VERSINE = series(lambda t2: 2.0 * np.sin(0.5 * np.sqrt(t2)) ** 2 / t2, 5, LARGE_T2)


@inlined
def find_half_angle(pair: Cells, work: Any) -> None:
    """Write angle / (4 sin(angle)) between elements e and e + 1."""
    p, q, half_angle = pair[0].q, pair[1].q, work.half_angle
    n_large = 0
    for j in range(LANES):
        first = dot(q[0, j], q[1, j], q[2, j], p[0, j], p[1, j], p[2, j])
        second = dot(q[3, j], q[4, j], q[5, j], p[3, j], p[4, j], p[5, j])
        third = dot(q[6, j], q[7, j], q[8, j], p[6, j], p[7, j], p[8, j])
        y = fma(-0.25, first + second + third, 0.75)
        y2 = y * y
        low = fma(y2, fma(_ARC[3], y, _ARC[2]), fma(_ARC[1], y, _ARC[0]))
        high = fma(y2, fma(_ARC[7], y, _ARC[6]), fma(_ARC[5], y, _ARC[4]))
        y4 = y2 * y2
        half = 0.25 * fma(y4, fma(y4, fma(_ARC[9], y, _ARC[8]), high), low)
        half_angle[j] = half
        n_large += 1 if half > _LARGE_HALF else 0
    if n_large > 0:
        _large_half_angle(pair, work)


@compiled_strictly
def _large_half_angle(pair: Cells, work: Any) -> None:
    """Write angle / (4 sin(angle)) between elements e and e + 1 into half_angle where the series does not reach."""
    here, there = pair[0], pair[1]
    p, q, half_angle = here.q, there.q, work.half_angle
    for j in range(LANES):
        # By what the series gave: a trace summed anew may round otherwise, and then another lane would decide.
        if half_angle[j] > _LARGE_HALF:
            trace = 0.0
            for i in range(9):
                trace += q[i, j] * p[i, j]
            y = min(0.75 - 0.25 * trace, 1.0 - 1e-15)
            half_angle[j] = 0.25 * np.arcsin(np.sqrt(y)) / np.sqrt(y * (1.0 - y))


@inlined
def half_rotation(p: FloatArray, q: FloatArray, half_angle: float, j: int) -> tuple[float, float, float]:
    """Half the rotation vector from directors p to q in lane j, from the antisymmetric part of q p^T."""
    u0 = half_angle * (
        dot(q[3, j], q[4, j], q[5, j], p[6, j], p[7, j], p[8, j])
        - dot(q[6, j], q[7, j], q[8, j], p[3, j], p[4, j], p[5, j])
    )
    u1 = half_angle * (
        dot(q[6, j], q[7, j], q[8, j], p[0, j], p[1, j], p[2, j])
        - dot(q[0, j], q[1, j], q[2, j], p[6, j], p[7, j], p[8, j])
    )
    u2 = half_angle * (
        dot(q[0, j], q[1, j], q[2, j], p[3, j], p[4, j], p[5, j])
        - dot(q[3, j], q[4, j], q[5, j], p[0, j], p[1, j], p[2, j])
    )
    return u0, u1, u2


@inlined
def find_turn(here: Any, work: Any, drift: float) -> None:
    """Write what the rotation of element e over `drift` seconds is made of."""
    w, square, sine, versine, n_large = here.w, work.square, work.sine, work.versine, 0
    for j in range(LANES):
        square[j], sine[j], versine[j] = turn(w[0, j], w[1, j], w[2, j], drift)
        n_large += 1 if square[j] > LARGE_T2 else 0
    if n_large > 0:
        large_turn(work)


@inlined
def turn(w0: float, w1: float, w2: float, drift: float) -> tuple[float, float, float]:
    """Square of the angle t that an element turns by, sin(t) / t and (1 - cos(t)) / t^2, where the series reach."""
    a, b, c = drift * w0, drift * w1, drift * w2
    t2 = dot(a, b, c, a, b, c)
    t4 = t2 * t2
    low, middle, high = fma(_SINE[1], t2, _SINE[0]), fma(_SINE[3], t2, _SINE[2]), fma(_SINE[5], t2, _SINE[4])
    sine = fma(t4, fma(t4, high, middle), low)
    low, middle, high = (
        fma(_VERSINE[1], t2, _VERSINE[0]),
        fma(_VERSINE[3], t2, _VERSINE[2]),
        fma(_VERSINE[5], t2, _VERSINE[4]),
    )
    return t2, sine, fma(t4, fma(t4, high, middle), low)


@compiled_strictly
def large_turn(work: Any) -> None:
    """Write sin(t) / t and (1 - cos t) / t^2 where the series of `turn` do not reach."""
    square, sine, versine = work.square, work.sine, work.versine
    for j in range(LANES):
        if square[j] > LARGE_T2:
            t = np.sqrt(square[j])
            sine[j] = np.sin(t) / t
            versine[j] = 2.0 * np.sin(0.5 * t) ** 2 / square[j]


@inlined
def rotate_element(here: Any, work: Any, drift: float) -> None:
    """Turn the directors of element e by its angular velocity over `drift` seconds (Rodrigues' formula)."""
    q, w, sine, versine = here.q, here.w, work.sine, work.versine
    for j in range(LANES):
        a, b, c, s = drift * w[0, j], drift * w[1, j], drift * w[2, j], sine[j]
        ka, kb, kc = versine[j] * a, versine[j] * b, versine[j] * c
        r00, r11, r22 = fma(-kb, b, fma(-kc, c, 1.0)), fma(-ka, a, fma(-kc, c, 1.0)), fma(-ka, a, fma(-kb, b, 1.0))
        ab, ac, bc = ka * b, ka * c, kb * c
        r01, r10, r02, r20, r12, r21 = (
            fma(s, c, ab), fma(-s, c, ab), fma(-s, b, ac), fma(s, b, ac), fma(s, a, bc), fma(-s, a, bc),
        )  # fmt: skip
        d0, d1, d2 = q[0, j], q[3, j], q[6, j]
        q[0, j], q[3, j], q[6, j] = (
            dot(r00, r01, r02, d0, d1, d2), dot(r10, r11, r12, d0, d1, d2), dot(r20, r21, r22, d0, d1, d2),
        )  # fmt: skip
        d0, d1, d2 = q[1, j], q[4, j], q[7, j]
        q[1, j], q[4, j], q[7, j] = (
            dot(r00, r01, r02, d0, d1, d2), dot(r10, r11, r12, d0, d1, d2), dot(r20, r21, r22, d0, d1, d2),
        )  # fmt: skip
        d0, d1, d2 = q[2, j], q[5, j], q[8, j]
        q[2, j], q[5, j], q[8, j] = (
            dot(r00, r01, r02, d0, d1, d2), dot(r10, r11, r12, d0, d1, d2), dot(r20, r21, r22, d0, d1, d2),
        )  # fmt: skip
