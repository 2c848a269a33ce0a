"""Exact cases on which both engines are judged: used by the validation report and by the tests.

Errors are relative to the largest exact value, or to a scale that the case names. Damped scenes settle: their damping
rate is the slowest angular frequency, so exp(-rate time / 2) is left of the start.
"""

from __future__ import annotations

from lattice_gym.verification.ball import BALL_CASES
from lattice_gym.verification.buckling import BUCKLING_CASES
from lattice_gym.verification.case import Case
from lattice_gym.verification.ground import GROUND_CASES
from lattice_gym.verification.momentum import MOMENTUM_CASES
from lattice_gym.verification.motion import MOTION_CASES
from lattice_gym.verification.statics import STATIC_CASES

CASES: tuple[Case, ...] = (
    *STATIC_CASES,
    *BUCKLING_CASES,
    *MOTION_CASES,
    *MOMENTUM_CASES,
    *GROUND_CASES,
    *BALL_CASES,
)
"""Every case."""
