"""Scenes with a ball that several files of tests use."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from small_worms import SMALL

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.critical_step import default_dt
from lattice_gym.physics.laws.ball import Ball, RigidBall
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.measures import dilatation
from lattice_gym.physics.rod import straight_rod
from lattice_gym.physics.state import RodState
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model

ROD: dict[str, Any] = {"radius": 0.01, "density": 1000.0, "youngs_modulus": 1e7, "shear_modulus": 4e6}
SOFT: dict[str, Any] = {"radius": 0.05, "density": 1000.0, "youngs_modulus": 1e3, "shear_modulus": 3e2}
RADIUS = 0.1
REACH = RADIUS + ROD["radius"]


def rails(*across: float, length: float = 8.0) -> dict[str, Any]:
    """Rods of two elements along x that hold still, at the given places across."""
    rods = tuple(straight_rod((-length / 2, y, 0), (length / 2, y, 0), 2, **ROD) for y in across)
    clamps = tuple(Clamp(k, node, min(node, 1)) for k in range(len(rods)) for node in range(3))
    return {"rods": rods, "clamps": clamps}


def ball(height: float, **changes: Any) -> RigidBall:
    """Ball above the middle of the second element of a rail."""
    values: dict[str, Any] = {"position": np.array([2.0, 0.0, height]), "radius": RADIUS, "mass": 1.0}
    return RigidBall(**(values | {"stiffness": 1e4} | changes))


def thrown(model: RodModel, velocity: tuple[float, float, float]) -> RodState:
    """State at rest but for the ball's velocity."""
    return replace(model.rest_state(), ball_velocity=np.array([velocity]))


def momenta(model: RodModel, state: RodState) -> FloatArray:
    """Momentum and angular momentum about the origin of everything, shape (2, 3)."""
    assert model.ball is not None
    mass, ball = model.node_mass[:, None], model.ball
    moving = np.concatenate([mass * state.velocity, ball.mass * state.ball_velocity])
    place = np.concatenate([state.position, state.ball_position])
    inertia = model.rod_array("inertia") / dilatation(model, state.position)
    spin = np.einsum("nji,nj->i", state.directors, inertia[:, None] * [1.0, 1.0, 2.0] * state.omega)
    return np.stack(
        [moving.sum(axis=0), np.cross(place, moving).sum(axis=0) + spin + ball.inertia * state.ball_omega[0]]
    )


def worm(medium: Medium | None = None, **ball: Any) -> tuple[RodModel, float]:
    """Small lattice with a ball that its rings press on, and its step."""
    lattice = build_lattice(LatticeDesign(**SMALL))
    world = World(medium=medium, ball=Ball(**({"radius": 0.028, "level": 1.7} | ball)))
    model = build_model(lattice, named_layout("all", lattice), world)
    return model, default_dt(model, 0.05, 0.5)
