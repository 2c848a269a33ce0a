"""Environments, their steps and resets, and laws of living muscles."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from bad_bodies import DESIGNS, FIELDS, LAYOUTS
from hunting import Target, fixed
from hypothesis import strategies as st
from junk import JUNK, NUMBERS, damaged, finite, small_env
from small_worms import N_SMALL, SMALL

from lattice_gym.checks import Parameters
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.physics.laws.activation import advance_activation
from lattice_gym.physics.laws.adaptation import Adaptation
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.tasks.registry import TASKS


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
    "design": DESIGNS.map(lambda design: {**design, **SMALL}),
    "muscles": st.one_of(LAYOUTS, st.sampled_from(["all", "extension", "strong"])),
    "control": st.one_of(st.sampled_from(["ring", "column"]), st.lists(st.integers(-1, 4), max_size=22)),
    "dt": st.one_of(st.floats(1e-7, 0.1), st.integers(1, 2000).map(lambda n: 0.05 / n)),
    "control_dt": st.floats(1e-7, 1.0),
    "rhythm": st.floats(0.0, 20.0),
    "command": st.dictionaries(
        st.sampled_from(["azimuth", "speed", "wavelength", "phase", "radius"]),
        st.one_of(NUMBERS, st.lists(st.floats(-1.0, 1.0), max_size=3)),
        max_size=3,
    ),
    "world": st.fixed_dictionaries(
        {},
        optional={
            "medium": st.one_of(JUNK, st.fixed_dictionaries({}, optional={"drag": NUMBERS, "density": NUMBERS})),
            "ground": st.one_of(JUNK, st.fixed_dictionaries({}, optional={"stiffness": NUMBERS, "wet": JUNK})),
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
    st.lists(NUMBERS, min_size=N_SMALL, max_size=N_SMALL),
    st.lists(st.floats(-2.0, 2.0), min_size=N_SMALL - 1, max_size=N_SMALL + 1),
    st.builds(
        lambda shape, dtype, fill: np.full(shape, fill).astype(dtype),
        st.sampled_from([(N_SMALL,), (1, N_SMALL), (N_SMALL, 1), (N_SMALL + 1,), (), (0,)]),
        st.sampled_from(["f2", "f4", "f8", "g", "i1", "u8", "?", "c16", "O", "S4", "U4", "M8[s]"]),
        st.sampled_from([0, 1]),
    ),
    st.lists(NUMBERS, min_size=N_SMALL, max_size=N_SMALL).map(lambda v: np.array(v, dtype=object)),
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


TARGETS = [
    Target("LatticeWormEnv", _ENVS, make_env, lambda call: (*_ENV, *FIELDS, "LatticeDesign")),
    Target("Adaptation and Hill", _LIVING, make_living, lambda call: (call[0].__name__,)),
    Target("Adaptation.advance", _USES, make_use, lambda call: (*call,)),
    Target("step", _ACTIONS, make_action, fixed("action")),
    Target("reset", _RESETS, make_reset, fixed("seed", "options")),
]
