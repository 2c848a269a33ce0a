"""Named quantities of a state: what a motion came to, read from node positions alone.

Everywhere `position` is the concatenated array of all nodes [m], shape (n_node, 3), structure rods first, and is never
written to. Heights and azimuths are those of the rest shape, so they name material points, not places.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lattice_gym.design import FloatArray, IntArray, finite_number, real_array, shown
from lattice_gym.lattice import Lattice
from lattice_gym.model import RodModel

LEAST_BEND = 1e-9
"""A top that leans by less is upright [rad]: rounding has a direction too."""
LEAST_AMPLITUDE = 5e-4
"""A wave of a smaller amplitude, as a share of the largest radius, counts as none: half of what may be commanded."""
LEAST_COHERENCE = 0.9
"""Motion of which the dominant mode has a smaller share (of the power) is no wave but noise.

Measured over two periods of a typical wave (27 to 60 control steps): 0.999 for the gait of gaits.py, 0.92 with three
tenths of its ring commands random, at most 0.42 for white noise, 0.67 for random commands of muscles or rings and 0.91
for those of columns, which move all levels together. Recordings of a dozen rows and fewer are too short to tell.
"""
LEAST_SHARE = 0.02
"""Levels that move less than this share of the level that moves most are left out of a travelling wave."""
STANDING = 0.05
"""A wave of a lower index goes nowhere: it has no direction and no speed."""


def site_nodes(lattice: Lattice) -> IntArray:
    """Rows of the concatenated node array that meet at each site, shape (n_site, 2)."""
    return lattice.site_rod * lattice.n_node + lattice.site_node


def site_positions(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Place of every site [m], shape (n_site, 3): the mean of the two nodes that meet there."""
    nodes = site_nodes(lattice)
    mean: FloatArray = 0.5 * (position[nodes[:, 0]] + position[nodes[:, 1]])
    return mean


def strain(lattice: Lattice, position: FloatArray) -> float:
    """Mean rise of the structure rods' top nodes over the rest height (Schaffer et al. 2024): positive is longer.

    The rise is taken from the rods' lowest nodes, along the third axis of `base_frame`, so that a free body does not
    stretch by moving away or tipping over.
    """
    rods = position[: lattice.n_rod * lattice.n_node].reshape(lattice.n_rod, lattice.n_node, 3)
    rest = lattice.position[:, -1, 2] - lattice.position[:, 0, 2]
    rise = (rods[:, -1] - rods[:, 0]) @ base_frame(lattice, position)[2] - rest
    return float(rise.mean()) / lattice.design.height


def base_frame(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Axes that move with the base, as rows, shape (3, 3): the world's where it is clamped.

    Under a free body the third is the normal of the bottom ring, and the first two are turned about it with the ring's
    sites (least squares), so that a rigid motion changes nothing that is measured along them.
    """
    if lattice.design.base == "clamped":
        return np.eye(3)
    sites = bottom_sites(lattice)
    ring, rest = site_positions(lattice, position)[sites], lattice.site_position[sites]
    up, spoke, rest_spoke = _normal(ring, "bottom"), ring - ring.mean(axis=0), rest - rest.mean(axis=0)
    first = rest_spoke[:, 0] @ spoke + rest_spoke[:, 1] @ np.cross(spoke, up)
    first -= (first @ up) * up
    size = float(np.linalg.norm(first))
    if not size > 0.0:
        raise ValueError("position: the bottom ring is too far from its rest shape to tell how it is turned")
    return np.stack([first / size, np.cross(up, first / size), up])


def bottom_sites(lattice: Lattice) -> IntArray:
    """Sites of the bottom ring in order of azimuth. Fewer than three span no plane: ValueError."""
    return _ring(lattice, "bottom", lattice.site_position[:, 2] < lattice.design.height * 1e-9)


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
    return sites[np.argsort(lattice.site_azimuth[sites])]


def top_centre(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Mean place of the top ring's sites [m], shape (3,)."""
    centre: FloatArray = site_positions(lattice, position)[top_sites(lattice)].mean(axis=0)
    return centre


def top_normal(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Return the unit normal of the top ring, shape (3,): the direction of the area vector of its sites."""
    return _normal(site_positions(lattice, position)[top_sites(lattice)], "top")


def _normal(ring: FloatArray, name: str) -> FloatArray:
    spoke = ring - ring.mean(axis=0)
    area = np.cross(spoke, np.roll(spoke, -1, axis=0)).sum(axis=0)
    size = float(np.linalg.norm(area))
    if not size > 0.0:
        raise ValueError(f"position: the {name} ring must enclose an area, got area vector {area.tolist()}")
    unit: FloatArray = area / size
    return unit


def bend_vector(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Bend angle [rad] times the horizontal unit vector the top leans towards, shape (2,); zero where it is upright.

    The angle is between the normals of the top ring and of the base, which is vertical where it is clamped; the vector
    is along the first two axes of `base_frame`. So a rigid motion of a free body is no bend.
    """
    normal = base_frame(lattice, position) @ top_normal(lattice, position)
    horizontal = float(np.hypot(normal[0], normal[1]))
    if horizontal < LEAST_BEND:
        return np.array([0.0 if normal[2] > 0.0 else np.pi, 0.0])
    lean: FloatArray = normal[:2] * (np.arctan2(horizontal, normal[2]) / horizontal)
    return lean


def bend_angle(lattice: Lattice, position: FloatArray) -> float:
    """Angle between the normals of the top ring and of the base [rad], in [0, pi] (Schaffer et al. 2024)."""
    return float(np.hypot(*bend_vector(lattice, position)))


def bend_direction(lattice: Lattice, position: FloatArray) -> float:
    """Azimuth that the top leans towards [rad], in [0, 2 pi); 0 where it stands upright."""
    lean = bend_vector(lattice, position)
    return azimuth_of(lean)


def azimuth_of(vector: FloatArray) -> float:
    """Azimuth of a horizontal vector [rad], in [0, 2 pi)."""
    azimuth = float(np.arctan2(vector[1], vector[0])) % (2.0 * np.pi)
    return azimuth if azimuth < 2.0 * np.pi else 0.0


def ring_radii(lattice: Lattice, position: FloatArray) -> FloatArray:
    """Mean distance of each level's sites to their centroid [m], shape (n_level,). No common levels: ValueError."""
    return _rings(lattice, position)[1]


def _rings(lattice: Lattice, position: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centroid of each level's sites [m], shape (n_level, 3), and their mean distance to it [m], shape (n_level,)."""
    level = lattice.site_level
    if lattice.n_level == 0 or level.min() < 0:
        raise ValueError("lattice: its sites share no common levels (uneven phases), so it has no ring radii")
    site = site_positions(lattice, position)
    count = np.bincount(level, minlength=lattice.n_level)
    centre = np.stack([np.bincount(level, site[:, i], lattice.n_level) for i in range(3)], axis=1) / count[:, None]
    radii: FloatArray = np.bincount(level, np.linalg.norm(site - centre[level], axis=1), lattice.n_level) / count
    return centre, radii


@dataclass(frozen=True)
class Lodging:
    """Where in the body a point lies: `lodging`."""

    height: float
    """Rest height of the place on the body's axis nearest to it [m]; 0 or the full height where it is out by an end."""
    outside: bool
    """Beside the body: further from the axis than the ring there."""
    end: int
    """+1 out by the top end, -1 by the bottom end, 0 between them."""


def lodging(lattice: Lattice, position: FloatArray, point: FloatArray) -> Lodging:
    """Place of a point [m], shape (3,), in the body, whose axis runs from ring centre to ring centre, level by level.

    It is out by an end where it lies beyond the plane through the last ring's centre across the axis there; else beside
    the body where its distance from the axis exceeds the radii of the two rings around it, taken linear between them.
    """
    centre, radius = _rings(lattice, position)
    side, way = np.diff(centre, axis=0), point - centre[:-1]
    share = np.sum(way * side, axis=1) / np.sum(side * side, axis=1)
    if share[0] < 0.0 and share[-1] < 1.0:
        return Lodging(0.0, False, -1)
    if share[-1] > 1.0 and share[0] > 0.0:
        return Lodging(float(lattice.level_height[-1]), False, 1)
    share = np.clip(share, 0.0, 1.0)
    distance = np.linalg.norm(way - share[:, None] * side, axis=1)
    k = int(np.argmin(distance))
    height, reach = (row[k] + share[k] * (row[k + 1] - row[k]) for row in (lattice.level_height, radius))
    return Lodging(float(height), bool(distance[k] > reach), 0)


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

    Motion that no one mode dominates (LEAST_COHERENCE) or that is too small (LEAST_AMPLITUDE) is no wave: it has an
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
    radii, level_height = real_array("radii", radii), real_array("level_height", level_height)
    _check_recording(radii, dt, level_height)
    motion = radii - radii.mean(axis=0)
    size = np.sqrt(np.mean(motion**2, axis=0))
    moving = size > LEAST_SHARE * float(size.max())
    if not moving.any():
        return TravellingWave(0.0, 0, 0.0)
    signal = _analytic(motion[:, moving]).T
    modes, strength, _ = np.linalg.svd(signal, full_matrices=False)
    mode: npt.NDArray[np.complex128] = modes[:, 0]
    amplitude = float(strength[0]) / float(np.sqrt(radii.size))
    coherent = strength[0] ** 2 >= LEAST_COHERENCE * np.sum(strength**2)
    if len(mode) < 2 or not coherent or amplitude < LEAST_AMPLITUDE * float(np.abs(radii).max()):
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


def _check_recording(radii: FloatArray, dt: float, level_height: FloatArray) -> None:
    if radii.ndim != 2 or radii.shape[0] < 4 or radii.shape[1] < 1 or not np.isfinite(radii).all():
        raise ValueError(f"radii: must be finite, of shape (n_time >= 4, n_level), got shape {radii.shape}")
    if (step := finite_number(dt)) is None or step <= 0.0:
        raise ValueError(f"dt: must be a positive time [s], got {shown(dt)}")
    if (
        level_height.shape != radii.shape[1:]
        or not np.isfinite(level_height).all()
        or (np.diff(level_height) <= 0).any()
    ):
        raise ValueError(
            f"level_height: must be {radii.shape[1]} finite, rising heights [m], one a column of radii, "
            f"got {level_height.tolist()}"
        )


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


def joint_gap(model: RodModel, position: FloatArray) -> float:
    """Largest distance between two nodes that a joint holds together [m]; 0 without joints."""
    first, second = model.tie_nodes(model.joints)
    gap = np.linalg.norm(position[first] - position[second], axis=1)
    return float(gap.max(initial=0.0))


def mass_centre(model: RodModel, position: FloatArray) -> FloatArray:
    """Centre of mass of the whole assembly [m], shape (3,)."""
    centre: FloatArray = model.node_mass @ position / model.node_mass.sum()
    return centre


def muscle_lengths(model: RodModel, position: FloatArray) -> FloatArray:
    """Length of every muscle along its rod, or of its line [m], shape (n_muscle,), in the order of their tensions."""
    along = np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))
    rods = np.array(model.muscles, dtype=np.int64)
    first, last = model.node_offset[rods], model.node_offset[rods + 1] - 1
    start, end = model.tie_nodes(model.lines)
    lines = np.linalg.norm(position[start] - position[end], axis=1)
    return np.concatenate([along[last - 1] - np.where(first > 0, along[first - 1], 0.0), lines])


def dilatation(model: RodModel, position: FloatArray) -> FloatArray:
    """Length of every element over its rest length, shape (n_elem,)."""
    rest = np.concatenate([rod.rest_length for rod in model.rods])
    lower = np.delete(np.arange(model.n_node), model.node_offset[1:] - 1)
    ratio: FloatArray = np.linalg.norm(position[lower + 1] - position[lower], axis=1) / rest
    return ratio


def muscle_strain(model: RodModel, position: FloatArray) -> FloatArray:
    """Length over rest length, less 1, of every muscle, shape (n_muscle,)."""
    rods = np.add.reduceat(np.concatenate([rod.rest_length for rod in model.rods]), model.element_offset[:-1])
    rest = np.concatenate([rods[list(model.muscles)], [line.rest_length for line in model.lines]])
    strain: FloatArray = muscle_lengths(model, position) / rest - 1.0
    return strain


def straightness(lattice: Lattice, model: RodModel, position: FloatArray) -> float:
    """Chord over length of the most crooked stretch of rod, relative to rest: 1 = as at rest, less = buckled.

    A stretch is a structure rod from one crossing to the next, or a whole muscle.
    """
    shares = []
    for index, rod in enumerate(model.rods):
        step = lattice.design.elements_per_segment if index < lattice.n_rod else rod.n_elem
        now, rest = (_chord_share(nodes, step) for nodes in (position[model.nodes(index)], rod.position))
        shares.append(now / rest)
    return float(np.concatenate(shares).min())


def _chord_share(nodes: FloatArray, step: int) -> FloatArray:
    """Chord over length of each stretch of `step` elements, shape (n_elem / step,)."""
    length = np.linalg.norm(np.diff(nodes, axis=0), axis=1).reshape(-1, step).sum(axis=1)
    chord = np.linalg.norm(np.diff(nodes[::step], axis=0), axis=1)
    share: FloatArray = chord / length
    return share
