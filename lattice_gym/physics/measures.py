"""Named quantities of a state: what a motion came to, read from node positions alone.

Everywhere `position` is the concatenated array of all nodes [m], shape (..., n_node, 3), structure rods first, and is
never written to; leading axes, of worms or times, are kept. Heights and azimuths are those of the rest shape, so they
name material points, not places.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from lattice_gym.body.lattice import Lattice
from lattice_gym.checks import FloatArray, IntArray, array, number, wrap_angle
from lattice_gym.physics.assembly import RodModel

MIN_BEND = 1e-9
"""A top that leans by less is upright [rad]: rounding has a direction too."""
MIN_AMPLITUDE = 5e-4
"""A wave of a smaller amplitude, as a share of the largest radius, counts as none: half of what may be commanded."""
MIN_COHERENCE = 0.9
"""Motion of which the dominant mode has a smaller share (of the power) is no wave but noise.

Measured over two periods of a typical wave (27 to 60 control steps): 0.999 for the gait of peristalsis, 0.92 with three
tenths of its ring commands random, at most 0.42 for white noise, 0.67 for random commands of muscles or rings and 0.91
for those of columns, which move all levels together. Recordings of a dozen rows and fewer are too short to tell.
"""
MIN_SHARE = 0.02
"""Levels that move less than this share of the level that moves most are left out of a travelling wave."""
STANDING = 0.05
"""A wave of a lower index goes nowhere: it has no direction and no speed."""


def site_positions(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Place of every site [m], shape (..., n_site, 3): the mean of the two nodes that meet there."""
    return _sites(lattice, position, slice(None))


def _sites(lattice: Lattice, position: FloatArray, sites: IntArray | slice) -> FloatArray:
    first, second = lattice.site_nodes[sites].T
    mean: FloatArray = 0.5 * (position.take(first, axis=-2) + position.take(second, axis=-2))
    return mean


def strain(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Mean rise of the structure rods' top nodes over the rest height, shape (...,): positive is longer.

    As in Schaffer et al. 2024. The rise is taken from the rods' lowest nodes, along the third axis of `base_frame`, so
    that a free body does not stretch by moving away or tipping over.
    """
    n_node, end = lattice.n_node, lattice.n_rod * lattice.n_node
    chord = position[..., n_node - 1 : end : n_node, :] - position[..., 0:end:n_node, :]
    rise = _in_base(lattice, position, chord)[..., 2] - _rest_rise(lattice)
    share: FloatArray = rise.sum(axis=-1) / (lattice.n_rod * lattice.design.height)
    return share


@lru_cache(maxsize=64)
def _rest_rise(lattice: Lattice) -> FloatArray:
    """Rise of each rod from end to end at rest [m], shape (n_rod,)."""
    return lattice.position[:, -1, 2] - lattice.position[:, 0, 2]


def _in_base(lattice: Lattice, position: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors, shape (..., n, 3), along the axes of `base_frame`."""
    if lattice.design.base == "clamped":
        return vectors
    turned: FloatArray = vectors @ np.swapaxes(base_frame(lattice, position), -1, -2)
    return turned


def base_frame(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Axes that move with the base, as rows, shape (..., 3, 3); the world's where it is clamped, shape (3, 3).

    Under a free body the third is the normal of the bottom ring, and the first two are turned about it with the ring's
    sites (least squares), so that a rigid motion changes nothing that is measured along them.
    """
    if lattice.design.base == "clamped":
        return np.eye(3)
    sites = bottom_sites(lattice)
    ring, rest = _sites(lattice, position, sites), lattice.site_position[sites]
    up, spoke, rest_spoke = _normal(ring, "bottom"), ring - _centre(ring)[..., None, :], rest - rest.mean(axis=0)
    first = rest_spoke[:, 0] @ spoke + rest_spoke[:, 1] @ _cross(spoke, up[..., None, :])
    first -= np.sum(first * up, axis=-1, keepdims=True) * up
    size = _norm(first)[..., None]
    if not (size > 0.0).all():
        raise ValueError("position: the bottom ring is too far from its rest shape to tell how it is turned")
    return np.stack([first / size, _cross(up, first / size), up], axis=-2)


@lru_cache(maxsize=64)
def bottom_sites(lattice: Lattice) -> IntArray:
    """Sites of the bottom ring in order of azimuth. Fewer than three span no plane: ValueError."""
    return _ring(lattice, "bottom", lattice.site_position[:, 2] < lattice.design.height * 1e-9)


@lru_cache(maxsize=64)
def top_sites(lattice: Lattice) -> IntArray:
    """Sites of the top ring in order of azimuth. Fewer than three span no plane: ValueError."""
    return _ring(lattice, "top", lattice.site_position[:, 2] > lattice.design.height * (1.0 - 1e-9))


def _ring(lattice: Lattice, name: str, mask: npt.NDArray[np.bool_]) -> IntArray:
    sites = np.flatnonzero(mask)
    if sites.size < 3:
        raise ValueError(
            f"lattice: {sites.size} sites at the {name} span no plane, so nothing can be said of how it is tilted; at "
            f"least 3 are needed (LatticeDesign.n_pairs is {lattice.design.n_pairs})"
        )
    ring: IntArray = sites[np.argsort(lattice.site_azimuth[sites])]
    ring.setflags(write=False)
    return ring


def top_centre(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Mean place of the top ring's sites [m], shape (..., 3)."""
    return _centre(_sites(lattice, position, top_sites(lattice)))


def base_centre(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Mean place of the bottom ring's sites [m], shape (..., 3)."""
    return _centre(_sites(lattice, position, bottom_sites(lattice)))


def top_normal(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Return the unit normal of the top ring, shape (..., 3): the direction of the area vector of its sites."""
    return _normal(_sites(lattice, position, top_sites(lattice)), "top")


def _normal(ring: FloatArray, name: str) -> FloatArray:
    spoke = ring - _centre(ring)[..., None, :]
    area = _cross(spoke, np.roll(spoke, -1, axis=-2)).sum(axis=-2)
    size = _norm(area)
    if not (size > 0.0).all():
        found = area[~(size > 0.0)].tolist()[0]
        raise ValueError(f"position: the {name} ring must enclose an area, got area vector {found}")
    unit: FloatArray = area / size[..., None]
    return unit


def _norm(vectors: FloatArray) -> FloatArray:
    """Lengths of vectors, shape (...,) of (..., 3); several times faster than numpy's for many short ones."""
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    length: FloatArray = np.sqrt(x * x + y * y + z * z)
    return length


def _centre(points: FloatArray) -> FloatArray:
    """Mean of points, shape (..., 3) of (..., n, 3)."""
    total: FloatArray = points[..., 0, :].copy()
    for k in range(1, points.shape[-2]):
        total += points[..., k, :]
    total /= points.shape[-2]
    return total


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products, shape (..., 3)."""
    back, on = [1, 2, 0], [2, 0, 1]
    product: FloatArray = a[..., back] * b[..., on] - a[..., on] * b[..., back]
    return product


def bend_vector(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Bend angle [rad] times the horizontal unit vector the top leans towards, shape (..., 2); zero where upright.

    The angle is between the normals of the top ring and of the base, which is vertical where it is clamped; the vector
    is along the first two axes of `base_frame`. So a rigid motion of a free body is no bend.
    """
    normal = _in_base(lattice, position, top_normal(lattice, position)[..., None, :])[..., 0, :]
    horizontal = np.hypot(normal[..., 0], normal[..., 1])
    upright = horizontal < MIN_BEND
    angle = np.arctan2(horizontal, normal[..., 2]) / np.where(upright, 1.0, horizontal)
    over = np.stack([np.where(normal[..., 2] > 0.0, 0.0, np.pi), np.zeros_like(horizontal)], axis=-1)
    return np.where(upright[..., None], over, normal[..., :2] * angle[..., None])


def bend_angle(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Angle between the normals of the top ring and of the base [rad], in [0, pi], shape (...,).

    As in Schaffer et al. 2024.
    """
    lean = bend_vector(lattice, position)
    angle: FloatArray = np.hypot(lean[..., 0], lean[..., 1])
    return angle


def bend_direction(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Azimuth that the top leans towards [rad], in [0, 2 pi), shape (...,); 0 where it stands upright."""
    return azimuth_of(bend_vector(lattice, position))


def twist_angle(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Angle by which the top ring is turned about its centre [rad], in [-pi, pi), shape (...,).

    Positive to the left as seen from above: the mean over the ring's sites, against the base (`base_frame`).
    """
    sites = top_sites(lattice)
    ring = _sites(lattice, position, sites)
    spoke = _in_base(lattice, position, ring - _centre(ring)[..., None, :])
    turned: FloatArray = wrap_angle(azimuth_of(spoke) - lattice.site_azimuth[sites]).mean(axis=-1)
    return turned


def azimuth_of(vector: FloatArray) -> FloatArray:
    """Azimuth of horizontal vectors, shape (..., 2), [rad], in [0, 2 pi), shape (...,)."""
    azimuth = np.arctan2(vector[..., 1], vector[..., 0]) % (2.0 * np.pi)
    return np.where(azimuth < 2.0 * np.pi, azimuth, 0.0)


def ring_radii(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Mean distance of each level's sites to their centroid [m], shape (..., n_level). No common levels: ValueError."""
    return _rings(lattice, position)[1]


def _rings(lattice: Lattice, position: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centroid of each level's sites [m], shape (..., n_level, 3), and their mean distance to it, (..., n_level)."""
    if lattice.n_level == 0:
        raise ValueError("lattice: its sites share no common levels (uneven phases), so it has no ring radii")
    # Sites are sorted by height, and every level has as many. Levels come last here: long rows take fewer loops.
    first, second = lattice.site_nodes.reshape(lattice.n_level, -1, 2).T
    site = 0.5 * (position.take(first, axis=-2) + position.take(second, axis=-2))
    centre: FloatArray = site.sum(axis=-3) / len(first)
    return centre, _norm(site - centre[..., None, :, :]).sum(axis=-2) / len(first)


@dataclass(frozen=True)
class CentrelineProjection:
    """Projection of points on the body's centreline, see `centreline_projection`; all of shape (...,)."""

    height: FloatArray
    """Rest height of the nearest point of the centreline [m]; 0 or the full height where the point is beyond an end."""
    beside: npt.NDArray[np.bool_]
    """Whether a point is beside the body: further from the centreline than the ring there."""
    end: IntArray
    """+1 beyond the top end, -1 beyond the bottom end, 0 between them."""

    @property
    def outside(self) -> npt.NDArray[np.bool_]:
        """Whether a point is outside the body: beside it or beyond an end."""
        out: npt.NDArray[np.bool_] = self.beside | (self.end != 0)
        return out


def centreline_projection(lattice: Lattice, position: FloatArray, point: FloatArray) -> CentrelineProjection:
    """Project points [m], shape (..., 3), on the body's centreline, which runs from ring centre to ring centre.

    A point is beyond an end where it lies beyond the plane through the last ring's centre normal to the centreline
    there. Else it is beside the body where its distance from the centreline exceeds the radius interpolated linearly
    between the two rings around it.
    """
    centre, radius = _rings(lattice, position)
    side, way = np.diff(centre, axis=-2), point[..., None, :] - centre[..., :-1, :]
    share = np.sum(way * side, axis=-1) / np.sum(side * side, axis=-1)
    below, above = (share[..., 0] < 0.0) & (share[..., -1] < 1.0), (share[..., -1] > 1.0) & (share[..., 0] > 0.0)
    end = above.astype(np.int64) - below
    share = np.clip(share, 0.0, 1.0)
    distance = _norm(way - share[..., None] * side)
    k = np.argmin(distance, axis=-1)[..., None]
    nearest, share, low, high = (
        np.take_along_axis(values, at, axis=-1)[..., 0]
        for values, at in ((distance, k), (share, k), (radius, k), (radius, k + 1))
    )
    lower, upper = lattice.level_height[k[..., 0]], lattice.level_height[k[..., 0] + 1]
    top = float(lattice.level_height[-1])
    height = np.where(end == 0, lower + share * (upper - lower), np.where(end > 0, top, 0.0))
    return CentrelineProjection(height, (nearest > low + share * (high - low)) & (end == 0), end)


@dataclass(frozen=True)
class TravellingWave:
    """How far motion along the body travels, and where to; unpacks as index, direction, speed."""

    index: float
    """1 = pure travelling wave, 0 = standing wave, noise or no motion."""
    direction: int
    """+1 up (away from the base), -1 down, 0 where nothing travels."""
    speed: float
    """Phase speed along the rest height [m/s], never negative; 0 where nothing travels."""
    amplitude: float = 0.0
    """Amplitude of the dominant mode, whatever it is, in the unit of the recording: sqrt(2) times the root mean square
    over all levels and times."""

    def __iter__(self) -> Iterator[float]:
        """Yield index, direction and speed."""
        return iter((self.index, self.direction, self.speed))


def travelling_wave(radii: FloatArray, dt: float, level_height: FloatArray) -> TravellingWave:
    """Travelling part of the ring radii, by complex orthogonal decomposition (Feeny 2008, J. Sound Vib. 310:77-90).

    Each level's radius, less its mean over time, becomes an analytic signal; u is the dominant complex mode over the
    levels. The index is the reciprocal condition number of [Re u, Im u]. Speed and direction come from straight lines
    through the unwrapped phases over time and height, so levels must lie closer than half a wavelength.

    Motion that no one mode dominates (MIN_COHERENCE) or that is too small (MIN_AMPLITUDE) is no wave: it has an
    amplitude, and index, direction and speed 0.

    The index of a pure wave is 1 where the levels span a whole number of half wavelengths, and somewhat lower elsewhere
    (0.84 where 8 levels span 1/1.2 of a wavelength). Record whole periods: a broken one smears the frequency.

    Parameters
    ----------
    radii
        Ring radii or deviations over time [m], shape (n_time, n_level), n_time >= 4.
    dt
        Time between rows [s].
    level_height
        Rest heights of the levels [m], rising, shape (n_level,).

    """
    radii, dt = array("radii", radii, ("n_time", "n_level"), unit="m"), number("dt", dt, 0.0, unit="s", above=True)
    if radii.shape[0] < 4 or radii.shape[1] < 1:
        raise ValueError(f"radii has shape {radii.shape}: must have at least 4 times and one level")
    level_height = array("level_height", level_height, radii.shape[1:], unit="m")
    if not (np.diff(level_height) > 0.0).all():
        raise ValueError(f"level_height = {level_height.tolist()}: must rise")
    motion = radii - radii.mean(axis=0)
    size = np.sqrt(np.mean(motion**2, axis=0))
    moving = size > MIN_SHARE * float(size.max())
    if not moving.any():
        return TravellingWave(0.0, 0, 0.0)
    signal = _analytic(motion[:, moving]).T
    modes, strength, _ = np.linalg.svd(signal, full_matrices=False)
    mode: npt.NDArray[np.complex128] = modes[:, 0]
    amplitude = float(strength[0]) / float(np.sqrt(radii.size))
    coherent = strength[0] ** 2 >= MIN_COHERENCE * np.sum(strength**2)
    if len(mode) < 2 or not coherent or amplitude < MIN_AMPLITUDE * float(np.abs(radii).max()):
        return TravellingWave(0.0, 0, 0.0, amplitude)
    spread = np.linalg.svd(np.stack([mode.real, mode.imag], axis=1), compute_uv=False)
    index = float(spread[1] / spread[0])
    course: npt.NDArray[np.complex128] = mode.conj() @ signal
    frequency = _phase_slope(course, dt * np.arange(len(course), dtype=np.float64))
    wavenumber = -_phase_slope(mode, level_height[moving])
    if index < STANDING or wavenumber == 0.0 or frequency == 0.0:
        return TravellingWave(index, 0, 0.0, amplitude)
    velocity = frequency / wavenumber
    return TravellingWave(index, 1 if velocity > 0.0 else -1, abs(velocity), amplitude)


def _analytic(signal: FloatArray) -> npt.NDArray[np.complex128]:
    """Analytic signal of every column: negative frequencies dropped, positive ones doubled (Hilbert transform)."""
    n = len(signal)
    gain = np.zeros(n)
    gain[0] = 1.0
    gain[1 : (n + 1) // 2] = 2.0
    if n % 2 == 0:
        gain[n // 2] = 1.0
    return np.asarray(np.fft.ifft(np.fft.fft(signal, axis=0) * gain[:, None], axis=0), dtype=np.complex128)


def _phase_slope(values: npt.NDArray[np.complex128], at: FloatArray) -> float:
    """Slope of the unwrapped phase over `at` [rad per unit], each value weighted with its power."""
    phase, weight = np.unwrap(np.angle(values)), np.abs(values) ** 2
    weight /= weight.sum()
    offset = at - weight @ at
    return float((weight * offset) @ phase / ((weight * offset) @ offset))


def joint_gap(model: RodModel, position: FloatArray) -> FloatArray:
    """Largest distance between two nodes that a joint holds together [m], shape (...,); 0 without joints."""
    first, second = model.tie_nodes(model.joints)
    gap: FloatArray = _norm(position[..., first, :] - position[..., second, :]).max(axis=-1, initial=0.0)
    return gap


def mass_centre(model: RodModel, position: FloatArray) -> FloatArray:
    """Centre of mass of the whole assembly [m], shape (..., 3)."""
    centre: FloatArray = model.node_mass @ position / model.node_mass.sum()
    return centre


def muscle_lengths(model: RodModel, position: FloatArray) -> FloatArray:
    """Length of every muscle along its rod, or of its line [m], shape (..., n_muscle), in the order of tensions."""
    (lower, start), (one, other) = model.muscle_elements, model.line_nodes
    along = _norm(position.take(lower + 1, axis=-2) - position.take(lower, axis=-2))
    rods: FloatArray = np.add.reduceat(along, start, axis=-1) if start.size else along
    if not one.size:
        return rods
    return np.concatenate([rods, _norm(position.take(one, axis=-2) - position.take(other, axis=-2))], axis=-1)


def muscle_rates(model: RodModel, position: FloatArray, velocity: FloatArray) -> FloatArray:
    """Rate at which every muscle grows longer [m/s], shape (..., n_muscle): the derivative of `muscle_lengths`."""
    (lower, start), (one, other) = model.muscle_elements, model.line_nodes
    along = _separation_rate(position, velocity, lower, lower + 1)
    rods: FloatArray = np.add.reduceat(along, start, axis=-1) if start.size else along
    return np.concatenate([rods, _separation_rate(position, velocity, other, one)], axis=-1) if one.size else rods


def _separation_rate(position: FloatArray, velocity: FloatArray, first: IntArray, second: IntArray) -> FloatArray:
    """Rate at which the distance of pairs of nodes grows [m/s], shape (..., n_pair)."""
    apart = position.take(second, axis=-2) - position.take(first, axis=-2)
    moving = velocity.take(second, axis=-2) - velocity.take(first, axis=-2)
    rate: FloatArray = (apart * moving).sum(axis=-1) / _norm(apart)
    return rate


def dilatation(model: RodModel, position: FloatArray) -> FloatArray:
    """Length of every element over its rest length, shape (..., n_elem)."""
    lower = model.lower_node
    side = position[..., lower + 1, :] - position[..., lower, :]
    ratio: FloatArray = _norm(side) / model.rod_array("rest_length")
    return ratio


def muscle_strain(model: RodModel, position: FloatArray) -> FloatArray:
    """Length over rest length, less 1, of every muscle, shape (..., n_muscle)."""
    stretch: FloatArray = muscle_lengths(model, position) / model.muscle_rest_length - 1.0
    return stretch


def straightness(lattice: Lattice, model: RodModel, position: FloatArray) -> FloatArray:
    """Chord over length of the most crooked stretch of rod, relative to rest, shape (...,): 1 = as at rest.

    Less is buckled. A stretch is a structure rod from one crossing to the next, or a whole muscle.
    """
    shares = []
    for index, rod in enumerate(model.rods):
        step = lattice.design.elements_per_segment if index < lattice.n_rod else rod.n_elem
        nodes = position[..., model.nodes(index), :]
        shares.append(_chord_share(nodes, step) / _chord_share(rod.position, step))
    least: FloatArray = np.concatenate(shares, axis=-1).min(axis=-1)
    return least


def _chord_share(nodes: FloatArray, step: int) -> FloatArray:
    """Chord over length of each stretch of `step` elements, shape (..., n_elem / step)."""
    length = _norm(np.diff(nodes, axis=-2))
    chord = _norm(np.diff(nodes[..., ::step, :], axis=-2))
    share: FloatArray = chord / length.reshape(*length.shape[:-1], -1, step).sum(axis=-1)
    return share
