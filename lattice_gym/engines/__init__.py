"""Engines advance a `RodModel` in time: "fused" (compiled, the default) and "pyelastica" (the reference).

Both take the same step, position Verlet as PyElastica 1.0.0 has it: half a drift, then with all forces of that instant
(internal, muscle tension, joints, point loads) a full kick, clamps, damping, and half a drift.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntEnum
from numbers import Integral
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from lattice_gym.design import FloatArray
from lattice_gym.model import RodModel, RodState

EngineName = Literal["fused", "pyelastica"]

MIN_DILATATION, MAX_DILATATION = 0.1, 5.0
"""Length over rest length outside which an element counts as over-stretched: linear elasticity ended long before."""


class Status(IntEnum):
    """How a call to `Engine.advance` ended."""

    OK = 0
    NON_FINITE = 1
    OVERSTRETCHED = 2
    INVERTED = 3


@dataclass(frozen=True)
class Health:
    """Status, and where it shows: rod and element (-1 when all is well)."""

    status: Status = Status.OK
    rod: int = -1
    element: int = -1

    @property
    def ok(self) -> bool:
        """True while the state can be trusted to be a state at all."""
        return self.status is Status.OK

    def __str__(self) -> str:
        return "ok" if self.ok else f"{self.status.name.lower()} (rod {self.rod}, element {self.element})"


class Engine(ABC):
    """Integrates one assembly with a fixed time step."""

    def __init__(self, model: RodModel, dt: float) -> None:
        if not (np.isfinite(dt) and dt > 0.0):
            raise ValueError(f"dt = {dt}: must be positive and finite [s]")
        self.model = model
        self.dt = float(dt)

    @property
    @abstractmethod
    def state(self) -> RodState:
        """A copy of the state."""

    def restore(self, state: RodState) -> None:
        """Take over a state; going on from it gives to the last bit what the engine that gave it would.

        Raises
        ------
        ValueError
            The state does not fit the model, is not finite, or has moved a clamped node.
        """
        state.check(self.model)
        self._restore(state)

    def advance(self, tension: npt.ArrayLike, n_substeps: int) -> Health:
        """Advance by n_substeps * dt.

        Parameters
        ----------
        tension
            Muscle tensions [N], shape (n_muscle,) and held, or (2, n_muscle): linear in time from the first row at the
            start of the call to the second at its end (each step takes the value at its middle).
        n_substeps
            Number of steps, at least 1.

        Raises
        ------
        ValueError
            Wrong shape, a tension that is negative or not finite, or no step.
        """
        pull = np.asarray(tension, dtype=np.float64)
        if pull.shape not in ((self.model.n_muscle,), (2, self.model.n_muscle)):
            n = self.model.n_muscle
            raise ValueError(f"tension: shape must be ({n},) or (2, {n}), got {pull.shape}")
        if not (np.isfinite(pull).all() and (pull >= 0.0).all()):
            raise ValueError("tension: must be finite and not negative [N]")
        if not isinstance(n_substeps, Integral) or isinstance(n_substeps, bool) or n_substeps < 1:
            raise ValueError(f"n_substeps = {n_substeps!r}: must be a whole number, at least 1")
        start, end = (pull, pull) if pull.ndim == 1 else pull
        return self._advance(start, end, int(n_substeps))

    @abstractmethod
    def _restore(self, state: RodState) -> None: ...

    @abstractmethod
    def _advance(self, start: FloatArray, end: FloatArray, n_substeps: int) -> Health: ...


def make_engine(name: EngineName, model: RodModel, dt: float) -> Engine:
    """Engine by name. The choice costs its imports only when made.

    Raises
    ------
    ValueError
        An unknown name, or dt not positive and finite.
    """
    if name == "fused":
        from lattice_gym.engines.fused import FusedEngine

        return FusedEngine(model, dt)
    if name == "pyelastica":
        from lattice_gym.engines.pyelastica import PyElasticaEngine

        return PyElasticaEngine(model, dt)
    raise ValueError(f"engine = {name!r}: must be one of {', '.join(get_args(EngineName))}")
