"""The vector environment beside as many single ones: whatever one of them gives, it gives to the last bit."""

from __future__ import annotations

import copy
import inspect
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from hypothesis import given, settings
from hypothesis import strategies as st
from small_worms import SMALL

from lattice_gym.body.design import LatticeDesign
from lattice_gym.checks import FloatArray
from lattice_gym.engines.health import Status
from lattice_gym.envs.core import Worms
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.goal import LatticeWormGoalVectorEnv
from lattice_gym.envs.scene import Scene
from lattice_gym.envs.vector import LatticeWormVectorEnv
from lattice_gym.tasks.base import MIN_PENALTY
from lattice_gym.tasks.registry import TASKS

pytestmark = pytest.mark.slow

"""A lattice of three sites on each of five levels: quick to build and to step."""
QUICK: dict[str, Any] = {"design": SMALL, "control_dt": 0.01}
WAVE = {"wavelength": 0.1, "speed": [0.1, 0.2, -0.15]}
IDS = [f"LatticeWorm{task.title()}-v0" for task in TASKS] + ["LatticeWorm-v0", "LatticeWormReachGoal-v0"]
LIVING: dict[str, Any] = {"strain_gain": 0.5, "force_gain": 0.2, "episode": 1.0, "fatigue_rate": 0.8,
                          "recovery_rate": 0.3, "observed": True}  # fmt: skip
MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED]

Vector = Any
"""gymnasium's type of vector environments knows no lists of seeds."""


def _pair(id: str, n: int, mode: AutoresetMode, **kwargs: Any) -> tuple[LatticeWormVectorEnv, Vector]:
    """Make the vector environment of an id and gymnasium's own of as many single ones."""
    native = gymnasium.make_vec(id, num_envs=n, autoreset_mode=mode, **kwargs)
    assert isinstance(native, LatticeWormVectorEnv)
    singles: Vector = gymnasium.make_vec(
        id, num_envs=n, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **kwargs
    )
    assert isinstance(singles, SyncVectorEnv)
    return native, singles


def _same(native: Any, single: Any, path: str = "") -> None:
    """Compare whatever an environment returns; of outcomes, those that there are."""
    if isinstance(single, dict):
        outcomes = {"outcome", "_outcome"}
        assert set(native) - outcomes == set(single) - outcomes, path
        for name in set(native) - outcomes:
            _same(native[name], single[name], f"{path}/{name}")
        if "outcome" in native:
            rows = native["_outcome"]
            for name, values in native["outcome"].items():
                expected = single["outcome"][name]
                np.testing.assert_array_equal(values[rows], expected[rows], err_msg=f"{path}/outcome/{name}")
    elif isinstance(single, np.ndarray) and single.dtype == object:
        assert native.shape == single.shape
        for k, (one, other) in enumerate(zip(native, single, strict=True)):
            _same(one, other, f"{path}[{k}]")
    elif isinstance(single, np.ndarray):
        assert native.dtype == single.dtype, path
        np.testing.assert_array_equal(native, single, err_msg=path)
    else:
        assert native == single, path


def _actions(env: Vector, n_step: int, seed: int = 0) -> FloatArray:
    """Random actions, some out of bounds."""
    return np.random.default_rng(seed).uniform(-0.1, 1.1, (n_step, *env.action_space.shape))


def _named(returned: tuple[Any, ...]) -> dict[str, Any]:
    """Name what a step returns."""
    return dict(zip(("observation", "reward", "terminated", "truncated", "info"), returned, strict=True))


def _follow(
    native: LatticeWormVectorEnv, singles: Vector, actions: npt.NDArray[Any], mode: AutoresetMode
) -> list[dict[str, Any]]:
    """Step both and compare all that they return; where neither resets, reset what has ended. Infos of the first."""
    infos = []
    for k, action in enumerate(actions):
        given, expected = native.step(action), singles.step(action)
        _same(_named(given), _named(expected), f"step {k}")
        assert given[0] in native.observation_space
        infos.append(given[4])
        ended = given[2] | given[3]
        assert set(np.flatnonzero(given[4].get("_outcome", 0.0 * ended))) <= set(np.flatnonzero(ended))
        if mode is AutoresetMode.SAME_STEP:
            assert ("final_info" in given[4]) == ended.any()
        else:
            np.testing.assert_array_equal(given[4].get("_outcome", 0.0 * ended), ended)
        if mode is AutoresetMode.DISABLED and ended.any():
            seeds = [40 + worm for worm in range(native.num_envs)]
            again = native.reset(seed=seeds, options={"reset_mask": ended})
            anew = singles.reset(seed=seeds, options={"reset_mask": ended})
            _same(dict(enumerate(again)), dict(enumerate(anew)), f"reset {k}")
    return infos


@pytest.mark.parametrize("id", IDS)
def test_as_many_single_environments(id: str) -> None:
    """Every id over time limits and resets, with the single ones' seeds."""
    native, singles = _pair(id, 2, AutoresetMode.NEXT_STEP, fidelity="fast", control_dt=0.02, max_episode_steps=3)
    for seed in (7, [3, 11]):
        _same(dict(enumerate(native.reset(seed=seed))), dict(enumerate(singles.reset(seed=seed))))
        infos = _follow(native, singles, _actions(native, 5), AutoresetMode.NEXT_STEP)
        assert all(info[mask].all() for info in infos for mask in ("_command", "_status", "_clipped_observations"))
    for vector in (native, singles):
        vector.close()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("id", ["LatticeWorm-v0", "LatticeWormExtension-v0", "LatticeWormReachGoal-v0"])
def test_autoreset_modes(id: str, mode: AutoresetMode) -> None:
    """Each as gymnasium has it, with everything observed, strengths carried over and episodes that end apart."""
    living = {**LIVING, "carry": True}
    kwargs = QUICK | {"rhythm": 1.3, "control": "ring", "adaptation": living, "max_episode_steps": 4}
    native, singles = _pair(id, 3, mode, **kwargs, **({"command": WAVE} if id == "LatticeWorm-v0" else {}))
    assert native.metadata["autoreset_mode"] is mode
    for vector in (native, singles):
        vector.reset(seed=0)
    actions = _actions(native, 12)
    _follow(native, singles, actions[:2], mode)
    # Worm 1 begins anew: from now on it ends apart from the others.
    late: dict[str, Any] = {"seed": [None, 5, None], "options": {"reset_mask": np.array([False, True, False])}}
    one, other = (dict(enumerate(vector.reset(**late))) for vector in (native, singles))
    _same(one, other)
    infos = _follow(native, singles, actions[2:], mode)
    ends = {tuple(info["_outcome"].tolist()) for info in infos if "_outcome" in info}
    assert ends <= {(True, False, True), (False, True, False)}


@pytest.mark.filterwarnings("ignore:hill.* the physics step")
@pytest.mark.parametrize("task", ["bending", "transport", "crawl"])
def test_anything_at_once(task: str) -> None:
    """In a world, on lines or rods, with Hill's laws, checks and few groups."""
    living = {
        "adaptation": {**LIVING, "mode": "episode", "carry": True},
        "hill": {"width": 0.5},
        "activation": "twitch",
    }
    checks = {"energy_check": True, "step_check": True, "design": SMALL} if task == "bending" else {}
    world = {} if task == "crawl" else {"medium": {"drag": 0.01}}
    kwargs = {"fidelity": "fast", "control_dt": 0.02, "control": "column", "world": world, "max_episode_steps": 3}
    native, singles = _pair(f"LatticeWorm{task.title()}-v0", 2, AutoresetMode.NEXT_STEP, **kwargs, **living, **checks)
    for vector in (native, singles):
        vector.reset(seed=2)
    _follow(native, singles, _actions(native, 5), AutoresetMode.NEXT_STEP)


def test_the_reference_engine() -> None:
    """Works as well, worm by worm."""
    kwargs = {"design": SMALL, "control_dt": 0.002, "engine": "pyelastica", "max_episode_steps": 2}
    native, singles = _pair("LatticeWormBending-v0", 2, AutoresetMode.NEXT_STEP, **kwargs)
    for vector in (native, singles):
        vector.reset(seed=2)
    _follow(native, singles, _actions(native, 4), AutoresetMode.NEXT_STEP)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("task", ["extension", "peristalsis", "reach"])
def test_a_worm_that_diverges_ends_alone(task: str, mode: AutoresetMode) -> None:
    """As a single one does, with a status and the penalty; others do not change by a bit."""
    kwargs: dict[str, Any] = {"design": SMALL, "dt": 0.005, "allow_large_dt": True, "rhythm": 0.9, "adaptation": LIVING}
    kwargs |= {"command": WAVE} if task == "peristalsis" else {}
    native, singles = _pair(f"LatticeWorm{task.title()}-v0", 3, mode, **kwargs)
    alone = LatticeWormVectorEnv(3, None, mode, task=task, **kwargs)
    for vector in (native, singles, alone):
        vector.reset(seed=1)
    pull = np.zeros_like(_actions(native, 6))
    pull[:, 1] = 1.0
    infos = _follow(native, singles, pull, mode)
    told = [info.get("final_info", info) for info in infos]
    status = [info["status"][1] for info in told]
    failed = next(k for k, code in enumerate(status) if code != Status.OK)
    assert status[failed] in (Status.NON_FINITE, Status.OVERSTRETCHED, Status.INVERTED)
    assert min(told[failed]["rod"][1], told[failed]["element"][1]) >= 0
    assert told[failed]["reward_terms"]["divergence"][1] == -MIN_PENALTY
    if mode is AutoresetMode.NEXT_STEP:
        native.reset(seed=1)
        for action in pull:
            seen, quiet = native.step(action)[0], alone.step(0.0 * action)[0]
            np.testing.assert_array_equal(seen[[0, 2]], quiet[[0, 2]])


def test_a_worm_that_does_not_step_earns_nothing() -> None:
    """Nor moves on in time, whether it failed before or not; the others step as they would alone."""
    scene = Scene("extension", design=SMALL)
    worms, alone = Worms(scene, 3), Worms(scene, 1)
    for worm in range(3):
        worms.begin(worm, np.random.default_rng(0))
    alone.begin(0, np.random.default_rng(0))
    torn = worms.state(1)
    torn.velocity[scene.lattice.n_node // 2] = 1e6
    worms.restore(torn, 1)
    pull = np.full((3, scene.n_group), 0.5)
    first, _ = worms.step(pull), alone.step(pull[:1])
    assert first.terminated.tolist() == worms.failed.tolist() == [False, True, False]
    assert first.reward[1] == -worms.task.penalty
    live, before = np.array([True, False, False]), worms.time
    for _ in range(2):
        result, expected = worms.step(pull, live), alone.step(pull[:1])
        assert result.reward.tolist() == [expected.reward[0], 0.0, 0.0]
        assert not result.terminated.any()
    np.testing.assert_array_equal(worms.time[1:], before[1:])
    np.testing.assert_array_equal(worms.observe()[0][0], alone.observe()[0][0])
    assert worms.failed.tolist() == [False, True, False]
    assert worms.step(pull, ~np.ones(3, dtype=bool)).reward.tolist() == [0.0, 0.0, 0.0]


def test_outcomes_of_all_worms() -> None:
    """What single environments tell after every step is there when asked for."""
    native, singles = _pair("LatticeWorm-v0", 2, AutoresetMode.NEXT_STEP, **QUICK, command=WAVE | {"speed": 1.0})
    for vector in (native, singles):
        vector.reset(seed=1)
    for action in _actions(native, 25):
        native.step(action)
        expected = singles.step(action)[4]["outcome"]
    found = native.outcome()
    assert found["wave_amplitude"].min() > 0.0
    for name, values in found.items():
        np.testing.assert_array_equal(values, expected[name])


def test_goals_are_rewarded_as_single_ones_are() -> None:
    """Those of a batch, with infos of single worms."""
    native = gymnasium.make_vec("LatticeWormReachGoal-v0", num_envs=3, **QUICK)
    assert isinstance(native, LatticeWormGoalVectorEnv)
    native.reset(seed=0)
    seen, reward, *_, info = native.step(_actions(native, 1)[0])
    terms = info["reward_terms"]
    names = [name for name in terms if not name.startswith("_")]
    infos = [{"reward_terms": {name: terms[name][k] for name in names}} for k in range(3)]
    np.testing.assert_array_equal(native.compute_reward(seen["achieved_goal"], seen["desired_goal"], infos), reward)


def test_options() -> None:
    """A number is for all, a list is drawn from, an array holds one for each; the others stay as they were."""
    native = LatticeWormVectorEnv(3, task="reach", **QUICK)
    _, info = native.reset(seed=0, options={"azimuth": np.array([0.0, 1.0, 2.0]), "radius": 0.1, "rise": [-0.05, 0.0]})
    np.testing.assert_array_equal(info["command"]["azimuth"], [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(info["command"]["radius"], 0.1)
    assert set(info["command"]["rise"]) <= {-0.05, 0.0}
    options = {"azimuth": np.array([3.0, 3.0, 3.0]), "reset_mask": np.array([True, False, True])}
    _, info = native.reset(options=options)
    assert set(options) == {"azimuth", "reset_mask"}
    np.testing.assert_array_equal(info["_command"], [True, False, True])
    assert native.np_random_seed == (0, 1, 2)
    assert len(native.np_random) == 3


def test_steps_need_a_reset() -> None:
    """Before the first one, of all worms, and of those that have ended and are not reset by themselves."""
    native = LatticeWormVectorEnv(2, 1, "Disabled", task="extension", **QUICK)
    action = np.zeros_like(_actions(native, 1)[0])
    for call in (lambda: native.step(action), lambda: native.reset(options={"reset_mask": np.array([True, False])})):
        with pytest.raises(gymnasium.error.ResetNeeded):
            call()
    native.reset(seed=0)
    assert native.step(action)[3].all()
    native.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"worms \[1\] have ended"):
        native.step(action)


def test_wrappers_of_gymnasium() -> None:
    """Returns and lengths of episodes are counted as those of any vector environment."""
    native = gymnasium.make_vec("LatticeWormExtension-v0", num_envs=2, max_episode_steps=3, **QUICK)
    assert native.spec is not None
    assert native.spec.id == "LatticeWormExtension-v0"
    counted = RecordEpisodeStatistics(native)
    counted.reset(seed=0)
    rewards = []
    for action in _actions(native, 3):
        _, reward, *_, info = counted.step(action)
        rewards.append(reward)
    np.testing.assert_allclose(info["episode"]["r"], np.sum(rewards, axis=0))
    assert info["episode"]["l"].tolist() == [3, 3]


def test_specs_survive_json() -> None:
    """With the arguments of a batch; the environment made of one gives the same."""
    design = LatticeDesign(**SMALL)
    made = gymnasium.make_vec("LatticeWormReach-v0", 3, autoreset_mode="SameStep", num_threads=1, design=design)
    assert made.spec is not None
    again = gymnasium.make_vec(EnvSpec.from_json(made.spec.to_json()))
    assert (again.num_envs, again.metadata) == (3, made.metadata)
    assert pickle.dumps(made.reset(seed=4)) == pickle.dumps(again.reset(seed=4))


def test_pictures() -> None:
    """One of each worm, as a single environment draws it; none without a render mode; close may be called again."""
    native, singles = _pair("LatticeWormExtension-v0", 2, AutoresetMode.NEXT_STEP, **QUICK, render_mode="rgb_array")
    for vector in (native, singles):
        vector.reset(seed=0)
    action = _actions(native, 1)[0]
    native.step(action)
    singles.step(action)
    pictures, expected = native.render(), singles.render()
    assert pictures is not None
    assert expected is not None
    assert (pictures[0] != pictures[1]).any()
    for picture, other in zip(pictures, expected, strict=True):
        np.testing.assert_allclose(picture.astype(float), np.asarray(other, dtype=float), atol=2.0)
    native.close()
    native.close()
    assert LatticeWormVectorEnv(2, task="extension", **QUICK).render() is None


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"num_envs": 0}, r"^num_envs = 0"),
        ({"num_envs": 1.5}, r"^num_envs = 1.5"),
        ({"max_episode_steps": 0}, r"^max_episode_steps = 0"),
        ({"autoreset_mode": "never"}, r"^autoreset_mode = 'never': must be one of 'NextStep', 'SameStep', 'Disabled'"),
        ({"num_threads": 0}, r"^num_threads = 0"),
        ({"task": "swimming"}, r"^task = 'swimming'"),
    ],
)
def test_wrong_arguments(kwargs: dict[str, Any], message: str) -> None:
    """The error names the argument."""
    with pytest.raises(ValueError, match=message):
        LatticeWormVectorEnv(**kwargs)


_HOSTILE: Vector = LatticeWormVectorEnv(2, task="reach", **QUICK)
_N_ACTION = int(np.prod(_HOSTILE.single_action_space.shape or ()))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: _HOSTILE.reset(seed=-1), r"^seed = -1"),
        (lambda: _HOSTILE.reset(seed=[1]), r"^seed = \[1\]: must be a sequence of 2 seeds"),
        (lambda: _HOSTILE.reset(seed=[1, "two"]), r"^seed\[1\] = 'two'"),
        (lambda: _HOSTILE.reset(options={"reset_mask": [True, False]}), r"^options\['reset_mask'\]"),
        (lambda: _HOSTILE.reset(options={"reset_mask": np.zeros(2, dtype=bool)}), r"^options\['reset_mask'\]"),
        (lambda: _HOSTILE.reset(options={"radius": np.zeros(3)}), r"^options\['radius'\]: an array"),
        (lambda: _HOSTILE.reset(options={"radius": np.array([0.1, 9.0])}), r"^options\['radius'\] = 9.0"),
        (lambda: _HOSTILE.reset(seed=np.array(-1)), r"^seed = array\(-1\)"),
        (lambda: _HOSTILE.reset(seed=np.zeros((2, 2))), r"^seed\[0\] = array"),
        (lambda: _HOSTILE.reset(options={"radius": np.array([0.1, None])}), r"^options\['radius'\] = None"),
        (lambda: _HOSTILE.reset(options={"speed": 1.0}), r"^options: there is no 'speed'"),
        (lambda: _HOSTILE.step(np.zeros(_N_ACTION)), r"^action: shape"),
        (lambda: _HOSTILE.step(np.full((2, _N_ACTION), np.nan)), r"^action: must not be NaN"),
        (lambda: _HOSTILE.step([["a"] * _N_ACTION] * 2), r"^action: must hold real numbers"),
    ],
)
def test_wrong_calls(call: Callable[[], object], message: str) -> None:
    """The error names what is wrong."""
    _HOSTILE.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        call()


def test_a_refused_reset_changes_nothing() -> None:
    """Of no worm, were it only one for which it was wrong."""
    one, other = (LatticeWormVectorEnv(2, task="reach", **QUICK) for _ in range(2))
    action = _actions(one, 1)[0]
    for native in (one, other):
        native.reset(seed=0)
        native.step(action)
    with pytest.raises(ValueError, match="radius"):
        one.reset(seed=9, options={"radius": np.array([0.1, 9.0])})
    assert one.np_random_seed == other.np_random_seed
    for part, expected in zip(one.step(action)[:4], other.step(action)[:4], strict=True):
        np.testing.assert_array_equal(part, expected)


@given(st.lists(st.floats(allow_nan=False, width=32), min_size=2 * _N_ACTION, max_size=2 * _N_ACTION))
@settings(max_examples=20, deadline=None)
def test_any_number_is_clipped_and_counted(values: list[float]) -> None:
    """Worm by worm; infinities too."""
    action = np.reshape(values, (2, _N_ACTION))
    _HOSTILE.reset(seed=0)
    seen, reward, *_, info = _HOSTILE.step(action)
    np.testing.assert_array_equal(info["clipped_actions"], np.sum((action < 0.0) | (action > 1.0), axis=1))
    assert seen in _HOSTILE.observation_space
    assert np.isfinite(reward).all()


@given(
    seed=st.one_of(st.none(), st.integers(), st.floats(), st.text(max_size=3), st.lists(st.integers(), max_size=3)),
    options=st.one_of(st.none(), st.integers(), st.lists(st.floats(), max_size=3),
                      st.dictionaries(st.sampled_from(["radius", "reset_mask", "moon"]), st.floats(), max_size=2)),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_any_reset_is_taken_or_named(seed: Any, options: Any) -> None:
    """Whatever is given begins episodes or is a ValueError that names it."""
    try:
        seen, info = _HOSTILE.reset(seed=seed, options=options)
    except ValueError as error:
        seen, info, message = None, {}, str(error)
    else:
        message = ""
    assert message.startswith(("seed", "options")) or (seen in _HOSTILE.observation_space and info["_command"].all())


def test_a_single_worm_is_the_single_environment() -> None:
    """A batch of one."""
    native, single = LatticeWormVectorEnv(1, task="bending", **QUICK), LatticeWormEnv("bending", **QUICK)
    np.testing.assert_array_equal(native.reset(seed=3)[0][0], single.reset(seed=3)[0])
    action = _actions(native, 1)[0]
    one, other = native.step(action), single.step(action[0])
    np.testing.assert_array_equal(one[0][0], other[0])
    assert one[1][0] == other[1]


def test_attributes_of_one_are_those_of_many() -> None:
    """And both name all arguments, and refuse others alike."""
    one, many = LatticeWormEnv("extension", **QUICK), LatticeWormVectorEnv(2, task="extension", **QUICK)
    for name in ("design", "layout", "world", "adaptation", "control_dt", "dt", "n_substeps", "splitting"):
        assert getattr(one, name) == getattr(many, name)
    assert type(one.task) is type(many.task)
    np.testing.assert_array_equal(one.groups, many.groups)
    np.testing.assert_array_equal(one.model.rest_state().position, many.model.rest_state().position)
    assert (one.lattice.n_rod, one.observation_slices) == (many.lattice.n_rod, many.observation_slices)
    for vector in (many.activation, many.strength):
        assert vector.shape == (2, *one.groups.shape)
    assert many.time.tolist() == [one.time] * 2 == [0.0, 0.0]
    kind: Any
    for kind, first in ((LatticeWormEnv, "task"), (LatticeWormVectorEnv, "num_envs")):
        named = list(inspect.signature(kind).parameters)
        assert named[0] == first
        assert {"task", "design", "activation", "render_mode"} < set(named)
        assert not {"goals_apart", "arguments"} & set(named)
        for wrong in ("foo", "goals_apart"):
            named_all = rf"^got an unexpected keyword argument '{wrong}'; there are {first}, .*randomise"
            for error in (TypeError, ValueError):  # as Python's own, and as any other argument's
                with pytest.raises(error, match=named_all):
                    kind(**{wrong: 1})


@pytest.mark.parametrize("copied", [pickle.dumps, copy.copy, copy.deepcopy])
def test_copies_are_refused(copied: Callable[[object], object]) -> None:
    """Their physics would be that of the original, or none."""
    with pytest.raises(TypeError, match=r"^LatticeWormVectorEnv: can be neither pickled nor copied"):
        copied(_HOSTILE)


def test_a_wave_too_fast_for_some_draws_is_refused_before_any_reset() -> None:
    """Whatever the wavelength drawn would have been: no worm begins, and no seed is taken."""
    native = LatticeWormVectorEnv(3, design=SMALL, control_dt=0.05)
    native.reset(seed=0)
    with pytest.raises(ValueError, match=r"^options: a wave of speed 0.4"):
        native.reset(seed=8, options={"speed": np.array([0.1, 0.1, 0.4]), "wavelength": [0.076, 0.1]})
    assert native.np_random_seed == (0, 1, 2)
