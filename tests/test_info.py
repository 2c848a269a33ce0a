"""What `info` tells: the same numbers after a reset and a step, of one worm and of many, and as text by a function."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from lattice_gym import Status, describe_status
from lattice_gym.engines.health import Health
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.info import STATUS

EXTENSION: dict[str, Any] = {"id": "LatticeWormExtension-v0", "control": "ring", "fidelity": "fast"}
ALL: dict[str, Any] = {
    "adaptation": {},
    "randomise": {"strength": (0.9, 1.1), "damping": (0.9, 1.1), "max_tension": (0.9, 1.1)},
}
HOSTILE: dict[str, Any] = EXTENSION | {"design": {"max_tension": 50.0}}
"""A worm that its muscles tear apart."""


def _leaves(info: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    """Names and values of nested infos."""
    for name, value in info.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{path}{name}.")
        else:
            yield path + name, value


def _shapes(info: Mapping[str, Any]) -> dict[str, tuple[type, tuple[int, ...]]]:
    return {name: (type(value), np.shape(value)) for name, value in _leaves(info)}


@pytest.mark.parametrize(
    "arguments",
    [
        EXTENSION,
        EXTENSION | ALL,
        EXTENSION | {"id": "LatticeWormBending-v0"},
        EXTENSION | {"id": "LatticeWormReachGoal-v0", "control": "column"},
        pytest.param(EXTENSION | {"id": "LatticeWorm-v0"}, marks=pytest.mark.slow),
        pytest.param(EXTENSION | {"id": "LatticeWormCrawl-v0"}, marks=pytest.mark.slow),
        pytest.param(EXTENSION | {"id": "LatticeWormTransport-v0"}, marks=pytest.mark.slow),
    ],
)
def test_reset_and_step_tell_the_same(arguments: dict[str, Any]) -> None:
    """The same names, types and shapes, as data sets of steps need them, and plain numbers all of them."""
    env = gymnasium.make(**arguments)
    _, start = env.reset(seed=0)
    *_, info = env.step(np.ones(env.action_space.shape or (), np.float32))
    assert _shapes(start) == _shapes(info)
    for name, value in _leaves(start):
        if name.startswith("reward_terms."):
            assert (type(value), value) == (float, 0.0)
        assert type(value) in (int, float) or value.dtype == np.float64
    assert start["command"] == info["command"]
    assert [start[name] for name in STATUS] == [info[name] for name in STATUS] == [Status.OK, -1, -1, -1]
    env.close()


def test_what_is_told_of_a_start() -> None:
    """Counts, outcome and factors are those of the start itself."""
    env = gymnasium.make(**EXTENSION | ALL)
    _, start = env.reset(seed=3)
    assert (start["outcome"], start["clipped_actions"], start["clipped_observations"]) == ({"strain": 0.0}, 0, 0)
    assert list(start["reward_terms"]) == ["strain", "effort", "divergence"]
    assert list(start["factors"]) == list(ALL["randomise"])
    _, again = env.reset(seed=4)
    assert start["factors"]["damping"] != again["factors"]["damping"]
    *_, info = env.step(np.full(env.action_space.shape or (), 1.5, np.float32))
    np.testing.assert_equal(info["factors"], again["factors"])
    assert info["clipped_actions"] == env.action_space.shape[0]  # type: ignore[index]
    env.close()


def test_infos_are_their_readers_own() -> None:
    """Whatever is written into one changes neither worm nor later infos."""
    env = gymnasium.make(**EXTENSION | ALL | {"id": "LatticeWormBending-v0"})
    envs = gymnasium.make_vec(num_envs=2, **EXTENSION | ALL | {"id": "LatticeWormBending-v0"})
    for worms in (env, envs):
        _, info = worms.reset(seed=0)
        kept = json.dumps(_plain(info["command"] | info["factors"]))
        info["command"]["azimuth"] *= 0.0
        info["factors"]["strength"][:] = 0.0
        info["strength"][:] = 0.0
        *_, info = worms.step(np.zeros(worms.action_space.shape or (), np.float32))
        assert json.dumps(_plain(info["command"] | info["factors"])) == kept
        assert (info["strength"] > 0.0).all()
        worms.close()


def _plain(info: Mapping[str, Any]) -> dict[str, Any]:
    return {name: np.asarray(value).tolist() for name, value in info.items() if not name.startswith("_")}


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_infos_of_many_hold_no_text(mode: AutoresetMode) -> None:
    """Arrays of numbers and bools, over ends of episodes, but for the last observations, as gymnasium has them."""
    envs = gymnasium.make_vec(num_envs=2, **EXTENSION | ALL, max_episode_steps=2, autoreset_mode=mode)
    assert envs.unwrapped.autoreset_mode is mode  # type: ignore[attr-defined]
    told = [envs.reset(seed=0)[1]]
    for _ in range(2 if mode is AutoresetMode.DISABLED else 5):
        told.append(envs.step(np.ones(envs.action_space.shape or (), np.float32))[4])
    for infos in told:
        for name, value in _leaves(infos):
            if name != "final_obs":
                assert value.dtype in (np.int64, np.float64, np.bool_), name
        assert set(told[0]) <= set(infos)
        assert all(infos[f"_{name}"].all() for name in told[0] if not name.startswith("_"))
    envs.close()


def test_a_failure_is_told_in_numbers_and_as_text() -> None:
    """The same of one worm and of a row of many; a new episode tells of none."""
    env = gymnasium.make(**HOSTILE)
    worm: Any = env.unwrapped
    env.reset(seed=0)
    terminated = False
    while not terminated:
        *_, terminated, _, info = env.step(np.ones(env.action_space.shape or (), np.float32))
    assert info["status"] in list(Status)[1:]
    assert type(info["status"]) is int
    assert worm.worms.health() == Health(*(info[name] for name in STATUS))
    assert describe_status(info, env) == worm.worms.status() != describe_status(info)
    assert re.fullmatch(
        r"(non_finite|overstretched|inverted|torn) \(rod \d+, element \d+(, joint \d+)?\)", describe_status(info)
    )
    assert info["reward_terms"]["divergence"] < 0.0

    envs = gymnasium.make_vec(num_envs=3, **HOSTILE, autoreset_mode="NextStep")
    envs.reset(seed=0)
    pulls = np.zeros(envs.action_space.shape or (), np.float32)
    pulls[1] = 1.0
    ended = np.zeros(3, bool)
    while not ended.any():
        *_, ended, _, infos = envs.step(pulls)
    for place in (None, envs):
        told = describe_status(info, None if place is None else env)
        assert [describe_status(infos, place, k) for k in range(3)] == ["ok", told, "ok"]
    assert [infos[name].tolist() for name in STATUS] == [
        [int(good), info[name], int(good)] for name, good in zip(STATUS, (0, -1, -1, -1), strict=True)
    ]
    *_, infos = envs.step(pulls)
    assert [describe_status(infos, worm=k) for k in (0, 1, -1)] == ["ok"] * 3
    assert describe_status(env.reset(seed=1)[1]) == "ok"
    env.close()
    envs.close()


def test_the_table_of_statuses_is_whole() -> None:
    """The specification has every code with its name."""
    rows = re.findall(r"^ *\| (\d) \| `([A-Z_]+)` \|", LatticeWormEnv.__doc__ or "", re.M)
    assert [(int(code), name) for code, name in rows] == [(status.value, status.name) for status in Status]


@pytest.mark.parametrize(
    "info",
    [
        None,
        {},
        "ok",
        {"status": 0},
        dict.fromkeys(STATUS, "ok"),
        {"status": 99, "rod": 0, "element": 0, "joint": 0},
        dict.fromkeys(STATUS, float("nan")),
    ],
)
def test_what_is_no_info_is_refused(info: Any) -> None:
    """One clear error that says what was wanted."""
    with pytest.raises(
        ValueError, match=r"^info = .*: must be what reset or step return, with whole numbers status, rod"
    ):
        describe_status(info)


def test_a_worm_that_is_not_there() -> None:
    """Is an IndexError, as of any sequence."""
    with pytest.raises(IndexError):
        describe_status({name: np.zeros(2, int) for name in STATUS}, worm=2)


@pytest.mark.parametrize("env", ["worm", gymnasium.make("CartPole-v1"), 7])
def test_what_is_no_environment_of_worms_is_refused(env: Any) -> None:
    """It cannot name muscles."""
    with pytest.raises(ValueError, match=r"^env = .*: must be an environment of worms"):
        describe_status(dict(zip(STATUS, (0, -1, -1, -1), strict=True)), env)
