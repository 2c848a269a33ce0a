"""Episodes start at rest where a world lets a worm come to rest."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from small_worms import bare_env

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.fidelity import FidelityName
from lattice_gym.envs.scene import resolve_world
from lattice_gym.envs.settling import SETTLED_SPEED
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.world import World
from lattice_gym.tasks.registry import TASKS

pytestmark = pytest.mark.slow


def test_a_worm_that_crawls_has_settled() -> None:
    """On the ground, for good; what is observed begins at zero, and wherever it went does not matter."""
    env = bare_env("LatticeWormCrawl-v0", control="ring", command={"direction": 1})
    observation, _ = env.reset(seed=0)
    np.testing.assert_array_equal(observation[: 6 * 54 + 15], 0.0)
    start = env.state
    assert 0.0 < start.position[:, 2].min() < env.design.structure_radius
    for _ in range(20):
        env.step(np.zeros(15))
    np.testing.assert_allclose(env.state.position, start.position, atol=5e-5)
    away = env.state
    away.position[:] += [0.3, -0.1, 0.0]
    env.worms.restore(away)
    observation = env.worms.observe()[0][0]
    np.testing.assert_allclose(observation[: 3 * 54], 0.0, atol=1e-3)
    np.testing.assert_allclose(observation[-2:], [1.0, -1.0], atol=1e-3)


@pytest.mark.parametrize("fidelity", ["fast", "default"])
@pytest.mark.parametrize("task", ["crawl", "transport"])
def test_doing_nothing_earns_nothing_once_settled(task: str, fidelity: FidelityName) -> None:
    """Over a whole episode, either way."""
    env = LatticeWormEnv(task, fidelity=fidelity, control="ring", command={"direction": 1})
    env.reset(seed=0)
    rewards = [env.step(np.zeros(15))[1] for _ in range(200)]
    assert np.abs(rewards).max() < 1e-4


@pytest.mark.parametrize("drag", [0.0, 1.0, 100.0])
def test_drag_holds_up_no_settling(drag: float) -> None:
    """A worm of few elements rolls over as it comes to rest: it has done so, however slowly the medium would let it."""
    env = LatticeWormEnv("crawl", fidelity="fast", control="ring", world={"medium": {"drag": drag}})
    env.reset(seed=0)
    start = env.state.position
    for _ in range(20):
        env.step(np.zeros(15))
    assert np.abs(env.state.position - start).max() < SETTLED_SPEED * env.design.height


@pytest.mark.parametrize("density", [990.0, 1001.0, 1010.0])
def test_a_ball_that_friction_holds_comes_to_rest(density: float) -> None:
    """At once, and stays."""
    env = LatticeWormEnv("transport", fidelity="fast", control="ring", world={"ball": {"density": density}})
    env.reset(seed=0)
    start = env.state.ball_position
    for _ in range(20):
        env.step(np.zeros(15))
    assert np.abs(env.state.ball_position - start).max() < SETTLED_SPEED * env.design.height


@pytest.mark.parametrize(
    ("task", "world", "message"),
    [
        ("transport", {"ball": {"density": 1050.0}}, r"^world: transport is over before it starts"),
        ("transport", {"ball": {"density": 500.0}}, r"^world: transport is over before it starts"),
        ("crawl", {"medium": {"density": 2000.0}}, r"^world: worm and ball do not come to rest .* after 30 s"),
        ("crawl", {"ground": None}, r"^world.ground = None: there is nothing to crawl on"),
        ("crawl", {"medium": None}, r"^world.medium: has no gravity"),
        ("crawl", {"medium": {"gravity": 0.0}}, r"^world.medium: has no gravity"),
        ("crawl", {"lying": False}, r"^world.lying = False: a worm that crawls must lie"),
    ],
)
def test_worlds_in_which_nothing_comes_to_rest(task: str, world: dict[str, Any], message: str) -> None:
    """Refused at once, not played: the ball that sinks or rises out of its rings, the worm that falls or floats."""
    with pytest.raises(ValueError, match=message):
        LatticeWormEnv(task, fidelity="fast", world=world)


@pytest.mark.parametrize("task", ["crawl", "transport"])
def test_restating_a_world_changes_nothing(task: str) -> None:
    """A dict changes parts by name: any own value, restated, leaves all others; an object replaces its part."""
    lattice = build_lattice(LatticeDesign(**TASKS[task].design))
    own = TASKS[task].world(lattice)
    for name, part in own.to_dict().items():
        single = [{field: value} for field, value in part.items()] if isinstance(part, dict) else []
        for stated in (part, *single):
            assert resolve_world({name: stated}, TASKS[task].world, lattice) == own
    changed = resolve_world({"medium": {"drag": 0.5}, "ball": Ball(friction=0.2)}, TASKS[task].world, lattice)
    assert own.medium is not None
    assert changed == replace(own, medium=replace(own.medium, drag=0.5), ball=Ball(friction=0.2))
    assert resolve_world({"medium": None, "ground": {}}, TASKS["reach"].world, lattice) == World(ground=Ground())
