"""Names of the parts of a worm, by the numbers that its model has for them."""

from __future__ import annotations

import numpy as np

from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import Muscle, MuscleLayout
from lattice_gym.checks import TAU, whole, wrap_angle


def describe_part(lattice: Lattice, layout: MuscleLayout, *, rod: int = -1, element: int = -1, joint: int = -1) -> str:
    """Say in words which part of a worm numbers of its model (see `worm.build_model`) stand for.

    Muscles and structure rods have the numbers that they have in the layout and in the design, each counted from 0.

    Parameters
    ----------
    lattice, layout
        The worm: muscles count that are on.
    rod
        Structure rods first, then muscles, be they rods or lines; -1: the ball, if no joint is given.
    element
        Of the rod, from the base or the muscle's start; -1: the whole rod.
    joint
        Those of the sites first, then two a muscle, at its start and at its end; it says all, whatever rod is given.
        -1: none.

    Raises
    ------
    ValueError
        A number that the worm has no part for.
    """
    n_muscle, design = len(layout), lattice.design
    n_joint = lattice.n_site + (2 * n_muscle if design.muscle_model == "rod" else 0)
    if whole("joint", joint, -1, n_joint - 1) >= 0:
        return _joint(lattice, layout, joint)
    if whole("rod", rod, -1, lattice.n_rod + n_muscle - 1) < 0:
        return "the ball"
    if rod < lattice.n_rod:
        count = lattice.n_node - 1
        if whole("element", element, -1, count - 1) < 0:
            return _rod(lattice, rod)
        return f"{_rod(lattice, rod)}, element {element} of {count}, {_segment(lattice, rod, element)}"
    muscle, count = rod - lattice.n_rod, design.elements_per_muscle if design.muscle_model == "rod" else 1
    named = _muscle(lattice, layout.active[muscle], muscle)
    if whole("element", element, -1, count - 1) < 0 or count == 1:
        return named
    return f"{named}, element {element} of {count}"


def _rod(lattice: Lattice, rod: int) -> str:
    hand = "right" if lattice.design.rod_chirality[rod] > 0 else "left"
    return f"structure rod {rod} ({hand}-handed)"


def _segment(lattice: Lattice, rod: int, element: int) -> str:
    """Where on a structure rod an element lies: between which of its sites."""
    step = element // lattice.design.elements_per_segment
    if lattice.n_level:
        return f"between levels {step} and {step + 1}"
    sites = np.flatnonzero((lattice.site_rod == rod).any(axis=1))  # by height
    return f"between sites {sites[step]} and {sites[step + 1]}"


def _muscle(lattice: Lattice, muscle: Muscle, number: int) -> str:
    sites = [muscle.start, muscle.end]
    start, end = lattice.site_azimuth[sites]
    place = _place(sorted(set(lattice.site_level[sites].tolist())), start + 0.5 * wrap_angle(end - start))
    return f"muscle {number} ({muscle.orientation}, {place}, sites {muscle.start} and {muscle.end})"


def _joint(lattice: Lattice, layout: MuscleLayout, joint: int) -> str:
    if joint < lattice.n_site:
        right, left = (_rod(lattice, rod) for rod in lattice.site_rod[joint].tolist())
        place = _place([int(lattice.site_level[joint])], lattice.site_azimuth[joint])
        return f"the joint of {right} and {left} at site {joint}, {place}"
    number, end = divmod(joint - lattice.n_site, 2)
    muscle = layout.active[number]
    site = (muscle.start, muscle.end)[end]
    rod = _rod(lattice, int(lattice.site_rod[site, 0]))
    return f"the joint of {_muscle(lattice, muscle, number)} and {rod} at site {site}"


def _place(levels: list[int], azimuth: float) -> str:
    """Levels, where the lattice has them, and azimuth [rad], given in whole degrees."""
    at = f"at {round(np.degrees(azimuth % TAU)) % 360} deg"
    if levels[0] < 0:
        return at
    return f"level {levels[0]} {at}" if len(levels) == 1 else f"levels {levels[0]} to {levels[1]} {at}"
