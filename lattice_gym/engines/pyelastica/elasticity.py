"""Elasticity: PyElastica's Cosserat rods, with their own rest strains and curvatures."""

from __future__ import annotations

from typing import cast

import numpy as np
from elastica.rod.cosserat_rod import CosseratRod

from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.rod import Rod


def make_rods(model: RodModel) -> list[CosseratRod]:
    """Rods of a model, with the mass that lines put on their nodes."""
    rods = [_make_rod(rod) for rod in model.rods]
    for index, rod in enumerate(rods):
        rod.mass[:] = model.node_mass[model.nodes(index)]
    return rods


def _make_rod(rod: Rod) -> CosseratRod:
    """Rod in PyElastica's arrays (components first), free of stress in its shape or of its natural curvature."""
    made = CosseratRod.straight_rod(
        rod.n_elem,
        rod.position[0].copy(),
        rod.directors[0, 2].copy(),
        rod.directors[0, 0].copy(),
        float(rod.rest_length.sum()),
        cast(float, rod.radius.copy()),  # annotated as a number, taken as one per element
        rod.density,
        youngs_modulus=rod.youngs_modulus,
        shear_modulus=rod.shear_modulus,
        position=rod.position.T.copy(),
        directors=np.moveaxis(rod.directors, 0, -1).copy(),
    )
    made.rest_sigma[:] = made.sigma
    made.rest_kappa[:] = made.kappa if rod.natural_curvature is None else rod.natural_curvature.T
    return made
