"""Random runs of a lattice worm: what a seed settles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import LAYOUTS, named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.critical_step import critical_dt
from lattice_gym.physics.laws.activation import advance_activation
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.worm import build_model

N_CONTROL = 12
"""Control steps of a run."""
CONTROL_DT = 0.05
"""[s]"""
MAX_SUBSTEPS = 500
"""Where the step is so short that more of them make a control step, the control step is shortened."""
FIRST_SEED = 20_000
"""Seeds below were used while the checks were made; those of the report were not."""


def draw(seed: int) -> tuple[LatticeDesign, str, Splitting, float]:
    """Design, layout, splitting, and step over the predicted critical one."""
    rng = np.random.default_rng(seed)
    while True:
        n_pairs, period_ratio = ((3, 1.5), (4, 2.0), (6, 1.5))[rng.integers(3)]
        values: dict[str, Any] = {
            "n_pairs": n_pairs,
            "period_ratio": period_ratio,
            "elements_per_segment": int(rng.integers(2, 7)),
            "structure_youngs_modulus": 70e3 * _log_uniform(rng, 0.3, 10.0),
            "muscle_youngs_modulus": 25e3 * _log_uniform(rng, 0.3, 10.0),
            "joint_stiffness": 100.0 * _log_uniform(rng, 0.3, 100.0),
            "structure_radius": 5e-3 * _log_uniform(rng, 0.5, 1.5),
            "muscle_radius": 5e-3 * _log_uniform(rng, 0.5, 1.5),
            "damping": 0.03 * _log_uniform(rng, 0.1, 10.0) if rng.random() < 0.8 else 0.0,
            "base": "clamped" if rng.random() < 0.7 else "free",
            "muscle_model": "rod" if rng.random() < 0.7 else "line",
            "max_tension": _log_uniform(rng, 0.1, 10.0),
        }
        layout = LAYOUTS[rng.integers(len(LAYOUTS))]
        splitting: Splitting = get_args(Splitting)[rng.integers(2)]
        share = float(rng.uniform(0.3, 2.0))
        try:
            return LatticeDesign(**values), layout, splitting, share
        except ValueError:  # too thick for its lattice: draw again
            continue


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def tensions(design: LatticeDesign, n_muscle: int, control_dt: float, seed: int) -> list[FloatArray]:
    """Ramps (2, n_muscle) of `N_CONTROL` + 1 control steps of random muscles switched fully on and off [N]."""
    rng = np.random.default_rng((seed, 1))
    activation, ramps = np.zeros(n_muscle), []
    for _ in range(N_CONTROL + 1):
        command = (rng.random(n_muscle) < 0.5).astype(float)
        after = advance_activation(activation, command, control_dt, design.rise_time, design.decay_time)
        ramps.append(design.max_tension * np.stack([activation, after]))
        activation = after
    return ramps


@dataclass(frozen=True)
class Plan:
    """All that a seed settles."""

    seed: int
    design: LatticeDesign
    layout: str
    splitting: Splitting
    share: float
    """Time step over the predicted critical one."""
    model: RodModel
    dt: float
    """[s]"""
    n_substeps: int
    ramps: list[FloatArray]
    """See `tensions`."""


def plan(seed: int) -> Plan:
    """Draw a run and set its time step, so that whole steps make a control step."""
    design, layout, splitting, share = draw(seed)
    lattice: Lattice = build_lattice(design)
    model: RodModel = build_model(lattice, named_layout(layout, lattice))
    stable = critical_dt(model, design.max_tension, splitting)
    n_substeps = min(max(1, math.ceil(CONTROL_DT / (share * stable))), MAX_SUBSTEPS)
    control_dt = min(CONTROL_DT, n_substeps * share * stable)
    dt, ramps = control_dt / n_substeps, tensions(design, model.n_muscle, control_dt, seed)
    return Plan(seed, design, layout, splitting, dt / stable, model, dt, n_substeps, ramps)
