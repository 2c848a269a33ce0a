"""A neutral description of any assembly of Cosserat rods: what both engines build from, with no engine inside.

`RodModel` holds constants, `RodState` what moves. `build_model` makes the model of a lattice worm; a cantilever, a free
rod or two joined rods are built from the same parts. Symbols follow Gazzola et al. 2018, R. Soc. Open Sci. 5:171628.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Integral

import numpy as np
import numpy.typing as npt

from lattice_gym.design import FloatArray, IntArray
from lattice_gym.lattice import Lattice
from lattice_gym.muscles import MuscleLayout

SHEAR_CORRECTION = 27.0 / 28.0
"""Kaneko 1975 for a circular section and Poisson's ratio 0.5, as PyElastica has it."""

DT_MARGIN = 0.5
"""Share of the predicted stable step that `default_dt` may use: room for what contraction adds to the stiffness."""

_FRAME_TOLERANCE = 1e-9
_DRIFT_TOLERANCE = 1e-6
"""Frames are turned step by step and never mended: a million steps leave about 1e-10."""


def _array(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Read-only float array of the given shape, or a ValueError that names it."""
    try:
        array = np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), shape))
    except (TypeError, ValueError):
        raise ValueError(f"{name}: must be real numbers of shape {shape}, got {value!r}") from None
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: must be finite")
    array.setflags(write=False)
    return array


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ValueError(message)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rod:
    """One Cosserat rod of circular section, free of stress in the shape given here.

    Raises
    ------
    ValueError
        Fewer than two elements, a zero-length element, directors that are no right-handed frames along the elements,
        or a property out of bounds.
    """

    position: FloatArray
    """Rest node positions [m], shape (n_elem + 1, 3)."""
    directors: FloatArray
    """Rest directors, shape (n_elem, 3, 3): rows d1, d2, d3, with d3 along the element."""
    radius: FloatArray
    """Radius of each element at rest [m], shape (n_elem,); a single number is spread."""
    density: float
    """[kg/m^3]"""
    youngs_modulus: float
    """[Pa]"""
    shear_modulus: float
    """[Pa]"""
    damping: float = 0.0
    """Translational damping [N s/m per node]."""
    rotational_damping: float = 0.0
    """[N m s per element]"""

    def __post_init__(self) -> None:
        position = np.asarray(self.position, dtype=np.float64)
        _require(
            position.ndim == 2 and position.shape[1] == 3 and len(position) >= 3,
            f"Rod.position: shape must be (n_elem + 1, 3) with n_elem >= 2, got {position.shape}",
        )
        n_elem = len(position) - 1
        for name, shape in (("position", (n_elem + 1, 3)), ("directors", (n_elem, 3, 3)), ("radius", (n_elem,))):
            object.__setattr__(self, name, _array(f"Rod.{name}", getattr(self, name), shape))
        _require(bool((self.rest_length > 0.0).all()), "Rod.position: two neighbouring nodes coincide")
        for name in ("density", "youngs_modulus", "shear_modulus"):
            value = getattr(self, name)
            _require(np.isfinite(value) and value > 0.0, f"Rod.{name} = {value}: must be positive and finite")
        for name in ("damping", "rotational_damping"):
            value = getattr(self, name)
            _require(np.isfinite(value) and value >= 0.0, f"Rod.{name} = {value}: must be finite and not negative")
        _require(bool((self.radius > 0.0).all()), "Rod.radius: must be positive")
        q = self.directors
        tangent = np.diff(self.position, axis=0) / self.rest_length[:, None]
        orthonormal = np.abs(q @ q.transpose(0, 2, 1) - np.eye(3)).max() < _FRAME_TOLERANCE
        right_handed = bool((np.linalg.det(q) > 0.0).all())
        along = np.abs(q[:, 2] - tangent).max() < _FRAME_TOLERANCE
        _require(orthonormal and right_handed and along, "Rod.directors: must be right-handed frames, d3 the tangent")

    @property
    def n_elem(self) -> int:
        """Number of elements."""
        return len(self.position) - 1

    @cached_property
    def rest_length(self) -> FloatArray:
        """Element lengths at rest [m], shape (n_elem,)."""
        length: FloatArray = np.linalg.norm(np.diff(self.position, axis=0), axis=1)
        return length

    @cached_property
    def rest_voronoi(self) -> FloatArray:
        """Mean length of each two neighbouring elements at rest [m], shape (n_elem - 1,)."""
        return 0.5 * (self.rest_length[1:] + self.rest_length[:-1])

    @cached_property
    def area(self) -> FloatArray:
        """Cross-section at rest [m^2], shape (n_elem,)."""
        return np.pi * self.radius**2

    @cached_property
    def second_moment(self) -> FloatArray:
        """Second moment of area about a diameter at rest [m^4], shape (n_elem,); twice that about the axis."""
        moment: FloatArray = np.pi / 4.0 * self.radius**4
        return moment

    @cached_property
    def mass(self) -> FloatArray:
        """Node masses [kg], shape (n_elem + 1,): half of either neighbouring element."""
        half = 0.5 * self.density * self.area * self.rest_length
        mass: FloatArray = np.append(half, 0.0) + np.append(0.0, half)
        return mass

    @cached_property
    def inertia(self) -> FloatArray:
        """Mass moment of inertia of each element about d1 and d2 [kg m^2], shape (n_elem,); twice that about d3."""
        return self.density * self.second_moment * self.rest_length

    @cached_property
    def shear_stiffness(self) -> FloatArray:
        """Corrected shear stiffness alpha G A [N], shape (n_elem,)."""
        return SHEAR_CORRECTION * self.shear_modulus * self.area

    @cached_property
    def stretch_stiffness(self) -> FloatArray:
        """E A [N], shape (n_elem,)."""
        return self.youngs_modulus * self.area

    @cached_property
    def bend_stiffness(self) -> FloatArray:
        """E I of each Voronoi region, weighted by length [N m^2], shape (n_elem - 1,)."""
        weighted = self.youngs_modulus * self.second_moment * self.rest_length
        return (weighted[1:] + weighted[:-1]) / (self.rest_length[1:] + self.rest_length[:-1])

    @cached_property
    def twist_stiffness(self) -> FloatArray:
        """G J of each Voronoi region, weighted by length [N m^2], shape (n_elem - 1,)."""
        return self.bend_stiffness * (2.0 * self.shear_modulus / self.youngs_modulus)

    @cached_property
    def rest_kappa(self) -> FloatArray:
        """Curvature and twist at rest in the material frame [1/m], shape (n_elem - 1, 3)."""
        return rotation_between(self.directors[:-1], self.directors[1:]) / self.rest_voronoi[:, None]


def rotation_between(first: FloatArray, second: FloatArray) -> FloatArray:
    """Rotation vectors that carry frames `first` into `second` [rad], in the material frame, shape (n, 3)."""
    relative = second @ first.transpose(0, 2, 1)
    axis = np.stack(
        [relative[:, i, j] - relative[:, j, i] for i, j in ((1, 2), (2, 0), (0, 1))],
        axis=1,
    )
    sine = 0.5 * np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(relative, axis1=1, axis2=2) - 1.0))
    return axis * np.where(sine > 0.0, 0.5 * angle / np.where(sine > 0.0, sine, 1.0), 0.5)[:, None]


def straight_frames(position: FloatArray, normal: npt.ArrayLike) -> FloatArray:
    """Directors along the elements of a rod, shape (n_elem, 3, 3), with d1 as near to `normal` as can be."""
    tangent = np.diff(position, axis=0)
    tangent = tangent / np.linalg.norm(tangent, axis=1)[:, None]
    d1 = np.broadcast_to(np.asarray(normal, dtype=np.float64), tangent.shape)
    d1 = d1 - np.sum(d1 * tangent, axis=1)[:, None] * tangent
    length = np.linalg.norm(d1, axis=1)
    _require(bool((length > 1e-6).all()), "normal: must not lie along the rod")
    d1 = d1 / length[:, None]
    return np.stack([d1, np.cross(tangent, d1), tangent], axis=1)


def straight_rod(
    start: npt.ArrayLike,
    end: npt.ArrayLike,
    n_elem: int,
    *,
    radius: float,
    density: float,
    youngs_modulus: float,
    shear_modulus: float,
    normal: npt.ArrayLike | None = None,
    damping: float = 0.0,
    rotational_damping: float = 0.0,
) -> Rod:
    """Straight rod of `n_elem` equal elements from `start` to `end` [m]; d1 lies towards `normal` (default: any)."""
    a, b = _array("start", start, (3,)), _array("end", end, (3,))
    _require(n_elem >= 2, f"n_elem = {n_elem}: must be at least 2")
    _require(bool((a != b).any()), "end: must differ from start")
    position = a + np.linspace(0.0, 1.0, n_elem + 1)[:, None] * (b - a)
    if normal is None:
        normal = np.eye(3)[np.argmin(np.abs(b - a))]
    return Rod(
        position=position,
        directors=straight_frames(position, normal),
        radius=np.full(n_elem, radius),
        density=density,
        youngs_modulus=youngs_modulus,
        shear_modulus=shear_modulus,
        damping=damping,
        rotational_damping=rotational_damping,
    )


@dataclass(frozen=True)
class Joint:
    """Spherical joint: a spring [N/m] and a dashpot [N s/m] of zero rest length between two nodes."""

    rod_a: int
    node_a: int
    rod_b: int
    node_b: int
    stiffness: float
    damping: float = 0.0


@dataclass(frozen=True)
class Clamp:
    """A node held at its rest position, an element held at its rest orientation, or both."""

    rod: int
    node: int | None = None
    element: int | None = None


@dataclass(frozen=True)
class PointForce:
    """Constant force on a node [N], in the laboratory frame."""

    rod: int
    node: int
    force: tuple[float, float, float]


@dataclass(frozen=True)
class PointTorque:
    """Constant torque on an element [N m], in its material frame: it turns with the element."""

    rod: int
    element: int
    torque: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class RodModel:
    """An assembly of rods. Arrays over all nodes (elements) hold the rods one after another.

    Raises
    ------
    ValueError
        No rod, an index that no rod, node or element has, a joint of a node with itself, a negative stiffness.
    """

    rods: tuple[Rod, ...]
    joints: tuple[Joint, ...] = ()
    clamps: tuple[Clamp, ...] = ()
    forces: tuple[PointForce, ...] = ()
    torques: tuple[PointTorque, ...] = ()
    muscles: tuple[int, ...] = ()
    """Rods that contract, in the order of the tensions."""

    def __post_init__(self) -> None:
        _require(len(self.rods) > 0, "rods: at least one is needed")
        for k, joint in enumerate(self.joints):
            self._check_index(f"joints[{k}]", joint.rod_a, joint.node_a, extra=1)
            self._check_index(f"joints[{k}]", joint.rod_b, joint.node_b, extra=1)
            same = (joint.rod_a, joint.node_a) == (joint.rod_b, joint.node_b)
            _require(not same, f"joints[{k}]: joins a node with itself")
            for name in ("stiffness", "damping"):
                value = getattr(joint, name)
                good = np.isfinite(value) and value >= 0.0
                _require(good, f"joints[{k}].{name} = {value}: must be finite and not negative")
        for k, clamp in enumerate(self.clamps):
            _require(
                clamp.node is not None or clamp.element is not None, f"clamps[{k}]: holds neither node nor element"
            )
            self._check_index(f"clamps[{k}]", clamp.rod, clamp.node or 0, extra=1)
            self._check_index(f"clamps[{k}]", clamp.rod, clamp.element or 0, extra=0)
        for k, force in enumerate(self.forces):
            self._check_index(f"forces[{k}]", force.rod, force.node, extra=1)
            _array(f"forces[{k}].force", force.force, (3,))
        for k, torque in enumerate(self.torques):
            self._check_index(f"torques[{k}]", torque.rod, torque.element, extra=0)
            _array(f"torques[{k}].torque", torque.torque, (3,))
        for k, rod in enumerate(self.muscles):
            self._check_index(f"muscles[{k}]", rod, 0, extra=0)
        _require(len(set(self.muscles)) == len(self.muscles), "muscles: a rod is named twice")

    def _check_index(self, name: str, rod: int, index: int, *, extra: int) -> None:
        for value in (rod, index):
            whole = isinstance(value, Integral) and not isinstance(value, bool)
            _require(whole, f"{name}: {value!r} must be a whole number")
        _require(0 <= rod < len(self.rods), f"{name}: there is no rod {rod}")
        count, part = self.rods[rod].n_elem + extra, "nodes" if extra else "elements"
        _require(0 <= index < count, f"{name}: rod {rod} has {count} {part}, no number {index}")

    @property
    def n_rod(self) -> int:
        """Number of rods."""
        return len(self.rods)

    @property
    def n_muscle(self) -> int:
        """Number of muscles."""
        return len(self.muscles)

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
    def joint_nodes(self) -> IntArray:
        """Rows of the two nodes of every joint, shape (n_joint, 2)."""
        offset = self.node_offset.tolist()
        ends = [(offset[j.rod_a] + j.node_a, offset[j.rod_b] + j.node_b) for j in self.joints]
        return np.array(ends, dtype=np.int64).reshape(-1, 2)

    def nodes(self, rod: int) -> slice:
        """Rows of a rod's nodes."""
        return slice(int(self.node_offset[rod]), int(self.node_offset[rod + 1]))

    def elements(self, rod: int) -> slice:
        """Rows of a rod's elements."""
        return slice(int(self.element_offset[rod]), int(self.element_offset[rod + 1]))

    def rest_state(self) -> RodState:
        """Return the state in which no rod or joint is stressed."""
        return RodState(
            position=np.concatenate([rod.position for rod in self.rods]),
            velocity=np.zeros((self.n_node, 3)),
            directors=np.concatenate([rod.directors for rod in self.rods]),
            omega=np.zeros((self.n_elem, 3)),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class RodState:
    """What moves: all that is needed to go on exactly."""

    position: FloatArray
    """Node positions [m], shape (n_node, 3)."""
    velocity: FloatArray
    """Node velocities [m/s], shape (n_node, 3)."""
    directors: FloatArray
    """Rows d1, d2, d3 of each element, shape (n_elem, 3, 3)."""
    omega: FloatArray
    """Angular velocities in the material frame [rad/s], shape (n_elem, 3)."""
    time: float = 0.0
    """[s]"""

    def copy(self) -> RodState:
        """Return a state that shares no memory with this one."""
        arrays = {name: getattr(self, name).copy() for name in ("position", "velocity", "directors", "omega")}
        return replace(self, **arrays)

    def check(self, model: RodModel) -> None:
        """Raise ValueError unless shapes fit `model`, all is finite, frames are frames and what is clamped rests."""
        shapes = {
            "position": (model.n_node, 3),
            "velocity": (model.n_node, 3),
            "directors": (model.n_elem, 3, 3),
            "omega": (model.n_elem, 3),
        }
        for name, shape in shapes.items():
            array = getattr(self, name)
            _require(array.shape == shape, f"RodState.{name}: shape must be {shape}, got {array.shape}")
            _require(bool(np.isfinite(array).all()), f"RodState.{name}: must be finite")
        _require(bool(np.isfinite(self.time)), f"RodState.time = {self.time}: must be finite")
        skew = np.abs(self.directors @ self.directors.transpose(0, 2, 1) - np.eye(3)).max()
        _require(bool(skew < _DRIFT_TOLERANCE), "RodState.directors: must be orthonormal")
        for clamp in model.clamps:
            rod = model.rods[clamp.rod]
            if clamp.node is not None:
                gap = self.position[model.nodes(clamp.rod)][clamp.node] - rod.position[clamp.node]
                still = np.abs(gap).max() < _FRAME_TOLERANCE * rod.rest_length.sum()
                _require(bool(still), f"RodState.position: {clamp} must stay at rest")
                _require(
                    not self.velocity[model.nodes(clamp.rod)][clamp.node].any(), f"RodState.velocity: {clamp} moves"
                )
            if clamp.element is not None:
                turn = self.directors[model.elements(clamp.rod)][clamp.element] - rod.directors[clamp.element]
                _require(bool(np.abs(turn).max() < _FRAME_TOLERANCE), f"RodState.directors: {clamp} must stay at rest")
                _require(
                    not self.omega[model.elements(clamp.rod)][clamp.element].any(), f"RodState.omega: {clamp} turns"
                )


def build_model(lattice: Lattice, layout: MuscleLayout) -> RodModel:
    """Model of a lattice worm: its structure rods first, then a rod for each active muscle of `layout`, in order."""
    design = lattice.design

    def shear_modulus(youngs_modulus: float, poisson_ratio: float) -> float:
        return youngs_modulus / (2.0 * (1.0 + poisson_ratio))

    structure = [
        Rod(
            position=lattice.position[i],
            directors=lattice.directors[i],
            radius=np.full(lattice.n_node - 1, design.structure_radius),
            density=design.structure_density,
            youngs_modulus=design.structure_youngs_modulus,
            shear_modulus=shear_modulus(design.structure_youngs_modulus, design.structure_poisson_ratio),
            damping=design.damping,
            rotational_damping=design.rotational_damping,
        )
        for i in range(lattice.n_rod)
    ]
    muscles = [
        straight_rod(
            lattice.site_position[muscle.start],
            lattice.site_position[muscle.end],
            design.elements_per_muscle,
            radius=design.muscle_radius,
            density=design.muscle_density,
            youngs_modulus=design.muscle_youngs_modulus,
            shear_modulus=shear_modulus(design.muscle_youngs_modulus, design.muscle_poisson_ratio),
            damping=design.damping,
            rotational_damping=design.rotational_damping,
        )
        for muscle in layout.active
    ]
    return RodModel(
        rods=(*structure, *muscles),
        joints=tuple(_lattice_joints(lattice, layout)),
        clamps=tuple(Clamp(i, node=0, element=0) for i in range(lattice.n_rod)) if design.base == "clamped" else (),
        muscles=tuple(range(lattice.n_rod, lattice.n_rod + len(muscles))),
    )


def _lattice_joints(lattice: Lattice, layout: MuscleLayout) -> Iterator[Joint]:
    """Join the two rods of every site, and each muscle's ends to the right-handed rods of its sites."""
    design = lattice.design
    spring = (design.joint_stiffness, design.joint_damping)
    for (rod_a, rod_b), (node_a, node_b) in zip(lattice.site_rod.tolist(), lattice.site_node.tolist(), strict=True):
        yield Joint(rod_a, node_a, rod_b, node_b, *spring)
    for k, muscle in enumerate(layout.active):
        for site, node in ((muscle.start, 0), (muscle.end, design.elements_per_muscle)):
            rod, at = int(lattice.site_rod[site, 0]), int(lattice.site_node[site, 0])
            yield Joint(rod, at, lattice.n_rod + k, node, *spring)


def stable_dt(model: RodModel) -> float:
    """Predict the largest stable position-Verlet step near rest [s].

    The highest squared frequency is bounded by that of a rod alone plus that of the joints alone, whose graph of
    springs and masses has no eigenvalue above the largest sum, over a joint, of stiffness over mass at its two ends
    (Anderson and Morley 1985). A dashpot acts on the velocity of the step before and takes its share likewise.
    """
    rod_square = max(_rod_bound(rod) for rod in model.rods)
    spring, dashpot = _joint_bound(model, "stiffness"), _joint_bound(model, "damping")
    square = rod_square + spring
    # An oscillator with a lagged dashpot is stable while square dt^2 + 2 dashpot dt <= 4.
    return float((np.sqrt(dashpot**2 + 4.0 * square) - dashpot) / square)


def _rod_bound(rod: Rod) -> float:
    """Largest squared frequency of a straight rod alone [1/s^2].

    In the fastest motion neighbouring nodes move, and neighbouring elements turn, in opposite senses: a 2 x 2 problem
    of deflection (shear alone) and turning (shear and bending), which is never below stretch alone.
    """
    stretch = _chain_bound(rod.stretch_stiffness / rod.rest_length, rod.mass)
    bend = _chain_bound(rod.bend_stiffness / rod.rest_voronoi, rod.inertia)
    deflect = _chain_bound(rod.shear_stiffness / rod.rest_length, rod.mass)
    turn = float(np.max(rod.shear_stiffness * rod.rest_length / rod.inertia))
    trace = bend + deflect + turn
    return max(stretch, 0.5 * (trace + float(np.sqrt(trace**2 - 4.0 * deflect * bend))))


def _chain_bound(stiffness: FloatArray, inertia: FloatArray) -> float:
    """Largest eigenvalue, bounded from above, of bodies in a row (n,) with springs between them (n - 1,)."""
    load = (np.append(stiffness, 0.0) + np.append(0.0, stiffness)) / inertia
    return float(np.max(load[1:] + load[:-1]))


def _joint_bound(model: RodModel, coefficient: str) -> float:
    """Largest eigenvalue, bounded from above, of the joints' coefficient matrix over the node masses."""
    mass = np.concatenate([rod.mass for rod in model.rods])
    load = np.zeros(model.n_node)
    ends = model.joint_nodes.tolist()
    for joint, (a, b) in zip(model.joints, ends, strict=True):
        load[a] += getattr(joint, coefficient) / mass[a]
        load[b] += getattr(joint, coefficient) / mass[b]
    return max((float(load[a] + load[b]) for a, b in ends), default=0.0)


def default_dt(model: RodModel, control_dt: float) -> float:
    """Largest step [s] that divides `control_dt` and stays below `DT_MARGIN` of the predicted stable step."""
    return control_dt / int(np.ceil(control_dt / (DT_MARGIN * stable_dt(model))))
