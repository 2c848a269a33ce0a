"""Scenes of rods that touch, which several files of tests use."""

from __future__ import annotations

from typing import Any

import numpy as np

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.critical_step import default_dt
from lattice_gym.physics.laws import contact
from lattice_gym.physics.laws.contact import Contact
from lattice_gym.physics.rod import straight_rod
from lattice_gym.physics.state import RodState
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model

ROD: dict[str, Any] = {"radius": 0.01, "density": 1000.0, "youngs_modulus": 1e6, "shear_modulus": 4e5}

REACH = 2.0 * ROD["radius"]
FIELDS = ("position", "velocity", "directors", "omega")


def crossing(gap: float, x: float = 0.0, y: float = 0.0, angle: float = 90.0, **changes: Any) -> RodModel:
    """Rod of three elements along x, and one above it, turned and moved, with a `gap` between their surfaces."""
    side, place = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.0]), np.array([x, y, REACH + gap])
    rod = ROD | changes.pop("rod", {})
    lower = straight_rod((-0.15, 0.0, 0.0), (0.15, 0.0, 0.0), 3, **rod)
    upper = straight_rod(place - 0.15 * side, place + 0.15 * side, 3, **rod)
    parts: dict[str, Any] = {"rods": (lower, upper), "contact": Contact(stiffness=1e3, damping=0.0)}
    return RodModel(**(parts | changes))


def moved(model: RodModel, rod: int, shift: Any, velocity: Any = (0.0, 0.0, 0.0)) -> RodState:
    """State at rest but for one rod."""
    state = model.rest_state().copy()
    state.position[model.nodes(rod)] += shift
    state.velocity[model.nodes(rod)] += velocity
    return state


def touching(model: RodModel, position: FloatArray) -> IntArray:
    """Pairs of elements that push at each other."""
    numbers = [model.n_elem, 1]
    pairs = contact.overlapping(model, position)
    found: IntArray = pairs[~np.isin(pairs @ numbers, contact.excluded(model) @ numbers)]
    return found


def worm(law: Contact | None, tension: float, **design: Any) -> tuple[RodModel, float]:
    """Lattice with compression muscles, and its step."""
    lattice = build_lattice(LatticeDesign(**design))
    model = build_model(lattice, named_layout("compression", lattice), World(contact=law))
    return model, default_dt(model, 0.05, tension)
