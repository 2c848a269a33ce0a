"""What callers hand to an engine: each check gives the value in the form engines use, or a ValueError that names it."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence

import numpy.typing as npt

from lattice_gym.checks import FloatArray, array, brief, invalid_value, optional, whole
from lattice_gym.physics.assembly import RodModel

MAX_STEPS = 2**62
"""What the step counter of the compiled code holds."""


def models_of_one_shape(models: Sequence[RodModel]) -> list[RodModel]:
    """Models as a list, if there is one at least and all are of one shape, see `difference_in_shape`."""
    if not isinstance(models, Sequence) or len(models) == 0 or not isinstance(models[0], RodModel):
        raise invalid_value("models", models, "must be a sequence of RodModel, at least one")
    for worm, model in enumerate(models):
        if (differs := difference_in_shape(models[0], model)) is not None:
            raise ValueError(f"models[{worm}]: must have the shape of models[0], but differs in {differs}")
    return list(models)


def difference_in_shape(model: RodModel, other: object) -> str | None:
    """Name what keeps a model from having the shape of another; None if it has.

    Models of one shape have the same rods by number of elements, the same joints, lines, muscles and ball; all else may
    differ.
    """
    if not isinstance(other, RodModel):
        return f"being {brief(other)}, no RodModel"
    parts: dict[str, Callable[[RodModel], object]] = {
        "the elements of its rods": lambda x: [rod.n_elem for rod in x.rods],
        "what its joints join": lambda x: [(t.rod_a, t.node_a, t.rod_b, t.node_b) for t in x.joints],
        "what its lines join": lambda x: [(t.rod_a, t.node_a, t.rod_b, t.node_b) for t in x.lines],
        "its muscles": lambda x: x.muscles,
        "having a ball or not": lambda x: x.n_ball,
    }
    return next((name for name, part in parts.items() if part(model) != part(other)), None)


def thread_count(num_threads: int | None) -> int:
    """How many threads to use at most; None: as many as there are cores for this process."""
    return optional(whole, "num_threads", num_threads, 1) or available_cores()


def available_cores() -> int:
    """Count the cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def tension_ramp(tension: npt.ArrayLike, shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """Tensions at the start and the end of a call [N], both of the given shape."""
    given = array("tension", tension, low=0.0, unit="N")
    if given.shape not in (shape, (2, *shape)):
        raise ValueError(f"tension has shape {given.shape}: must have {shape} or {(2, *shape)}")
    return (given[0], given[1]) if given.ndim > len(shape) else (given, given)
