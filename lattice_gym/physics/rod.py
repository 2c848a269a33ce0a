"""One Cosserat rod: its constants and its shape at rest.

Symbols follow Gazzola et al. 2018, R. Soc. Open Sci. 5:171628.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import numpy.typing as npt

from lattice_gym.body.design import MAX_ELEMENTS
from lattice_gym.checks import REQUIRED, FloatArray, Parameters, array, checked, optional, real, require, whole

SHEAR_CORRECTION = 27.0 / 28.0
"""Kaneko 1975 for a circular section and Poisson's ratio 0.5, as PyElastica has it."""
FRAME_TOLERANCE = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Rod(Parameters):
    """One Cosserat rod of circular section, free of stress as given here unless `natural_curvature` says else.

    Raises
    ------
    ValueError
        Fewer than two elements, a zero-length element, directors that are no right-handed frames along the elements,
        or a property out of bounds.
    """

    position: FloatArray = checked(REQUIRED, array, shape=("n_elem + 1", 3), unit="m", read_only=True)
    """Rest node positions [m], shape (n_elem + 1, 3)."""
    directors: FloatArray
    """Rest directors, shape (n_elem, 3, 3): rows d1, d2, d3, with d3 along the element."""
    radius: FloatArray
    """Radius of each element at rest [m], shape (n_elem,); a single number is spread."""
    density: float = real(REQUIRED, 0.0, math.inf, "kg/m^3", above=True)
    """[kg/m^3]"""
    youngs_modulus: float = real(REQUIRED, 0.0, math.inf, "Pa", above=True)
    """[Pa]"""
    shear_modulus: float = real(REQUIRED, 0.0, math.inf, "Pa", above=True)
    """[Pa]"""
    damping: float = real(0.0, 0.0, math.inf, "N s/m per node")
    """Translational damping [N s/m per node]."""
    rotational_damping: float = real(0.0, 0.0, math.inf, "N m s")
    """[N m s per element]"""
    natural_curvature: FloatArray | None = None
    """Curvature and twist free of stress, in the material frame [1/m], shape (n_elem - 1, 3); None: those of the shape.

    A rod held in a shape that is not its own: straight by nature, say, but bent and twisted between clamps.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        n_elem = self.n_elem
        require(n_elem >= 2, f"Rod.position has {n_elem + 1} nodes: must have at least 3")
        fixed = partial(array, spread=True, read_only=True)
        directors = fixed("Rod.directors", self.directors, (n_elem, 3, 3))
        radius = fixed("Rod.radius", self.radius, (n_elem,), 0.0, unit="m", above=True)
        curvature = optional(fixed, "Rod.natural_curvature", self.natural_curvature, (n_elem - 1, 3), unit="1/m")
        for name, values in (("directors", directors), ("radius", radius), ("natural_curvature", curvature)):
            object.__setattr__(self, name, values)
        with np.errstate(all="ignore"):
            size = self.rest_length
        require(bool(np.isfinite(size).all()), "Rod.position: nodes lie too far apart")
        require(bool((size > 0.0).all()), "Rod.position: two neighbouring nodes coincide")
        q = self.directors
        tangent = np.diff(self.position, axis=0) / self.rest_length[:, None]
        orthonormal = np.abs(q @ q.transpose(0, 2, 1) - np.eye(3)).max() < FRAME_TOLERANCE
        right_handed = bool((np.linalg.det(q) > 0.0).all())
        along = np.abs(q[:, 2] - tangent).max() < FRAME_TOLERANCE
        require(orthonormal and right_handed and along, "Rod.directors: must be right-handed frames, d3 the tangent")
        self._check_constants()

    def _check_constants(self) -> None:
        """Refuse a rod whose numbers are each possible, but not together."""
        with np.errstate(all="ignore"):
            constants = [self.mass, self.inertia, self.stretch_stiffness, self.shear_stiffness]
            constants += [self.bend_stiffness, self.twist_stiffness]
            sound = all(bool((np.isfinite(c) & (c > 0.0) & np.isfinite(1.0 / c)).all()) for c in constants)
        names = "Rod.position, radius, density, youngs_modulus, shear_modulus"
        require(sound, f"{names}: mass or stiffness leaves the range of numbers; some are far too large or too small")

    def scaled(self, stiffness: float, damping: float) -> Rod:
        """Return the rod with factors on its moduli and on both dampings, which is not checked again."""
        rod = copy(self)
        kept = {name: value for name, value in vars(self).items() if name not in _OF_MODULI}
        kept |= {name: stiffness * kept[name] for name in ("youngs_modulus", "shear_modulus")}
        kept |= {name: damping * kept[name] for name in ("damping", "rotational_damping")}
        vars(rod).clear()
        vars(rod).update(kept)
        return rod

    def __repr__(self) -> str:
        return f"Rod({self.n_elem} elements, length {self.rest_length.sum():.6g} m)"

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
        return node_sums(0.5 * self.density * self.area * self.rest_length)

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


def node_sums(values: FloatArray) -> FloatArray:
    """Sum over the elements at each node of a rod, shape (n_elem + 1,), of values of shape (n_elem,)."""
    sums: FloatArray = np.append(values, 0.0) + np.append(0.0, values)
    return sums


def node_radius(rod: Rod) -> FloatArray:
    """Radius at each node of a rod [m], shape (n_elem + 1,): the mean of its elements'."""
    return node_sums(rod.radius) / node_sums(np.ones(rod.n_elem))


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
    d1 = array("normal", normal, tangent.shape, spread=True)
    if np.abs(d1).max() > 0.0:
        d1 = d1 / np.abs(d1).max()
    d1 = d1 - np.sum(d1 * tangent, axis=1)[:, None] * tangent
    length = np.linalg.norm(d1, axis=1)
    require(bool((length > 1e-6).all()), "normal: must not lie along the rod")
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
    a, b = array("start", start, (3,), unit="m"), array("end", end, (3,), unit="m")
    count = whole("n_elem", n_elem, 2, MAX_ELEMENTS)
    require(bool((a != b).any()), "end: must differ from start")
    with np.errstate(all="ignore"):
        chord = b - a
        apart = float(np.linalg.norm(chord / count))
        inside = math.isfinite(apart) and apart**2 > 0.0 and apart > 1e-12 * float(np.abs([a, b]).max())
    require(inside, f"end: lies too close to start, or too far from it, for {count} elements")
    position = a + np.linspace(0.0, 1.0, count + 1)[:, None] * chord
    if normal is None:
        normal = np.eye(3)[np.argmin(np.abs(b - a))]
    return Rod(
        position=position,
        directors=straight_frames(position, normal),
        radius=array("Rod.radius", radius, (count,), unit="m", spread=True),
        density=density,
        youngs_modulus=youngs_modulus,
        shear_modulus=shear_modulus,
        damping=damping,
        rotational_damping=rotational_damping,
    )
