"""Actions, and the commands from 0 to 1 that they stand for."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt

from lattice_gym.checks import FloatArray, IntArray, array, invalid_value, items, number

COMMAND_RANGE = (0.0, 1.0)
"""Range of commands, and by default of actions."""
MAX_ACTION = 1e6
"""Bound of the size of an action."""


def resolve_action_range(given: object) -> tuple[float, float]:
    """Least and largest number of an action, rounded to float32 as the space of actions is.

    Raises
    ------
    ValueError
        What is no pair of numbers, the lower first, or one without room between them in float32.
    """
    each = partial(number, low=-MAX_ACTION, high=MAX_ACTION)
    low, high = (float(np.float32(end)) for end in items("action_range", given, each, 2, "numbers, the lower first"))
    if low >= high:
        raise invalid_value("action_range", given, "must have the lower first, and room between both in float32")
    return low, high


def to_command(
    action: npt.ArrayLike, shape: tuple[int, ...], action_range: tuple[float, float] = COMMAND_RANGE
) -> tuple[FloatArray, IntArray]:
    """Commands from 0 to 1, of the given shape (..., n_action), and how many actions were clipped, shape (...,).

    Raises
    ------
    ValueError
        NaN, another shape or what is no real number.
    """
    try:
        given = np.asarray(action)
    except ValueError:
        raise ValueError(f"action: must be an array of shape {shape}, got {action!r}") from None
    if given.dtype.kind not in "fiu":
        raise ValueError(f"action: must hold real numbers, got {given.dtype}")
    if given.shape != shape:
        raise ValueError(f"action: shape must be {shape}, got {given.shape}")
    (low, high), n_clipped = action_range, np.zeros(shape[:-1], dtype=np.int64)
    bounded = given.astype(np.float64)
    if not (given.min() >= low and given.max() <= high):
        if np.isnan(given).any():
            raise ValueError(f"action: must not be NaN, got NaN in {np.argwhere(np.isnan(given)).tolist()}")
        bounded = np.minimum(np.maximum(bounded, low), high)
        n_clipped = (bounded != given).sum(axis=-1)
    if action_range == COMMAND_RANGE:
        return bounded, n_clipped
    # In the type of the action, so that gymnasium's RescaleAction gives the same to the last bit.
    own = bounded.astype(np.float32) if given.dtype == np.float32 else bounded
    return np.clip((own - low) / (high - low), 0.0, 1.0).astype(np.float64), n_clipped


def to_action(command: npt.ArrayLike, action_range: tuple[float, float]) -> FloatArray:
    """Actions that stand for commands from 0 to 1, of their shape."""
    low, high = action_range
    commanded: FloatArray = array("command", command)
    return commanded if action_range == COMMAND_RANGE else low + (high - low) * commanded
