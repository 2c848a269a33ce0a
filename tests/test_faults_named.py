"""What fails is named as it was built: muscles with kind, level and sites, rods with their hand, joints with both."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import MuscleLayout, diagonal, horizontal, named_layout, tie, vertical
from lattice_gym.checks import TAU
from lattice_gym.engines.health import Health, Status, describe
from lattice_gym.engines.registry import EngineName
from lattice_gym.engines.simulation import simulate
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.info import describe_status
from lattice_gym.envs.vector import LatticeWormVectorEnv
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.laws.lines import Line
from lattice_gym.physics.part_names import describe_part
from lattice_gym.physics.rod import straight_rod
from lattice_gym.physics.worm import build_model
from lattice_gym.rendering.scene import in_lines

UNEVEN = LatticeDesign(n_pairs=2, phases=(0.0, 2.5, 0.0, 2.5), period_ratio=1.0, elements_per_segment=3)
SWAPPED = LatticeDesign(n_pairs=3, chirality=(1, -1, 1, -1, 1, -1), period_ratio=1.5, elements_per_segment=2)
ROD: dict[str, Any] = {"radius": 0.01, "density": 1e3, "youngs_modulus": 1e6, "shear_modulus": 4e5}
SITES = re.compile(r"(?:levels? (\d+)(?: to (\d+))? )?at (\d+) deg, sites (\d+) and (\d+)")


def worms() -> dict[str, tuple[Lattice, MuscleLayout]]:
    """Worms of every kind: all muscles, one side only, along the rods, by hand, some off, as lines, without levels."""
    whole, uneven, swapped = (build_lattice(design) for design in (LatticeDesign(), UNEVEN, SWAPPED))
    lines = build_lattice(LatticeDesign(muscle_model="line", elements_per_segment=2))
    some = named_layout("all", swapped)
    return {
        "all": (whole, named_layout("all", whole)),
        "one side": (whole, named_layout("bending", whole)),
        "along the rods": (swapped, diagonal(swapped)),
        "some are off": (swapped, some.switched(np.arange(len(some.muscles)) % 3 > 0)),
        "by hand": (whole, tie(whole, [(0, 17), (40, 3)]) | horizontal(whole, levels=[2]) | vertical(whole, span=4)),
        "without levels": (uneven, tie(uneven, [(0, 3), (5, 2)])),
        "lines": (lines, named_layout("all", lines)),
        "none": (whole, MuscleLayout()),
    }


WORMS = worms()
each_worm = pytest.mark.parametrize("worm", WORMS)


@each_worm
def test_muscles_are_named_by_kind_level_azimuth_and_sites(worm: str) -> None:
    """The ends of the rod, or line, that the number stands for in the model lie at the sites named."""
    lattice, layout = WORMS[worm]
    model, height = build_model(lattice, layout), lattice.design.height
    first = model.rest_state().position
    for k, muscle in enumerate(layout.active):
        text = describe_part(lattice, layout, rod=lattice.n_rod + k, element=0)
        number, kind, place, rest = re.fullmatch(r"muscle (\d+) \((\w+), (.*)\)(.*)", text).groups()  # type: ignore[union-attr]
        assert (int(number), kind) == (k, muscle.orientation)
        assert rest == ("" if model.lines else f", element 0 of {lattice.design.elements_per_muscle}")
        low, high, degrees, *sites = SITES.fullmatch(place).groups()  # type: ignore[union-attr]
        if model.lines:
            rows = [model.line_nodes[end][k] for end in (0, 1)]
            ends = first[rows]
        else:
            ends = model.rods[lattice.n_rod + k].position[[0, -1]]
        np.testing.assert_allclose(ends, lattice.site_position[list(map(int, sites))], atol=1e-12)
        middle = ends.mean(axis=0)
        if np.hypot(*middle[:2]) > 1e-6:  # The middle of two sites across the body has no azimuth.
            apart = np.arctan2(middle[1], middle[0]) - np.radians(int(degrees))
            assert abs((apart + np.pi) % TAU - np.pi) < np.radians(0.51)
        if lattice.n_level:
            levels = sorted({low, high or low}, key=int)
            heights = sorted(set(np.round(ends[:, 2] / height * (lattice.n_level - 1)).astype(int).tolist()))
            assert [int(level) for level in levels] == heights
        else:
            assert low is None


@each_worm
def test_structure_rods_are_named_by_hand_and_level(worm: str) -> None:
    """An element lies between the levels named, or between the sites where there are none."""
    lattice, layout = WORMS[worm]
    model = build_model(lattice, layout)
    for rod in range(lattice.n_rod):
        hand = "right" if lattice.design.rod_chirality[rod] > 0 else "left"
        named = f"structure rod {rod} ({hand}-handed)"
        assert describe_part(lattice, layout, rod=rod) == named
        count = model.rods[rod].n_elem
        for element in range(count):
            text = describe_part(lattice, layout, rod=rod, element=element)
            assert text.startswith(f"{named}, element {element} of {count}, between ")
            kind, low, high = re.search(r"between (levels|sites) (\d+) and (\d+)$", text).groups()  # type: ignore[union-attr]
            ends = lattice.level_height if lattice.n_level else lattice.site_position[:, 2]
            assert kind == ("levels" if lattice.n_level else "sites")
            middle = model.rods[rod].position[element : element + 2, 2].mean()
            assert ends[int(low)] < middle < ends[int(high)]
            if kind == "sites":
                assert all(rod in lattice.site_rod[int(site)] for site in (low, high))


@each_worm
def test_joints_are_named_by_what_they_join(worm: str) -> None:
    """Both rods at a site, or a muscle and the rod that it is tied to, as in the model."""
    lattice, layout = WORMS[worm]
    model = build_model(lattice, layout)
    for k, joint in enumerate(model.joints):
        text = describe_part(lattice, layout, joint=k)
        assert text == describe_part(lattice, layout, rod=joint.rod_a, element=0, joint=k)
        site = int(re.search(r"at site (\d+)", text).group(1))  # type: ignore[union-attr]
        np.testing.assert_allclose(
            model.rods[joint.rod_b].position[joint.node_b], lattice.site_position[site], atol=1e-12
        )
        rods = [describe_part(lattice, layout, rod=rod) for rod in (joint.rod_a, joint.rod_b)]
        first, second = rods if joint.rod_b < lattice.n_rod else reversed(rods)
        assert text.startswith(f"the joint of {first} and {second} at site ")


def test_sentences() -> None:
    """As they read, of one worm and of one of several."""
    lattice, layout = WORMS["all"]
    by_hand, lines, uneven = WORMS["by hand"], WORMS["lines"], WORMS["without levels"]
    for (body, muscles), health, text in (
        (
            (lattice, layout),
            Health(Status.OVERSTRETCHED, 30, 1),
            "overstretched: muscle 18 (horizontal, level 4 at 30 deg, sites 24 and 25), element 1 of 2",
        ),
        (
            (lattice, layout),
            Health(Status.NON_FINITE, 4, 12),
            "not finite: structure rod 4 (right-handed), element 12 of 40, between levels 2 and 3",
        ),
        (
            by_hand,
            Health(Status.INVERTED, 13, 0),
            "inverted: muscle 1 (custom, levels 0 to 6 at 210 deg, sites 40 and 3), element 0 of 2",
        ),
        (
            uneven,
            Health(Status.OVERSTRETCHED, 5, 1),
            "overstretched: muscle 1 (custom, at 17 deg, sites 5 and 2), element 1 of 2",
        ),
        (
            lines,
            Health(Status.OVERSTRETCHED, 60, 0),
            "overstretched: muscle 48 (vertical, levels 0 to 2 at 0 deg, sites 0 and 12)",
        ),
        (
            (lattice, layout),
            Health(Status.TORN, 3, 15, 27),
            "torn: the joint of structure rod 1 (right-handed) and structure rod 11 (left-handed) at site 27, "
            "level 4 at 180 deg",
        ),
        ((lattice, layout), Health(Status.NON_FINITE), "not finite: the ball"),
        (
            (lattice, layout),
            Health(Status.ENERGY, 11, 0),
            "spurious energy, most of it in structure rod 11 (left-handed), element 0 of 40, between levels 0 and 1",
        ),
        ((lattice, layout), Health(Status.INACCURATE), "inaccurate, as the time step is too long: the ball"),
    ):
        assert describe(health, body, muscles) == text
        assert describe(health, body, muscles, worm=3) == f"worm 3: {text}"
    assert describe(Health(), lattice, layout, worm=3) == "ok"
    assert all(describe(Health(status, 0, 0), lattice, layout) for status in Status)


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"rod": 102}, r"^rod = 102: .* 101"),
        ({"rod": -2}, r"^rod = -2: "),
        ({"rod": 1.5}, r"^rod = 1.5: "),
        ({"rod": 3, "element": 40}, r"^element = 40: .* 39"),
        ({"rod": 12, "element": 2}, r"^element = 2: .* 1"),
        ({"joint": 288}, r"^joint = 288: "),
    ],
)
def test_numbers_without_a_part_are_refused(numbers: dict[str, Any], message: str) -> None:
    """With the largest there is."""
    with pytest.raises(ValueError, match=message):
        describe_part(*WORMS["all"], **numbers)


def test_numpy_numbers_are_taken() -> None:
    """As infos hold them."""
    numbers = {"rod": np.int64(30), "element": np.int32(1), "joint": np.int64(-1)}
    assert describe_part(*WORMS["all"], **numbers).startswith("muscle 18 ")  # type: ignore[arg-type]


def test_overstretched_line_is_named_itself(engine_name: EngineName) -> None:
    """Not the rod that it is tied to; lines count on from the rods on both engines."""
    rods = tuple(straight_rod((x, 0, 0), (x, 0, 1), 2, **ROD) for x in (0.0, 0.5))
    ties = [(0, 0, 1, 0), (0, 2, 1, 2)]
    lines = tuple(
        Line(*ends, rest_length=length, stiffness=1e-6) for ends, length in zip(ties, (0.5, 0.05), strict=True)
    )
    clamps = tuple(Clamp(rod, node=node) for rod in (0, 1) for node in (0, 1, 2))
    engine = simulate(engine_name, RodModel(rods=rods, lines=lines, clamps=clamps), 1e-6)
    assert engine.advance(np.zeros(2), 1) == Health(Status.OVERSTRETCHED, 3, 0)


def fail(env: LatticeWormEnv | LatticeWormVectorEnv, monkeypatch: pytest.MonkeyPatch, health: Health) -> None:
    """Let the last worm's next step end so."""
    engine = env.worms.engine
    worm = engine.n_worm - 1

    def advance(tension: object, n_substeps: int) -> Any:
        codes = np.zeros(engine.n_worm, np.int64)
        codes[worm] = health.status
        return codes

    monkeypatch.setattr(engine, "advance", advance)
    monkeypatch.setattr(engine, "health", lambda row=0: health if row == worm else Health())


@pytest.mark.parametrize("task", ["bending", "transport"])
def test_environments_name_them(task: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """One worm and a batch, in the status of a step."""
    design = {"elements_per_segment": 2}
    health = Health(Status.OVERSTRETCHED, 12 + 50, 1)
    text = "overstretched: muscle 50 (vertical, levels 0 to 2 at 120 deg, sites 2 and 14), element 1 of 2"
    if task == "transport":
        health, text = Health(Status.NON_FINITE), "not finite: the ball"
    one = LatticeWormEnv(task, design, fidelity="fast")
    many = LatticeWormVectorEnv(3, task=task, design=design, fidelity="fast")
    for env in (one, many):
        env.reset(seed=0)
        fail(env, monkeypatch, health)
        info = env.step(np.zeros(env.action_space.sample().shape))[4]
        assert describe_status(info, env, -1) == text
    assert one.worms.status() == text
    assert many.worms.status(2) == f"worm 2: {text}"
    assert many.worms.status(0) == many.worms.status(1) == "ok"


def test_world_in_which_a_worm_fails_says_where() -> None:
    """Worms settle before there is an episode; the error says what failed as well."""
    soft = {"elements_per_segment": 2, "structure_youngs_modulus": 500.0, "muscle_youngs_modulus": 100.0}
    with pytest.raises(ValueError, match=r"do not come to rest in it: inverted: muscle \d+ \(\w+, level \d+ at "):
        LatticeWormEnv("crawl", soft, world={"medium": {"gravity": 100.0, "density": 0.0}})


def test_sentence_is_not_broken_within_a_word_of_a_picture() -> None:
    """A line of text ends between words, and before a bracket rather than in it."""
    lattice, layout = WORMS["all"]
    text = describe(Health(Status.TORN, joint=96 + 5), lattice, layout)
    for width in range(40, 120):
        lines = in_lines(text, width).split("\n")
        assert " ".join(lines) == text
        assert all(line.count("(") == line.count(")") for line in lines if width > 50)
