"""The benchmark scene: the paper's extension motion, default design, `extension` layout, 0.5 N in every muscle."""

from __future__ import annotations

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.engines.registry import EngineName
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.worm import build_model

ENGINES: tuple[EngineName, EngineName] = ("fused", "pyelastica")
BENCHMARK_DT, CONTROL_DT = 1e-4, 0.05
"""Time step of the benchmark scene, and control step of the environments [s]."""
TENSION = 0.5
"""In every muscle of the benchmark scene [N]."""


def benchmark_model() -> RodModel:
    """Model of the benchmark scene."""
    lattice = build_lattice(LatticeDesign())
    return build_model(lattice, named_layout("extension", lattice))
