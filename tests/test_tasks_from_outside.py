"""What a task must be, whoever wrote it: parts, values and rewards are checked, and divergence never pays."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from typing import Any, ClassVar, cast

import gymnasium
import numpy as np
import pytest
from small_worms import episode
from task_scenes import CALM, LATTICE, REST, terms_of, tipped

from lattice_gym.body.design import LatticeDesign
from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.envs.core import Worms
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.scene import Scene
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.state import Motion
from lattice_gym.physics.world import World
from lattice_gym.tasks.base import EFFORT_WEIGHT, MIN_PENALTY, RewardTerm, Task
from lattice_gym.tasks.crawl import Crawl
from lattice_gym.tasks.registry import TASKS, design_for, resolve_task, task_label

pytestmark = pytest.mark.slow


class Stand(Task):
    """The least that a task must have: be paid for nothing but lying low."""

    name = "stand"
    time_limit = 500
    rewards: ClassVar[Mapping[str, RewardTerm]] = {"height": RewardTerm(2.0, -3.0, -1.0)}

    def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
        """Minus the greatest height."""
        return {"height": -motion.position[:, :, 2].max(axis=-1) / 0.1}

    def outcome(self, motion: Motion, worms: IntArray) -> dict[str, FloatArray]:
        """Greatest height [m]."""
        return {"height": motion.position[:, :, 2].max(axis=-1)}


class Unbounded(Stand):
    """As `Stand`, without a range."""

    rewards: ClassVar[Mapping[str, RewardTerm]] = {"height": RewardTerm(2.0)}


class Abstract(Task):
    """No task: it has a name only."""

    name = "abstract"


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ("swimming", r"^task = 'swimming': must be one of extension, compression, bending, peri"),
        (None, r"^task = None: must be one of"),
        (["bending"], r"^task = \['bending'\]: must be one of"),
        (LatticeDesign, r"^task = <class .*LatticeDesign'>: must be one of"),
        ("json:loads", r"^task = 'json:loads': must be one of .* a subclass of Task"),
        ("json:nothing", r"^task = 'json:nothing': cannot be imported: AttributeError"),
        ("no_such_module:Task", r"^task = 'no_such_module:Task': cannot be imported: ModuleNotFoundError"),
        (":", r"^task = ':': cannot be imported"),
        (Abstract, r"^task = <class .*Abstract'>: lacks time_limit, rewards, outcome, terms"),
        ("lattice_gym.tasks.base:Task", r"^task = .* lacks name, time_limit, rewards, outcome, terms"),
    ],
)
def test_what_is_no_task(task: Any, message: str) -> None:
    """The error says what would be one, or what is missing."""
    with pytest.raises(ValueError, match=message):
        resolve_task(task)


def _stand(**members: Any) -> type[Task]:
    """Task that stands, but for some members."""
    return type("Odd", (Stand,), members)


@pytest.mark.parametrize(
    ("member", "value", "message"),
    [
        ("name", "", r"^Odd.name = '': must be a text of at least one character$"),
        ("name", 3, r"^Odd.name = 3: must be a text"),
        ("time_limit", 40.0, r"^Odd.time_limit = 40.0: must be a whole number of control steps, such as 40$"),
        ("time_limit", 0, r"^Odd.time_limit = 0: must be a whole number"),
        ("time_limit", -3, r"^Odd.time_limit = -3: must be a whole number"),
        ("time_limit", True, r"^Odd.time_limit = True: must be a whole number"),
        ("rewards", ["height"], r"^Odd.rewards = \['height'\]: must be a mapping of names to RewardTerm$"),
        (
            "rewards",
            {"height": (1.0, 0.0, 1.0)},
            r"^Odd.rewards\['height'\] = .*; use RewardTerm\(weight, low, high\)$",
        ),
        ("muscles", None, r"^Odd.muscles = None: must be a method; leave it out for the default$"),
        ("observe", (1.0,), r"^Odd.observe = \(1.0,\): must be a method"),
    ],
)
def test_values_that_no_task_can_have(member: str, value: Any, message: str) -> None:
    """The error names the class, the value and the way out."""
    with pytest.raises(ValueError, match=message):
        resolve_task(_stand(**{member: value}))


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("over", "terminated"),
        ("blank_memory", "initial_memory"),
        ("surroundings", "world"),
        ("reset", "initial_memory"),
        ("observes", "observe"),
        ("command_range", "command_ranges"),
        ("init_memory", "initial_memory"),
        ("muscle", "muscles"),
    ],
)
def test_a_misspelt_part_is_told_once(written: str, meant: str) -> None:
    """With the name that is meant."""
    odd = _stand(**{written: lambda self: None})
    with pytest.warns(UserWarning, match=rf"^Odd.{written} is no part of Task, .*: if {meant} is meant, rename it$"):
        resolve_task(odd)
    assert resolve_task(odd) is odd


def test_names_of_its_own_are_a_tasks_own_matter() -> None:
    """No warning for what resembles no part of a task."""
    names = ("way", "target", "best", "distance", "angle", "record", "origin", "check_angle", "sign", "REACHED")
    resolve_task(_stand(**dict.fromkeys(names, 1.0)))


@pytest.mark.parametrize("value", [0.5, np.zeros(2), np.zeros((1, 1))])
@pytest.mark.parametrize("method", ["terms", "outcome"])
def test_a_method_must_give_a_number_a_worm(method: str, value: Any) -> None:
    """The first reset or step says which method does not, and what it gave."""
    odd = _stand(**{method: lambda self, *arguments: {"height": value}})
    env = LatticeWormEnv(odd, fidelity="fast")
    shape = re.escape(str(np.shape(value)))
    with pytest.raises(
        ValueError, match=rf"^Odd.{method}: 'height' has shape {shape}: must have \(1,\), one number a worm$"
    ):
        episode(env, 1)


class Count(Stand):
    """As `Stand`, and count the control steps of the episode."""

    def initial_memory(self) -> dict[str, FloatArray]:
        """None yet."""
        return {"steps": np.zeros(())}

    def remember(self, motion: Motion, activation: FloatArray, time: FloatArray) -> Mapping[str, FloatArray]:
        """One more."""
        return {"steps": self.memory["steps"] + 1.0}


def test_a_step_that_failed_is_not_remembered() -> None:
    """Nor one that a worm does not take; others remember theirs, and a new episode nothing."""
    worms = Worms(Scene(Count, fidelity="fast"), 3)
    for worm in range(3):
        worms.begin(worm, np.random.default_rng(0))
    torn = worms.state(1)
    torn.velocity[worms.scene.lattice.n_node // 2] = 1e6
    worms.restore(torn, 1)
    command, found = np.zeros((3, worms.scene.n_group)), []
    for live in (np.ones(3, dtype=bool), np.array([True, False, False])):
        worms.step(command, live)
        found.append(worms.task.memory["steps"].tolist())
    assert worms.failed.tolist() == [False, True, False]
    assert found == [[1.0, 0.0, 1.0], [2.0, 0.0, 1.0]]
    worms.begin(0, np.random.default_rng(0))
    assert worms.task.memory["steps"].tolist() == [0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("gives", "message"),
    [
        (None, r"^Odd.remember = None: must be a mapping of names to arrays$"),
        ({"step": np.ones(1)}, r"^Odd.remember: there is no 'step'; there are steps$"),
        (
            {"steps": np.ones((1, 1))},
            r"^Odd.remember: 'steps' has shape \(1, 1\): must have \(1,\), a row a worm as `initial_memory` has it$",
        ),
    ],
)
def test_what_cannot_be_remembered(gives: Any, message: str) -> None:
    """The first step says what is wrong."""
    odd = type("Odd", (Count,), {"remember": lambda self, *arguments: gives})
    env = LatticeWormEnv(odd, fidelity="fast")
    env.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        env.step(np.zeros(env.action_space.shape))


def test_methods_that_give_nothing() -> None:
    """As where a return was forgotten."""
    env = LatticeWormEnv(_stand(outcome=lambda self, motion, worms: None), fidelity="fast")
    with pytest.raises(ValueError, match=r"^Odd.outcome = None: must be a mapping of names to arrays$"):
        env.reset(seed=0)
    with pytest.raises(ValueError, match=r"^Odd.muscles = None: must be MuscleLayout; return one, or leave the method"):
        LatticeWormEnv(_stand(muscles=classmethod(lambda cls, lattice: None)), fidelity="fast")


def test_tasks_by_class_and_by_string() -> None:
    """A name, a class and "module:Class" are the same."""
    for name, kind in TASKS.items():
        assert resolve_task(name) is resolve_task(kind) is resolve_task(f"{kind.__module__}:{kind.__name__}") is kind
        assert task_label(kind) == name
    assert resolve_task(task_label(Stand)) is Stand

    class Local(Stand):
        """Cannot be imported."""

    assert resolve_task(Local) is Local
    with pytest.raises(ValueError, match=r"^task = .*Local'>: cannot be imported as"):
        task_label(Local)


def test_reward_weights() -> None:
    """They change their terms and nothing else; 0 takes a term away, and less than 0 turns it round."""
    weights = {"sideways": 3.0, "effort": 0.0}
    plain, changed = TASKS["bending"](LATTICE, 0.05), TASKS["bending"](LATTICE, 0.05, reward_weights=weights)
    assert changed.weights == {"bend": 1.0, "sideways": 3.0, "effort": 0.0}
    state, active = tipped(0.5, 1.0), np.full(90, 0.5)
    own, other = terms_of(plain, state, active, 0.05), terms_of(changed, state, active, 0.05)
    assert other == own | {"sideways": 3.0 * own["sideways"], "effort": 0.0}
    turned = TASKS["bending"](LATTICE, 0.05, reward_weights={"bend": -1})
    assert terms_of(turned, state, active, 0.05)["bend"] == -own["bend"]


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ({"speed": 1.0}, r"^reward_weights: there is no 'speed'; there are bend, sideways, effort$"),
        ({"divergence": 1.0}, r"^reward_weights: there is no 'divergence'"),
        ({"bend": "much"}, r"^reward_weights\['bend'\] = 'much': must be a number from -1e\+06 to 1e\+06$"),
        ({"bend": True}, r"^reward_weights\['bend'\] = True"),
        ({"bend": float("nan")}, r"^reward_weights\['bend'\] = nan"),
        ({"bend": 1e7}, r"^reward_weights\['bend'\] = 10000000.0"),
        ([1.0], r"^reward_weights = \[1.0\]: must be a mapping"),
    ],
)
def test_wrong_reward_weights(weights: Any, message: str) -> None:
    """The error names the known terms."""
    with pytest.raises(ValueError, match=message):
        TASKS["bending"](LATTICE, 0.05, reward_weights=weights)
    with pytest.raises(ValueError, match=message):
        LatticeWormEnv("bending", reward_weights=weights)


@pytest.mark.parametrize("factor", [1.0, -3.0, 100.0, 0.0])
def test_no_episode_is_worse_than_divergence(task: Task, factor: float) -> None:
    """Not even the best one cut short by it, beside the worst that lasts; 1000 where nobody changes the weights.

    What is shown is the arithmetic: by the ranges that a task states, of each step or of the whole episode. Two of
    them are no theorem: nothing crawls two body lengths a second, and rods tear before they are six times as long.
    """
    weights = {name: factor * weight for name, weight in task.weights.items()}
    changed = type(task)(task.lattice, 0.05, reward_weights=weights)
    ranges = {**task.rewards, "effort": RewardTerm(EFFORT_WEIGHT, -1.0, 0.0)}
    ends = [
        sorted((weights[name] * term.low * steps, weights[name] * term.high * steps))
        for name, term in ranges.items()
        for steps in [1 if term.per_episode else task.time_limit]
    ]
    worst, best = (sum(end[side] for end in ends) for side in (0, 1))
    assert changed.penalty == pytest.approx(max(MIN_PENALTY, best - worst), rel=1e-12)
    if factor == 1.0:
        assert changed.penalty == MIN_PENALTY > best - worst


def test_penalty_of_a_foreign_task() -> None:
    """An episode that may end at once earns nothing: 0 counts as a value although the range is below it."""
    assert Stand(LATTICE, 0.05).penalty == pytest.approx(500 * (2.0 * 3.0 + EFFORT_WEIGHT))
    assert Stand(LATTICE, 0.05, reward_weights={"height": 0.1}).penalty == MIN_PENALTY
    env = LatticeWormEnv(Stand, fidelity="fast", dt=0.005, allow_large_dt=True)
    env.reset(seed=0)
    terminated, reward, info = False, 0.0, dict[str, Any]()
    while not terminated:
        _, reward, terminated, _, info = env.step(np.ones(env.action_space.shape))
    assert reward == info["reward_terms"]["divergence"] == -env.task.penalty == -3005.0
    assert env.task.caption(env.state).startswith("height 0.1")


def test_penalty_of_longer_episodes() -> None:
    """It grows with the most steps that they may last, and tells for how many it is enough; never below the task's."""
    limits = (None, 50, 83, 84, 500)
    enough = [TASKS["reach"](LATTICE, 0.05, time_limit=limit).penalised_steps for limit in limits]
    assert enough == [83, 83, 83, 84, 500]
    longer = TASKS["reach"](LATTICE, 0.05, time_limit=500)
    assert longer.penalty == pytest.approx(500 * (12.0 + EFFORT_WEIGHT))
    assert longer.penalty > MIN_PENALTY == TASKS["reach"](LATTICE, 0.05, time_limit=83).penalty
    assert Stand(LATTICE, 0.05, reward_weights={"height": 0.0, "effort": 0.0}).penalised_steps == np.inf
    prize = type("Prize", (Stand,), {"rewards": {"height": RewardTerm(2.0, -400.0, 0.0, per_episode=True)}})
    assert prize(LATTICE, 0.05).penalised_steps == 20_000
    with pytest.raises(ValueError, match=r"^time_limit = 0: must be a whole number, at least 1, or None$"):
        LatticeWormEnv("reach", time_limit=cast(Any, 0))


@pytest.mark.parametrize("many", [False, True])
def test_an_episode_longer_than_the_penalty_is_made_for_is_told_once(many: bool) -> None:
    """With the figure and the way out: of one worm; many know their limit, and reckon with it."""
    short = type("Short", (Stand,), {"time_limit": 3, "rewards": {"height": RewardTerm(400.0, -3.0, -1.0)}})
    shared: dict[str, Any] = {"task": short, "fidelity": "fast", "control_dt": 0.005, "max_episode_steps": 6}
    make: Any = gymnasium.make_vec if many else gymnasium.make

    def play(env: Any) -> list[str]:
        env.reset(seed=0)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            for _ in range(6):
                env.step(np.zeros(env.action_space.shape))
        return [str(one.message) for one in caught]

    told = [
        "stand: an episode of more than 3 control steps may be worth less than one that diverges, which costs 3600.03: "
        "give time_limit, the most steps that an episode may last"
    ]
    assert play(make("LatticeWorm-v0", **shared)) == ([] if many else told)
    env = make("LatticeWorm-v0", **shared, time_limit=6)
    assert play(env) == []
    assert env.unwrapped.task.penalty == pytest.approx(6 * (1200.0 + EFFORT_WEIGHT))


def test_a_range_that_is_not_known_is_told() -> None:
    """With the figure and the way out; a weight of 0 needs none."""
    message = r"^stand: .*'height' is -inf to inf.*costs 1000; .*Unbounded.rewards\['height'\] = RewardTerm\(2, low"
    with pytest.warns(UserWarning, match=message):
        LatticeWormEnv(Unbounded, fidelity="fast")
    LatticeWormEnv(Unbounded, fidelity="fast", reward_weights={"height": 0.0})


def test_terms_must_be_those_that_were_declared() -> None:
    """Neither more nor fewer, and none of those of every task."""

    class Wrong(Stand):
        """Gives another term."""

        def terms(self, motion: Motion, activation: FloatArray, time: FloatArray) -> dict[str, FloatArray]:
            return {"depth": np.zeros(1)}

    with pytest.raises(ValueError, match=r"^Wrong.terms gave depth: must give the terms of its rewards, height"):
        terms_of(Wrong(LATTICE, 0.05), REST, CALM, 0.05)

    class Taken(Stand):
        """Declares what every task has."""

        rewards: ClassVar[Mapping[str, RewardTerm]] = {"effort": RewardTerm(1.0, -1.0, 0.0)}

    with pytest.raises(ValueError, match=r"^Taken.rewards: effort is a term of every task"):
        Taken(LATTICE, 0.05)


def test_design_for() -> None:
    """The task's own values, with changes; what is no field is refused."""
    assert design_for("crawl", height=0.2) == LatticeDesign(base="free", damping=0.003, height=0.2)
    assert design_for(Stand) == LatticeDesign()
    with pytest.raises(ValueError, match="speed"):
        design_for("crawl", speed=1.0)


def test_a_design_that_drops_a_value_is_told() -> None:
    """Once, with field, values and the way out; not where the value was chosen, nor for a dict."""
    with pytest.warns(UserWarning, match="^design: ") as caught:
        LatticeWormEnv("transport", LatticeDesign(elements_per_segment=2))
    (one,) = caught
    assert str(one.message) == (
        "design: this LatticeDesign has the default max_tension = 0.5 where transport has max_tension = 1.0: start "
        "from lattice_gym.design_for('transport', ...); where the default is meant, give to_dict() of it"
    )
    for design in (
        design_for("transport", elements_per_segment=2),
        design_for("transport", elements_per_segment=2, max_tension=0.5),
        LatticeDesign(max_tension=0.9),
        {"max_tension": 0.5},
    ):
        LatticeWormEnv("transport", design, fidelity="fast")
    misspelt = type("Misspelt", (TASKS["extension"],), {"name": "misspelt", "design": {"hight": 0.3}})
    for either in (LatticeDesign(), None):
        with pytest.raises(ValueError, match="there is no 'hight'; there are"):
            LatticeWormEnv(misspelt, either)


def test_a_world_that_drops_values_is_told() -> None:
    """Once, with all fields, values and the way out, be it all of the world or a part of it; not for a dict."""
    world = World(medium=Medium(), ground=Ground(stiffness=150.0), lying=True)
    with pytest.warns(UserWarning, match="^world: ") as caught:
        LatticeWormEnv("crawl", world=world, fidelity="fast")
    assert [str(one.message) for one in caught] == [
        "world: this world has the default medium.drag = 0.0 where crawl has medium.drag = 1.0: start from the task's "
        "own by a dict of what differs; where the default is meant, give to_dict() of it"
    ]
    dropped = (
        r"^world: this world has the default medium = None, ball.level = 1.0, ball.friction = 0.3 where transport has "
        r"medium = Medium\(gravity=9.81, .*\), ball.level = 4.5, ball.friction = 0.1: start"
    )
    with pytest.warns(UserWarning, match=dropped):
        LatticeWormEnv("transport", world=World(ball=Ball(radius=0.02)), fidelity="fast")
    with pytest.warns(UserWarning, match=r"^world: this world has the default medium.drag = 0.0 where crawl has"):
        LatticeWormEnv("crawl", world={"medium": Medium(density=990.0)}, fidelity="fast")
    given: Any
    for given in (
        {"medium": {"drag": 0.0}},
        {"ground": Ground(stiffness=150.0)},
        world.to_dict(),
        World(medium=Medium(drag=0.5), ground=Ground(), lying=True),
        Crawl.world(LATTICE),
    ):
        LatticeWormEnv("crawl", world=given, fidelity="fast")


@pytest.mark.parametrize("many", [False, True])
def test_an_id_with_another_time_limit_is_told_once(many: bool) -> None:
    """Unless it was given by hand: of many when they are made, of one at the end of the first episode that it ends."""

    class Nod(Stand):
        """Told of once in a process, hence a class of its own."""

    def play(steps: int, **arguments: Any) -> None:
        """Play one episode, if it has any steps."""
        make: Any = gymnasium.make_vec if many else gymnasium.make
        env = make("LatticeWorm-v0", task=Nod, fidelity="fast", control_dt=0.005, **arguments)
        if steps:
            env.reset(seed=0)
        for _ in range(steps):
            env.step(np.zeros(env.action_space.shape))
        env.close()

    play(40, max_episode_steps=40)
    with pytest.warns(UserWarning, match=r"^LatticeWorm-v0 ends episodes after 200 steps, stand is made for 500: "):
        play(0 if many else 200)
    play(0 if many else 200)
