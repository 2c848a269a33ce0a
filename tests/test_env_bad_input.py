"""What users give an environment that it cannot use: one clear error that names it, and no harm done."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_worms import N_SMALL, SMALL, SMALL_WAVE, bare_env

from lattice_gym.body.design import LatticeDesign
from lattice_gym.engines.health import Status
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.physics.critical_step import critical_dt
from lattice_gym.physics.laws.activation import advance_activation
from lattice_gym.physics.world import World

pytestmark = pytest.mark.slow


def _refusal(call: Callable[[], object]) -> str | None:
    """Return the message of the ValueError a call raises, if it does."""
    try:
        call()
    except ValueError as error:
        return str(error)
    return None


def test_a_refused_reset_does_not_seed() -> None:
    """The generator goes on as if nothing had been asked."""
    one, other = (bare_env("LatticeWormReach-v0", design=SMALL) for _ in range(2))
    for env in (one, other):
        env.reset(seed=0)
    with pytest.raises(ValueError, match="options"):
        one.reset(seed=5, options={"nope": 1})
    assert one.reset()[1] == other.reset()[1]


@given(
    st.lists(st.floats(allow_nan=False, width=32), min_size=N_SMALL, max_size=N_SMALL),
    st.sampled_from([np.float32, np.float64, list]),
)
@settings(max_examples=25, deadline=None)
def test_any_number_is_clipped_and_counted(values: list[float], kind: Any) -> None:
    """Infinities too; the reward stays finite and the observation in its space."""
    env = _HOSTILE
    env.reset(seed=0)
    observation, reward, _, _, info = env.step(kind(values))
    assert info["clipped_actions"] == sum(not 0.0 <= value <= 1.0 for value in values)
    assert observation in env.observation_space
    assert np.isfinite(reward)
    expected = advance_activation(np.zeros(N_SMALL), np.clip(values, 0.0, 1.0), 0.05, 0.015, 0.05)
    np.testing.assert_allclose(env.activation, expected)


_HOSTILE = LatticeWormEnv(design=SMALL, command=SMALL_WAVE)


@pytest.mark.parametrize(
    "action",
    [
        np.full(N_SMALL, np.nan),
        np.append(np.zeros(N_SMALL - 1), np.nan),
        np.zeros(N_SMALL - 1),
        np.zeros((1, N_SMALL)),
        np.zeros(N_SMALL, dtype=np.complex128),
        np.zeros(N_SMALL, dtype=np.bool_),
        np.array(["a"] * N_SMALL),
        [None] * N_SMALL,
        [[0.0], [0.0, 1.0]],
        0.5,
        None,
        "up",
        {"muscle": 1.0},
    ],
)
def test_wrong_actions(action: Any) -> None:
    """A ValueError that names the action, and the episode goes on as if nothing had been asked."""
    _HOSTILE.reset(seed=0)
    before = pickle.dumps(_HOSTILE.state)
    with pytest.raises(ValueError, match=r"^action:"):
        _HOSTILE.step(action)
    assert pickle.dumps(_HOSTILE.state) == before
    assert _HOSTILE.step(np.zeros(N_SMALL))[4]["status"] == Status.OK


def test_steps_need_a_reset() -> None:
    """Before the first one, as Gymnasium's own wrapper has it."""
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset"):
        LatticeWormEnv(design=SMALL, command=SMALL_WAVE).step(np.zeros(N_SMALL))


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"task": "swimming"}, r"^task = 'swimming': must be one of extension"),
        ({"task": ["bending"]}, r"^task = "),
        ({"design": 7}, r"^design = 7"),
        ({"design": {"n_pair": 6}}, r"^LatticeDesign: there is no 'n_pair'"),
        ({"design": {"period_ratio": 1.4}}, r"^LatticeDesign.period_ratio = 1.4: .* nearest"),
        ({"muscles": "strong"}, r"^muscles = 'strong'"),
        ({"muscles": 3}, r"^muscles = 3"),
        ({"muscles": {"muscles": [{"orientation": "custom", "start": 0, "end": 54}]}}, r"^muscles: site 54"),
        ({"muscles": {"muscles": []}}, r"^muscles"),
        ({"control": "brain"}, r"^control = 'brain'"),
        ({"control": [0, 1]}, r"^control = \[0, 1\]: must be a sequence of 90 groups, one for each"),
        ({"control": [0, 2] * 45}, r"^control: group 1 drives no muscle"),
        ({"rhythm": 0.0}, r"^rhythm = 0.0: must be a number above 0 and at most 10 \[Hz\]"),
        ({"rhythm": 11.0}, r"^rhythm = 11.0"),
        ({"rhythm": "fast"}, r"^rhythm = 'fast'"),
        ({"engine": "steam"}, r"^engine = 'steam': must be one of fused, pyelastica"),
        ({"dt": 0.0}, r"^dt = 0.0"),
        ({"dt": float("nan")}, r"^dt = nan"),
        ({"dt": "small"}, r"^dt = 'small'"),
        ({"dt": True}, r"^dt = True"),
        ({"dt": 0.1}, r"^dt = 0.1: must be a number above 0 and at most 0.05"),
        ({"dt": 1e-9}, r"^dt = 1e-09: 5e\+07 steps in control_dt"),
        ({"dt": 3e-4}, r"^dt = 0.0003: must divide .* 0.00029940\d* and 0.00030120\d* s"),
        ({"dt": 1e-3}, r"^dt = 0.001: above the critical time step, .* allow_large_dt=True"),
        ({"allow_large_dt": "yes"}, r"^allow_large_dt = 'yes'"),
        ({"control_dt": 0.0}, r"^control_dt = 0.0"),
        ({"control_dt": -0.05}, r"^control_dt = -0.05"),
        ({"control_dt": float("inf")}, r"^control_dt = inf"),
        ({"control_dt": 10**400}, r"^control_dt = 1000"),
        ({"control_dt": 0.2}, r"^command: .*4 control steps"),
        ({"observation": "pixels"}, r"^observation = 'pixels': must be a list of terms; write \["),
        ({"observation": []}, r"^observation = "),
        ({"task": "crawl", "design": LatticeDesign()}, r"^world: a worm that lies needs a free base"),
        ({"task": "crawl", "design": LatticeDesign(), "world": World()}, r"^design.base = .*must be free"),
        ({"task": "crawl", "command": {"direction": 0.5}}, r"^command\['direction'\] = 0.5: must be -1 or 1"),
        ({"task": "transport", "world": {"ball": None}}, r"^world.ball = None: there is nothing to carry"),
        (
            {"task": "transport", "design": {"n_pairs": 2, "period_ratio": 1.0}},
            r"^design: 2 pairs of rods leave no room for a ball",
        ),
        ({"world": {"lying": True}}, r"^world: a worm that lies needs a free base"),
        ({"world": 7}, r"^world = 7: must be World"),
        ({"world": {"moon": None}}, r"^World: there is no 'moon'"),
        ({"world": {"ground": {"stiffness": -1.0}}}, r"^Ground.stiffness = -1.0"),
        ({"command": {"azimuth": 0.0}}, r"^command: there is no 'azimuth'"),
        ({"render_mode": "human"}, r"^render_mode = 'human'"),
        ({"render_mode": 3}, r"^render_mode = 3"),
        ({"design": {"structure_youngs_modulus": 1e13}}, r"^dt = .* steps in control_dt"),
    ],
)
def test_wrong_arguments(kwargs: dict[str, Any], message: str) -> None:
    """The error names the argument."""
    with pytest.raises(ValueError, match=message):
        LatticeWormEnv(**kwargs)


_JUNK = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), st.lists(st.floats(), max_size=3),
    st.dictionaries(st.text(max_size=5), st.floats(), max_size=2),
)  # fmt: skip


@given(
    name=st.sampled_from(
        [
            "task",
            "design",
            "muscles",
            "control",
            "rhythm",
            "engine",
            "dt",
            "allow_large_dt",
            "control_dt",
            "observation",
            "command",
            "world",
            "render_mode",
            "randomise",
        ]
    ),
    value=_JUNK,
)
@settings(max_examples=150, deadline=None)
def test_any_argument_is_taken_or_named(name: str, value: Any) -> None:
    """Whatever an argument is, it makes a working environment or a ValueError that names it."""
    kwargs: dict[str, Any] = {"task": "bending", "design": SMALL} | {name: value}
    message = _refusal(lambda: LatticeWormEnv(**kwargs))
    if message is None:
        env = LatticeWormEnv(**kwargs)
        assert env.reset(seed=0)[0] in env.observation_space
    else:
        assert name in message.lower()


@given(options=_JUNK)
@settings(max_examples=50, deadline=None)
def test_any_options_are_taken_or_named(options: Any) -> None:
    """None and an empty dict change nothing; what the task does not command is refused."""
    message = _refusal(lambda: _HOSTILE.reset(seed=0, options=options))
    assert (message is None) == (options is None or options == {})
    assert message is None or message.startswith("options")
    assert _HOSTILE.reset(seed=0)[0] in _HOSTILE.observation_space


@pytest.mark.parametrize("divisor", [160, 200, 500])
def test_dt(divisor: int) -> None:
    """Any whole fraction of the control step below the critical step is taken as it is."""
    env = LatticeWormEnv(dt=0.05 / divisor)
    assert (env.n_substeps, env.dt) == (divisor, 0.05 / divisor)
    assert env.dt < critical_dt(env.model, env.design.max_tension)
    assert LatticeWormEnv().n_substeps * LatticeWormEnv().dt == pytest.approx(0.05, rel=1e-12)
