"""Observation terms: what each holds, lists of them, a user's own, and the table of the docs."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from hypothesis import given, settings
from hypothesis import strategies as st
from small_worms import SMALL

from lattice_gym import LatticeWormEnv, LatticeWormGoalEnv, LatticeWormVectorEnv, ObservationTerm
from lattice_gym.checks import FloatArray
from lattice_gym.envs.core import Worms
from lattice_gym.envs.observation import table
from lattice_gym.envs.scene import Scene
from lattice_gym.envs.terms import TERMS
from lattice_gym.physics.measures import base_frame, muscle_lengths, muscle_rates, ring_radii, site_positions
from lattice_gym.physics.state import Motion

pytestmark = pytest.mark.slow

"""A lattice of three sites on each of five levels: quick to build and to step."""
ALL: dict[str, Any] = {"rhythm": 1.3, "adaptation": {"fatigue_rate": 0.5}, "observation": list(TERMS)}
"""Every term, but that there must be a ground."""
DOCS = Path(__file__).resolve().parents[1] / "docs" / "observations.md"


class Far(ObservationTerm):
    """Twice the strain, and a number far out of bounds."""

    name = "far"
    wrong: ClassVar[Any] = None
    """Given in place of its numbers."""

    def __init__(self, scene: Scene) -> None:
        self.low, self.high = np.array([-1.0, -2.0]), np.array([1.0, 3.0])

    def __call__(self, worms: Worms) -> FloatArray:
        """Two numbers a worm."""
        if self.wrong is not None:
            return np.asarray(self.wrong)
        strain = 2.0 * worms.measures.strain
        return np.stack([strain, np.full_like(strain, 1e9)], axis=-1)


class Unbounded(Far):
    """With a bound that is not finite."""

    name = "unbounded"

    def __init__(self, scene: Scene) -> None:
        self.low, self.high = np.array([-np.inf]), np.array([1.0])


class Huge(Unbounded):
    """With a bound that float32 cannot hold."""

    name = "huge"

    def __init__(self, scene: Scene) -> None:
        self.low, self.high = np.array([0.0]), np.array([1e300])


class Nameless(ObservationTerm):
    """Without a name and numbers."""


def _crawler(**kwargs: Any) -> LatticeWormEnv:
    return LatticeWormEnv("crawl", fidelity="fast", control="ring", **ALL, **kwargs)


def _parts(env: LatticeWormEnv, observation: FloatArray) -> dict[str, FloatArray]:
    return {name: observation[place] for name, place in env.observation_slices.items()}


def test_every_term_holds_what_it_says() -> None:
    """Against the state, on a worm that moves on a ground."""
    env = _crawler()
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(7):
        action = rng.random(15)
        observation, *_, info = env.step(action)
    assert info["clipped_observations"] == 0
    assert observation in env.observation_space
    state, lattice, height = env.state, env.lattice, env.design.height
    seen, start = _parts(env, observation), env.scene.start
    assert sum(len(part) for part in seen.values()) == len(observation)
    expected: dict[str, Any] = {
        "activation": env.worms.group_activation[0],
        "command": env.task.observe(Motion.of(state), np.array([env.time]))[0],
        "clock": [np.cos(2.6 * np.pi * env.time), np.sin(2.6 * np.pi * env.time)],
        "strength": env.strength,
        "muscle_lengths": muscle_lengths(env.model, state.position) / env.model.muscle_rest_length,
        "ring_radii": ring_radii(lattice, state.position) / ring_radii(lattice, lattice.position.reshape(-1, 3)),
        "previous_action": action,
        "ground_contact": [
            min(state.position[node, 2] - env.model.node_radius[node] for node in pair) < 0.0
            for pair in lattice.site_nodes
        ],
    }
    sites, moving, begun = (site_positions(lattice, x) for x in (state.position, state.velocity, start.position))
    rings = lattice.site_level == 0, lattice.site_level == lattice.n_level - 1
    (base, top), (base_speed, top_speed) = ([x[ring].mean(axis=0) / height for ring in rings] for x in (sites, moving))
    normal = np.cross(*(sites[rings[1]][[1, 2]] - sites[rings[1]][0]))
    first = base - begun[rings[0]].mean(axis=0) / height
    expected["body_frame"] = [*first, *base_frame(lattice, state.position)[2], *base_speed, *(top - base)]
    assert abs(abs(seen["body_frame"][12:15] @ normal) / np.linalg.norm(normal) - 1.0) < 0.1
    np.testing.assert_allclose(seen["body_frame"][15:], top_speed, rtol=1e-5, atol=1e-6)
    seen["body_frame"] = seen["body_frame"][:12]
    for name, values in expected.items():
        np.testing.assert_allclose(seen[name], values, rtol=1e-5, atol=1e-6, err_msg=name)
    assert 0.0 < seen["ground_contact"].mean() < 1.0


@pytest.mark.parametrize("muscle_model", ["rod", "line"])
def test_rates_are_the_derivative_of_lengths(muscle_model: str) -> None:
    """By a central difference, for muscles of both kinds."""
    env = LatticeWormEnv("extension", design=SMALL | {"muscle_model": muscle_model})
    env.reset(seed=0)
    env.step(env.action_space.sample())
    state, dt = env.state, 1e-6
    later, earlier = (muscle_lengths(env.model, state.position + way * state.velocity) for way in (dt, -dt))
    rates = muscle_rates(env.model, state.position, state.velocity)
    np.testing.assert_allclose(rates, (later - earlier) / (2.0 * dt), rtol=1e-6, atol=1e-9)


def test_the_default_is_a_list_too() -> None:
    """Written out it changes nothing; a vector environment takes it, and has the same slices."""
    names = ["sites", "activation", "command", "clock", "strength"]
    kwargs: dict[str, Any] = {"design": SMALL, "rhythm": 1.0, "adaptation": {"observed": True}}
    plain, stated = LatticeWormEnv("reach", **kwargs), LatticeWormEnv("reach", **kwargs, observation=tuple(names))
    assert list(plain.observation_slices) == names
    assert plain.observation_space == stated.observation_space
    np.testing.assert_array_equal(plain.reset(seed=0)[0], stated.reset(seed=0)[0])
    native = LatticeWormVectorEnv(2, task="reach", **kwargs, observation=names)
    assert native.observation_slices == plain.observation_slices
    assert native.single_observation_space == plain.observation_space


def test_previous_action_is_that_of_the_last_sound_step() -> None:
    """As clipped; nothing at the start of an episode."""
    env = LatticeWormEnv("extension", design=SMALL, control="ring", observation=["previous_action"])
    assert not env.reset(seed=0)[0].any()
    action = np.linspace(-0.5, 1.5, env.action_space.shape[0])
    np.testing.assert_allclose(env.step(action)[0], np.clip(action, 0.0, 1.0), rtol=1e-6)
    action[:] = np.nan
    assert not env.reset()[0].any()


@pytest.mark.parametrize("term", [Far, f"{__name__}:Far"])
def test_a_term_of_ones_own(term: Any) -> None:
    """By class or by name, clipped and counted, in a copy too."""
    env = LatticeWormEnv("extension", design=SMALL, observation=["activation", term])
    env.reset(seed=0)
    for twin in (env, copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        observation, *_, info = twin.step(np.ones(env.action_space.shape))
        assert info["clipped_observations"] == 1
        strain, far = observation[twin.observation_slices["far"]]
        assert (strain, far) == (pytest.approx(2.0 * info["outcome"]["strain"], rel=1e-6), 3.0)
        assert observation in env.observation_space


def test_specs_survive_json() -> None:
    """With names and "module:Class"."""
    made = gymnasium.make("LatticeWormReach-v0", design=SMALL, observation=["nodes", f"{__name__}:Far", "command"])
    assert made.spec is not None
    again = gymnasium.make(EnvSpec.from_json(made.spec.to_json()))
    np.testing.assert_array_equal(made.reset(seed=4)[0], again.reset(seed=4)[0])


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"observation": "nodes"}, r'^observation = \'nodes\': must be a list of terms; write \["nodes", "activation", '
                                   r'"command"\]'),
        ({"observation": "nodes", "rhythm": 1.0}, r'write \["nodes", "activation", "command", "clock"\]'),
        ({"observation": f"{__name__}:Far"}, r'must be a list of terms; write \["sites", "activation", "command"\]'),
        ({"observation": []}, r"^observation = \[\]: must be a list"),
        ({"observation": ["sites", "pixels"]}, r"^observation\[1\] = 'pixels': must be one of sites, nodes"),
        ({"observation": ["sites", 3]}, r"^observation\[1\] = 3"),
        ({"observation": ["no_such:Term"]}, r"^observation\[0\] = 'no_such:Term': cannot be imported"),
        ({"observation": ["lattice_gym:World"]}, r"^observation\[0\] = 'lattice_gym:World': must be one of"),
        ({"observation": ["sites", "sites"]}, r"^observation: holds 'sites' twice"),
        ({"observation": ["clock"]}, r'^observation: "clock" needs a rhythm'),
        ({"observation": ["sites"], "rhythm": 1.0}, r'^rhythm = 1: is not observed; add "clock"'),
        ({"observation": ["strength"]}, r'^observation: "strength" needs an adaptation; without one it is 1'),
        ({"observation": ["sites"], "adaptation": {"observed": True}}, r"^adaptation.observed = True: is not observed"),
        ({"observation": ["ground_contact"]}, r'^observation: "ground_contact" needs a ground'),
        ({"observation": [Unbounded]}, r"^Unbounded: low and high must be arrays .* finite as float32"),
        ({"observation": [Huge]}, r"^Huge: low and high must be arrays .* finite as float32"),
        ({"observation": ["sites", Nameless]}, r"^observation\[1\] = .*Nameless'>: lacks name, __call__$"),
    ],
)  # fmt: skip
def test_wrong_lists(kwargs: dict[str, Any], message: str) -> None:
    """The error names what is wrong, and what to write."""
    with pytest.raises(ValueError, match=message):
        LatticeWormEnv("extension", design=SMALL, **kwargs)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (np.full((1, 2), np.nan), r"^far: gives NaN"),
        (np.zeros((1, 3)), r"^far: must give shape \(1, 2\), got \(1, 3\)"),
    ],
)
def test_wrong_terms(wrong: Any, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one's own are named where they are observed."""
    monkeypatch.setattr(Far, "wrong", wrong)
    if np.shape(wrong) != (1, 2):
        monkeypatch.setattr(Far, "stays_within", True)
    env = LatticeWormEnv("extension", design=SMALL, observation=[Far])
    with pytest.raises(ValueError, match=message):
        env.reset(seed=0)


def test_goals_are_observed_once() -> None:
    """Apart; what is commanded would give them away to a policy whose goal was exchanged."""
    env = LatticeWormGoalEnv(design=SMALL, observation=["nodes", "previous_action"])
    assert list(env.observation_slices) == ["nodes", "previous_action"]
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    with pytest.raises(ValueError, match=r'^observation: "command" is observed apart'):
        LatticeWormGoalEnv(design=SMALL, observation=["sites", "command"])


@given(st.lists(st.one_of(st.sampled_from([*TERMS, "clok"]), st.none(), st.text(max_size=4)), max_size=4))
@settings(max_examples=30, deadline=None)
def test_any_list_is_taken_or_named(names: list[Any]) -> None:
    """Whatever it holds."""
    try:
        env, message = LatticeWormEnv("extension", design=SMALL, observation=names), ""
    except ValueError as error:
        env, message = _DEFAULT, str(error)
    assert message.startswith("observation") or env is not _DEFAULT
    assert env.reset(seed=0)[0] in env.observation_space


_DEFAULT = LatticeWormEnv("extension", design=SMALL)


def test_the_page_has_the_table_of_all_terms() -> None:
    """`docs/observations.md` says of every term what the package says."""
    scene = Scene(observation=list(TERMS), rhythm=1.0, adaptation={}, world={"ground": {}})
    assert table(Worms(scene).observer.terms) in DOCS.read_text()


def test_wrappers_need_no_private_name() -> None:
    """What a wrapper may want is public on one worm and on many alike, and reading it changes nothing."""
    one = LatticeWormEnv("reach", design=SMALL)
    many = LatticeWormVectorEnv(2, task="reach", design=SMALL)
    for env in (one, many):
        env.reset(seed=0)
        env.step(np.full(env.action_space.shape, 0.7))
    first, second = one.worms, many.worms
    for name in ("activation", "group_activation", "strength", "previous_action", "time", "n_step", "failed"):
        np.testing.assert_array_equal(getattr(first, name)[0], getattr(second, name)[0])
    for values, others in zip(first.motion, second.motion, strict=True):
        np.testing.assert_array_equal(values[0], others[0])
    for name in ("muscle_lengths", "muscle_rates", "ring_radii", "strain", "bend_vector", "mass_centre", "top_centre",
                 "top_normal", "top_velocity", "base_centre", "base_frame", "base_velocity", "site_position",
                 "site_velocity"):  # fmt: skip
        np.testing.assert_array_equal(getattr(first.measures, name)[0], getattr(second.measures, name)[0])
    before = pickle.dumps(one.state)
    with pytest.raises(ValueError, match="read-only"):
        first.motion.position[:] = 0.0
    for name in ("group_activation", "strength", "previous_action", "n_step", "sound_time", "failed"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(second, name)[0] = 1
    assert pickle.dumps(one.state) == before
    assert first.status() == second.status(1) == "ok"
