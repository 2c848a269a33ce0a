"""A neutral description of any assembly of Cosserat rods: what both engines build from, with no engine inside.

`RodModel` holds constants, `state.RodState` what moves. `worm.build_model` makes the model of a lattice worm; a
cantilever, a free rod or two joined rods are built from the same parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lattice_gym.checks import REQUIRED, FloatArray, IntArray, Parameters, count, require
from lattice_gym.physics.laws.ball import BallLaw, RigidBall
from lattice_gym.physics.laws.base import Law, tuple_of
from lattice_gym.physics.laws.contact import Contact, ContactLaw
from lattice_gym.physics.laws.damping import DampingLaw
from lattice_gym.physics.laws.elasticity import ElasticityLaw
from lattice_gym.physics.laws.ground import Ground, GroundLaw
from lattice_gym.physics.laws.hill import Hill, HillLaw
from lattice_gym.physics.laws.joints import Joint, JointLaw
from lattice_gym.physics.laws.lines import Line, LineLaw
from lattice_gym.physics.laws.loads import LoadLaw, PointForce, PointTorque
from lattice_gym.physics.laws.medium import MediumLaw
from lattice_gym.physics.laws.muscles import MuscleLaw
from lattice_gym.physics.rod import FRAME_TOLERANCE, Rod, node_radius, node_sums
from lattice_gym.physics.state import RodState


@dataclass(frozen=True)
class Clamp(Parameters):
    """A node held at its rest position, an element held at its rest orientation, or both."""

    rod: int = count(REQUIRED)
    node: int | None = count(None, none=True)
    """None: no node."""
    element: int | None = count(None, none=True)
    """None: no element."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.node is not None or self.element is not None, "Clamp: needs a node or an element to hold")


LAWS: tuple[type[Law], ...] = (
    ElasticityLaw,
    JointLaw,
    MuscleLaw,
    LineLaw,
    HillLaw,
    MediumLaw,
    LoadLaw,
    GroundLaw,
    BallLaw,
    ContactLaw,
    DampingLaw,
)
"""Every law between two control steps. Forces of one instant first; damping follows the kick."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RodModel:
    """An assembly of rods. Arrays over all nodes (elements) hold the rods one after another.

    Each law takes and checks the fields that are its own, see `laws.base.Law`.

    Raises
    ------
    ValueError
        No rod, an index that no rod, node or element has, a joint of a node with itself, a line between two ends at one
        place, a negative stiffness, a gravity that is no vector, a medium's density or drag that is negative, friction
        by direction without a body axis.
    """

    rods: tuple[Rod, ...]
    """At least one."""
    joints: tuple[Joint, ...] = ()
    """Pairs of nodes that springs hold together."""
    clamps: tuple[Clamp, ...] = ()
    """Nodes and elements that do not move."""
    forces: tuple[PointForce, ...] = ()
    """Constant forces on nodes [N]."""
    torques: tuple[PointTorque, ...] = ()
    """Constant torques on elements [N m]."""
    muscles: tuple[int, ...] = ()
    """Rods that contract, in the order of the tensions."""
    lines: tuple[Line, ...] = ()
    """Muscles without nodes; their tensions follow those of `muscles`."""
    ball: RigidBall | None = None
    """Rigid ball that pushes at rods; None is none."""
    gravity: FloatArray | None = None
    """[m/s^2], shape (3,); None is none."""
    medium_density: float = 0.0
    """Density of the surrounding fluid [kg/m^3], which gives buoyancy."""
    medium_drag: float = 0.0
    """Resistance of that fluid to motion, per speed and length of a rod or line [N s/m^2]."""
    ground: Ground | None = None
    """Plane z = 0 that bears every node at its `node_radius`, with friction on the centre line; None is none."""
    hill: Hill | None = None
    """How the force of all muscles depends on their length and speed; None: it is their tension."""
    contact: Contact | None = None
    """How rods that are no muscles push at each other; None: they go through each other."""

    def __post_init__(self) -> None:
        for fields in ({"rods": tuple_of(Rod), "clamps": tuple_of(Clamp)}, *(law.fields for law in LAWS)):
            for name, take in fields.items():
                object.__setattr__(self, name, take(name, getattr(self, name)))
        require(len(self.rods) > 0, "rods: at least one is needed")
        for k, clamp in enumerate(self.clamps):
            self.check_node(f"clamps[{k}]", clamp.rod, clamp.node or 0)
            self.check_element(f"clamps[{k}]", clamp.rod, clamp.element or 0)
        with np.errstate(all="ignore"):
            for law in self.laws:
                law.check()

    def __repr__(self) -> str:
        counts = f"{self.n_rod} rods, {self.n_node} nodes, {self.n_muscle} muscles, {len(self.joints)} joints"
        return f"RodModel({counts}; {', '.join(type(law).__name__ for law in self.laws)})"

    @cached_property
    def laws(self) -> tuple[Law, ...]:
        """The laws that it obeys, in the order of `LAWS`."""
        return tuple(law(self) for law in LAWS if law.present(self))

    def check_node(self, name: str, rod: int, node: int) -> None:
        """Raise ValueError of a name unless a rod has a node."""
        self._check_index(name, rod, node, "node", extra=1)

    def check_element(self, name: str, rod: int, element: int) -> None:
        """Raise ValueError of a name unless a rod has an element."""
        self._check_index(name, rod, element, "element", extra=0)

    def _check_index(self, name: str, rod: int, index: int, part: str, extra: int) -> None:
        require(rod < self.n_rod, f"{name}: there is no rod {rod}; there are {self.n_rod}, counted from 0")
        n_part = self.rods[rod].n_elem + extra
        require(index < n_part, f"{name}: rod {rod} has no {part} {index}; it has {n_part}, counted from 0")

    @property
    def n_rod(self) -> int:
        """Number of rods."""
        return len(self.rods)

    @property
    def n_muscle(self) -> int:
        """Number of muscles."""
        return len(self.muscles) + len(self.lines)

    @property
    def balls(self) -> tuple[RigidBall, ...]:
        """The ball, or none."""
        return () if self.ball is None else (self.ball,)

    @property
    def n_ball(self) -> int:
        """Number of balls, 0 or 1."""
        return len(self.balls)

    @cached_property
    def node_mass(self) -> FloatArray:
        """Mass of every node [kg], shape (n_node,): its rod's share and what lines put on it."""
        return self._with_lines([rod.mass for rod in self.rods], [line.mass for line in self.lines])

    @cached_property
    def node_volume(self) -> FloatArray:
        """Volume that every node displaces [m^3], shape (n_node,): its rod's share and that of lines."""
        return self._with_lines(
            [rod.mass / rod.density for rod in self.rods],
            [line.mass / line.density for line in self.lines],
        )

    @cached_property
    def element_radius(self) -> FloatArray:
        """Radius of every element at rest [m], shape (n_elem,)."""
        return self.rod_array("radius")

    @cached_property
    def node_damping(self) -> FloatArray:
        """Translational damping of every node [N s/m], shape (n_node,), with the drag of the medium."""
        drag = self.medium_drag
        return self._with_lines(
            [rod.damping + drag * node_sums(0.5 * rod.rest_length) for rod in self.rods],
            [line.damping + drag * line.rest_length for line in self.lines],
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

    @cached_property
    def lower_node(self) -> IntArray:
        """Row of the first node of every element, shape (n_elem,); the next row is its second."""
        return np.delete(np.arange(self.n_node), self.node_offset[1:] - 1)

    @cached_property
    def element_rod(self) -> IntArray:
        """Rod of every element, shape (n_elem,)."""
        return np.repeat(np.arange(self.n_rod), [rod.n_elem for rod in self.rods])

    @cached_property
    def left_element(self) -> IntArray:
        """Row of the first element of every Voronoi region, shape (n_elem - n_rod,); the next row is its second."""
        return np.delete(np.arange(self.n_elem), self.element_offset[1:] - 1)

    def rod_array(self, name: str) -> FloatArray:
        """Concatenate an array of `Rod`, given by its name, over all rods."""
        return np.concatenate([getattr(rod, name) for rod in self.rods])

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
        lower = [self.lower_node[self.elements(rod)] for rod in self.muscles]
        start = np.cumsum([0] + [len(rows) for rows in lower])[:-1]
        return np.concatenate([np.zeros(0, np.int64), *lower]), start

    @cached_property
    def muscle_rest_length(self) -> FloatArray:
        """Length of every muscle at rest [m], shape (n_muscle,)."""
        rods = [float(self.rods[rod].rest_length.sum()) for rod in self.muscles]
        return np.array(rods + [line.rest_length for line in self.lines])

    @cached_property
    def clamped_nodes(self) -> tuple[IntArray, FloatArray, FloatArray]:
        """Rows of clamped nodes, their positions [m], shape (n, 3), and tolerances for rounding [m], shape (n,)."""
        clamped = [(clamp.rod, clamp.node) for clamp in self.clamps if clamp.node is not None]
        place = [self.rods[rod].position[node] for rod, node in clamped]
        tolerance = [FRAME_TOLERANCE * float(self.rods[rod].rest_length.sum()) for rod, _ in clamped]
        rows = [int(self.node_offset[rod]) + node for rod, node in clamped]
        return np.array(rows, np.int64), np.reshape(place, (-1, 3)), np.array(tolerance)

    @cached_property
    def clamped_elements(self) -> tuple[IntArray, FloatArray]:
        """Rows of clamped elements, and their directors, shape (n, 3, 3)."""
        clamped = [(clamp.rod, clamp.element) for clamp in self.clamps if clamp.element is not None]
        frames = [self.rods[rod].directors[element] for rod, element in clamped]
        rows = [int(self.element_offset[rod]) + element for rod, element in clamped]
        return np.array(rows, np.int64), np.reshape(frames, (-1, 3, 3))

    def scaled(self, structure: float, muscle: float, damping: float) -> RodModel:
        """Return the assembly with factors on the moduli of its rods and muscles and on the damping of both.

        Nothing is checked again, as that takes far longer than all else; factors must be positive.
        """
        muscles, model = set(self.muscles), copy(self)
        stiffness = [muscle if index in muscles else structure for index in range(self.n_rod)]
        rods = tuple(rod.scaled(factor, damping) for rod, factor in zip(self.rods, stiffness, strict=True))
        lines = tuple(line.scaled(muscle, damping) for line in self.lines)
        for cached in ("node_damping", "laws"):
            vars(model).pop(cached, None)
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
            position=self.rod_array("position"),
            velocity=np.zeros((self.n_node, 3)),
            directors=self.rod_array("directors"),
            omega=np.zeros((self.n_elem, 3)),
            ball_position=np.reshape([ball.position for ball in self.balls], (-1, 3)),
            ball_velocity=np.zeros((self.n_ball, 3)),
            ball_omega=np.zeros((self.n_ball, 3)),
        )
