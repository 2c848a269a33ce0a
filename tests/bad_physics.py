"""Engines, rods, models and worlds."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from functools import cache, partial
from typing import Any

import numpy as np
from hunting import Target, fixed
from hypothesis import strategies as st
from junk import JUNK, NUMBERS, damaged, finite, small_model
from small_worms import N_SMALL

from lattice_gym.engines.simulation import simulate
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.laws.contact import Contact
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.joints import Joint
from lattice_gym.physics.laws.lines import Line
from lattice_gym.physics.laws.loads import PointForce, PointTorque
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.rod import Rod, straight_rod
from lattice_gym.physics.world import World

_ENGINE = {"name": "fused", "dt": 1e-4, "splitting": "pyelastica", "energy_check": False}
_ENGINES = st.fixed_dictionaries({
    "make": damaged(_ENGINE, 0, 1),
    "tension": st.one_of(JUNK, st.lists(NUMBERS, min_size=N_SMALL, max_size=N_SMALL), st.just(np.full(N_SMALL, 0.1))),
    "n_substeps": st.one_of(st.integers(-1, 4), st.integers(1, 3), JUNK.filter(lambda value: not _huge(value))),
    "state": st.one_of(st.just({}), damaged({"position": None, "velocity": None, "directors": None, "omega": None,
                                              "time": 0.0}, 1, 2)),
})  # fmt: skip


def _huge(value: Any) -> bool:
    """Tell whether a value asks, rightly, for more steps than a test can wait for."""
    return isinstance(value, int | float | np.number) and not isinstance(value, complex) and bool(value > 1000)


def make_engines(call: dict[str, Any]) -> None:
    """Check that an engine that is taken advances by the time asked for."""
    engine = simulate(model=small_model(), **call["make"])
    state, junk = small_model().rest_state(), call["state"]
    state = replace(state, **{name: value for name, value in junk.items() if value is not None})
    engine.restore(state)
    before = engine.state.time
    health = engine.advance(call["tension"], call["n_substeps"])
    elapsed = engine.state.time - before
    assert np.isclose(elapsed, call["n_substeps"] * engine.dt) or abs(before) > 1e3, "took another number of steps"
    if health.ok:
        finite(engine.state.position)


_ROD: dict[str, Any] = {"start": (0.0, 0.0, 0.0), "end": (0.0, 0.0, 1.0), "n_elem": 3, "radius": 0.05, "density": 1e3,
        "youngs_modulus": 1e5, "shear_modulus": 3e4, "normal": None, "damping": 0.0,
        "rotational_damping": 0.0}  # fmt: skip


@cache
def good_rod() -> Rod:
    """Make a rod of three elements."""
    return straight_rod(**_ROD)


_ROD_PARTS = {name: getattr(good_rod(), name) for name in (
    "position", "directors", "radius", "density", "youngs_modulus", "shear_modulus", "damping", "rotational_damping"
)}  # fmt: skip


def make_rod(call: tuple[str, dict[str, Any]]) -> None:
    """Check that a rod that is taken has sound constants."""
    kind, arguments = call
    rod = straight_rod(**arguments) if kind == "straight" else Rod(**arguments)
    with np.errstate(all="ignore"):
        constants = [rod.mass, rod.inertia, rod.shear_stiffness, rod.bend_stiffness, rod.rest_kappa]
    finite(rod.rest_length, *constants)


_RODS = st.one_of(
    st.tuples(st.just("straight"), damaged(_ROD, 1, 2)),
    st.tuples(st.just("rod"), damaged(_ROD_PARTS, 1, 2)),
)  # fmt: skip

_INDEX = st.one_of(st.integers(-1, 4), JUNK)
_VECTOR = st.one_of(JUNK, st.tuples(NUMBERS, NUMBERS, NUMBERS))
_PARTS: dict[str, tuple[type, dict[str, st.SearchStrategy[Any]]]] = {
    "joints": (Joint, {"rod_a": st.just(0), "node_a": _INDEX, "rod_b": st.just(1), "node_b": _INDEX,
                       "stiffness": NUMBERS, "damping": NUMBERS}),
    "lines": (Line, {"rod_a": _INDEX, "node_a": st.just(0), "rod_b": st.just(1), "node_b": _INDEX,
                     "rest_length": NUMBERS, "stiffness": NUMBERS, "mass": NUMBERS, "damping": st.just(0.0),
                     "density": NUMBERS}),
    "clamps": (Clamp, {"rod": _INDEX, "node": _INDEX, "element": _INDEX}),
    "forces": (PointForce, {"rod": _INDEX, "node": _INDEX, "force": _VECTOR}),
    "torques": (PointTorque, {"rod": _INDEX, "element": _INDEX, "torque": _VECTOR}),
    "muscles": (tuple, {}),
}  # fmt: skip
_AROUND: dict[str, st.SearchStrategy[Any]] = {
    "gravity": _VECTOR, "medium_density": NUMBERS, "medium_drag": NUMBERS,
    "ground": st.one_of(JUNK, st.builds(Ground, stiffness=st.floats(1e-6, 1e9), damping=st.floats(0.0, 1e6))),
}  # fmt: skip


def _part(name: str) -> st.SearchStrategy[tuple[str, Any]]:
    if name in _AROUND:
        return st.tuples(st.just(name), _AROUND[name])
    kind, values = _PARTS[name]
    made = st.fixed_dictionaries(values).map(lambda drawn: partial(kind, **drawn))  # made where refusals are counted
    whole = made if values else st.one_of(st.integers(-1, 3), JUNK)
    return st.tuples(st.just(name), st.one_of(st.lists(st.one_of(whole, whole, whole, JUNK), max_size=2), JUNK))


def _made(part: Any) -> Any:
    return part() if isinstance(part, partial) else part


def make_model(call: list[tuple[str, Any]]) -> None:
    """Check that a model that is taken can be stepped, whatever comes of it."""
    rods = good_rod(), straight_rod(**{**_ROD, "start": (1, 0, 0), "end": (1, 0, 1)})
    parts: dict[str, Any] = {
        name: [_made(part) for part in given] if isinstance(given, list) else given for name, given in call
    }
    model = RodModel(rods=rods, **parts)
    engine = simulate("fused", model, 1e-9)
    with np.errstate(all="ignore"):
        engine.advance(np.zeros(model.n_muscle), 1)
    assert engine.state.position.shape == (model.n_node, 3)


_MODELS = st.lists(
    st.sampled_from(sorted({*_PARTS, *_AROUND})).flatmap(_part), min_size=1, max_size=2, unique_by=lambda part: part[0]
)

_AROUND_PARTS: dict[str, type[Medium | Ground | Ball | Contact]] = {
    "medium": Medium,
    "ground": Ground,
    "ball": Ball,
    "contact": Contact,
}
_FULL_WORLD: dict[str, Any] = {**{name: asdict(part()) for name, part in _AROUND_PARTS.items()}, "lying": True}


def make_world(call: dict[str, Any]) -> None:
    """Check that a world that is taken comes back from its dict form, and from JSON."""
    world = World.from_dict(call)
    assert World.from_dict(json.loads(json.dumps(world.to_dict()))) == world


def _damaged_world(name: str) -> st.SearchStrategy[dict[str, Any]]:
    if name == "lying":
        return damaged(_FULL_WORLD, 1, 2)
    return damaged(_FULL_WORLD[name], 1, 2).map(lambda part: {**_FULL_WORLD, name: part})


_WORLDS = st.sampled_from(sorted(_FULL_WORLD)).flatmap(_damaged_world)

TARGETS = [
    Target(
        "engines",
        _ENGINES,
        make_engines,
        fixed("engine", "dt", "splitting", "energy_check", "tension", "n_substeps", "RodState"),
    ),
    Target("Rod and straight_rod", _RODS, make_rod, lambda call: (*_ROD, *_ROD_PARTS)),
    Target("RodModel", _MODELS, make_model, lambda call: tuple(name.rstrip("s") for name, _ in call)),
    Target(
        "World",
        _WORLDS,
        make_world,
        lambda call: (*_FULL_WORLD, *(field for part in _AROUND_PARTS.values() for field in part().to_dict())),
    ),
]
