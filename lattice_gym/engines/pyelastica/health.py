"""Health of an assembly in PyElastica's arrays."""

from __future__ import annotations

import numpy as np

from lattice_gym.checks import FloatArray
from lattice_gym.engines.health import Health, Status, overstretched_line, torn_joint
from lattice_gym.engines.pyelastica.law import Bodies
from lattice_gym.engines.pyelastica.lines import line_lengths
from lattice_gym.physics.laws.elasticity import MAX_DILATATION, MIN_DILATATION


def health_of(bodies: Bodies, joint_gap_limits: FloatArray) -> Health:
    """Status of the first rod and element found at fault, then of joints, lines and the ball."""
    model = bodies.model
    for index in range(model.n_rod):
        if not (health := _rod_health(bodies, index)).ok:
            return health
    position = bodies.positions()
    for k, (a, b) in enumerate(zip(*model.tie_nodes(model.joints), strict=True)):
        if not np.linalg.norm(position[b] - position[a]) <= joint_gap_limits[k]:
            return torn_joint(model, k)
    for k, (line, length) in enumerate(zip(model.lines, line_lengths(model, position), strict=True)):
        if not MIN_DILATATION <= length / line.rest_length <= MAX_DILATATION:
            return overstretched_line(model, k)
    if (sphere := bodies.sphere) is not None:
        moving = (sphere.position_collection, sphere.velocity_collection, sphere.omega_collection)
        if not all(np.isfinite(value).all() for value in moving):
            return Health(Status.NON_FINITE)
    return Health()


def _rod_health(bodies: Bodies, index: int) -> Health:
    """Status of the first element of a rod found at fault."""
    rod = bodies.rods[index]
    position, velocity, directors = rod.position_collection, rod.velocity_collection, rod.director_collection
    side = np.diff(position, axis=1)
    with np.errstate(all="ignore"):
        finite = np.isfinite(side).all(0) & np.isfinite(np.diff(velocity, axis=1)).all(0)
        finite &= np.isfinite(directors).all((0, 1)) & np.isfinite(rod.omega_collection).all(0)
        dilatation = np.linalg.norm(side, axis=0) / rod.rest_lengths
        stretched = (dilatation < MIN_DILATATION) | (dilatation > MAX_DILATATION)
        inverted = np.sum(directors[2] * side, axis=0) <= 0.0
    status = np.select(
        [~finite, stretched, inverted], [Status.NON_FINITE, Status.OVERSTRETCHED, Status.INVERTED], Status.OK
    )
    if not status.any():
        return Health()
    element = int(np.argmax(status != Status.OK))
    return Health(Status(int(status[element])), index, element)
