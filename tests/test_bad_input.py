"""Whole calls with random and hostile arguments: each works, or one ValueError names what is wrong.

`python -m tests.test_bad_input --count 10000` makes that many generated calls and prints how many escaped: raised
anything else, named nothing, warned, hung, or worked and returned what is not finite or not what was asked for. As a
test a few hundred calls are made on every target.
"""

from __future__ import annotations

import argparse
import dataclasses
import io
import json
import signal
import sys
import tempfile
import traceback
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass, fields, replace
from decimal import Decimal
from fractions import Fraction
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as seeded
from hypothesis import strategies as st

from lattice_gym.benchmarks.__main__ import parse as parse_report
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
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
from lattice_gym.checks import Parameters
from lattice_gym.engines.simulation import simulate
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.laws.activation import advance_activation
from lattice_gym.physics.laws.adaptation import Adaptation
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.laws.contact import Contact
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.laws.joints import Joint
from lattice_gym.physics.laws.lines import Line
from lattice_gym.physics.laws.loads import PointForce, PointTorque
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.measures import travelling_wave
from lattice_gym.physics.rod import Rod, straight_rod
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model
from lattice_gym.recording.trajectory import Recorder, Trajectory
from lattice_gym.tasks.registry import TASKS, gait

HANG = 30.0
"""A call that takes longer hangs [s]."""
IN_TESTS = 250
"""Calls on each target in the tests."""
SMALL: dict[str, Any] = {"n_pairs": 3, "period_ratio": 1.5, "elements_per_segment": 2}
N_SMALL = 21
"""Muscles of its layout "all"."""
WAVE = {"wavelength": 0.1, "speed": 0.1}

Call = Any


@dataclass(frozen=True)
class Target:
    """What is called, with what, and the names one of which a refusal must hold."""

    name: str
    calls: st.SearchStrategy[Call]
    make: Callable[[Call], object]
    """Makes the call and checks what it returns; AssertionError where that is wrong."""
    names: Callable[[Call], tuple[str, ...]]


class Hang(BaseException):
    """What a call that takes too long is stopped with."""


@contextmanager
def bounded(seconds: float) -> Iterator[None]:
    """Raise `Hang` where the body takes longer."""

    def give_up(*_: object) -> None:
        raise Hang

    old = signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, old)


def escape(target: Target, call: Call) -> str | None:
    """Say what is wrong with how a call ended, if anything is."""
    try:
        with warnings.catch_warnings(), bounded(HANG):
            warnings.simplefilter("error")
            target.make(call)
    except ValueError as error:
        message = str(error)
        if not any(name.lower() in message.lower() for name in target.names(call)):
            return f"the message names nothing: {message[:300]!r}"
    except Hang:
        return f"no answer within {HANG:g} s"
    except (Exception, SystemExit) as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {str(error)[:200]} ({Path(at.filename).name}:{at.lineno})"
    return None


def hunt(target: Target, count: int, seed: int) -> tuple[int, dict[str, Call]]:
    """Make `count` generated calls; how many there were, and an example of every kind of escape."""
    made, escapes = 0, dict[str, Call]()

    @seeded(seed)
    @settings(max_examples=count, deadline=None, phases=[Phase.generate], database=None,
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(target.calls)
    def run(call: Call) -> None:
        nonlocal made
        made += 1
        if (problem := escape(target, call)) is not None:
            escapes.setdefault(problem, call)

    run()
    return made, escapes


# What hostile callers send

_NUMBERS = st.one_of(
    st.sampled_from([0, 1, 2, 3, 5, -1, 0.0, -0.0, 0.5, 1.5, 1e-9, -1e-9, 1e-320, 1e308, -1e308, 2**31, 2**63, 10**400,
                     float("nan"), float("inf"), -float("inf"), True, False]),
    st.integers(-3, 40), st.floats(), st.floats(1e-6, 10.0),
    st.sampled_from([np.float32(0.1), np.float64("nan"), np.int8(-1), np.int64(3), np.uint8(200), np.bool_(True),
                     np.float16(2.0), np.array(1.5), Fraction(1, 3), Fraction(3, 2), Decimal("0.1"), 1j]),
)  # fmt: skip
_ARRAYS = st.builds(
    lambda shape, dtype, fill: np.full(shape, fill).astype(dtype),
    st.lists(st.integers(0, 4), max_size=3).map(tuple),
    st.sampled_from([np.float64, np.float32, np.int64, np.bool_, np.complex128, np.object_]),
    st.sampled_from([0.0, 1.0, -1.0, 0.5]),
)
_ODD = st.sampled_from([None, "", "all", "nan", "1", b"1", object(), print, range(3), {1, 2}, ..., type, np.float64])
JUNK: st.SearchStrategy[Any] = st.one_of(
    _NUMBERS, st.text(max_size=6), _ODD, _ARRAYS, st.lists(_NUMBERS, max_size=4),
    st.dictionaries(st.text(max_size=4), _NUMBERS, max_size=2), st.tuples(_NUMBERS, _NUMBERS),
)  # fmt: skip


def damaged(good: Mapping[str, Any], least: int = 1, most: int = 3) -> st.SearchStrategy[dict[str, Any]]:
    """Draw good arguments of which some are replaced by junk."""
    names = st.lists(st.sampled_from(sorted(good)), min_size=least, max_size=most, unique=True)

    def some(chosen: list[str]) -> st.SearchStrategy[dict[str, Any]]:
        return st.fixed_dictionaries(dict.fromkeys(chosen, JUNK))

    return names.flatmap(some).map(lambda junk: {**good, **junk})


def finite(*arrays: Any) -> None:
    """Refuse what is not finite."""
    for array in arrays:
        assert np.isfinite(array).all(), "not finite"


@cache
def small() -> Lattice:
    """Build a lattice of three sites on each of five levels."""
    return build_lattice(LatticeDesign(**SMALL))


@cache
def small_env() -> LatticeWormEnv:
    """Make an environment that is stepped but never damaged."""
    return LatticeWormEnv(design=SMALL, command=WAVE)


@cache
def small_model() -> RodModel:
    """Build the model of the small lattice."""
    return build_model(small(), named_layout("all", small()))


# Designs

FIELDS = {spec.name: spec for spec in fields(LatticeDesign)}


def _in_bounds(name: str) -> st.SearchStrategy[Any]:
    bounds = FIELDS[name].metadata
    if "low" not in bounds:
        return JUNK
    low, high = bounds["low"], bounds["high"]
    if "unit" not in bounds:
        return st.integers(low, min(high, 40))
    return st.one_of(st.floats(low, high), st.sampled_from([low, high, np.nextafter(low, -1), np.nextafter(high, 1e9)]))


_DESIGNS = st.lists(st.sampled_from(sorted(FIELDS)), min_size=1, max_size=5, unique=True).flatmap(
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


_JSON = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5)),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=5), inner, max_size=3)),
    max_leaves=6,
)
_DESIGN_JSON = st.one_of(
    JUNK,
    _JSON.map(json.dumps),
    st.dictionaries(st.sampled_from([*FIELDS, "colour"]), _JSON, max_size=3),
    st.dictionaries(st.sampled_from([*FIELDS, "colour"]), _JSON, max_size=3).map(json.dumps),
    st.tuples(st.just(LatticeDesign().to_json()), st.integers(0, 900)).map(lambda both: both[0][: both[1]]),
)

# Muscles

_MUSCLE = st.one_of(
    damaged({"orientation": "custom", "start": 0, "end": 4}),
    st.fixed_dictionaries({
        "orientation": st.sampled_from(["custom", "horizontal", "vertical"]),
        "start": st.integers(-1, 16), "end": st.integers(-1, 16), "on": st.booleans(),
    }),
    JUNK,
)  # fmt: skip
_LAYOUTS = st.one_of(
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

# Environments


def _parts_of(kind: type[Parameters]) -> st.SearchStrategy[dict[str, Any]]:
    """Draw some fields of parameters: in bounds, or junk."""

    def value(bounds: Mapping[str, Any]) -> st.SearchStrategy[Any]:
        within = st.floats(bounds.get("low", 0.0), bounds.get("high", 1.0))
        return st.one_of(within, st.booleans(), st.sampled_from(["episode", "continuous"]), JUNK)

    return st.fixed_dictionaries({}, optional={spec.name: value(spec.metadata) for spec in fields(kind)})


_ENV: dict[str, Any] = {
    "task": "bending", "design": SMALL, "muscles": None, "control": "muscle", "rhythm": None, "engine": "fused",
    "dt": None, "allow_large_dt": False, "control_dt": 0.05, "observation": None, "command": None,
    "render_mode": None, "energy_check": False, "world": None, "adaptation": None, "hill": None,
}  # fmt: skip
_ENV_VALUES: dict[str, st.SearchStrategy[Any]] = {
    "task": st.sampled_from([*TASKS, "Bending"]),
    "design": _DESIGNS.map(lambda design: {**design, **SMALL}),
    "muscles": st.one_of(_LAYOUTS, st.sampled_from(["all", "extension", "strong"])),
    "control": st.one_of(st.sampled_from(["ring", "column"]), st.lists(st.integers(-1, 4), max_size=22)),
    "dt": st.one_of(st.floats(1e-7, 0.1), st.integers(1, 2000).map(lambda n: 0.05 / n)),
    "control_dt": st.floats(1e-7, 1.0),
    "rhythm": st.floats(0.0, 20.0),
    "command": st.dictionaries(
        st.sampled_from(["azimuth", "speed", "wavelength", "phase", "radius"]),
        st.one_of(_NUMBERS, st.lists(st.floats(-1.0, 1.0), max_size=3)),
        max_size=3,
    ),
    "world": st.fixed_dictionaries(
        {},
        optional={
            "medium": st.one_of(JUNK, st.fixed_dictionaries({}, optional={"drag": _NUMBERS, "density": _NUMBERS})),
            "ground": st.one_of(JUNK, st.fixed_dictionaries({}, optional={"stiffness": _NUMBERS, "wet": JUNK})),
            "lying": st.one_of(JUNK, st.booleans()),
        },
    ),
    "adaptation": _parts_of(Adaptation),
    "hill": _parts_of(Hill),
}
_ENVS = st.lists(st.sampled_from(sorted(_ENV)), min_size=1, max_size=4, unique=True).flatmap(
    lambda names: st.fixed_dictionaries({name: st.one_of(JUNK, _ENV_VALUES.get(name, JUNK)) for name in names})
).map(lambda junk: {**_ENV, **junk})  # fmt: skip


def make_env(call: dict[str, Any]) -> None:
    """Check that an environment that is taken gives sound observations and rewards."""
    env = LatticeWormEnv(**call)
    if env.n_substeps > 20_000:
        return
    assert env.reset(seed=0)[0] in env.observation_space, "observation out of its space"
    observation, reward, *_, info = env.step(np.full(env.action_space.shape, 0.5))
    assert observation in env.observation_space, "observation out of its space"
    finite(reward, env.state.position, env.state.velocity)
    assert reward == sum(info["reward_terms"].values()), "reward terms do not sum"


_LIVING = st.sampled_from([Adaptation, Hill]).flatmap(lambda kind: st.tuples(st.just(kind), _parts_of(kind)))


def make_living(call: tuple[type[Parameters], dict[str, Any]]) -> None:
    """Check that what is taken comes back the same from its dict form."""
    kind, values = call
    made = kind(**values)
    assert kind.from_dict(json.loads(json.dumps(dataclasses.asdict(made)))) == made, "dict form differs"


_USE: dict[str, Any] = {
    "activation": np.full(3, 0.5), "tension": np.full(3, 2.0), "strain": np.full(3, -0.1), "duration": 0.05
}  # fmt: skip
_USES = damaged(_USE)


def make_use(call: dict[str, Any]) -> None:
    """Check that strength stays finite and in bounds, whatever the use."""
    for mode in ("continuous", "episode"):
        adaptation = Adaptation(strain_gain=1e6, force_gain=1e6, fatigue_rate=1.0, mode=mode, carry=True)
        strength = adaptation.at_reset(adaptation.advance(adaptation.initial(3), **call)).factor
        assert ((strength >= 0.0) & (strength <= adaptation.max_strength)).all(), "out of bounds"


_ACTIONS = st.one_of(
    JUNK,
    st.lists(_NUMBERS, min_size=N_SMALL, max_size=N_SMALL),
    st.lists(st.floats(-2.0, 2.0), min_size=N_SMALL - 1, max_size=N_SMALL + 1),
    st.builds(
        lambda shape, dtype, fill: np.full(shape, fill).astype(dtype),
        st.sampled_from([(N_SMALL,), (1, N_SMALL), (N_SMALL, 1), (N_SMALL + 1,), (), (0,)]),
        st.sampled_from(["f2", "f4", "f8", "g", "i1", "u8", "?", "c16", "O", "S4", "U4", "M8[s]"]),
        st.sampled_from([0, 1]),
    ),
    st.lists(_NUMBERS, min_size=N_SMALL, max_size=N_SMALL).map(lambda v: np.array(v, dtype=object)),
    st.builds(lambda at, value: np.where(np.arange(N_SMALL) == at, value, 0.5), st.integers(0, 20),
              st.sampled_from([np.nan, np.inf, -np.inf, 1e308, -1e-320])),
    st.just(np.ma.masked_array(np.full(N_SMALL, 0.5), mask=np.arange(N_SMALL) < 3)),
)  # fmt: skip


def make_action(action: Any) -> None:
    """Check that an action is clipped and counted, or refused and leaves the state alone."""
    env = small_env()
    env.reset(seed=0)
    before = env.state
    try:
        observation, reward, terminated, _, info = env.step(action)
    except ValueError:
        assert np.array_equal(env.state.position, before.position), "a refused action moved the worm"
        assert env.time == 0.0, "a refused action took time"
        raise
    given = np.asarray(action, dtype=np.float64)
    outside = np.count_nonzero((given < 0.0) | (given > 1.0))
    assert info["clipped_actions"] == outside, "clipped without being counted"
    assert observation in env.observation_space, "observation out of its space"
    finite(reward)
    assert not terminated, "terminated"
    expected = advance_activation(np.zeros(N_SMALL), np.clip(given, 0.0, 1.0), 0.05, 0.015, 0.05)
    assert np.allclose(env.activation, expected), "another action was taken"


_RESETS = st.fixed_dictionaries({
    "seed": st.one_of(st.none(), st.integers(0, 5), JUNK),
    "options": st.one_of(
        st.none(), JUNK,
        st.dictionaries(st.sampled_from(["speed", "wavelength", "amplitude", "phase", "azimuth"]), JUNK, max_size=3),
        st.dictionaries(st.sampled_from(["speed", "wavelength", "amplitude", "phase"]), st.floats(-2.0, 2.0)),
    ),
})  # fmt: skip


def make_reset(call: dict[str, Any]) -> None:
    """Check that a reset that is taken commands what was asked."""
    env = small_env()
    observation, info = env.reset(**call)
    assert observation in env.observation_space, "observation out of its space"
    for name, value in (call["options"] or {}).items():
        assert info["command"][name] == value, "another command was taken"


# Engines and models

_ENGINE = {"name": "fused", "dt": 1e-4, "splitting": "pyelastica", "energy_check": False}
_ENGINES = st.fixed_dictionaries({
    "make": damaged(_ENGINE, 0, 1),
    "tension": st.one_of(JUNK, st.lists(_NUMBERS, min_size=N_SMALL, max_size=N_SMALL), st.just(np.full(N_SMALL, 0.1))),
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
_VECTOR = st.one_of(JUNK, st.tuples(_NUMBERS, _NUMBERS, _NUMBERS))
_PARTS: dict[str, tuple[type, dict[str, st.SearchStrategy[Any]]]] = {
    "joints": (Joint, {"rod_a": st.just(0), "node_a": _INDEX, "rod_b": st.just(1), "node_b": _INDEX,
                       "stiffness": _NUMBERS, "damping": _NUMBERS}),
    "lines": (Line, {"rod_a": _INDEX, "node_a": st.just(0), "rod_b": st.just(1), "node_b": _INDEX,
                     "rest_length": _NUMBERS, "stiffness": _NUMBERS, "mass": _NUMBERS, "damping": st.just(0.0),
                     "density": _NUMBERS}),
    "clamps": (Clamp, {"rod": _INDEX, "node": _INDEX, "element": _INDEX}),
    "forces": (PointForce, {"rod": _INDEX, "node": _INDEX, "force": _VECTOR}),
    "torques": (PointTorque, {"rod": _INDEX, "element": _INDEX, "torque": _VECTOR}),
    "muscles": (tuple, {}),
}  # fmt: skip
_AROUND: dict[str, st.SearchStrategy[Any]] = {
    "gravity": _VECTOR, "medium_density": _NUMBERS, "medium_drag": _NUMBERS,
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

# Worlds

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


# Trajectories


@cache
def good_trajectory() -> Trajectory:
    """Record three frames of the small worm."""
    layout = named_layout("all", small())
    recorder = Recorder(small().design, layout, "bending")
    for frame in range(3):
        recorder.append(0.1 * frame, small_model().rest_state().position, np.full(N_SMALL, 0.5), 1.0, "line")
    return recorder.build()


_FRAMES = {"time": 0.0, "position": small_model().rest_state().position, "activation": np.zeros(N_SMALL),
           "reward": 0.0, "outcome": "", "ball": None}  # fmt: skip
_TRAJECTORY = {name: getattr(good_trajectory(), name) for name in (
    "time", "position", "activation", "reward", "outcome", "design", "layout", "task", "world", "ball"
)}  # fmt: skip


def make_trajectory(call: tuple[str, dict[str, Any]]) -> None:
    """Check that a trajectory that is taken is finite."""
    kind, arguments = call
    if kind == "frame":
        recorder = Recorder(small().design, good_trajectory().layout, "bending")
        recorder.append(**arguments)
        trajectory = recorder.build()
    else:
        trajectory = Trajectory(**arguments)
    finite(trajectory.time, trajectory.position, trajectory.activation, trajectory.reward)


_TRAJECTORIES = st.one_of(
    st.tuples(st.just("frame"), damaged(_FRAMES, 1, 2)), st.tuples(st.just("whole"), damaged(_TRAJECTORY, 1, 2))
)


@cache
def _saved() -> dict[str, bytes]:
    """Return the members of a saved trajectory."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "good.npz"
        good_trajectory().save(path)
        with zipfile.ZipFile(path) as archive:
            return {name: archive.read(name) for name in archive.namelist()}


def _member(value: Any) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array(file, np.asarray(value), allow_pickle=True)
    return file.getvalue()


_META = ("format", "version", "task", "outcome", "design", "layout", "world")
_FILES = st.one_of(
    st.dictionaries(
        st.sampled_from([*_saved(), "other.npy", "time"]),
        st.one_of(st.none(), st.binary(max_size=80), _ARRAYS.map(_member), _NUMBERS.map(_member)),
        min_size=1, max_size=2,
    ),
    st.dictionaries(st.sampled_from([*_META, "more"]), _JSON, min_size=1, max_size=2).map(
        lambda changes: {"meta.npy": _member(json.dumps({**_meta(), **changes}))}
    ),
    st.tuples(st.sampled_from(sorted(_saved())), st.integers(0, 200), st.integers(0, 255)).map(
        lambda hit: {hit[0]: _hit(_saved()[hit[0]], hit[1], hit[2])}
    ),
)  # fmt: skip


def _meta() -> dict[str, Any]:
    array = np.lib.format.read_array(io.BytesIO(_saved()["meta.npy"]))
    return dict(json.loads(array.item()))


def _hit(content: bytes, place: int, value: int) -> bytes:
    hit = bytearray(content)
    hit[place % len(hit)] = value
    return bytes(hit)


def make_trajectory_file(call: dict[str, bytes | None]) -> None:
    """Load a sound zip file with damaged members; what loads is finite."""
    members = {name: data for name, data in {**_saved(), **call}.items() if data is not None}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "damaged.npz"
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in members.items():
                archive.writestr(name, data)
        trajectory = Trajectory.load(path)
    finite(trajectory.time, trajectory.position, trajectory.activation, trajectory.reward)


# Command lines

_WORDS = st.lists(
    st.one_of(
        st.sampled_from(["paper", "engines", "divergence", "--engine", "--tension", "fused", "warp", "--no-pictures",
                         "--quick", "--out", "0.5", "-1", "nan", "inf", "", "--", "--help"]),
        st.text(max_size=4),
    ),
    max_size=4,
)  # fmt: skip


def make_options(words: list[str]) -> None:
    """Check that options are read, or refused with a line that says why; nothing runs."""
    said = io.StringIO()
    try:
        with redirect_stderr(said), redirect_stdout(io.StringIO()):
            options = parse_report(words).report
    except SystemExit as leaving:
        if leaving.code == 2:
            raise ValueError(said.getvalue()) from None
        if leaving.code != 0:
            raise
        return
    for value in getattr(options, "tension", []):
        assert np.isfinite(value), "not finite"


def _fixed(*names: str) -> Callable[[Call], tuple[str, ...]]:
    return lambda call: names


TARGETS = [
    Target("LatticeDesign", _DESIGNS, make_design, _fixed(*FIELDS)),
    Target("LatticeDesign.from_dict and from_json", _DESIGN_JSON, make_design_json, _fixed("LatticeDesign")),
    Target("resolve_layout", _LAYOUTS, make_layout, _fixed("muscle", "orientation")),
    Target(
        "functions of muscles, gaits and measures",
        _MUSCLE_FUNCTIONS,
        lambda call: _MUSCLE_CALLS[call[0]][0](**call[1]),
        lambda call: _MUSCLE_CALLS[call[0]][2],
    ),
    Target("LatticeWormEnv", _ENVS, make_env, lambda call: (*_ENV, *FIELDS, "LatticeDesign")),
    Target("Adaptation and Hill", _LIVING, make_living, lambda call: (call[0].__name__,)),
    Target("Adaptation.advance", _USES, make_use, lambda call: (*call,)),
    Target("step", _ACTIONS, make_action, _fixed("action")),
    Target("reset", _RESETS, make_reset, _fixed("seed", "options")),
    Target(
        "engines",
        _ENGINES,
        make_engines,
        _fixed("engine", "dt", "splitting", "energy_check", "tension", "n_substeps", "RodState"),
    ),
    Target("Rod and straight_rod", _RODS, make_rod, lambda call: (*_ROD, *_ROD_PARTS)),
    Target("RodModel", _MODELS, make_model, lambda call: tuple(name.rstrip("s") for name, _ in call)),
    Target(
        "World",
        _WORLDS,
        make_world,
        lambda call: (*_FULL_WORLD, *(field for part in _AROUND_PARTS.values() for field in part().to_dict())),
    ),
    Target("Trajectory and Recorder", _TRAJECTORIES, make_trajectory, lambda call: (*call[1],)),
    Target("Trajectory.load", _FILES, make_trajectory_file, _fixed("damaged.npz")),
    Target("options of the reports", _WORDS, make_options, _fixed("--help")),
]


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_nothing_escapes(target: Target) -> None:
    """A few hundred calls on each target."""
    _, escapes = hunt(target, IN_TESTS, seed=0)
    assert escapes == {}


def test_escapes_are_seen() -> None:
    """Every kind of escape is one, or the test above would show nothing."""

    def call(what: str) -> object:
        if what == "fine":
            return None
        if what == "named":
            raise ValueError("size = -1: must be positive")
        if what == "unnamed":
            raise ValueError("bad")
        if what == "warned":
            return np.sqrt(np.array(-1.0))
        if what == "crashed":
            raise KeyError(what)
        finite(np.nan)
        return None

    kinds = ["fine", "named", "unnamed", "warned", "crashed", "wrong"]
    target = Target("target", st.sampled_from(kinds), call, _fixed("size"))
    _, escapes = hunt(target, 200, seed=0)
    assert set(escapes.values()) == set(kinds[2:])


def main() -> int:
    """Hunt over all targets; exit status 1 where anything escaped."""
    options = argparse.ArgumentParser(description="Call everything with generated input and count what escapes.")
    options.add_argument("--count", type=int, default=10_000, help="calls in all (default: 10000)")
    options.add_argument("--seed", type=int, default=0, help="of the generator (default: 0)")
    options.add_argument("--only", default="", help="part of the names of the targets to call")
    given_ = options.parse_args()
    chosen = [target for target in TARGETS if given_.only in target.name]
    total, kinds = 0, 0
    for target in chosen:
        made, escapes = hunt(target, -(-given_.count // len(chosen)), given_.seed)
        total, kinds = total + made, kinds + len(escapes)
        sys.stdout.write(f"{target.name}: {made} inputs, {len(escapes)} escapes\n")
        for problem, call in escapes.items():
            sys.stdout.write(f"  {problem}\n    {str(call)[:400]}\n")
        sys.stdout.flush()
    sys.stdout.write(f"{total} generated inputs, {kinds} kinds of escape\n")
    return 1 if kinds else 0


if __name__ == "__main__":
    sys.exit(main())
