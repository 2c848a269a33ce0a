"""Tasks: rewards of shapes whose reward is known, commands, and what hand-made gaits earn from the physics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from task_scenes import CALM, LATTICE, MODEL, REST, SHAPE, observed, shaped, terms_of, tipped

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.fidelity import FidelityName
from lattice_gym.physics.measures import muscle_lengths, top_centre
from lattice_gym.physics.state import Motion, RodState
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model
from lattice_gym.tasks.base import EFFORT_WEIGHT, Task
from lattice_gym.tasks.peristalsis import FULL_DRIVE_AMPLITUDE, Peristalsis
from lattice_gym.tasks.reach import EIGHT_TARGETS
from lattice_gym.tasks.registry import TASKS, design_for, gait

pytestmark = pytest.mark.slow


def _outcome(task: Task, state: RodState) -> dict[str, float]:
    """Outcome of the only worm."""
    return {name: value.item() for name, value in task.outcome(Motion.of(state), np.array([0])).items()}


def _over(task: Task, state: RodState) -> bool:
    """Whether the episode of the only worm is over."""
    return bool(task.terminated(Motion.of(state)).item())


CARRIER = build_model(LATTICE, named_layout("all", LATTICE), TASKS["transport"].world(LATTICE))
WAVE = {"speed": 0.1, "wavelength": 0.1, "amplitude": 0.05, "phase": 0.0}
LEAST = {"reach": 0.08, "crawl": 0.02, "transport": 0.03}
"""What gaits earn a step at least; else 0.15."""


def _widened(deviation: FloatArray) -> RodState:
    """Rest positions with levels 1 to 8 widened by these shares."""
    width = 1.0 + np.interp(SHAPE[:, 2] / 0.1 * 8, np.arange(9), np.concatenate([[0.0], deviation]))[:, None]
    return shaped(SHAPE * np.concatenate([width, width, np.ones_like(width)], axis=1))


def _play(
    task: str, act: Callable[[LatticeWormEnv], npt.ArrayLike], **command: Any
) -> tuple[FloatArray, dict[str, Any]]:
    """Rewards of an episode and the last info."""
    env, rewards, info = LatticeWormEnv(task, command=command), [], dict[str, Any]()
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(TASKS[task].time_limit):
        _, reward, terminated, _, info = env.step(act(env))
        rewards.append(reward)
        if terminated:
            assert info["outcome"].get("delivered", 0.0) == 1.0
            break
    return np.array(rewards), info


def test_terms_have_their_names(task: Task) -> None:
    """In order; an outcome is not the reward; what is observed has its bounds; rest earns zero."""
    task.begin(np.random.default_rng(0), None)
    terms = terms_of(task, task.rest, CALM, 0.05)
    assert tuple(terms) == (*task.rewards, "effort")
    assert sum(terms.values()) == pytest.approx(0.0, abs=1e-12)
    assert observed(task, task.rest, 0.05).shape == (len(task.bounds),)
    assert all(isinstance(value, float) for value in {**terms, **_outcome(task, task.rest)}.values())


def test_effort_has_a_price(task: Task) -> None:
    """Every muscle fully active for nothing costs the effort alone."""
    assert sum(terms_of(task, task.rest, np.ones(90), 0.05).values()) == pytest.approx(-EFFORT_WEIGHT)
    assert terms_of(task, task.rest, np.full(90, 0.5), 0.05)["effort"] == pytest.approx(-0.25 * EFFORT_WEIGHT)


@given(stretch=st.floats(-0.5, 1.0))
def test_length(stretch: float) -> None:
    """Extension pays the strain, compression its opposite; the outcome is the same."""
    state = shaped(SHAPE * [1.0, 1.0, 1.0 + stretch])
    for name, sign in (("extension", 1.0), ("compression", -1.0)):
        task = TASKS[name](LATTICE, 0.05)
        assert terms_of(task, state, CALM, 0.0)["strain"] == pytest.approx(sign * stretch, abs=1e-12)
        assert _outcome(task, state)["strain"] == pytest.approx(stretch, abs=1e-12)


@given(angle=st.floats(0.01, 3.0), azimuth=st.floats(0.0, 6.28), command=st.floats(-6.28, 6.28))
def test_bending(angle: float, azimuth: float, command: float) -> None:
    """The part of the bend along the command counts, the part across counts against."""
    task = TASKS["bending"](LATTICE, 0.05, {"azimuth": command})
    terms, outcome = terms_of(task, tipped(angle, azimuth), CALM, 0.0), _outcome(task, tipped(angle, azimuth))
    assert terms["bend"] == pytest.approx(angle * np.cos(azimuth - command), abs=1e-9)
    assert terms["sideways"] == pytest.approx(-angle * abs(np.sin(azimuth - command)), abs=1e-9)
    assert outcome["bend_angle"] == pytest.approx(angle, abs=1e-9)
    assert np.cos(outcome["bend_direction"] - azimuth) == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(observed(task, REST, 0.0), [np.cos(command), np.sin(command)])


@given(
    moved=st.tuples(*[st.floats(-0.15, 0.15)] * 3),
    azimuth=st.floats(-6.28, 6.28),
    radius=st.floats(0.0, 1.5),
    rise=st.floats(-1.0, 1.5),
)
def test_reach(moved: tuple[float, ...], azimuth: float, radius: float, rise: float) -> None:
    """What is earned is how much nearer the target is, in body lengths, wherever the whole body goes."""
    task = TASKS["reach"](LATTICE, 0.05, {"azimuth": azimuth, "radius": radius, "rise": rise}, MODEL)
    target = 0.1 * np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), rise])
    state, near = shaped(SHAPE + moved), float(np.linalg.norm(target - moved))
    terms, outcome = terms_of(task, state, CALM, 0.35), _outcome(task, state)
    assert terms["approach"] == pytest.approx((np.linalg.norm(target) - near) / 0.1, abs=1e-5)
    assert outcome["distance"] == pytest.approx(near, abs=1e-6)
    if abs(near - 0.003) > 1e-6:
        assert (outcome["reached"], outcome["reach_time"]) == ((1.0, 0.35) if near < 0.003 else (0.0, 0.0))
    np.testing.assert_allclose(observed(task, state, 0.35), np.clip((target - moved) / 0.02, -10.0, 10.0), atol=1e-4)
    np.testing.assert_allclose(task.markers(0), target[None] + [[0.0, 0.0, 0.1]], atol=1e-7)


def test_reach_lies_down() -> None:
    """A target lies down with the body."""
    lattice = build_lattice(LatticeDesign(base="free"))
    model = build_model(lattice, named_layout("all", lattice), World(lying=True))
    task = TASKS["reach"](lattice, 0.05, {"azimuth": 0.0, "radius": 0.2, "rise": -0.1}, model)
    state = model.rest_state()
    state.position[:] += [-0.01, 0.0, -0.02]  # along the axis, which is x now, and along what was x, which is down
    assert terms_of(task, state, CALM, 0.0)["approach"] == pytest.approx(np.hypot(0.2, 0.1), abs=1e-6)
    np.testing.assert_allclose(task.markers(0), [top_centre(lattice, state.position)], atol=1e-8)


def _crawl(**command: float) -> Task:
    return TASKS["crawl"](build_lattice(design_for("crawl")), 0.05, command)


@given(way=st.floats(-0.05, 0.05), aside=st.floats(-0.05, 0.05), direction=st.sampled_from([-1.0, 1.0]))
@settings(deadline=None)
def test_crawl(way: float, aside: float, direction: float) -> None:
    """Ten for a height along the command, nothing for what goes aside; the steps of a way add up to it."""
    task = _crawl(direction=direction)
    task.begin(np.random.default_rng(0), None)
    state, total = task.rest, 0.0
    for k in range(1, 5):
        state = replace(task.rest, position=task.rest.position + 0.25 * k * np.array([way, aside, 0.01]))
        total += terms_of(task, state, CALM, 0.05 * k)["progress"]
    along, outcome = 10.0 * direction * way, _outcome(task, state)
    assert total == pytest.approx(10.0 * along, abs=1e-9)
    assert outcome["speed"] == pytest.approx(60.0 * along / 0.2, abs=1e-6)
    far = np.hypot(way, aside) > 1.01e-3
    assert outcome["drift"] == pytest.approx(np.arctan2(abs(aside), direction * way) if far else 0.0, abs=1e-6)
    assert outcome["cost_of_transport"] == 0.0
    np.testing.assert_allclose(observed(task, state, 0.2), [direction, 10.0 * aside], atol=1e-9)


@pytest.mark.parametrize("strength", [1.0, np.linspace(0.5, 1.0, 90)])
def test_cost_of_transport(strength: float | FloatArray) -> None:
    """Every muscle a millimetre shorter under half its tension, then longer, over weight times way."""
    task = _crawl(direction=1.0)
    task.strength = strength
    task.begin(np.random.default_rng(0), None)
    half, length = np.full(90, 0.5), muscle_lengths(task.model, task.rest.position)
    terms_of(task, task.rest, half, 0.05)
    short = task.rest.copy()
    for muscle in task.model.muscles:
        rows = task.model.nodes(muscle)
        middle = short.position[rows].mean(axis=0)
        short.position[rows] = middle + (short.position[rows] - middle) * (1.0 - 0.001 / length[muscle - 12])
    for state, time in ((short, 0.1), (task.rest, 0.15)):
        terms_of(task, state, half, time)
    moved = replace(task.rest, position=task.rest.position + np.array([0.02, 0.0, 0.0]))
    terms_of(task, moved, half, 0.2)
    mass = task.model.node_mass.sum()
    assert mass == pytest.approx(0.425, rel=0.01)
    work = 90 * np.mean(strength) * 0.25 * 0.001
    assert _outcome(task, moved)["cost_of_transport"] == pytest.approx(work / (mass * 9.81 * 0.02), rel=1e-9)
    assert task.caption(moved) == "+60.0 body lengths/min along +x, 0 deg off course"


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_the_crawling_gait_crawls_both_ways(direction: float) -> None:
    """On isotropic ground, at more than what was asked for by half, and hardly off course."""
    _, info = _play(
        "crawl",
        lambda env: gait("crawl", env.lattice, env.layout, env.task.command)(env.time),
        direction=direction,
    )
    assert info["outcome"]["speed"] > 3.0
    assert info["outcome"]["drift"] < np.radians(10.0)
    assert 1.0 < info["outcome"]["cost_of_transport"] < 10.0


@given(
    height=st.floats(-0.02, 0.12), off=st.floats(0.0, 0.06), angle=st.floats(0.0, 6.28), up=st.sampled_from([-1.0, 1.0])
)
@settings(deadline=None)
def test_transport(height: float, off: float, angle: float, up: float) -> None:
    """Ten for a height along the command; out by the commanded end is delivered, by another way lost."""
    task = TASKS["transport"](LATTICE, 0.05, {"direction": up}, CARRIER)
    task.begin(np.random.default_rng(0), None)
    state = task.rest.copy()
    state.ball_position[:] = [off * np.cos(angle), off * np.sin(angle), height]
    if min(abs(height), abs(height - 0.1), abs(off - 0.0375)) < 1e-9:
        return
    terms, outcome = terms_of(task, state, CALM, 0.5), _outcome(task, state)
    way = up * (np.clip(height, 0.0, 0.1) - 0.05625)
    end = np.sign(height - 0.05) if not 0.0 < height < 0.1 else 0.0
    lost = end == -up or (end == 0.0 and off > 0.0375)
    assert terms["progress"] == pytest.approx(100.0 * way, abs=1e-9)
    assert terms["lost"] == (-5.0 if lost else 0.0)
    assert outcome["distance"] == pytest.approx(way, abs=1e-9)
    assert outcome["speed"] == pytest.approx(2.0 * way, abs=1e-9)
    assert (outcome["held"], outcome["delivered"]) == (float(not lost), float(end == up))
    assert _over(task, state) == bool(end or lost)


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("fidelity", ["fast", "default"])
def test_the_carrying_gait_carries_both_ways(direction: float, fidelity: FidelityName) -> None:
    """From the middle out by the commanded end, two fifths of the height and more, on either mesh."""
    env = LatticeWormEnv("transport", command={"direction": direction}, fidelity=fidelity)
    env.reset(seed=0)
    wave, info = gait("transport", env.lattice, env.layout, env.task.command), dict[str, Any]()
    for _ in range(200):
        _, _, terminated, _, info = env.step(wave(env.time))
        if terminated:
            break
    assert info["outcome"]["delivered"] == 1.0
    assert info["outcome"]["distance"] > 0.04
    assert 0.01 < info["outcome"]["speed"] < 0.016


def test_eight_targets_are_reached() -> None:
    """To a fiftieth of the height by the hand-made gait, and within a second."""
    azimuths = EIGHT_TARGETS["azimuth"]
    assert isinstance(azimuths, list)
    for azimuth in azimuths:
        _, info = _play(
            "reach",
            lambda env: gait("reach", env.lattice, env.layout, env.task.command)(env.time),
            **(dict(EIGHT_TARGETS) | {"azimuth": azimuth}),
        )
        assert info["outcome"]["distance"] < 0.02 * 0.1
        assert 0.0 < info["outcome"]["reach_time"] < 1.0


@given(share=st.floats(-1.0, 2.0), phase=st.floats(-6.0, 6.0), time=st.floats(0.0, 5.0), up=st.booleans())
def test_tracking(share: float, phase: float, time: float, up: bool) -> None:
    """A share s of the commanded wave earns (2 s - s^2) / (1 + (1 - s)^2): 1 for all, -3/5 for its opposite."""
    task = TASKS["peristalsis"](LATTICE, 0.05, WAVE | {"speed": 0.1 if up else -0.1, "phase": phase})
    assert isinstance(task, Peristalsis)
    # The 8 levels span one wavelength, so sums over them do not depend on the time.
    target = 0.05 * np.cos(2 * np.pi * ((1 if up else -1) * time - np.arange(1, 9) / 8) + phase)
    np.testing.assert_allclose(task.target(np.array([time]))[0], target, atol=1e-12)
    earned = terms_of(task, _widened(share * target), CALM, time)["tracking"]
    assert earned == pytest.approx((2.0 * share - share**2) / (1.0 + (1.0 - share) ** 2), abs=1e-9)


@given(deviation=st.lists(st.floats(-0.9, 3.0), min_size=8, max_size=8), wave=st.integers(0, 50))
def test_tracking_is_bounded(deviation: list[float], wave: int) -> None:
    """From -1 to 2 whatever the rings do and whatever wave may be asked for."""
    rng = np.random.default_rng(wave)
    command = {"speed": 0.08, "wavelength": rng.uniform(0.04, 1.0), "amplitude": rng.uniform(0.001, 0.5)}
    task = TASKS["peristalsis"](LATTICE, 0.05, command | {"phase": rng.uniform(-6.0, 6.0)})
    assert -1.0 <= terms_of(task, _widened(np.array(deviation)), CALM, 0.3)["tracking"] <= 2.0


@given(seed=st.integers(0, 1000), size=st.floats(1e-3, 0.5))
def test_no_still_shape_follows_a_wave(seed: int, size: float) -> None:
    """Over a whole period any fixed deviation costs, and none costs more than 1 a step."""
    task = TASKS["peristalsis"](LATTICE, 0.05, WAVE)
    deviation = np.random.default_rng(seed).uniform(-size, size, 8)
    earned = [terms_of(task, _widened(deviation), CALM, 0.05 * k)["tracking"] for k in range(20)]
    assert -1.0 <= np.mean(earned) < 0.0


def test_holding_all_rings_costs_little() -> None:
    """An unbounded error paid -2874 for an episode of it, less than blowing up at its start."""
    rewards, _ = _play(
        "peristalsis",
        lambda env: np.array([float(m.orientation == "horizontal") for m in env.layout.active]),
        amplitude=0.04,
    )
    assert -200.0 * (1.0 + EFFORT_WEIGHT) < rewards.sum() < 0.0


def test_the_wave_is_measured_over_two_periods() -> None:
    """Nothing before, then the commanded wave's index, direction and speed; a new episode forgets."""
    task = TASKS["peristalsis"](LATTICE, 0.05, WAVE | {"speed": -0.1})
    assert isinstance(task, Peristalsis)
    task.begin(np.random.default_rng(0), None)
    for step in range(1, 41):
        assert set(_outcome(task, REST).values()) == {0.0}
        assert task.caption(REST) == ""
        terms_of(task, _widened(task.target(np.array([0.05 * step]))[0]), CALM, 0.05 * step)
    outcome = _outcome(task, REST)
    assert outcome["wave_index"] > 0.99
    assert outcome["wave_direction"] == -1.0
    assert outcome["wave_speed"] == pytest.approx(0.1, rel=1e-6)
    assert outcome["wave_amplitude"] == pytest.approx(0.05, rel=1e-6)
    asked = "(asked: down at 0.100 m/s, 5.0 %)"
    assert task.caption(REST) == f"wave index 1.00, down at 0.100 m/s, amplitude 5.0 % {asked}"
    for step in range(41, 81):
        terms_of(task, REST, CALM, 0.05 * step)
    assert task.caption(REST) == f"wave index 0.00, going nowhere, amplitude 0.0 % {asked}"
    task.begin(np.random.default_rng(0), None)
    assert _outcome(task, REST)["wave_index"] == 0.0


@pytest.mark.parametrize("control", ["muscle", "ring", "column"])
def test_random_actions_make_no_wave(control: str) -> None:
    """Of a direction and a speed; how far the radii moved is told all the same."""
    for seed in range(3):
        env = LatticeWormEnv(control=control)
        env.reset(seed=seed)
        rng, info = np.random.default_rng(seed), dict[str, Any]()
        for _ in range(80):
            info = env.step(rng.random(env.action_space.shape))[4]
        outcome = info["outcome"]
        assert (outcome["wave_index"], outcome["wave_direction"], outcome["wave_speed"]) == (0.0, 0.0, 0.0)
        assert 0.004 < outcome["wave_amplitude"] < 0.05


@pytest.mark.parametrize(("drive", "travels"), [(1.0, True), (0.1, True), (1e-4, False)])
def test_a_vanishing_gait_makes_no_wave(drive: float, travels: bool) -> None:
    """A tenth of the drive still does, and its amplitude says how little."""
    env = LatticeWormEnv(command=WAVE)
    env.reset(seed=0)
    wave, info = gait("peristalsis", env.lattice, env.layout, env.task.command), dict[str, Any]()
    for _ in range(80):
        info = env.step(drive * wave(env.time))[4]
    outcome = info["outcome"]
    assert (outcome["wave_index"] > 0.8) == (outcome["wave_direction"] == 1.0) == travels
    assert outcome["wave_amplitude"] == pytest.approx(0.048 * drive, rel=0.1)


def test_captions() -> None:
    """Units, and what was asked beside what came; what stands upright leans no way."""
    assert TASKS["extension"](LATTICE, 0.05).caption(shaped(SHAPE * [1.0, 1.0, 1.311])) == "strain +31.1 %"
    assert TASKS["compression"](LATTICE, 0.05).caption(shaped(SHAPE * [1.0, 1.0, 0.8])) == "strain -20.0 %"
    bending = TASKS["bending"](LATTICE, 0.05, {"azimuth": np.radians(-270.0)})
    lean = tipped(np.radians(24.6), np.radians(92.0))
    assert bending.caption(lean) == "bend 24.6 deg towards 92 deg (asked: 90 deg)"
    assert bending.caption(tipped(0.1, np.radians(359.7))) == "bend 5.7 deg towards 0 deg (asked: 90 deg)"
    assert bending.caption(REST) == "bend 0.0 deg (asked: 90 deg)"
    transport = TASKS["transport"](LATTICE, 0.05, {"direction": 1.0}, CARRIER)
    state = transport.rest.copy()
    for height, end in ((0.06, ""), (0.101, ", delivered"), (-0.01, ", lost")):
        state.ball_position[0, 2] = height
        terms_of(transport, state, CALM, 2.0)
        way = 1e3 * (min(max(height, 0.0), 0.1) - 0.05625)
        assert transport.caption(state) == f"{way:+.1f} mm up at {way / 2:.1f} mm/s{end}"
    reach = TASKS["reach"](LATTICE, 0.05, {"azimuth": 0.0, "radius": 0.2, "rise": 0.0})
    assert reach.caption(REST) == "20.0 mm from the target"
    there = shaped(SHAPE + np.array([0.02, 0.0, 0.0]))
    terms_of(reach, there, CALM, 1.5)
    assert reach.caption(there) == "0.0 mm from the target, reached after 1.50 s"


def test_a_free_body_is_not_paid_for_tilting() -> None:
    """Tipped over whole it neither bends, stretches nor shrinks; the same body on a clamped base bends."""
    lattice = build_lattice(LatticeDesign(base="free"))
    for name, term in (("bending", "bend"), ("extension", "strain"), ("compression", "strain")):
        terms = terms_of(TASKS[name](lattice, 0.05), tipped(0.7, 1.0), CALM, 0.0)
        assert terms[term] == pytest.approx(0.0, abs=1e-12)
    clamped = TASKS["bending"](LATTICE, 0.05, {"azimuth": 1.0})
    assert terms_of(clamped, tipped(0.7, 1.0), CALM, 0.0)["bend"] > 0.69


def test_slow_control_steps_cannot_follow() -> None:
    """The fastest wave that may be drawn must be sampled; a slower one may be asked for."""
    with pytest.raises(ValueError, match=r"^command: .*period of 0.666667 s; it must last 4 control steps"):
        TASKS["peristalsis"](LATTICE, 0.2)
    TASKS["peristalsis"](LATTICE, 0.2, {"speed": 0.05})


@pytest.mark.parametrize("name", list(TASKS))
def test_gaits_beat_doing_nothing_and_chance(name: str) -> None:
    """Doing nothing earns nothing, to what settling leaves, and a gait more than random commands."""
    nothing, _ = _play(name, lambda env: np.zeros(env.action_space.shape))
    chance, _ = _play(name, lambda env: env.action_space.sample())
    made, _ = _play(name, lambda env: gait(name, env.lattice, env.layout, env.task.command)(env.time))
    assert np.abs(nothing).max() < 1e-4
    assert made.mean() > LEAST.get(name, 0.15)
    assert made.mean() > 1.4 * max(chance.mean(), 0.0)
    if name in ("bending", "peristalsis"):
        assert chance.mean() < 0.01


def test_lengths_of_gaits() -> None:
    """As PyElastica gave them in a rebuild of the paper's worm at 0.5 N: +30.8 % and -18.6 %, here after 2 s."""
    for name, strain in (("extension", 0.308), ("compression", -0.186)):
        _, info = _play(name, lambda env: gait(env.task.name, env.lattice, env.layout, {})(env.time))
        assert info["outcome"]["strain"] == pytest.approx(strain, rel=0.05)


@pytest.mark.parametrize("azimuth", [0.0, 2.0, -1.1])
def test_bends_of_gaits(azimuth: float) -> None:
    """A bend of more than 20 degrees, within 3 degrees of where it was asked."""
    _, info = _play(
        "bending", lambda env: gait("bending", env.lattice, env.layout, env.task.command)(0.0), azimuth=azimuth
    )
    assert np.degrees(info["outcome"]["bend_angle"]) > 20.0
    assert np.cos(info["outcome"]["bend_direction"] - azimuth) > np.cos(np.radians(3.0))


@pytest.mark.parametrize(("speed", "wavelength"), [(0.08, 0.12), (0.12, 0.08), (0.1, 0.1), (-0.1, 0.1)])
def test_the_antiphase_gait_can_make_the_wave_that_is_drawn(speed: float, wavelength: float) -> None:
    """At the corners of what is drawn, and downwards: amplitude, mean, reward, direction and speed."""
    env = LatticeWormEnv(
        command={"speed": speed, "wavelength": wavelength, "amplitude": FULL_DRIVE_AMPLITUDE, "phase": 0.0}
    )
    env.reset(seed=0)
    wave, rewards, info = gait("peristalsis", env.lattice, env.layout, env.task.command), [], dict[str, Any]()
    for _ in range(200):
        _, reward, _, _, info = env.step(wave(env.time))
        rewards.append(reward)
    assert isinstance(env.task, Peristalsis)
    middle = env.task.record()[:, 3:6]
    amplitude = 0.5 * (middle.max(axis=0) - middle.min(axis=0))
    np.testing.assert_allclose(amplitude, FULL_DRIVE_AMPLITUDE, rtol=0.15)
    np.testing.assert_allclose(middle.mean(axis=0), 0.0, atol=0.01)
    assert np.mean(rewards[40:]) > 0.75
    assert info["outcome"]["wave_index"] > 0.7
    assert info["outcome"]["wave_direction"] == np.sign(speed)
    assert info["outcome"]["wave_speed"] == pytest.approx(abs(speed), rel=0.1)
