"""How a call to an engine ends: statuses, where a failure shows, and the bounds both engines judge by."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import MuscleLayout
from lattice_gym.checks import FloatArray
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.part_names import describe_part


class Status(IntEnum):
    """How a call to `Engine.advance` ended.

    NON_FINITE: a position, velocity or director is NaN or infinite. OVERSTRETCHED: an element or a line is shorter than
    `MIN_DILATATION` or longer than `MAX_DILATATION` times its rest length. INVERTED: an element points against its d3.
    TORN: two joined nodes are further apart than `joint_gap_limits` allows. ENERGY: the ledger shows more spurious
    energy than `energy.ENERGY_TOLERANCE` allows; needs the energy check. INACCURATE: a run at half the step, started
    when the state was last set, differs by more than `STEP_TOLERANCE`, or failed; needs the step check.
    """

    OK = 0
    NON_FINITE = 1
    OVERSTRETCHED = 2
    INVERTED = 3
    TORN = 4
    ENERGY = 5
    INACCURATE = 6


@dataclass(frozen=True)
class Health:
    """Status, and where it shows: rod and element, and the joint where one is torn (-1 where there is none).

    Lines count on from the rods, so that a muscle has the same number as a line, and are one element. A failure without
    a rod is the ball's. As text it has these numbers; `describe` names the parts of a worm.
    """

    status: Status = Status.OK
    rod: int = -1
    element: int = -1
    joint: int = -1

    @property
    def ok(self) -> bool:
        """Whether no failure was found."""
        return self.status is Status.OK

    def __str__(self) -> str:
        if self.ok:
            return "ok"
        if self.rod < 0:
            return f"{self.status.name.lower()} (ball)"
        joint = f", joint {self.joint}" if self.joint >= 0 else ""
        return f"{self.status.name.lower()} (rod {self.rod}, element {self.element}{joint})"


def describe(health: Health, lattice: Lattice, layout: MuscleLayout, worm: int | None = None) -> str:
    """Say what failed of a worm and where, or "ok"; the number of the worm, if given, comes first."""
    if health.ok:
        return "ok"
    part = describe_part(lattice, layout, rod=health.rod, element=health.element, joint=health.joint)
    text = _SENTENCES[health.status].format(part)
    return text if worm is None else f"worm {worm}: {text}"


_SENTENCES = {
    Status.NON_FINITE: "not finite: {}",
    Status.OVERSTRETCHED: "overstretched: {}",
    Status.INVERTED: "inverted: {}",
    Status.TORN: "torn: {}",
    Status.ENERGY: "spurious energy, most of it in {}",
    Status.INACCURATE: "inaccurate, as the time step is too long: {}",
}


def joint_gap_limits(model: RodModel) -> FloatArray:
    """Gap beyond which each joint counts as torn [m], shape (n_joint,): its gap at rest and the radii of both rods.

    Two rods that lie further apart than that have come off each other.
    """
    limits = np.zeros(len(model.joints))
    for k, joint in enumerate(model.joints):
        a, b = model.rods[joint.rod_a], model.rods[joint.rod_b]
        gap = float(np.linalg.norm(a.position[joint.node_a] - b.position[joint.node_b]))
        radii = (rod.radius[min(node, rod.n_elem - 1)] for rod, node in ((a, joint.node_a), (b, joint.node_b)))
        limits[k] = gap + float(sum(radii))
    return limits


def torn_joint(model: RodModel, joint: int) -> Health:
    """Health that names a torn joint, by its first rod and the element at its node there."""
    tie = model.joints[joint]
    return Health(Status.TORN, tie.rod_a, element_at(model, tie.rod_a, tie.node_a), joint)


def overstretched_line(model: RodModel, line: int) -> Health:
    """Health that names an over-stretched line."""
    return Health(Status.OVERSTRETCHED, model.n_rod + line, 0)


def element_at(model: RodModel, rod: int, node: int) -> int:
    """Element that begins at a node, or the last one."""
    return min(node, model.rods[rod].n_elem - 1)
