"""The assembly of a lattice worm: its structure rods, muscles, joints, clamps, and what surrounds it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import Muscle, MuscleLayout
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.laws.ball import RigidBall
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.laws.joints import Joint
from lattice_gym.physics.laws.lines import Line
from lattice_gym.physics.rod import Rod, node_radius, straight_rod
from lattice_gym.physics.world import World


def build_model(
    lattice: Lattice, layout: MuscleLayout, world: World | None = None, *, hill: Hill | None = None
) -> RodModel:
    """Model of a lattice worm: its structure rods first, then a rod for each active muscle of `layout`, in order.

    A `world` adds what surrounds it; see `World`. With muscles as lines, which touch nothing, there can be no ball.
    """
    design, world = lattice.design, World() if world is None else world
    medium = world.medium
    if world.ball is not None and design.muscle_model == "line":
        raise ValueError('design.muscle_model = "line": world.ball needs muscles as rods, as lines touch nothing')
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
        ball=ball,
        gravity=None if medium is None else np.array([0.0, 0.0, -medium.gravity]),
        medium_density=0.0 if medium is None else medium.density,
        medium_drag=0.0 if medium is None else medium.drag,
        ground=world.ground,
        hill=hill,
        contact=world.contact,
    )


def _ball(lattice: Lattice, world: World) -> RigidBall | None:
    """Rigid ball of a world that has one, on the axis of the upright lattice."""
    ball, medium, design = world.ball, world.medium, lattice.design
    if ball is None:
        return None
    if ball.level > design.n_segment:
        raise ValueError(f"Ball.level = {ball.level!r}: must not be above the top level, {design.n_segment}")
    volume = 4.0 / 3.0 * math.pi * ball.radius**3
    weight = 0.0 if medium is None else (ball.density - medium.density) * volume * medium.gravity
    return RigidBall(
        position=np.array([0.0, 0.0, ball.level * design.height / design.n_segment]),
        radius=ball.radius,
        mass=ball.density * volume,
        stiffness=ball.stiffness,
        damping=ball.damping,
        friction=ball.friction,
        force=(0.0, 0.0, -weight),
    )


def _laid_down(rods: Sequence[Rod], ball: RigidBall | None) -> tuple[list[Rod], RigidBall | None]:
    """Turn rods and ball about y, from +z to +x, and lift them until the rods' lowest surface touches z = 0."""
    turn = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    shift = np.array([0.0, 0.0, -min(float((rod.position @ turn[:, 2] - node_radius(rod)).min()) for rod in rods)])
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
    return Line(
        rod_a,
        node_a,
        rod_b,
        node_b,
        rest_length=float(rod.rest_length.sum()),
        stiffness=float(rod.stretch_stiffness[0]),
        mass=float(rod.mass.sum()),
        damping=rod.damping * (rod.n_elem + 1),
        density=rod.density,
    )


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
