"""A neutral description of any assembly of Cosserat rods: what both engines build from, with no engine inside.

`RodModel` holds constants, `RodState` what moves. `build_model` makes the model of a lattice worm; a cantilever, a free
rod or two joined rods are built from the same parts. Symbols follow Gazzola et al. 2018, R. Soc. Open Sci. 5:171628.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Integral
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lattice_gym.design import MAX_ELEMENTS, FloatArray, IntArray, finite_number, real_array, shown, whole_number
from lattice_gym.hill import Hill
from lattice_gym.lattice import Lattice
from lattice_gym.muscles import Muscle, MuscleLayout
from lattice_gym.world import Contact, Ground, World

SHEAR_CORRECTION = 27.0 / 28.0
"""Kaneko 1975 for a circular section and Poisson's ratio 0.5, as PyElastica has it."""

_FRAME_TOLERANCE = 1e-9
_DRIFT_TOLERANCE = 1e-6
"""Frames are turned step by step and never mended: a million steps leave about 1e-10."""


def _array(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Read-only float array of the given shape, or a ValueError that names it."""
    given = real_array(name, value)
    try:
        array = np.array(np.broadcast_to(given, shape))
    except ValueError:
        raise ValueError(f"{name}: must be real numbers of shape {shape}, got {shown(value)}") from None
    array.setflags(write=False)
    return array


def _number(name: str, value: object, *, above: bool) -> float:
    """Finite number that is positive, or not negative; else a ValueError that names it."""
    number = finite_number(value)
    if number is None or number < 0.0 or (above and number == 0.0):
        raise ValueError(
            f"{name} = {shown(value)}: must be {'positive and finite' if above else 'finite and not negative'}"
        )
    return number


def _parts(name: str, values: object, kind: type) -> None:
    """Refuse what is no tuple (or list) of a kind of part."""
    if not isinstance(values, tuple | list):
        raise ValueError(f"{name} = {shown(values)}: must be a tuple of {kind.__name__}")
    for k, value in enumerate(values):
        if not isinstance(value, kind) or isinstance(value, bool):
            raise ValueError(f"{name}[{k}] = {shown(value)}: must be {kind.__name__}")


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ValueError(message)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rod:
    """One Cosserat rod of circular section, free of stress as given here unless `natural_curvature` says else.

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
    natural_curvature: FloatArray | None = None
    """Curvature and twist free of stress, in the material frame [1/m], shape (n_elem - 1, 3); None: those of the shape.

    A rod held in a shape that is not its own: straight by nature, say, but bent and twisted between clamps.
    """

    def __post_init__(self) -> None:
        position = real_array("Rod.position", self.position)
        _require(
            position.ndim == 2 and position.shape[1] == 3 and len(position) >= 3,
            f"Rod.position: shape must be (n_elem + 1, 3) with n_elem >= 2, got {position.shape}",
        )
        n_elem = len(position) - 1
        for name, shape in (("position", (n_elem + 1, 3)), ("directors", (n_elem, 3, 3)), ("radius", (n_elem,))):
            object.__setattr__(self, name, _array(f"Rod.{name}", getattr(self, name), shape))
        if self.natural_curvature is not None:
            curvature = _array("Rod.natural_curvature", self.natural_curvature, (n_elem - 1, 3))
            object.__setattr__(self, "natural_curvature", curvature)
        with np.errstate(all="ignore"):
            size = self.rest_length
        _require(bool(np.isfinite(size).all()), "Rod.position: nodes lie too far apart")
        _require(bool((size > 0.0).all()), "Rod.position: two neighbouring nodes coincide")
        for name in ("density", "youngs_modulus", "shear_modulus"):
            object.__setattr__(self, name, _number(f"Rod.{name}", getattr(self, name), above=True))
        for name in ("damping", "rotational_damping"):
            object.__setattr__(self, name, _number(f"Rod.{name}", getattr(self, name), above=False))
        _require(bool((self.radius > 0.0).all()), "Rod.radius: must be positive")
        q = self.directors
        tangent = np.diff(self.position, axis=0) / self.rest_length[:, None]
        orthonormal = np.abs(q @ q.transpose(0, 2, 1) - np.eye(3)).max() < _FRAME_TOLERANCE
        right_handed = bool((np.linalg.det(q) > 0.0).all())
        along = np.abs(q[:, 2] - tangent).max() < _FRAME_TOLERANCE
        _require(orthonormal and right_handed and along, "Rod.directors: must be right-handed frames, d3 the tangent")
        self._check_constants()

    def _check_constants(self) -> None:
        """Refuse a rod whose numbers are each possible, but not together."""
        with np.errstate(all="ignore"):
            constants = [self.mass, self.inertia, self.stretch_stiffness, self.shear_stiffness]
            constants += [self.bend_stiffness, self.twist_stiffness]
            sound = all(bool((np.isfinite(c) & (c > 0.0) & np.isfinite(1.0 / c)).all()) for c in constants)
        names = "Rod.position, radius, density, youngs_modulus, shear_modulus"
        _require(sound, f"{names}: mass or stiffness leaves the range of numbers; some are far too large or too small")

    def scaled(self, stiffness: float, damping: float) -> Rod:
        """Return the rod with factors on its moduli and on both dampings, which is not checked again."""
        rod = copy(self)
        kept = {name: value for name, value in vars(self).items() if name not in _OF_MODULI}
        kept |= {name: stiffness * kept[name] for name in ("youngs_modulus", "shear_modulus")}
        kept |= {name: damping * kept[name] for name in ("damping", "rotational_damping")}
        vars(rod).clear()
        vars(rod).update(kept)
        return rod

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
        return _node_sums(0.5 * self.density * self.area * self.rest_length)

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
        """Curvature and twist free of stress in the material frame [1/m], shape (n_elem - 1, 3)."""
        if self.natural_curvature is not None:
            return self.natural_curvature
        return rotation_between(self.directors[:-1], self.directors[1:]) / self.rest_voronoi[:, None]


_OF_MODULI = ("shear_stiffness", "stretch_stiffness", "bend_stiffness", "twist_stiffness")


def _node_sums(values: FloatArray) -> FloatArray:
    """Sum over the elements at each node of a rod, shape (n_elem + 1,), of values of shape (n_elem,)."""
    sums: FloatArray = np.append(values, 0.0) + np.append(0.0, values)
    return sums


def _node_radius(rod: Rod) -> FloatArray:
    """Radius at each node of a rod [m], shape (n_elem + 1,): the mean of its elements'."""
    return _node_sums(rod.radius) / _node_sums(np.ones(rod.n_elem))


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
    d1 = _array("normal", normal, tangent.shape)
    if np.abs(d1).max() > 0.0:
        d1 = d1 / np.abs(d1).max()
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
    count = whole_number(n_elem)
    if count is None or not 2 <= count <= MAX_ELEMENTS:
        raise ValueError(f"n_elem = {shown(n_elem)}: must be a whole number, at least 2, at most {MAX_ELEMENTS}")
    _require(bool((a != b).any()), "end: must differ from start")
    with np.errstate(all="ignore"):
        chord = b - a
        apart = float(np.linalg.norm(chord / count))
        inside = math.isfinite(apart) and apart**2 > 0.0 and apart > 1e-12 * float(np.abs([a, b]).max())
    _require(inside, f"end: lies too close to start, or too far from it, for {count} elements")
    position = a + np.linspace(0.0, 1.0, count + 1)[:, None] * chord
    if normal is None:
        normal = np.eye(3)[np.argmin(np.abs(b - a))]
    return Rod(
        position=position,
        directors=straight_frames(position, normal),
        radius=_array("Rod.radius", radius, (count,)),
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
class Line:
    """Muscle without nodes of its own: the tension and stretch of a straight rod between two nodes.

    Its mass and its damping stand on its two ends, half on either.
    """

    rod_a: int
    node_a: int
    rod_b: int
    node_b: int
    rest_length: float
    """[m]"""
    stiffness: float
    """E A [N]"""
    mass: float = 0.0
    """[kg]"""
    damping: float = 0.0
    """[N s/m]"""
    density: float = math.inf
    """What its mass has for a volume [kg/m^3]: a medium carries nothing of an infinitely dense one."""


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
class Ball:
    """Rigid uniform ball that pushes at elements of rods, each a cylinder of its rest radius with round ends.

    Where it overlaps one by a depth, with u the velocity of its material at the nearest point of the centre line over
    that of the line there, it pushes with N = max(0, stiffness depth - damping u_n) along the normal. Friction, at most
    friction N, takes all slip u_t that everything else leaves at the end of a step, or acts against it in full:
    Coulomb's law. Both act on the centre line: the lever rule shares them between its two nodes, and the ball has the
    opposite force and its moment, so that momentum and angular momentum close; the rod is not twisted.
    """

    position: FloatArray
    """Where its centre starts [m], shape (3,)."""
    radius: float
    """[m]"""
    mass: float
    """[kg]"""
    stiffness: float
    """Of the contact with an element [N/m]."""
    damping: float = 0.0
    """Of that contact, along the normal [N s/m]."""
    friction: float = 0.0
    """Friction over normal force."""
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Constant force, as its weight less what the medium carries [N]."""

    def __post_init__(self) -> None:
        for name in ("radius", "mass"):
            object.__setattr__(self, name, _number(f"Ball.{name}", getattr(self, name), above=True))
        for name in ("stiffness", "damping", "friction"):
            object.__setattr__(self, name, _number(f"Ball.{name}", getattr(self, name), above=False))
        object.__setattr__(self, "position", _array("Ball.position", self.position, (3,)))
        object.__setattr__(self, "force", tuple(_array("Ball.force", self.force, (3,)).tolist()))
        sound = self.inertia > 0.0 and math.isfinite(self.inertia) and math.isfinite(1.0 / self.inertia)
        _require(sound, "Ball.radius, mass: inertia leaves the range of numbers; they are far too large or too small")

    @property
    def inertia(self) -> float:
        """Moment of inertia about any diameter [kg m^2]."""
        return 0.4 * self.mass * self.radius**2


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
        _require(len(self.rods) > 0, "rods: at least one is needed")
        object.__setattr__(self, "hill", Hill.resolve("hill", self.hill))
        for k, joint in enumerate(self.joints):
            self._check_index(f"joints[{k}]", joint.rod_a, joint.node_a, extra=1)
            self._check_index(f"joints[{k}]", joint.rod_b, joint.node_b, extra=1)
            same = (joint.rod_a, joint.node_a) == (joint.rod_b, joint.node_b)
            _require(not same, f"joints[{k}]: joins a node with itself")
            for name in ("stiffness", "damping"):
                _number(f"joints[{k}].{name}", getattr(joint, name), above=False)
        for k, line in enumerate(self.lines):
            self._check_index(f"lines[{k}]", line.rod_a, line.node_a, extra=1)
            self._check_index(f"lines[{k}]", line.rod_b, line.node_b, extra=1)
            for name in ("rest_length", "stiffness", "mass", "damping"):
                _number(f"lines[{k}].{name}", getattr(line, name), above=name == "rest_length")
            if not (isinstance(line.density, float) and line.density == math.inf):
                _number(f"lines[{k}].density", line.density, above=True)
            stiff = finite_number(float(line.stiffness) / float(line.rest_length)) is not None
            _require(stiff, f"lines[{k}].rest_length = {line.rest_length}: far too short for its stiffness")
            self._check_direction(f"lines[{k}]", line)
        for k, clamp in enumerate(self.clamps):
            held = clamp.node is not None or clamp.element is not None
            _require(held, f"clamps[{k}]: holds neither node nor element")
            self._check_index(f"clamps[{k}]", clamp.rod, 0 if clamp.node is None else clamp.node, extra=1)
            self._check_index(f"clamps[{k}]", clamp.rod, 0 if clamp.element is None else clamp.element, extra=0)
        for k, force in enumerate(self.forces):
            self._check_index(f"forces[{k}]", force.rod, force.node, extra=1)
            _array(f"forces[{k}].force", force.force, (3,))
        for k, torque in enumerate(self.torques):
            self._check_index(f"torques[{k}]", torque.rod, torque.element, extra=0)
            _array(f"torques[{k}].torque", torque.torque, (3,))
        for k, rod in enumerate(self.muscles):
            self._check_index(f"muscles[{k}]", rod, 0, extra=0)
        _require(len(set(self.muscles)) == len(self.muscles), "muscles: a rod is named twice")
        known = self.bolus is None or isinstance(self.bolus, Ball)
        _require(known, f"bolus = {shown(self.bolus)}: must be Ball or None")
        self._check_world()

    def _check_world(self) -> None:
        """Refuse a medium or ground that is none, and weights or drags beyond the range of numbers."""
        if self.gravity is not None:
            object.__setattr__(self, "gravity", _array("gravity", self.gravity, (3,)))
        for name in ("medium_density", "medium_drag"):
            object.__setattr__(self, name, _number(name, getattr(self, name), above=False))
        if self.ground is not None and not isinstance(self.ground, Ground):
            raise ValueError(f"ground = {shown(self.ground)}: must be Ground or None")
        if self.ground is not None and not self.ground.isotropic:
            self._check_axis()
        if self.contact is not None and not isinstance(self.contact, Contact):
            raise ValueError(f"contact = {shown(self.contact)}: must be Contact or None")
        with np.errstate(all="ignore"):
            _require(bool(np.isfinite(self.node_weight).all()), "gravity, medium_density: far too large for these rods")
            _require(bool(np.isfinite(self.node_damping).all()), "medium_drag: far too large for these rods")

    def _check_axis(self) -> None:
        """Refuse rods whose ends cancel out: what a body axis is made of."""
        place = np.concatenate([rod.position for rod in self.rods])
        tail, head = self.rod_ends
        with np.errstate(all="ignore"):
            chord = place[head] - place[tail]
            length, most = float(np.linalg.norm(chord.sum(axis=0))), float(np.linalg.norm(chord, axis=1).sum())
        _require(
            _FRAME_TOLERANCE * most < length < math.inf,
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
        apart = _FRAME_TOLERANCE * float(line.rest_length) < length < math.inf
        _require(apart, f"{name}: its two ends lie at one place at rest, or too far apart")

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
            [rod.damping + drag * _node_sums(0.5 * rod.rest_length) for rod in self.rods],
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
        return np.concatenate([_node_radius(rod) for rod in self.rods])

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
        slack = [_FRAME_TOLERANCE * float(self.rods[rod].rest_length.sum()) for rod, _ in held]
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


def _no_bolus() -> FloatArray:
    return np.zeros((0, 3))


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
    bolus_position: FloatArray = field(default_factory=_no_bolus)
    """Position of the ball's centre [m], shape (n_bolus, 3)."""
    bolus_velocity: FloatArray = field(default_factory=_no_bolus)
    """[m/s], shape (n_bolus, 3)"""
    bolus_omega: FloatArray = field(default_factory=_no_bolus)
    """Angular velocity in the laboratory frame [rad/s], shape (n_bolus, 3)."""
    time: float = 0.0
    """[s]"""

    def copy(self) -> RodState:
        """Return a state that shares no memory with this one."""
        arrays = {name: value.copy() for name, value in vars(self).items() if name != "time"}
        return replace(self, **arrays)

    def check(self, model: RodModel) -> None:
        """Raise ValueError unless shapes fit `model`, all is finite, frames are frames and what is clamped rests."""
        shapes = {
            "position": (model.n_node, 3),
            "velocity": (model.n_node, 3),
            "directors": (model.n_elem, 3, 3),
            "omega": (model.n_elem, 3),
            "bolus_position": (model.n_bolus, 3),
            "bolus_velocity": (model.n_bolus, 3),
            "bolus_omega": (model.n_bolus, 3),
        }
        for name, shape in shapes.items():
            array = real_array(f"RodState.{name}", getattr(self, name))
            _require(array.shape == shape, f"RodState.{name}: shape must be {shape}, got {array.shape}")
            _require(bool(np.isfinite(array).all()), f"RodState.{name}: must be finite")
        _require(
            finite_number(self.time) is not None, f"RodState.time = {shown(self.time)}: must be a finite number [s]"
        )
        d1, d2, d3 = (self.directors[:, row] for row in range(3))
        skew = np.abs(self.directors @ self.directors.transpose(0, 2, 1) - np.eye(3)).max()
        _require(bool(skew < _DRIFT_TOLERANCE), "RodState.directors: must be orthonormal")
        right_handed = bool((np.sum(np.cross(d1, d2) * d3, axis=1) > 0.0).all())
        _require(right_handed, "RodState.directors: must be right-handed")
        (nodes, place, slack), (elements, frames) = model.held_nodes, model.held_elements
        clamped = [clamp for clamp in model.clamps if clamp.node is not None]
        gap = np.abs(self.position[nodes] - place)
        _refuse_any(~(gap < slack[:, None]), clamped, "RodState.position: {} must stay at rest")
        _refuse_any(self.velocity[nodes] != 0.0, clamped, "RodState.velocity: {} moves")
        clamped = [clamp for clamp in model.clamps if clamp.element is not None]
        turn = np.abs(self.directors[elements] - frames).reshape(-1, 9)
        _refuse_any(~(turn < _FRAME_TOLERANCE), clamped, "RodState.directors: {} must stay at rest")
        _refuse_any(self.omega[elements] != 0.0, clamped, "RodState.omega: {} turns")


def _refuse_any(wrong: npt.NDArray[np.bool_], clamps: Sequence[Clamp], message: str) -> None:
    """Raise ValueError that names the first clamp with something wrong in its row."""
    if wrong.any():
        raise ValueError(message.format(clamps[int(np.argmax(wrong.any(axis=1)))]))


class Motion(NamedTuple):
    """What is seen of worms that move side by side: one row a worm."""

    position: FloatArray
    """Node positions [m], shape (n_worm, n_node, 3)."""
    velocity: FloatArray
    """Node velocities [m/s], shape (n_worm, n_node, 3)."""
    bolus_position: FloatArray
    """Positions of the balls' centres [m], shape (n_worm, n_bolus, 3)."""
    bolus_velocity: FloatArray
    """[m/s], shape (n_worm, n_bolus, 3)"""

    @classmethod
    def of(cls, state: RodState) -> Motion:
        """Motion of a single worm."""
        return cls(state.position[None], state.velocity[None], state.bolus_position[None], state.bolus_velocity[None])

    def rows(self, worms: IntArray) -> Motion:
        """Motion of some of the worms, shape (n,) of their rows."""
        return Motion(*(part[worms] for part in self))


def build_model(
    lattice: Lattice, layout: MuscleLayout, world: World | None = None, *, hill: Hill | None = None
) -> RodModel:
    """Model of a lattice worm: its structure rods first, then a rod for each active muscle of `layout`, in order.

    A `world` adds what surrounds it; see `World`. With muscles as lines, which touch nothing, there can be no bolus.
    """
    design, world = lattice.design, World() if world is None else world
    medium = world.medium
    if world.bolus is not None and design.muscle_model == "line":
        raise ValueError('design.muscle_model = "line": world.bolus needs muscles as rods, as lines touch nothing')
    structure = [
        Rod(
            position=lattice.position[i],
            directors=lattice.directors[i],
            radius=np.full(lattice.n_node - 1, design.structure_radius),
            density=design.structure_density,
            youngs_modulus=design.structure_youngs_modulus,
            shear_modulus=_shear_modulus(design.structure_youngs_modulus, design.structure_poisson_ratio),
            damping=design.damping * design.damping_share,
            rotational_damping=design.rotational_damping * design.damping_share,
        )
        for i in range(lattice.n_rod)
    ]
    muscles = [_muscle_rod(lattice, muscle) for muscle in layout.active]
    lines = tuple(_muscle_line(lattice, muscle, rod) for muscle, rod in zip(layout.active, muscles, strict=True))
    as_lines = design.muscle_model == "line"
    rods, ball = structure if as_lines else [*structure, *muscles], _ball(lattice, world)
    if world.lying:
        rods, ball = _laid_down(rods, ball)
    return RodModel(
        rods=tuple(rods),
        joints=tuple(_lattice_joints(lattice, layout)),
        clamps=tuple(Clamp(i, node=0, element=0) for i in range(lattice.n_rod)) if design.base == "clamped" else (),
        muscles=() if as_lines else tuple(range(lattice.n_rod, lattice.n_rod + len(muscles))),
        lines=lines if as_lines else (),
        bolus=ball,
        gravity=None if medium is None else np.array([0.0, 0.0, -medium.gravity]),
        medium_density=0.0 if medium is None else medium.density,
        medium_drag=0.0 if medium is None else medium.drag,
        ground=world.ground,
        hill=hill,
        contact=world.contact,
    )


def _ball(lattice: Lattice, world: World) -> Ball | None:
    """Ball of a world with a bolus, on the axis of the upright lattice."""
    bolus, medium, design = world.bolus, world.medium, lattice.design
    if bolus is None:
        return None
    if bolus.level > design.n_segment:
        raise ValueError(f"Bolus.level = {bolus.level!r}: must not be above the top level, {design.n_segment}")
    volume = 4.0 / 3.0 * math.pi * bolus.radius**3
    weight = 0.0 if medium is None else (bolus.density - medium.density) * volume * medium.gravity
    return Ball(
        position=np.array([0.0, 0.0, bolus.level * design.height / design.n_segment]),
        radius=bolus.radius,
        mass=bolus.density * volume,
        stiffness=bolus.stiffness,
        damping=bolus.damping,
        friction=bolus.friction,
        force=(0.0, 0.0, -weight),
    )


def _laid_down(rods: Sequence[Rod], ball: Ball | None) -> tuple[list[Rod], Ball | None]:
    """Turn rods and ball about y, from +z to +x, and lift them until the rods' lowest surface touches z = 0."""
    turn = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    shift = np.array([0.0, 0.0, -min(float((rod.position @ turn[:, 2] - _node_radius(rod)).min()) for rod in rods)])
    laid = [replace(rod, position=rod.position @ turn + shift, directors=rod.directors @ turn) for rod in rods]
    return laid, None if ball is None else replace(ball, position=ball.position @ turn + shift)


def _shear_modulus(youngs_modulus: float, poisson_ratio: float) -> float:
    return youngs_modulus / (2.0 * (1.0 + poisson_ratio))


def _muscle_rod(lattice: Lattice, muscle: Muscle) -> Rod:
    design = lattice.design
    return straight_rod(
        lattice.site_position[muscle.start],
        lattice.site_position[muscle.end],
        design.elements_per_muscle,
        radius=design.muscle_radius,
        density=design.muscle_density,
        youngs_modulus=design.muscle_youngs_modulus,
        shear_modulus=_shear_modulus(design.muscle_youngs_modulus, design.muscle_poisson_ratio),
        damping=design.damping,
        rotational_damping=design.rotational_damping,
    )


def _muscle_line(lattice: Lattice, muscle: Muscle, rod: Rod) -> Line:
    """Line with the length, stiffness, mass and damping of a muscle's rod."""
    (rod_a, node_a), (rod_b, node_b) = (_tie(lattice, site) for site in (muscle.start, muscle.end))
    length, stiffness = float(rod.rest_length.sum()), float(rod.stretch_stiffness[0])
    damping = rod.damping * (rod.n_elem + 1)
    return Line(rod_a, node_a, rod_b, node_b, length, stiffness, float(rod.mass.sum()), damping, rod.density)


def _tie(lattice: Lattice, site: int) -> tuple[int, int]:
    """Rod and node that muscles at a site are tied to: those of its right-handed rod."""
    return int(lattice.site_rod[site, 0]), int(lattice.site_node[site, 0])


def _lattice_joints(lattice: Lattice, layout: MuscleLayout) -> Iterator[Joint]:
    """Join the two rods of every site, and muscle rods by their ends to the right-handed rods of their sites."""
    design = lattice.design
    spring = (design.joint_stiffness, design.joint_damping)
    for (rod_a, rod_b), (node_a, node_b) in zip(lattice.site_rod.tolist(), lattice.site_node.tolist(), strict=True):
        yield Joint(rod_a, node_a, rod_b, node_b, *spring)
    if design.muscle_model == "line":
        return
    for k, muscle in enumerate(layout.active):
        for site, node in ((muscle.start, 0), (muscle.end, design.elements_per_muscle)):
            yield Joint(*_tie(lattice, site), lattice.n_rod + k, node, *spring)
