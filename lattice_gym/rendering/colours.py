"""Colours of the worm, its surroundings and its muscles' activation."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lattice_gym.checks import FloatArray

ROD, SITE, PLATE, BALL, TEXT, HAZE = "#a9b3bf", "#8c97a5", "#e6eaee", "#5b8db8", "#2b3440", "#ffffff"
MARKER, TOP = "#139a53", "#1c2733"
# From 0 to 1 lightness falls evenly, by 12 to 14 units of CIELAB a step.
ACTIVATION = ("#f7e6c9", "#f7b98b", "#ee8262", "#d8474c", "#ad1745", "#76093f")


def activation_colour(activation: npt.ArrayLike) -> FloatArray:
    """Red, green and blue from 0 to 255 of activations in [0, 1], shape (n,) -> (n, 3)."""
    anchors = np.stack([rgb(code) for code in ACTIVATION])
    value, place = np.asarray(activation, dtype=np.float64), np.linspace(0.0, 1.0, len(anchors))
    return np.stack([np.interp(value, place, channel) for channel in anchors.T], axis=1)


def rgb(code: str) -> FloatArray:
    """Red, green and blue from 0 to 255 of a colour written #rrggbb, shape (3,)."""
    return np.array([int(code[k : k + 2], 16) for k in (1, 3, 5)], dtype=np.float64)
