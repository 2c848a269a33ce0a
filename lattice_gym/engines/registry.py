"""Engines by name: a choice costs its imports only when it is made."""

from __future__ import annotations

from typing import Literal, get_args

from lattice_gym.checks import shown
from lattice_gym.engines.base import Engine
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.damping import Splitting

EngineName = Literal["fused", "pyelastica"]


def check_options(name: EngineName, splitting: Splitting, energy_check: bool, step_check: bool) -> None:
    """Refuse options that no engine has."""
    for argument, value, choices in (("engine", name, EngineName), ("splitting", splitting, Splitting)):
        if not isinstance(value, str) or value not in get_args(choices):
            raise ValueError(f"{argument} = {shown(value)}: must be one of {', '.join(get_args(choices))}")
    for argument, check in (("energy_check", energy_check), ("step_check", step_check)):
        if not isinstance(check, bool):
            raise ValueError(f"{argument} = {shown(check)}: must be True or False")


def make_engine(
    name: EngineName,
    model: RodModel,
    dt: float,
    splitting: Splitting = "pyelastica",
    energy_check: bool = False,
    step_check: bool = False,
) -> Engine:
    """Engine by name. The choice costs its imports only when made; a check costs nothing where it is off.

    The step check takes a second engine along at half the step, and so costs twice the run itself.

    Raises
    ------
    ValueError
        An unknown name or splitting, one that the engine lacks, a check that is not a bool, or dt not positive and
        finite.
    """
    check_options(name, splitting, energy_check, step_check)
    engine = _make_engine(name, model, dt, splitting, energy_check)
    return engine.shadowed(_make_engine(name, model, 0.5 * engine.dt, splitting, False)) if step_check else engine


def _make_engine(name: EngineName, model: RodModel, dt: float, splitting: Splitting, energy_check: bool) -> Engine:
    if name == "fused":
        from lattice_gym.engines.fused.engine import FusedEngine

        return FusedEngine(model, dt, splitting, energy_check)
    if splitting != "pyelastica":
        raise ValueError(f"splitting = {splitting!r}: the pyelastica engine damps as PyElastica does; take fused")
    from lattice_gym.engines.pyelastica.engine import PyElasticaEngine

    return PyElasticaEngine(model, dt, energy_check)
