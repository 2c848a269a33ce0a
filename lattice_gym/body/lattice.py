"""From a design to rods at rest and the sites where they cross."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lattice_gym.body.design import LatticeDesign
from lattice_gym.checks import TAU, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Lattice:
    """Rods at rest and their crossings; every array is read-only.

    The axis is z, the base lies at z = 0. Sites are sorted by height, then azimuth. A level is a height at which every
    rod crosses another; with uneven phases there is none: site_level is -1 throughout and n_level is 0.
    """

    design: LatticeDesign
    position: FloatArray
    """Rest positions of the nodes [m], shape (n_rod, n_node, 3)."""
    directors: FloatArray
    """Rows d1 (radially outward), d2, d3 (along the element), shape (n_rod, n_node - 1, 3, 3)."""
    site_position: FloatArray
    """Rest positions of the sites [m], shape (n_site, 3)."""
    site_azimuth: FloatArray
    """Azimuths of the sites [rad] in [0, 2 pi), shape (n_site,)."""
    site_level: IntArray
    """Levels of the sites from 0 at the base, shape (n_site,)."""
    site_rod: IntArray
    """The right-handed and the left-handed rod of each site, shape (n_site, 2)."""
    site_node: IntArray
    """The node of each of the two rods at the site, shape (n_site, 2)."""
    level_height: FloatArray
    """Heights of the levels [m], shape (n_level,)."""

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def __repr__(self) -> str:
        rods = f"{self.design.n_pairs} pairs, {self.n_rod} rods of {self.n_node} nodes"
        return f"Lattice({rods}, {self.n_site} sites, {self.n_level or 'no'} levels)"

    @property
    def n_rod(self) -> int:
        """Number of structure rods."""
        return len(self.position)

    @property
    def n_node(self) -> int:
        """Number of nodes on each rod."""
        return len(self.position[0])

    @property
    def n_site(self) -> int:
        """Number of sites."""
        return len(self.site_position)

    @property
    def n_level(self) -> int:
        """Number of levels."""
        return len(self.level_height)

    @cached_property
    def site_nodes(self) -> IntArray:
        """Rows of the two nodes of each site among those of all rods, one rod after another, shape (n_site, 2)."""
        return self.site_rod * self.n_node + self.site_node


def build_lattice(design: LatticeDesign) -> Lattice:
    """Rods, sites and levels of a design.

    On its way up the right-handed rod of rank i meets the left-handed ones of ranks i, i + 1, i + 2, ... one after
    another: the s-th at the mean of the azimuths from which the two start, at a height proportional to their
    difference. That is the s-th crossing of both rods, so crossings follow from whole numbers alone.
    """
    pattern, n_pairs, n_segment = design.phase_pattern, design.n_pairs, design.n_segment
    repeat = len(pattern.offset)
    start, step = (part.ravel() for part in np.indices((n_pairs, n_segment + 1)))
    (turn_a, index_a), (turn_b, index_b) = np.divmod(start, repeat), np.divmod(start + step, repeat)
    offset = np.array(pattern.offset)
    # Offsets and turns are kept apart so that equal heights and azimuths come out equal to the last bit.
    lead = (offset[index_b] - offset[index_a]) / TAU * pattern.symmetry + (turn_b - turn_a)
    height = design.height * (lead / (n_segment // repeat))
    azimuth = (offset[index_a] + offset[index_b]) / 2 + math.pi / pattern.symmetry * (
        (turn_a + turn_b) % (2 * pattern.symmetry)
    )
    azimuth = azimuth % TAU
    rod_of = np.empty((2, n_pairs), dtype=np.int64)  # row 0: right-handed, row 1: left-handed
    for row, sign in enumerate((1, -1)):
        family = np.flatnonzero(design.rod_chirality == sign)
        rod_of[row, np.array(pattern.rank)[family]] = family
    site_rod = np.stack([rod_of[0, start], rod_of[1, (start + step) % n_pairs]], axis=1)
    site_node = np.repeat(step[:, None] * design.elements_per_segment, 2, axis=1)
    radius = design.diameter / 2
    site_position = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), height], axis=1)
    has_levels = repeat == 1
    order = np.lexsort((azimuth, height))
    crossing = np.empty((design.n_rod, n_segment + 1), dtype=np.int64)
    crossing[site_rod, step[:, None]] = np.arange(start.size)[:, None]
    position, directors = _rods(design, height[crossing], site_position[crossing])
    return Lattice(
        design=design,
        position=position,
        directors=directors,
        site_position=site_position[order],
        site_azimuth=azimuth[order],
        site_level=step[order] if has_levels else np.full(start.size, -1),
        site_rod=site_rod[order],
        site_node=site_node[order],
        level_height=height[: n_segment + 1] if has_levels else np.empty(0),
    )


def _rods(design: LatticeDesign, height: FloatArray, crossing: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rest nodes and directors of the rods.

    Crossings come rod by rod: heights [m], shape (n_rod, n_segment + 1), and positions [m], one axis of 3 more.
    """
    count = design.elements_per_segment
    share = np.arange(count) / count
    z = height[:, :-1, None] + np.diff(height)[:, :, None] * share
    z = np.concatenate([z.reshape(design.n_rod, -1), height[:, -1:]], axis=1)
    phase = np.array([design.phase_pattern.azimuth(rank) for rank in design.phase_pattern.rank])
    angle = phase[:, None] + design.rod_chirality[:, None] * (TAU / design.period) * z
    radius = design.diameter / 2
    position = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=2)
    position[:, ::count] = crossing  # the same numbers on both rods of a site

    tangent = np.diff(position, axis=1)
    tangent /= np.linalg.norm(tangent, axis=2, keepdims=True)
    middle = (angle[:, 1:] + angle[:, :-1]) / 2
    outward = np.stack([np.cos(middle), np.sin(middle), np.zeros_like(middle)], axis=2)
    # The chord of a helix is at right angles to the radius through its middle; only rounding is left to take out.
    outward -= np.sum(outward * tangent, axis=2, keepdims=True) * tangent
    outward /= np.linalg.norm(outward, axis=2, keepdims=True)
    return position, np.stack([outward, np.cross(tangent, outward), tangent], axis=2)
