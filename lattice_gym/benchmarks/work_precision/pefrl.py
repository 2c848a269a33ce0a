"""Why PyElastica's fourth-order stepper, PEFRL, is left out: what it does to a constant force and to damping."""

from __future__ import annotations

import numpy as np
from elastica.timestepper.symplectic_steppers import PEFRL

from lattice_gym.engines.pyelastica.assembly import Assembly
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.loads import PointForce
from lattice_gym.physics.rod import straight_rod

_DT, _N_STEP, _DAMPING = 1e-4, 10, 1e-3
_PUSH = 1e-3
"""Acceleration of every node [m/s^2] or its velocity at the start [m/s]: so small that the rod stays as it is."""


def _with_pefrl(model: RodModel) -> Assembly:
    """Assembly that the other stepper advances."""
    assembly = Assembly(model, _DT)
    assembly.stepper = PEFRL()
    return assembly


def pefrl_faults() -> tuple[float, float]:
    """Velocity under a constant force over the exact one, and how many times a step it damps: both should be 1."""
    rod = straight_rod(
        (0, 0, 0), (0, 0, 1), 4, radius=0.05, density=1e3, youngs_modulus=1e4, shear_modulus=4e3, damping=0.0
    )
    forces = tuple(PointForce(0, node, (0.0, 0.0, _PUSH * float(mass))) for node, mass in enumerate(rod.mass))
    pushed = _with_pefrl(RodModel(rods=(rod,), forces=forces))
    pushed.advance(np.empty(0), np.empty(0), _N_STEP)
    gained = pushed.state.velocity[:, 2].mean() / (_PUSH * _N_STEP * _DT)

    damped_rod = straight_rod(
        (0, 0, 0), (0, 0, 1), 4, radius=0.05, density=1e3, youngs_modulus=1e4, shear_modulus=4e3, damping=_DAMPING
    )
    model = RodModel(rods=(damped_rod,))
    damped, rest = _with_pefrl(model), model.rest_state()
    rest.velocity[:, 2] = _PUSH
    damped.restore(rest)
    damped.advance(np.empty(0), np.empty(0), 1)
    decay = -np.log(damped.state.velocity[2, 2] / _PUSH) / (_DAMPING * _DT / damped_rod.mass[2])
    return float(gained), float(decay)
