"""Engines by name: one entry each, whose imports cost only once it is chosen."""

from __future__ import annotations

import pkgutil
from collections.abc import Sequence

from lattice_gym.checks import choice
from lattice_gym.engines.base import Engine
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.damping import Splitting

ENGINES: dict[str, str] = {
    "fused": "lattice_gym.engines.fused.engine:FusedEngine",
    "pyelastica": "lattice_gym.engines.pyelastica.engine:PyElasticaEngine",
}
"""Class of every engine, "module:Class": "fused" is compiled, "pyelastica" the reference."""

EngineName = str
"""A key of `ENGINES`."""


def engine_class(name: EngineName) -> type[Engine]:
    """Class of an engine, or a ValueError that names those that there are."""
    made: type[Engine] = pkgutil.resolve_name(ENGINES[choice("engine", name, ENGINES)])
    return made


def make_engine(
    name: EngineName,
    models: Sequence[RodModel],
    dt: float,
    splitting: Splitting = "pyelastica",
    *,
    energy_check: bool = False,
    step_check: bool = False,
    num_threads: int | None = None,
) -> Engine:
    """Make an engine by its name; for the other arguments see `Engine`.

    Raises
    ------
    ValueError
        An unknown name, or an argument that the engine refuses.
    """
    return engine_class(name)(
        models, dt, splitting, energy_check=energy_check, step_check=step_check, num_threads=num_threads
    )
