"""A neutral description of any assembly of Cosserat rods: what both engines build from, with no engine inside.

`RodModel` holds constants, `state.RodState` what moves. `worm.build_model` makes the model of a lattice worm; a
cantilever, a free rod or two joined rods are built from the same parts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Integral

import numpy as np

from lattice_gym.checks import FloatArray, IntArray, finite_number, shown, whole_number
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.laws.contact import Contact
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.laws.joints import Joint
from lattice_gym.physics.laws.lines import Line
from lattice_gym.physics.laws.loads import PointForce, PointTorque
from lattice_gym.physics.rod import FRAME_TOLERANCE, Rod, array_of_shape, checked_size, node_radius, node_sums, require
from lattice_gym.physics.state import RodState


def _parts(name: str, values: object, kind: type) -> None:
    """Refuse what is no tuple (or list) of a kind of part."""
    if not isinstance(values, tuple | list):
        raise ValueError(f"{name} = {shown(values)}: must be a tuple of {kind.__name__}")
    for k, value in enumerate(values):
        if not isinstance(value, kind) or isinstance(value, bool):
            raise ValueError(f"{name}[{k}] = {shown(value)}: must be {kind.__name__}")


@dataclass(frozen=True)
class Clamp:
    """A node held at its rest position, an element held at its rest orientation, or both."""

    rod: int
    node: int | None = None
    element: int | None = None


PARTS: dict[str, type] = {
    "rods": Rod,
    "joints": Joint,
    "clamps": Clamp,
    "forces": PointForce,
    "torques": PointTorque,
    "muscles": Integral,
    "lines": Line,
}
"""What each field of a `RodModel` holds."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RodModel:
    """An assembly of rods. Arrays over all nodes (elements) hold the rods one after another.

    Raises
    ------
    ValueError
        No rod, an index that no rod, node or element has, a joint of a node with itself, a line between two ends at one
        place, a negative stiffness, a gravity that is no vector, a medium's density or drag that is negative, friction
        by direction without a body axis.
    """

    rods: tuple[Rod, ...]
    joints: tuple[Joint, ...] = ()
    clamps: tuple[Clamp, ...] = ()
    forces: tuple[PointForce, ...] = ()
    torques: tuple[PointTorque, ...] = ()
    muscles: tuple[int, ...] = ()
    """Rods that contract, in the order of the tensions."""
    lines: tuple[Line, ...] = ()
    """Muscles without nodes; their tensions follow those of `muscles`."""
    bolus: Ball | None = None
    gravity: FloatArray | None = None
    """[m/s^2], shape (3,); None is none."""
    medium_density: float = 0.0
    """Of the fluid around [kg/m^3]: it carries its own weight of what it makes room for."""
    medium_drag: float = 0.0
    """Resistance of that fluid to motion, per speed and length of a rod or line [N s/m^2]."""
    ground: Ground | None = None
    """Plane z = 0 that bears every node at its `node_radius`, with friction on the centre line; None is none."""
    hill: Hill | None = None
    """How the force of all muscles depends on their length and speed."""
    contact: Contact | None = None
    """How rods that are no muscles push at each other, see `contact`; None: they go through each other."""

    def __post_init__(self) -> None:
        for name, kind in PARTS.items():
            _parts(name, getattr(self, name), kind)
            object.__setattr__(self, name, tuple(getattr(self, name)))
        require(len(self.rods) > 0, "rods: at least one is needed")
        object.__setattr__(self, "hill", Hill.resolve("hill", self.hill))
        for k, joint in enumerate(self.joints):
            self._check_index(f"joints[{k}]", joint.rod_a, joint.node_a, extra=1)
            self._check_index(f"joints[{k}]", joint.rod_b, joint.node_b, extra=1)
            same = (joint.rod_a, joint.node_a) == (joint.rod_b, joint.node_b)
            require(not same, f"joints[{k}]: joins a node with itself")
            for name in ("stiffness", "damping"):
                checked_size(f"joints[{k}].{name}", getattr(joint, name), above=False)
        for k, line in enumerate(self.lines):
            self._check_index(f"lines[{k}]", line.rod_a, line.node_a, extra=1)
            self._check_index(f"lines[{k}]", line.rod_b, line.node_b, extra=1)
            for name in ("rest_length", "stiffness", "mass", "damping"):
                checked_size(f"lines[{k}].{name}", getattr(line, name), above=name == "rest_length")
            if not (isinstance(line.density, float) and line.density == math.inf):
                checked_size(f"lines[{k}].density", line.density, above=True)
            stiff = finite_number(float(line.stiffness) / float(line.rest_length)) is not None
            require(stiff, f"lines[{k}].rest_length = {line.rest_length}: far too short for its stiffness")
            self._check_direction(f"lines[{k}]", line)
        for k, clamp in enumerate(self.clamps):
            held = clamp.node is not None or clamp.element is not None
            require(held, f"clamps[{k}]: holds neither node nor element")
            self._check_index(f"clamps[{k}]", clamp.rod, 0 if clamp.node is None else clamp.node, extra=1)
            self._check_index(f"clamps[{k}]", clamp.rod, 0 if clamp.element is None else clamp.element, extra=0)
        for k, force in enumerate(self.forces):
            self._check_index(f"forces[{k}]", force.rod, force.node, extra=1)
            array_of_shape(f"forces[{k}].force", force.force, (3,))
        for k, torque in enumerate(self.torques):
            self._check_index(f"torques[{k}]", torque.rod, torque.element, extra=0)
            array_of_shape(f"torques[{k}].torque", torque.torque, (3,))
        for k, rod in enumerate(self.muscles):
            self._check_index(f"muscles[{k}]", rod, 0, extra=0)
        require(len(set(self.muscles)) == len(self.muscles), "muscles: a rod is named twice")
        known = self.bolus is None or isinstance(self.bolus, Ball)
        require(known, f"bolus = {shown(self.bolus)}: must be Ball or None")
        self._check_world()

    def _check_world(self) -> None:
        """Refuse a medium or ground that is none, and weights or drags beyond the range of numbers."""
        if self.gravity is not None:
            object.__setattr__(self, "gravity", array_of_shape("gravity", self.gravity, (3,)))
        for name in ("medium_density", "medium_drag"):
            object.__setattr__(self, name, checked_size(name, getattr(self, name), above=False))
        if self.ground is not None and not isinstance(self.ground, Ground):
            raise ValueError(f"ground = {shown(self.ground)}: must be Ground or None")
        if self.ground is not None and not self.ground.isotropic:
            self._check_axis()
        if self.contact is not None and not isinstance(self.contact, Contact):
            raise ValueError(f"contact = {shown(self.contact)}: must be Contact or None")
        with np.errstate(all="ignore"):
            require(bool(np.isfinite(self.node_weight).all()), "gravity, medium_density: far too large for these rods")
            require(bool(np.isfinite(self.node_damping).all()), "medium_drag: far too large for these rods")

    def _check_axis(self) -> None:
        """Refuse rods whose ends cancel out: what a body axis is made of."""
        place = np.concatenate([rod.position for rod in self.rods])
        tail, head = self.rod_ends
        with np.errstate(all="ignore"):
            chord = place[head] - place[tail]
            length, most = float(np.linalg.norm(chord.sum(axis=0))), float(np.linalg.norm(chord, axis=1).sum())
        require(
            FRAME_TOLERANCE * most < length < math.inf,
            "ground: where friction differs by direction, rods that are no muscles must have a mean way, end to end",
        )

    def _check_index(self, name: str, rod: int, index: int, *, extra: int) -> None:
        if whole_number(rod) is None or not 0 <= rod < len(self.rods):
            raise ValueError(f"{name}: there is no rod {shown(rod)}")
        count, part = self.rods[rod].n_elem + extra, "nodes" if extra else "elements"
        if whole_number(index) is None or not 0 <= index < count:
            raise ValueError(f"{name}: rod {rod} has {count} {part}, no number {shown(index)}")

    def _check_direction(self, name: str, line: Line) -> None:
        """Refuse a line whose direction at rest is lost in rounding."""
        a, b = self.rods[line.rod_a].position[line.node_a], self.rods[line.rod_b].position[line.node_b]
        with np.errstate(all="ignore"):
            length = math.sqrt(np.sum((b - a) ** 2))
        apart = FRAME_TOLERANCE * float(line.rest_length) < length < math.inf
        require(apart, f"{name}: its two ends lie at one place at rest, or too far apart")

    @property
    def n_rod(self) -> int:
        """Number of rods."""
        return len(self.rods)

    @property
    def n_muscle(self) -> int:
        """Number of muscles."""
        return len(self.muscles) + len(self.lines)

    @property
    def n_bolus(self) -> int:
        """Number of balls, 0 or 1."""
        return 0 if self.bolus is None else 1

    @cached_property
    def node_mass(self) -> FloatArray:
        """Mass of every node [kg], shape (n_node,): its rod's share and what lines put on it."""
        return self._with_lines([rod.mass for rod in self.rods], [line.mass for line in self.lines])

    @cached_property
    def node_volume(self) -> FloatArray:
        """Volume that every node makes room for [m^3], shape (n_node,): its rod's share and that of lines."""
        return self._with_lines(
            [rod.mass / rod.density for rod in self.rods],
            [float(line.mass) / float(line.density) for line in self.lines],
        )

    @cached_property
    def element_radius(self) -> FloatArray:
        """Radius of every element at rest [m], shape (n_elem,)."""
        return np.concatenate([rod.radius for rod in self.rods])

    @cached_property
    def node_damping(self) -> FloatArray:
        """Translational damping of every node [N s/m], shape (n_node,), with the drag of the medium."""
        drag = self.medium_drag
        return self._with_lines(
            [rod.damping + drag * node_sums(0.5 * rod.rest_length) for rod in self.rods],
            [float(line.damping) + drag * float(line.rest_length) for line in self.lines],
        )

    @cached_property
    def node_weight(self) -> FloatArray:
        """Weight of every node less what the medium carries [N], shape (n_node, 3): zero without gravity."""
        if self.gravity is None:
            return np.zeros((self.n_node, 3))
        return np.outer(self.node_mass - self.medium_density * self.node_volume, self.gravity)

    @cached_property
    def node_radius(self) -> FloatArray:
        """Radius of the rod at every node at rest [m], shape (n_node,): the mean of its elements'."""
        return np.concatenate([node_radius(rod) for rod in self.rods])

    def _with_lines(self, of_rods: list[FloatArray], of_lines: list[float]) -> FloatArray:
        total = np.concatenate(of_rods)
        for rows in self.tie_nodes(self.lines):
            np.add.at(total, rows, 0.5 * np.array(of_lines))
        return total

    @cached_property
    def node_offset(self) -> IntArray:
        """Row of each rod's first node, then the number of nodes, shape (n_rod + 1,)."""
        return np.cumsum([0] + [rod.n_elem + 1 for rod in self.rods])

    @cached_property
    def element_offset(self) -> IntArray:
        """Row of each rod's first element, then the number of elements, shape (n_rod + 1,)."""
        return np.cumsum([0] + [rod.n_elem for rod in self.rods])

    @property
    def n_node(self) -> int:
        """Number of nodes of all rods."""
        return int(self.node_offset[-1])

    @property
    def n_elem(self) -> int:
        """Number of elements of all rods."""
        return int(self.element_offset[-1])

    @cached_property
    def rod_ends(self) -> tuple[IntArray, IntArray]:
        """Rows of the first and of the last node of every rod that is no muscle, shape (n,) each.

        The body axis points from the mean of the first to that of the last: in a worm from the base to the top.
        """
        rods = np.setdiff1d(np.arange(self.n_rod), self.muscles).astype(np.int64)
        return self.node_offset[rods], self.node_offset[rods + 1] - 1

    def tie_nodes(self, ties: Sequence[Joint | Line]) -> tuple[IntArray, IntArray]:
        """Rows of the first and of the second node of joints or lines, shape (n_tie,) each."""
        offset = self.node_offset.tolist()
        first = [offset[tie.rod_a] + tie.node_a for tie in ties]
        second = [offset[tie.rod_b] + tie.node_b for tie in ties]
        return np.array(first, dtype=np.int64), np.array(second, dtype=np.int64)

    @cached_property
    def line_nodes(self) -> tuple[IntArray, IntArray]:
        """Rows of the first and of the second node of every line, shape (n_line,) each."""
        return self.tie_nodes(self.lines)

    @cached_property
    def muscle_elements(self) -> tuple[IntArray, IntArray]:
        """Rows of the lower nodes of all elements of rods that contract, and where in them each such rod begins."""
        lower = [np.arange(self.nodes(rod).start, self.nodes(rod).stop - 1) for rod in self.muscles]
        start = np.cumsum([0] + [len(rows) for rows in lower])[:-1]
        return np.concatenate([np.zeros(0, np.int64), *lower]), start

    @cached_property
    def muscle_rest_length(self) -> FloatArray:
        """Length of every muscle at rest [m], shape (n_muscle,)."""
        rods = [float(self.rods[rod].rest_length.sum()) for rod in self.muscles]
        return np.array(rods + [float(line.rest_length) for line in self.lines])

    @cached_property
    def held_nodes(self) -> tuple[IntArray, FloatArray, FloatArray]:
        """Rows of the nodes that clamps hold, where they rest [m], shape (n, 3), and what of that is rounding [m]."""
        held = [(clamp.rod, clamp.node) for clamp in self.clamps if clamp.node is not None]
        place = [self.rods[rod].position[node] for rod, node in held]
        slack = [FRAME_TOLERANCE * float(self.rods[rod].rest_length.sum()) for rod, _ in held]
        rows = [int(self.node_offset[rod]) + node for rod, node in held]
        return np.array(rows, np.int64), np.reshape(place, (-1, 3)), np.array(slack)

    @cached_property
    def held_elements(self) -> tuple[IntArray, FloatArray]:
        """Rows of the elements that clamps hold, and their directors at rest, shape (n, 3, 3)."""
        held = [(clamp.rod, clamp.element) for clamp in self.clamps if clamp.element is not None]
        frames = [self.rods[rod].directors[element] for rod, element in held]
        rows = [int(self.element_offset[rod]) + element for rod, element in held]
        return np.array(rows, np.int64), np.reshape(frames, (-1, 3, 3))

    def scaled(self, structure: float, muscle: float, damping: float) -> RodModel:
        """Return the assembly with factors on the moduli of its rods and muscles and on the damping of both.

        Nothing is checked again, as that takes far longer than all else; factors must be positive.
        """
        muscles, model = set(self.muscles), copy(self)
        stiffness = [muscle if index in muscles else structure for index in range(self.n_rod)]
        rods = tuple(rod.scaled(factor, damping) for rod, factor in zip(self.rods, stiffness, strict=True))
        lines = tuple(
            replace(line, stiffness=muscle * line.stiffness, damping=damping * line.damping) for line in self.lines
        )
        vars(model).pop("node_damping", None)
        vars(model).update(rods=rods, lines=lines)
        return model

    def nodes(self, rod: int) -> slice:
        """Rows of a rod's nodes."""
        return slice(int(self.node_offset[rod]), int(self.node_offset[rod + 1]))

    def elements(self, rod: int) -> slice:
        """Rows of a rod's elements."""
        return slice(int(self.element_offset[rod]), int(self.element_offset[rod + 1]))

    def rest_state(self) -> RodState:
        """Return the state in which every rod has the shape it was given and nothing moves."""
        return RodState(
            position=np.concatenate([rod.position for rod in self.rods]),
            velocity=np.zeros((self.n_node, 3)),
            directors=np.concatenate([rod.directors for rod in self.rods]),
            omega=np.zeros((self.n_elem, 3)),
            bolus_position=np.reshape([] if self.bolus is None else self.bolus.position, (-1, 3)),
            bolus_velocity=np.zeros((self.n_bolus, 3)),
            bolus_omega=np.zeros((self.n_bolus, 3)),
        )
