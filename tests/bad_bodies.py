"""Designs, layouts and functions of muscles."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from dataclasses import fields
from fractions import Fraction
from typing import Any

import numpy as np
from hunting import Target, fixed
from hypothesis import strategies as st
from junk import JUNK, damaged, finite, small
from small_worms import SMALL

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import (
    Muscle,
    MuscleLayout,
    bending_layout,
    control_groups,
    horizontal,
    named_layout,
    resolve_layout,
    tie,
    vertical,
)
from lattice_gym.physics.laws.activation import advance_activation
from lattice_gym.physics.measures import travelling_wave
from lattice_gym.physics.worm import build_model
from lattice_gym.tasks.registry import gait

FIELDS = {spec.name: spec for spec in fields(LatticeDesign)}


def _in_bounds(name: str) -> st.SearchStrategy[Any]:
    bounds = FIELDS[name].metadata
    if "low" not in bounds:
        return JUNK
    low, high = bounds["low"], bounds["high"]
    if "unit" not in bounds:
        return st.integers(low, min(high, 40))
    return st.one_of(st.floats(low, high), st.sampled_from([low, high, np.nextafter(low, -1), np.nextafter(high, 1e9)]))


DESIGNS = st.lists(st.sampled_from(sorted(FIELDS)), min_size=1, max_size=5, unique=True).flatmap(
    lambda names: st.fixed_dictionaries({name: st.one_of(JUNK, _in_bounds(name)) for name in names})
).map(lambda junk: {**SMALL, **junk})  # fmt: skip


def make_design(call: dict[str, Any]) -> None:
    """Check that a design that is taken holds the numbers given, survives JSON and builds a lattice."""
    design = LatticeDesign(**call)
    for name, value in call.items():
        held, value = getattr(design, name), float(value) if isinstance(value, Fraction) else value
        assert held is None if value is None else np.all(np.asarray(held) == np.asarray(value)), f"{name} was changed"
    assert LatticeDesign.from_json(design.to_json()) == design, "JSON changed it"
    if design.n_rod * design.n_segment * design.elements_per_segment < 5000:
        lattice = build_lattice(design)
        finite(lattice.position, lattice.directors, lattice.site_position)
        model = build_model(lattice, MuscleLayout())
        finite(model.rest_state().position, model.node_mass)


def make_design_json(call: Any) -> None:
    """Read text or a mapping of anything."""
    design = LatticeDesign.from_json(call) if isinstance(call, str) else LatticeDesign.from_dict(call)
    assert isinstance(design, LatticeDesign)


JSON = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5)),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=5), inner, max_size=3)),
    max_leaves=6,
)
_DESIGN_JSON = st.one_of(
    JUNK,
    JSON.map(json.dumps),
    st.dictionaries(st.sampled_from([*FIELDS, "colour"]), JSON, max_size=3),
    st.dictionaries(st.sampled_from([*FIELDS, "colour"]), JSON, max_size=3).map(json.dumps),
    st.tuples(st.just(LatticeDesign().to_json()), st.integers(0, 900)).map(lambda both: both[0][: both[1]]),
)

_MUSCLE = st.one_of(
    damaged({"orientation": "custom", "start": 0, "end": 4}),
    st.fixed_dictionaries({
        "orientation": st.sampled_from(["custom", "horizontal", "vertical"]),
        "start": st.integers(-1, 16), "end": st.integers(-1, 16), "on": st.booleans(),
    }),
    JUNK,
)  # fmt: skip
LAYOUTS = st.one_of(
    JUNK, st.fixed_dictionaries({"muscles": st.one_of(JUNK, st.lists(_MUSCLE, max_size=4))}),
    st.builds(lambda entries: {"muscles": entries, "name": 1}, st.lists(_MUSCLE, max_size=2)),
)  # fmt: skip


def make_layout(call: Any) -> None:
    """Check that a layout that is taken survives JSON and builds a model."""
    layout = resolve_layout(call, small())
    assert MuscleLayout.from_dict(json.loads(json.dumps(layout.to_dict()))) == layout, "JSON changed it"
    assert build_model(small(), layout).n_muscle == len(layout)


_MUSCLE_CALLS: dict[str, tuple[Callable[..., object], dict[str, Any], tuple[str, ...]]] = {
    "horizontal": (lambda **k: horizontal(small(), **k), {"levels": [1]}, ("levels",)),
    "vertical": (lambda **k: vertical(small(), **k), {"span": 2}, ("span",)),
    "tie": (lambda **k: tie(small(), **k), {"pairs": [(0, 4)]}, ("pairs", "muscle")),
    "bending": (lambda **k: bending_layout(small(), **k), {"azimuth": 0.0}, ("azimuth",)),
    "muscle": (
        Muscle,
        {"orientation": "custom", "start": 0, "end": 1, "on": True},
        ("orientation", "start", "end", "on"),
    ),
    "layout": (MuscleLayout, {"muscles": ()}, ("muscles",)),
    "named": (lambda **k: named_layout(lattice=small(), **k), {"name": "all"}, ("muscles",)),
    "select": (
        lambda **k: horizontal(small()).select(small(), **k),
        {"orientation": None, "levels": None, "azimuth": None},
        ("orientation", "levels", "azimuth"),
    ),
    "switched": (lambda **k: horizontal(small()).switched(**k), {"mask": [True] * 12}, ("mask",)),
    "groups": (
        lambda **k: control_groups(layout=horizontal(small()), lattice=small(), **k),
        {"control": "ring"},
        ("control",),
    ),
    "activation": (
        lambda **k: finite(advance_activation(**k)),
        {"activation": np.zeros(3), "command": np.ones(3), "duration": 0.1, "rise_time": 0.1, "decay_time": 0.1},
        ("activation", "command", "duration", "rise_time", "decay_time"),
    ),
    "gait": (
        lambda **k: finite(gait(lattice=small(), layout=named_layout("all", small()), **k)(0.3)),
        {"task": "bending", "command": {"azimuth": 0.0}},
        ("task", "command", "azimuth", "gait"),
    ),
    "wave": (
        lambda **k: finite(dataclasses.astuple(travelling_wave(**k))),
        {"radii": np.ones((8, 3)), "dt": 0.1, "level_height": [0.1, 0.2, 0.3]},
        ("radii", "dt", "level_height"),
    ),
}  # fmt: skip
_MUSCLE_FUNCTIONS = st.sampled_from(sorted(_MUSCLE_CALLS)).flatmap(
    lambda name: st.tuples(st.just(name), damaged(_MUSCLE_CALLS[name][1], 1, 2))
)

TARGETS = [
    Target("LatticeDesign", DESIGNS, make_design, fixed(*FIELDS)),
    Target("LatticeDesign.from_dict and from_json", _DESIGN_JSON, make_design_json, fixed("LatticeDesign")),
    Target("resolve_layout", LAYOUTS, make_layout, fixed("muscle", "orientation")),
    Target(
        "functions of muscles, gaits and measures",
        _MUSCLE_FUNCTIONS,
        lambda call: _MUSCLE_CALLS[call[0]][0](**call[1]),
        lambda call: _MUSCLE_CALLS[call[0]][2],
    ),
]
