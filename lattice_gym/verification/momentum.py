"""Exact cases of momentum: a free lattice under tensions that are internal to it."""

from __future__ import annotations

import numpy as np

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.simulation import Simulation
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.state import RodState
from lattice_gym.physics.worm import build_model
from lattice_gym.verification.case import Reading, Scene, exact_case, sample

NEWTON = "Newton's third law"


def momenta(model: RodModel, state: RodState) -> FloatArray:
    """Momentum [kg m/s] and angular momentum about the origin [kg m^2/s] of rods and ball, shape (2, 3)."""
    carried, position = model.node_mass[:, None] * state.velocity, state.position
    spin = np.zeros(3)
    for index, rod in enumerate(model.rods):
        length = np.linalg.norm(np.diff(position[model.nodes(index)], axis=0), axis=1)
        inertia = (rod.inertia * rod.rest_length / length)[:, None] * np.array([1.0, 1.0, 2.0])
        elements = model.elements(index)
        spin += np.einsum("eji,ej->i", state.directors[elements], inertia * state.omega[elements])
    if model.ball is not None:
        carried = np.concatenate([carried, model.ball.mass * state.ball_velocity])
        position = np.concatenate([position, state.ball_position])
        spin += model.ball.inertia * state.ball_omega[0]
    return np.stack([carried.sum(axis=0), np.cross(position, carried).sum(axis=0) + spin])


def _free_lattice(n_elem: int, which: int) -> Scene:
    """Free, undamped lattice of n_elem elements a segment under random tensions in all its muscles."""
    design = LatticeDesign(base="free", damping=0.0, rotational_damping=0.0, elements_per_segment=n_elem)
    lattice = build_lattice(design)
    model = build_model(lattice, named_layout("all", lattice))

    def share(state: RodState) -> float:
        """One of both momenta over the sum of what the nodes carry."""
        carried = model.node_mass[:, None] * state.velocity
        parts = carried if which == 0 else np.cross(state.position, carried)
        return float(np.linalg.norm(momenta(model, state)[which]) / np.abs(parts).sum())

    def observe(engine: Simulation) -> Reading:
        tension = 0.3 * np.random.default_rng(1).random(model.n_muscle)
        times = np.linspace(0.005, 0.02, 4)
        return Reading(1e3 * times, sample(engine, times, share, tension), np.zeros(len(times)), scale=1.0)

    return Scene(model, model.rest_state(), 2e-4, observe)


@exact_case(
    "Momentum, free lattice",
    quantity="momentum over its parts' sum",
    abscissa="t [ms]",
    exact="0",
    source=NEWTON,
    n_elem=5,
    tolerance=1e-11,
    reason="rounding: internal forces cancel in pairs",
)
def linear_momentum(n_elem: int) -> Scene:
    """Of the lattice."""
    return _free_lattice(n_elem, 0)


@exact_case(
    "Angular momentum, free lattice",
    quantity="momentum over its parts' sum",
    abscissa="t [ms]",
    exact="0",
    source=NEWTON,
    n_elem=5,
    tolerance=1e-6,
    reason="the couple's turn between two elements is a trapezoid sum: exact to the cube of their angle (0.1 rad)",
)
def angular_momentum(n_elem: int) -> Scene:
    """Of the lattice, about the origin."""
    return _free_lattice(n_elem, 1)


MOMENTUM_CASES = (linear_momentum, angular_momentum)
"""Every case of the free lattice."""
