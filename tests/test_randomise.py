"""Factors drawn for every episode: what they change, and that nothing else does."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import SyncVectorEnv
from hypothesis import given, settings
from hypothesis import strategies as st
from small_worms import SMALL

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.randomisation import BODY, NAMES, Randomisation, apply_factors
from lattice_gym.envs.vector import LatticeWormVectorEnv
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.critical_step import critical_dt
from lattice_gym.physics.worm import build_model

QUICK: dict[str, Any] = {"task": "reach", "design": SMALL, "control_dt": 0.02}
ALL = dict.fromkeys(NAMES, (0.8, 1.25))


def _episode(env: LatticeWormEnv, n_step: int = 3, seed: int | None = 0) -> list[Any]:
    """Everything an episode of random actions returns."""
    env.action_space.seed(0)
    return [env.reset(seed=seed), *(env.step(env.action_space.sample()) for _ in range(n_step))]


def _final(env: LatticeWormEnv) -> Any:
    _episode(env)
    return env.state.position


@pytest.mark.parametrize("muscle_model", ["rod", "line"])
@given(factors=st.fixed_dictionaries(dict.fromkeys(BODY, st.floats(0.1, 10.0))))
@settings(max_examples=5, deadline=None)
def test_a_body_with_factors_is_that_of_the_design_with_them(muscle_model: str, factors: dict[str, float]) -> None:
    """Every constant, to rounding; the model it was made from stays as it was."""
    design = LatticeDesign(**SMALL, muscle_model=muscle_model)
    scaled = {name: factor * getattr(design, name) for name, factor in factors.items()}
    scaled["rotational_damping"] = factors["damping"] * design.rotational_damping
    plain, expected = _model(design), _model(replace(design, **scaled))
    before = plain.node_damping.copy(), [rod.bend_stiffness.copy() for rod in plain.rods]
    found = apply_factors(plain, factors)
    np.testing.assert_array_equal(plain.node_damping, before[0])
    np.testing.assert_allclose(found.node_damping, expected.node_damping, rtol=1e-12)
    np.testing.assert_array_equal(found.node_mass, expected.node_mass)
    for rod, twin, kept, own in zip(found.rods, expected.rods, before[1], plain.rods, strict=True):
        np.testing.assert_array_equal(own.bend_stiffness, kept)
        assert rod.rotational_damping == pytest.approx(twin.rotational_damping, rel=1e-12)
        for name in ("stretch_stiffness", "shear_stiffness", "bend_stiffness", "twist_stiffness", "inertia"):
            np.testing.assert_allclose(getattr(rod, name), getattr(twin, name), rtol=1e-12)
    for line, other in zip(found.lines, expected.lines, strict=True):
        assert (line.stiffness, line.damping) == pytest.approx((other.stiffness, other.damping), rel=1e-12)


def _model(design: LatticeDesign) -> RodModel:
    lattice = build_lattice(design)
    return build_model(lattice, named_layout("all", lattice))


@pytest.mark.parametrize("name", [*BODY, "max_tension", "strength"])
def test_a_worm_with_a_factor_moves_as_one_of_that_design(name: str) -> None:
    """On ranges of no width: to rounding of the constants, and a twentieth more or less is far from nothing."""
    field = "max_tension" if name == "strength" else name
    design = LatticeDesign(**SMALL)
    changed: dict[str, Any] = {field: 1.05 * getattr(design, field)}
    if name == "damping":
        changed["rotational_damping"] = 1.05 * design.rotational_damping
    shared: dict[str, Any] = {"task": "reach", "control_dt": 0.02, "dt": 1e-4}
    plain, made, drawn = (
        _final(LatticeWormEnv(design=body, randomise=ranges, **shared))
        for body, ranges in ((design, None), (replace(design, **changed), None), (design, {name: (1.05, 1.05)}))
    )
    np.testing.assert_allclose(drawn, made, rtol=0.0, atol=1e-12)
    assert np.abs(drawn - plain).max() > 1e-6


def test_draws() -> None:
    """Seeded, within the ranges, one for each muscle; one more range leaves commands and other factors alone."""
    few, more = (LatticeWormEnv(**QUICK, randomise=ranges) for ranges in ({"damping": (0.5, 2.0)}, ALL))
    plain, seen = LatticeWormEnv(**QUICK), []
    for seed in range(20):
        command, first, second = (env.reset(seed=seed)[1] for env in (plain, few, more))
        assert command["command"] == first["command"] == second["command"]
        assert (list(first["factors"]), list(second["factors"])) == (["damping"], list(NAMES))
        share = (first["factors"]["damping"] - 0.5) / 1.5
        assert second["factors"]["damping"] == pytest.approx(0.8 + share * 0.45, rel=1e-12)
        assert second["factors"]["strength"].shape == (more.model.n_muscle,)
        seen.append([share, *second["factors"]["strength"]])
    shares, strengths = np.array(seen)[:, 0], np.array(seen)[:, 1:]
    assert 0.0 <= shares.min() < 0.2 < 0.8 < shares.max() <= 1.0
    assert 0.8 <= strengths.min() < 0.85 < 1.2 < strengths.max() <= 1.25
    assert np.ptp(strengths, axis=1).min() > 0.2
    assert few.reset()[1]["factors"] != few.reset()[1]["factors"]


def test_without_it_nothing_changes() -> None:
    """To the last bit; an empty mapping is none."""
    nothing: dict[str, tuple[float, float]] = {}
    one, other = (_episode(LatticeWormEnv(**QUICK, randomise=ranges)) for ranges in (None, nothing))
    assert pickle.dumps(one) == pickle.dumps(other)
    assert "factors" not in one[0][1]


@pytest.mark.slow
def test_as_many_single_environments() -> None:
    """A batch draws for each worm what single environments draw, at every reset, and all else follows."""
    kwargs = {**QUICK, "randomise": ALL, "adaptation": {"fatigue_rate": 1.0}, "rhythm": 1.0, "energy_check": True}
    native: Any = LatticeWormVectorEnv(2, 2, **kwargs)
    singles: Any = SyncVectorEnv([lambda: gymnasium.wrappers.TimeLimit(LatticeWormEnv(**kwargs), 2)] * 2)
    rng, returned = np.random.default_rng(0), []
    for vector in (native, singles):
        returned.append([vector.reset(seed=3)])
    for action in rng.random((5, *native.action_space.shape)):
        for vector, steps in zip((native, singles), returned, strict=True):
            steps.append(vector.step(action))
    for one, other in zip(*returned, strict=True):
        for part, expected in zip(one[:-1], other[:-1], strict=True):
            np.testing.assert_array_equal(part, expected)
        assert ("factors" in one[-1]) == ("factors" in other[-1])
        for name in NAMES if "factors" in one[-1] else ():
            np.testing.assert_array_equal(one[-1]["factors"][name], other[-1]["factors"][name])


def test_the_default_step_is_that_of_the_worst_corner() -> None:
    """Stable for the stiffest body, and for the softest muscle under the largest tension."""
    ranges = {"structure_youngs_modulus": (0.5, 4.0), "muscle_youngs_modulus": (0.2, 1.0), "max_tension": (1.0, 2.0)}
    env, plain = LatticeWormEnv(**QUICK, randomise=ranges), LatticeWormEnv(**QUICK)
    assert env.dt < plain.dt
    bodies = [{"structure_youngs_modulus": a, "muscle_youngs_modulus": b} for a in (0.5, 4.0) for b in (0.2, 1.0)]
    limits = [
        critical_dt(apply_factors(env.model, body), 2.0 * env.design.max_tension, env.splitting) for body in bodies
    ]
    assert env.dt < min(limits)
    with pytest.raises(ValueError, match=r"^dt = .*above the critical time step"):
        LatticeWormEnv(**QUICK, randomise=ranges, dt=0.02 / int(0.02 / (1.01 * min(limits))))


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_go_on_exactly(copied: Any) -> None:
    """The body of the episode is part of the state."""
    env = LatticeWormEnv(**QUICK, randomise=ALL)
    _episode(env)
    twin = copied(env)
    action = np.full(env.action_space.shape, 0.7)
    assert pickle.dumps(env.step(action)) == pickle.dumps(twin.step(action))
    assert pickle.dumps(_episode(env, seed=None)) == pickle.dumps(_episode(twin, seed=None))


def test_specs_survive_json() -> None:
    """And the environment made of one draws the same."""
    made = gymnasium.make(
        "LatticeWormReach-v0", design=SMALL, randomise={"damping": [0.5, 2.0], "strength": [0.9, 1.0]}
    )
    assert made.spec is not None
    again = gymnasium.make(EnvSpec.from_json(made.spec.to_json()))
    assert pickle.dumps(made.reset(seed=4)) == pickle.dumps(again.reset(seed=4))


@pytest.mark.parametrize(
    ("randomise", "message"),
    [
        (1.0, r"^randomise = 1.0: must be a mapping"),
        ({"mass": (1.0, 2.0)}, r"^randomise: there is no 'mass'; there are structure_youngs_modulus, "),
        ({"damping": 1.0}, r"^randomise\['damping'\] = 1.0: must be a sequence of 2 factors from 0.01 to 100"),
        ({"damping": (2.0, 1.0)}, r"^randomise\['damping'\]"),
        ({"damping": (0.0, 1.0)}, r"^randomise\['damping'\]"),
        ({"damping": (1.0, 101.0)}, r"^randomise\['damping'\]"),
        ({"damping": (1.0, float("nan"))}, r"^randomise\['damping'\]"),
        ({"strength": (0.5, 1.0, 2.0)}, r"^randomise\['strength'\]"),
        ({"strength": "ab"}, r"^randomise\['strength'\]"),
        ({"strength": (True, 2.0)}, r"^randomise\['strength'\]"),
    ],
)
def test_wrong_ranges(randomise: Any, message: str) -> None:
    """The error names them."""
    with pytest.raises(ValueError, match=message):
        LatticeWormEnv(**QUICK, randomise=randomise)


@given(
    st.one_of(
        st.none(),
        st.integers(),
        st.text(max_size=3),
        st.dictionaries(
            st.one_of(st.sampled_from(NAMES), st.text(max_size=3)),
            st.one_of(st.none(), st.floats(), st.lists(st.one_of(st.floats(), st.text(max_size=2)), max_size=3)),
            max_size=3,
        ),
    )
)
def test_any_ranges_are_taken_or_named(randomise: Any) -> None:
    """Whatever they are."""
    try:
        ranges, message = Randomisation.resolve(randomise), ""
    except ValueError as error:
        ranges, message = None, str(error)
    assert message.startswith("randomise") or ranges is None or set(ranges.ranges) <= set(NAMES)
