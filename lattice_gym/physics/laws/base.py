"""What every law of an assembly says of itself.

A law is made for one `RodModel`. It takes and checks the fields of the model that are its own, knows the energy that it
stores and the work that it does, gives its springs and dashpots around rest to the critical time step, and has its
force as a plain formula, with which tests compare what the engines do.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol, Self

import numpy as np
import numpy.typing as npt

from lattice_gym.checks import FloatArray, IntArray, array, instance, items, optional

if TYPE_CHECKING:
    from lattice_gym.physics.assembly import RodModel
    from lattice_gym.physics.state import RodState

Converter = Callable[[str, object], object]
"""Turns what was given for a field of that name into what the model holds, or raises ValueError."""


class Generalised(NamedTuple):
    """Displacements or forces of all that moves."""

    node: FloatArray
    """Displacements [m] or forces [N] in the laboratory frame, shape (n_node, 3)."""
    element: FloatArray
    """Turns [rad] or couples [N m] in the material frame, shape (n_elem, 3)."""
    ball: FloatArray
    """Displacements [m] or forces [N] in the laboratory frame, shape (n_ball, 3)."""

    @classmethod
    def split(cls, model: RodModel, values: FloatArray) -> Self:
        """View a vector of shape (3 n_node + 3 n_elem + 3 n_ball,)."""
        rows, n_rod = values.reshape(-1, 3), model.n_node + model.n_elem
        return cls(rows[: model.n_node], rows[model.n_node : n_rod], rows[n_rod:])

    @classmethod
    def zeros(cls, model: RodModel) -> Self:
        """Nothing moves, nothing acts."""
        return cls.split(model, np.zeros(3 * (model.n_node + model.n_elem + model.n_ball)))


class Shortened(NamedTuple):
    """Largest shortening of rods and lines by muscles, see `muscles.contraction`."""

    rod: FloatArray
    """Length over rest length of every rod, shape (n_rod,)."""
    line: FloatArray
    """Length over rest length of every line, shape (n_line,)."""
    tension: float
    """Largest tension that is asked of a muscle [N]."""
    peak: float
    """Largest tension that acts in a muscle [N], see `hill.Hill.peak`."""


class Operator(Protocol):
    """Springs (dashpots) around rest: a symmetric map from displacements (velocities) to the opposing forces."""

    coupled: bool
    """Whether it acts on more than nodes."""

    def __call__(self, moved: Generalised, against: Generalised) -> None:
        """Add the forces against what has moved, in place."""


@dataclass(frozen=True)
class PairSprings:
    """Springs between two nodes each: their rows, shape (n_tie,), and a matrix [N/m], shape (n_tie, 3, 3)."""

    first: IntArray
    second: IntArray
    matrix: FloatArray
    coupled = False

    def __call__(self, moved: Generalised, against: Generalised) -> None:
        """Add the forces against displacements, in place."""
        pull = np.einsum("nij,nj->ni", self.matrix, moved.node[self.second] - moved.node[self.first])
        force = np.zeros_like(moved.node)
        np.add.at(force, self.first, -pull)
        np.add.at(force, self.second, pull)
        against.node[:] += force


@dataclass(frozen=True)
class NodeSprings:
    """Springs that hold every node to its place [N/m]: one number for each component, or for each node and it."""

    stiffness: FloatArray
    coupled = False

    def __call__(self, moved: Generalised, against: Generalised) -> None:
        """Add the forces against displacements, in place."""
        against.node[:] += moved.node * self.stiffness


class Linearised(NamedTuple):
    """What a law adds to the problem of the critical time step, see `critical_step`."""

    springs: Sequence[Operator] = ()
    """Forces by displacement [N/m]."""
    dashpots: Sequence[Operator] = ()
    """Forces by velocity, taken as it stands before the kick [N s/m]."""


class Law(ABC):
    """A law that a model obeys."""

    fields: ClassVar[Mapping[str, Converter]] = {}
    """Fields of `RodModel` that are this law's own, and how what is given for them is taken."""
    gauge: ClassVar[bool] = False
    """Whether the zero of its energy is arbitrary."""

    def __init__(self, model: RodModel) -> None:
        self.model = model

    @classmethod
    @abstractmethod
    def present(cls, model: RodModel) -> bool:
        """Tell whether a model obeys it; its fields are taken, but not checked."""

    def check(self) -> None:  # noqa: B027 (most have nothing to check)
        """Raise ValueError where the parameters do not fit the assembly."""

    def energy(self, state: RodState) -> Mapping[str, FloatArray]:
        """Energy that it stores in a state [J], by name and place."""
        return {}

    def work(self, before: RodState, after: RodState) -> float:
        """Work of its constant forces between two states [J]."""
        return 0.0

    def linearised(self, shortened: Shortened) -> Linearised:
        """Springs and dashpots around rest, with muscles shortened."""
        return Linearised()

    @abstractmethod
    def force(self, state: RodState, tension: FloatArray) -> Generalised:
        """Return forces and couples in a state by the plain formula, with which tests compare the engines.

        Tensions [N] have the shape (n_muscle,). Friction is apart, as it is no force of a state: see `apply_friction`
        of ground and ball.
        """


def tuple_of(kind: type) -> Converter:
    """Take a sequence of one kind of part."""
    return partial(items, each=partial(instance, kind=kind), what=kind.__name__)


def one_or_none(kind: type) -> Converter:
    """Take one object, or None."""
    return partial(optional, partial(instance, kind=kind))


def vector(name: str, given: npt.ArrayLike, unit: str) -> tuple[float, float, float]:
    """Three components."""
    x, y, z = array(name, given, (3,), unit=unit).tolist()
    return x, y, z
