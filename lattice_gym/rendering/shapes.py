"""Meshes of rods, muscles and sites that move in place, so that a scene is built only once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.physics.assembly import RodModel
from lattice_gym.rendering.extras import extra

# No radius is drawn more than this many times its rest value, however short the element.
MAX_BULGE = 2.0
# Corners of a tube's cross-section.
SIDES = 12


def catmull_rom(n_node: int, samples: int) -> FloatArray:
    """Matrix of the Catmull-Rom curve through n_node nodes, shape ((n_node - 1) samples + 1, n_node)."""
    place = np.arange((n_node - 1) * samples + 1) / samples
    before = np.minimum(place.astype(np.int64), n_node - 2)
    t = place - before
    weights = [-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, t**3 - t**2]
    padded = np.zeros((len(t), n_node + 2))
    np.put_along_axis(padded, before[:, None] + np.arange(4), 0.5 * np.stack(weights, axis=1), axis=1)
    # The curve goes on straight beyond both ends.
    matrix = padded[:, 1:-1].copy()
    matrix[:, [0, 1]] += padded[:, [0]] * [2, -1]
    matrix[:, [-1, -2]] += padded[:, [-1]] * [2, -1]
    return matrix


def _mesh(n_point: int, faces: IntArray) -> Any:
    """Mesh whose points, normals and colours are set later."""
    mesh = extra("pyvista").PolyData.from_regular_faces(np.zeros((n_point, 3), np.float32), faces)
    mesh.point_data["normal"] = np.zeros((n_point, 3), np.float32)
    mesh.point_data.active_normals_name = "normal"
    mesh.point_data["colour"] = np.zeros((n_point, 3), np.uint8)
    return mesh


class Tubes:
    """One mesh of round-ended tubes along rods of equal element counts, moved in place."""

    def __init__(self, model: RodModel, rods: Sequence[int], scale: float, pieces: int, taper: float) -> None:
        rest = np.stack([model.rods[rod].position for rod in rods])
        n_rod, n_node = rest.shape[:2]
        self._nodes = model.node_offset[list(rods)][:, None] + np.arange(n_node)
        self._rest_radius = scale * np.stack([model.rods[rod].radius for rod in rods])
        self._rest_length = np.linalg.norm(np.diff(rest, axis=1), axis=2)
        samples = math.ceil(pieces / (n_node - 1))
        self._spline = catmull_rom(n_node, samples)
        n_sample = len(self._spline)
        along = np.arange(n_sample)[:, None] / samples
        self._profile = np.maximum(0.0, 1.0 - np.abs(along - np.arange(n_node)))
        self._profile *= 1.0 - taper * (2.0 * along / (n_node - 1) - 1.0) ** 4
        # A ring of points is a cross-section; those of the caps shrink to a point one radius beyond the end.
        cap = np.array([0.0, np.pi / 4])
        self._ring = np.concatenate([[0, 0], np.arange(n_sample), [n_sample - 1] * 2])
        self._ahead = np.concatenate([-np.cos(cap), np.zeros(n_sample), np.cos(cap[::-1])])
        self._aside = np.concatenate([np.sin(cap), np.ones(n_sample), np.sin(cap[::-1])])
        side = np.arange(SIDES) * 2 * np.pi / SIDES
        self._circle = np.stack([np.cos(side), np.sin(side)], axis=1)
        here, there = np.arange(SIDES), np.roll(np.arange(SIDES), -1)
        quads = np.stack([here, there, there + SIDES, here + SIDES], axis=1)
        quads = (quads + SIDES * np.arange(len(self._ring) - 1)[:, None, None]).reshape(-1, 4)
        n_point = SIDES * len(self._ring)
        self.mesh = _mesh(n_rod * n_point, (quads + n_point * np.arange(n_rod)[:, None, None]).reshape(-1, 4))

    def update(self, position: FloatArray) -> None:
        """Move to node positions (n_node, 3) [m]."""
        node = position[self._nodes]
        length = np.linalg.norm(np.diff(node, axis=1), axis=2)
        shortest = self._rest_length / MAX_BULGE**2
        bulge = self._rest_radius * np.sqrt(self._rest_length / np.maximum(length, shortest))
        at_node = 0.5 * (np.concatenate([bulge[:, :1], bulge], axis=1) + np.concatenate([bulge, bulge[:, -1:]], axis=1))
        centre = self._spline @ node
        tangent = np.gradient(centre, axis=1)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=2, keepdims=True), np.finfo(np.float64).tiny)
        frame = _frames(tangent)[:, self._ring]
        outward = self._aside[:, None, None] * (self._circle @ frame)
        outward += (self._ahead[:, None] * tangent[:, self._ring])[:, :, None]
        radius = (at_node @ self._profile.T)[:, self._ring, None, None]
        overwrite(self.mesh.points, centre[:, self._ring, None] + radius * outward)
        overwrite(self.mesh.point_data["normal"], outward)


def _frames(tangent: FloatArray) -> FloatArray:
    """Two normals at each point of a curve, carried along without twist, shape (n_rod, n, 3) -> (n_rod, n, 2, 3)."""
    normal = np.empty_like(tangent)
    carried = np.eye(3)[np.abs(tangent[:, 0]).argmin(axis=1)]
    for k in range(tangent.shape[1]):
        across = carried - np.sum(carried * tangent[:, k], axis=1, keepdims=True) * tangent[:, k]
        size = np.linalg.norm(across, axis=1, keepdims=True)
        # Where the curve turns right into the normal, the old one serves.
        carried = np.where(size > 1e-6, across / np.maximum(size, 1e-6), carried)
        normal[:, k] = carried
    return np.stack([normal, np.cross(tangent, normal)], axis=2)


class Balls:
    """One mesh of equal balls, moved in place."""

    def __init__(self, count: int, radius: float, corners: int = SIDES) -> None:
        ball = extra("pyvista").Sphere(radius=1.0, theta_resolution=corners, phi_resolution=3 * corners // 4)
        self._unit, self._radius = np.asarray(ball.points, dtype=np.float64), radius
        faces = ball.regular_faces + len(self._unit) * np.arange(count)[:, None, None]
        self.mesh = _mesh(count * len(self._unit), faces.reshape(-1, 3))
        self.mesh.point_data["normal"][:] = np.tile(self._unit, (count, 1))

    def update(self, centre: FloatArray) -> None:
        """Move to centres (count, 3) [m]."""
        overwrite(self.mesh.points, centre[:, None] + self._radius * self._unit)


def overwrite(array: Any, values: npt.NDArray[Any]) -> None:
    """Overwrite a mesh's array and let VTK know."""
    array[:] = values.reshape(array.shape)
    array.VTKObject.Modified()
