"""Stretch, shear, bending and twist of rods: PyElastica's law.

With l the rest length of an element, e its length over it, t its direction, Q its directors, D the rest length of a
Voronoi region and E its length over that, in the material frame (Gazzola et al. 2018, R. Soc. Open Sci. 5:171628):

    strain      sigma = e Q t - d3              stress   n = S sigma       S = diag(alpha G A, alpha G A, E A)
    curvature   kappa = log(Q_next Q^T) / D     couple   m = B (kappa - kappa0)        B = diag(E I, E I, G J)
    force on nodes (eq. 2.15)    difference of Q^T n / e
    couple on elements (2.16)    difference of m / E^3, mean of D kappa x m / E^3, l Q t x n,
                                 (J omega / e) x omega, J omega (de/dt) / e^2

It is not quite that of an elastic body: no potential gives these forces wherever stretch comes together with shear or
bending. Stored is the work that straining in proportion from rest takes,

    stretch and shear   l (S |shear|^2 + E A (e - 1)^2) (e - 1 - ln e) / (e - 1)^2     (alone: E A l (e - 1 - ln e))
    bending and twist   D (kappa - kappa0) . B (kappa - kappa0) / (2 E^2)

What other paths of straining give or take beyond that is of third order in the strains.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.physics.laws.base import Generalised, Law, Linearised, Shortened
from lattice_gym.physics.rod import rotation_between

if TYPE_CHECKING:
    from lattice_gym.physics.assembly import RodModel
    from lattice_gym.physics.state import RodState

MIN_DILATATION, MAX_DILATATION = 0.1, 5.0
"""Length over rest length outside which an element counts as over-stretched: linear elasticity ended long before."""

_SMALL_STRAIN = 1e-3
"""Below this the series of (e - 1 - ln e) / (e - 1)^2 is exact to 1e-13 where the closed form has lost digits."""

_SMALL_ANGLE = 1e-3
"""[rad] Below this the derivative of a rotation vector takes its value at 0, exact to 1e-9."""


def path_share(e: FloatArray) -> FloatArray:
    """(e - 1 - ln e) / (e - 1)^2, shape kept: 1/2 at rest."""
    strain = e - 1.0
    small = np.abs(strain) < _SMALL_STRAIN
    safe = np.where(small, 1.0, strain)
    series = 0.5 - strain / 3.0 + strain**2 / 4.0 - strain**3 / 5.0
    share: FloatArray = np.where(small, series, (safe - np.log1p(safe)) / safe**2)
    return share


class ElasticityLaw(Law):
    """Elasticity of all rods; every model has it."""

    @classmethod
    def present(cls, model: RodModel) -> bool:
        """Tell that rods are elastic."""
        return True

    @cached_property
    def _stiffness(self) -> FloatArray:
        """Diagonals of S [N], shape (n_elem, 3)."""
        shear, stretch = (self.model.rod_array(f"{name}_stiffness") for name in ("shear", "stretch"))
        return np.stack([shear, shear, stretch], axis=1)

    @cached_property
    def _rigidity(self) -> FloatArray:
        """Diagonals of B [N m^2], shape (n_elem - n_rod, 3)."""
        bend, twist = (self.model.rod_array(f"{name}_stiffness") for name in ("bend", "twist"))
        return np.stack([bend, bend, twist], axis=1)

    @cached_property
    def _rest(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Lengths of elements and Voronoi regions [m], and curvatures [1/m], at rest."""
        return (
            self.model.rod_array("rest_length"),
            self.model.rod_array("rest_voronoi"),
            self.model.rod_array("rest_kappa"),
        )

    def energy(self, state: RodState) -> Mapping[str, FloatArray]:
        """Energy of stretch and shear in every element, shape (n_elem,), and of bending and twist in every region."""
        (rest, voronoi, natural), low, left = self._rest, self.model.lower_node, self.model.left_element
        side = state.position[low + 1] - state.position[low]
        length = np.sqrt(np.einsum("ni,ni->n", side, side))
        strain = np.einsum("nij,nj->ni", state.directors, side) / rest[:, None]
        strain[:, 2] -= 1.0
        shear, stretch, square = self._stiffness[:, 0], self._stiffness[:, 2], strain * strain
        quadratic = shear * (square[:, 0] + square[:, 1]) + stretch * square[:, 2]
        bent = rotation_between(state.directors[left], state.directors[left + 1]) / voronoi[:, None] - natural
        region = 0.5 * (length[left] + length[left + 1]) / voronoi
        return {
            "stretch": rest * quadratic * path_share(length / rest),
            "bend": 0.5 * voronoi * np.einsum("ni,ni->n", self._rigidity, bent * bent) / region**2,
        }

    def linearised(self, shortened: Shortened) -> Linearised:
        """Springs of all rods, in one operator."""
        return Linearised(springs=[_RodSprings.of(self.model, shortened)])

    def force(self, state: RodState, tension: FloatArray) -> Generalised:
        """Equations 2.15 and 2.16, with the inertial terms of stretching elements."""
        force, (rest, voronoi, natural) = Generalised.zeros(self.model), self._rest
        low, left, q, spin = self.model.lower_node, self.model.left_element, state.directors, state.omega
        side, apart = (np.array(of[low + 1] - of[low]) for of in (state.position, state.velocity))
        length = np.linalg.norm(side, axis=1)
        e = (length / rest)[:, None]
        rate = (np.sum(side * apart, axis=1) / length / rest)[:, None]
        tangent = np.einsum("nij,nj->ni", q, side / length[:, None])
        stress = self._stiffness * (e * tangent - [0.0, 0.0, 1.0])
        pull = np.einsum("nji,nj->ni", q, stress) / e
        np.add.at(force.node, low, pull)
        np.subtract.at(force.node, low + 1, pull)

        kappa = rotation_between(q[left], q[left + 1]) / voronoi[:, None]
        region = (0.5 * (length[left] + length[left + 1]) / voronoi)[:, None]
        couple = self._rigidity * (kappa - natural) / region**3
        turning = 0.5 * voronoi[:, None] * np.cross(kappa, couple)
        np.add.at(force.element, left, couple + turning)
        np.add.at(force.element, left + 1, turning - couple)
        momentum = self.model.rod_array("inertia")[:, None] * [1.0, 1.0, 2.0] * spin / e
        force.element[:] += rest[:, None] * np.cross(tangent, stress) + np.cross(momentum, spin) + momentum * rate / e
        return force


@dataclass(frozen=True)
class _RodSprings:
    """Stretch, shear, bending and twist around rest, of rods in which muscles pull and which they have shortened.

    An element of length e times its rest length l bears along it E A / (l e^2), across it G A / (l e), and against
    turning l e G A, each per unit; a Voronoi region E I / (D e^3). Turns are in the material frame.
    """

    low: IntArray
    left: IntArray
    frame: FloatArray
    stretch: FloatArray
    """Along the directors [N/m], shape (n_elem, 3)."""
    across: FloatArray
    """Couple by shear, and shear by turn [N], shape (n_elem,)."""
    turn: FloatArray
    """[N m/rad], shape (n_elem,)"""
    before: FloatArray
    after: FloatArray
    """From turns of the elements before and after a region to roots of its energy, shape (n_elem - n_rod, 3, 3)."""
    coupled = True

    @classmethod
    def of(cls, model: RodModel, shortened: Shortened) -> _RodSprings:
        rod, left, frame = model.element_rod, model.left_element, model.rod_array("directors")
        e = shortened.rod[rod]
        pull = np.zeros(model.n_rod)
        pull[list(model.muscles)] = shortened.peak
        rest, shear, stretch = (
            model.rod_array(name) for name in ("rest_length", "shear_stiffness", "stretch_stiffness")
        )
        # An element under axial force N turns against G A - N.
        cross = shear + stretch * (1.0 - e) / e
        across = (shear + pull[rod]) / (rest * e)
        bend, twist, voronoi = (model.rod_array(name) for name in ("bend_stiffness", "twist_stiffness", "rest_voronoi"))
        root = np.sqrt(np.stack([bend, bend, twist], axis=1) / voronoi[:, None] / e[left, None] ** 3)
        after = _log_derivative(rotation_between(frame[left], frame[left + 1]))
        return cls(
            low=model.lower_node,
            left=left,
            frame=frame,
            stretch=np.stack([across, across, stretch / (rest * e**2)], axis=1),
            across=cross,
            turn=rest * e * cross,
            before=root[:, :, None] * after.transpose(0, 2, 1),
            after=root[:, :, None] * after,
        )

    def __call__(self, moved: Generalised, against: Generalised) -> None:
        """Add the forces and couples against displacements and turns, in place."""
        shift, turn, couple = moved.node, moved.element, against.element
        side = np.einsum("nij,nj->ni", self.frame, shift[self.low + 1] - shift[self.low])
        pull = self.stretch * side
        pull[:, 0] -= self.across * turn[:, 1]
        pull[:, 1] += self.across * turn[:, 0]
        pull = np.einsum("nji,nj->ni", self.frame, pull)
        against.node[self.low] -= pull
        against.node[self.low + 1] += pull
        couple[:, 0] += self.across * side[:, 1] + self.turn * turn[:, 0]
        couple[:, 1] += -self.across * side[:, 0] + self.turn * turn[:, 1]
        bend = np.einsum("nij,nj->ni", self.after, turn[self.left + 1])
        bend -= np.einsum("nij,nj->ni", self.before, turn[self.left])
        couple[self.left + 1] += np.einsum("nji,nj->ni", self.after, bend)
        couple[self.left] -= np.einsum("nji,nj->ni", self.before, bend)


def _log_derivative(angle: FloatArray) -> FloatArray:
    """Change of a rotation vector with a small turn after it, shape (n, 3, 3); transposed: with one before it."""
    size = np.linalg.norm(angle, axis=1)
    skew = np.cross(np.eye(3)[None], angle[:, None, :])
    safe = np.where(size > _SMALL_ANGLE, size, 1.0)
    curve = np.where(size > _SMALL_ANGLE, 1.0 / safe**2 - 0.5 / (safe * np.tan(0.5 * safe)), 1.0 / 12.0)
    return np.eye(3) + 0.5 * skew + curve[:, None, None] * (skew @ skew)
