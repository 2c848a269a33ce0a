"""NumPy arrays wherever a list may be given, and what an episode without a time limit is called."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest

from lattice_gym import Command, LatticeWormEnv, LatticeWormVectorEnv, RewardTerm, Task
from lattice_gym.checks import is_list

FAST: dict[str, Any] = {"fidelity": "fast", "control": "column"}
TERMS = ["sites", "activation", "command"]


@pytest.mark.parametrize(
    "arguments",
    [
        {"command": {"azimuth": [0.1, 0.2], "rise": -0.01}},
        {"command": {"azimuth": [1, 2]}},
        {"observation": TERMS},
        {"observation": TERMS, "command": {"radius": (0.1,)}},
        {"randomise": {"damping": [0.5, 2.0]}},
        {"control": [muscle // 2 for muscle in range(90)]},
        {"design": {"phases": [step % 6 * np.pi / 3 for step in range(12)], "chirality": [1] * 6 + [-1] * 6}},
    ],
    ids=lambda arguments: "-".join(arguments),
)
def test_an_array_is_a_list(arguments: dict[str, Any]) -> None:
    """One worm and many are the same with arrays as with lists."""
    told = [LatticeWormEnv("reach", **FAST | given).reset(seed=3) for given in (arguments, _as_arrays(arguments))]
    assert repr(told[0]) == repr(told[1])
    many = [
        LatticeWormVectorEnv(2, task="reach", **FAST | given).reset(seed=3)
        for given in (arguments, _as_arrays(arguments))
    ]
    assert repr(many[0]) == repr(many[1])


def _as_arrays(values: Any) -> Any:
    """Values with an array in place of every list."""
    if isinstance(values, dict):
        return {name: _as_arrays(value) for name, value in values.items()}
    return np.array(values) if isinstance(values, list | tuple) else values


def test_options_may_be_arrays() -> None:
    """One worm draws from them; of many each has its own."""
    env = LatticeWormEnv("reach", **FAST)
    few = {"azimuth": np.array([0.5, 1.5])}
    assert {env.reset(seed=seed, options=few)[1]["command"]["azimuth"] for seed in range(9)} == {0.5, 1.5}
    envs = LatticeWormVectorEnv(2, task="reach", **FAST)
    _, info = envs.reset(seed=range(4, 6), options={"azimuth": np.array([0.5, 1.5])})
    assert info["command"]["azimuth"].tolist() == [0.5, 1.5]
    assert envs.np_random_seed == (4, 5)


class Directed(Task):
    """A task whose author writes arrays where tuples are usual."""

    name = "directed"
    time_limit = 2
    rewards: ClassVar[Mapping[str, RewardTerm]] = {"none": RewardTerm(1.0, 0.0, 0.0)}
    bounds: ClassVar[Any] = np.ones(1)
    observation: ClassVar[Any] = np.array(TERMS)

    def command_ranges(self) -> dict[str, Command]:
        """Two ways to go."""
        return {"way": Command(-1.0, 1.0, -1.0, 1.0, "1", np.array([-1.0, 1.0]))}  # type: ignore[arg-type]

    def observe(self, motion: Any, time: Any) -> Any:
        """Tell the way."""
        return self.commanded["way"][:, None]

    def terms(self, motion: Any, activation: Any, time: Any) -> Any:
        """Nothing."""
        return {"none": np.zeros(self.n_worm)}

    def outcome(self, motion: Any, worms: Any) -> Any:
        """Nothing."""
        return {}


def test_a_task_may_hold_arrays() -> None:
    """Choices, bounds and observation of a task of one's own."""
    env = LatticeWormEnv(Directed, **FAST)
    assert {env.reset(seed=seed)[1]["command"]["way"] for seed in range(6)} == {-1.0, 1.0}
    assert env.reset(options={"way": 1})[1]["command"]["way"] == 1.0
    with pytest.raises(ValueError, match=r"^options\['way'\] = 0.5: must be -1 or 1"):
        env.reset(options={"way": 0.5})


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ({"azimuth": np.array([])}, "must hold at least one number to draw from"),
        ({"azimuth": np.array([[0.1], [0.2]])}, "must be a number"),
        ({"azimuth": np.array([0.1, np.nan])}, r"\[1\] = .*nan.*: must be a number"),
        ({"azimuth": np.array(["0.1"])}, "must be a number"),
        ({"azimuth": {0.1, 0.2}}, "must be a number"),
        ({"azimuth": "0.1"}, "must be a number"),
    ],
)
def test_what_is_no_list_of_numbers_is_refused(command: Any, message: str) -> None:
    """An array is checked number by number; a set has no order to draw by."""
    with pytest.raises(ValueError, match=rf"^command\['azimuth'\].*{message}"):
        LatticeWormEnv("reach", command=command, **FAST)


@pytest.mark.parametrize(
    ("value", "whether"),
    [
        ([], True),
        ((1,), True),
        (range(2), True),
        (np.zeros(2), True),
        (np.zeros((2, 2)), True),
        (np.zeros(()), False),
        (np.float64(1.0), False),
        ("ab", False),
        (b"ab", False),
        ({1}, False),
        ({1: 2}, False),
        (iter([1]), False),
        (None, False),
        (3, False),
    ],
)
def test_what_counts_as_a_list(value: object, whether: bool) -> None:
    """Ordered, and read as often as one likes."""
    assert is_list(value) == whether


@pytest.mark.parametrize("unlimited", [-1, np.int64(-1)])
def test_minus_one_is_no_time_limit(unlimited: int) -> None:
    """As `gymnasium.make` has it, so `make_vec`; the specification survives JSON."""
    arguments: dict[str, Any] = {"control": "ring", "fidelity": "fast", "max_episode_steps": unlimited}
    one = gymnasium.make("LatticeWormExtension-v0", **arguments)
    many = gymnasium.make_vec("LatticeWormExtension-v0", num_envs=2, **arguments)
    one.reset(seed=0)
    many.reset(seed=0)
    action = np.zeros(8)
    for _ in range(41):  # one more than the task's own
        *_, truncated, _ = one.step(action)
        *_, truncations, _ = many.step(np.tile(action, (2, 1)))
        assert not truncated
        assert not truncations.any()


@pytest.mark.parametrize("limit", [0, -2, 2.5, True, "40"])
def test_other_time_limits_are_refused(limit: Any) -> None:
    """Only -1 has a meaning below 1."""
    with pytest.raises(ValueError, match=r"^max_episode_steps = "):
        LatticeWormVectorEnv(1, max_episode_steps=limit, task="extension", **FAST)
