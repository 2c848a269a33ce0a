"""Trajectories: what may be recorded, and files that are read back exactly or refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import MuscleLayout, horizontal, named_layout, tie
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model
from lattice_gym.recording.files import replacing
from lattice_gym.recording.trajectory import Recorder, Trajectory, n_nodes

DESIGN = LatticeDesign(n_pairs=2, period_ratio=1.0, elements_per_segment=1, structure_radius=3e-3)
LATTICE = build_lattice(DESIGN)
LAYOUT = horizontal(LATTICE, [1, 2])
N_NODE = n_nodes(DESIGN, LAYOUT)


def example(n_frame: int = 3, **changes: Any) -> Trajectory:
    """Return a sound trajectory with some fields changed."""
    rng = np.random.default_rng(5)
    values: dict[str, Any] = {
        "time": np.arange(n_frame) / 3,
        "position": rng.normal(size=(n_frame, N_NODE, 3)),
        "activation": rng.random((n_frame, len(LAYOUT))),
        "reward": rng.normal(size=n_frame),
        "outcome": tuple(f"strain {k} %, été" for k in range(n_frame)),
        "design": DESIGN,
        "layout": LAYOUT,
        "task": "extension",
    }
    return Trajectory(**{**values, **changes})


def assert_same(a: Trajectory, b: Trajectory) -> None:
    """Fail unless two trajectories are equal to the last bit."""
    for name in ("time", "position", "ball", "activation", "reward", "markers"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), strict=True)
    assert (a.outcome, a.design, a.layout, a.task, a.world) == (b.outcome, b.design, b.layout, b.task, b.world)


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Trajectory]:
    """Return the path of a saved trajectory and the trajectory."""
    path = tmp_path_factory.mktemp("saved") / "t.npz"
    trajectory = example()
    trajectory.save(path)
    return path, trajectory


def rewrite(path: Path, target: Path, **changes: Any) -> None:
    """Copy a saved trajectory with some members changed, or left out if None."""
    with np.load(path) as members:
        values = {**members, **changes}
    np.savez(target, **{name: value for name, value in values.items() if value is not None})


@pytest.mark.parametrize("muscle_model", ["rod", "line"])
@pytest.mark.parametrize("layout", ["extension", "all"])
def test_node_count_is_the_models(layout: str, muscle_model: str) -> None:
    """What the design and the layout say is what the model has."""
    lattice = build_lattice(LatticeDesign(elements_per_segment=2, elements_per_muscle=3, muscle_model=muscle_model))
    muscles = named_layout(layout, lattice)
    assert n_nodes(lattice.design, muscles) == build_model(lattice, muscles).n_node


def test_round_trip(saved: tuple[Path, Trajectory]) -> None:
    """A file gives back every bit."""
    assert_same(Trajectory.load(saved[0]), saved[1])


@given(
    task=st.text(),
    outcome=st.lists(st.text(st.characters(exclude_categories=[])), min_size=1, max_size=3),
    rewards=st.data(),
    on=st.booleans(),
)
@settings(max_examples=50, deadline=None)
def test_round_trip_of_any_text_and_number(
    tmp_path_factory: pytest.TempPathFactory, task: str, outcome: list[str], rewards: st.DataObject, on: bool
) -> None:
    """Lone surrogates, NULs, subnormal and huge numbers, and no active muscle included."""
    reward = rewards.draw(
        st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=len(outcome), max_size=len(outcome))
    )
    layout = LAYOUT.switched(np.array([on] * len(LAYOUT.muscles)))
    n_frame, path = len(outcome), tmp_path_factory.mktemp("text") / "any.npz"
    trajectory = example(
        n_frame,
        task=task,
        outcome=outcome,
        reward=reward,
        layout=layout,
        position=np.full((n_frame, n_nodes(DESIGN, layout), 3), -1e-40),
        activation=np.ones((n_frame, len(layout))),
    )
    trajectory.save(path)
    assert_same(Trajectory.load(path), trajectory)


def test_file_reads_without_pickle_or_this_package(saved: tuple[Path, Trajectory]) -> None:
    """Plain numpy opens it."""
    with np.load(saved[0], allow_pickle=False) as members:
        assert members["position"].shape == (3, N_NODE, 3)
        assert json.loads(members["meta"].item())["version"] == 4


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("time", [0.0, 1.0, 1.0], "must increase; frame 2"),
        ("time", [0.0, np.nan, 1.0], "finite"),
        ("time", [[0.0, 1.0, 2.0]], "shape"),
        ("position", np.zeros((3, N_NODE - 1, 3)), "shape"),
        ("position", np.full((3, N_NODE, 3), np.inf), "finite"),
        ("position", np.full((3, N_NODE, 3), 1e300), "finite"),
        ("position", "here", "array of real numbers"),
        ("activation", np.full((3, len(LAYOUT)), 1.01), "must be a number from"),
        ("activation", np.full((3, len(LAYOUT)), -0.01), "must be a number from"),
        ("activation", np.zeros((3, len(LAYOUT) + 1)), "shape"),
        ("reward", np.array([0.0, np.nan, 0.0]), "finite"),
        ("outcome", ("", ""), "one a frame"),
        ("outcome", ("", "", 3), r"\[2\] = 3: must be text"),
        ("task", None, "must be text"),
        ("world", {}, "must be World"),
        ("ball", np.zeros((3, 1, 3)), "has shape"),
        ("markers", np.zeros(3), "has shape"),
        ("markers", np.full((1, 3), np.nan), "finite"),
        ("markers", "there", "array of real numbers"),
    ],
)
def test_wrong_values_are_refused(name: str, value: Any, words: str) -> None:
    """The message names the field and what is wrong."""
    with pytest.raises(ValueError, match=rf"Trajectory\.{name}.*{words}"):
        example(**{name: value})


def test_no_frame_is_refused() -> None:
    """There is nothing to show in it."""
    with pytest.raises(ValueError, match="at least one frame"):
        example(0)
    with pytest.raises(ValueError, match="at least one"):
        Recorder(DESIGN, LAYOUT, "extension").build()


def test_layout_of_another_lattice_is_refused() -> None:
    """Its sites do not exist here."""
    far = tie(build_lattice(LatticeDesign()), [(0, 53)])
    with pytest.raises(ValueError, match="site 53"):
        example(layout=far)


def test_arrays_are_own_and_read_only() -> None:
    """No caller can change a trajectory afterwards."""
    time = np.arange(3.0)
    trajectory = example(time=time)
    time[0] = -9.0
    assert trajectory.time[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        trajectory.position[0] = 0.0


def test_recorder_copies_its_frames() -> None:
    """A caller may go on using its arrays."""
    recorder = Recorder(DESIGN, LAYOUT, "bending")
    position, activation = np.zeros((N_NODE, 3)), np.zeros(len(LAYOUT))
    for k in range(4):
        position += 1.0
        activation += 0.1
        recorder.append(0.05 * k, position, activation, reward=-k, outcome=f"{k}")
    trajectory = recorder.build()
    assert len(recorder) == trajectory.n_frame == 4
    np.testing.assert_array_equal(trajectory.position[:, 0, 0], [1, 2, 3, 4])
    np.testing.assert_allclose(trajectory.activation[:, 0], [0.1, 0.2, 0.3, 0.4], rtol=1e-6)
    np.testing.assert_array_equal(trajectory.reward, [0, -1, -2, -3])
    assert trajectory.outcome == ("0", "1", "2", "3")
    assert trajectory.task == "bending"


def test_a_ball_is_kept(tmp_path: Path) -> None:
    """With the world that has one, through the file."""
    recorder = Recorder(DESIGN, LAYOUT, "transport", World(ball=Ball(radius=0.01)))
    for k in range(2):
        recorder.append(0.1 * k, np.zeros((N_NODE, 3)), np.zeros(len(LAYOUT)), ball=[[0.0, 0.0, 0.5 * k]])
    with pytest.raises(ValueError, match="ball has shape"):
        recorder.append(0.2, np.zeros((N_NODE, 3)), np.zeros(len(LAYOUT)))
    trajectory = recorder.build()
    trajectory.save(tmp_path / "ball.npz")
    again = Trajectory.load(tmp_path / "ball.npz")
    assert_same(again, trajectory)
    assert again.world.ball == Ball(radius=0.01)
    assert again.ball is not None
    np.testing.assert_array_equal(again.ball[:, 0, 2], [0.0, 0.5])
    with pytest.raises(ValueError, match=r"^Trajectory\.world = 'sea': must be World"):
        Recorder(DESIGN, LAYOUT, "transport", "sea")  # type: ignore[arg-type]


def test_markers_are_kept_and_older_files_have_none(saved: tuple[Path, Trajectory], tmp_path: Path) -> None:
    """Through the file; one of version 2 has none, and no other version may lack them."""
    recorder = Recorder(DESIGN, LAYOUT, "reach")
    recorder.append(0.0, np.zeros((N_NODE, 3)), np.zeros(len(LAYOUT)))
    trajectory = recorder.build([[0.1, 0.0, 0.5]])
    trajectory.save(tmp_path / "marked.npz")
    again = Trajectory.load(tmp_path / "marked.npz")
    assert_same(again, trajectory)
    np.testing.assert_array_equal(again.markers, np.array([[0.1, 0.0, 0.5]], np.float32))
    old = tmp_path / "old.npz"
    rewrite(saved[0], old, markers=None, meta=edited(saved[0], version=2))
    assert_same(Trajectory.load(old), saved[1])
    rewrite(saved[0], old, markers=None)
    with pytest.raises(ValueError, match=r"old\.npz.*version 4; must be version 2"):
        Trajectory.load(old)


def test_the_ball_of_older_files_is_read(tmp_path: Path) -> None:
    """Version 3 had another name for it."""
    recorder = Recorder(DESIGN, LAYOUT, "transport", World(ball=Ball(radius=0.01)))
    recorder.append(0.0, np.zeros((N_NODE, 3)), np.zeros(len(LAYOUT)), ball=[[0.0, 0.0, 0.5]])
    trajectory, path = recorder.build(), tmp_path / "old.npz"
    trajectory.save(path)
    with np.load(path, allow_pickle=False) as members:
        arrays: dict[str, Any] = dict(members)
    meta = json.loads(arrays["meta"].item()) | {"version": 3}
    meta["world"] = meta["world"].replace('"ball"', '"bolus"')
    np.savez(path, **arrays | {"meta": np.array(json.dumps(meta)), "bolus": arrays.pop("ball")})
    assert_same(Trajectory.load(path), trajectory)


def test_recorder_refuses_a_frame_of_another_shape_or_not_finite() -> None:
    """At once, not at the end of the episode."""
    recorder = Recorder(DESIGN, LAYOUT, "bending")
    with pytest.raises(ValueError, match="position has shape"):
        recorder.append(0.0, np.zeros((3, N_NODE)), np.zeros(len(LAYOUT)))
    with pytest.raises(ValueError, match=r"^activation\[0\] = nan: must be a number from"):
        recorder.append(0.0, np.zeros((N_NODE, 3)), np.full(len(LAYOUT), np.nan))
    assert len(recorder) == 0


@given(st.data())
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damage_is_harmless_or_refused(saved: tuple[Path, Trajectory], data: st.DataObject) -> None:
    """Flipped, cut or appended bytes load as what was saved or are a ValueError that names the file."""
    path, trajectory = saved
    content = bytearray(path.read_bytes())
    cut = data.draw(st.one_of(st.just(len(content)), st.integers(0, len(content))))
    places = data.draw(st.lists(st.integers(0, max(cut - 1, 0)), max_size=4))
    del content[cut:]
    for place in places:
        if content:
            content[place] ^= data.draw(st.integers(1, 255))
    content += data.draw(st.sampled_from([b"", b"PK", bytes(40)]))
    damaged = path.with_name("damaged.npz")
    damaged.write_bytes(content)
    try:
        loaded = Trajectory.load(damaged)
    except ValueError as error:
        message = str(error)
    else:
        assert_same(loaded, trajectory)
        message = str(damaged)
    assert str(damaged) in message


@given(st.binary(max_size=200))
@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_foreign_bytes_are_refused(saved: tuple[Path, Trajectory], content: bytes) -> None:
    """Whatever they are."""
    foreign = saved[0].with_name("foreign.npz")
    foreign.write_bytes(content)
    with pytest.raises(ValueError, match=r"foreign\.npz.*not an \.npz file"):
        Trajectory.load(foreign)


def edited(path: Path, **changes: Any) -> Any:
    """Return the meta text of a saved trajectory with some entries changed."""
    with np.load(path) as members:
        return np.array(json.dumps({**json.loads(members["meta"].item()), **changes}))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"position": None}, "must hold .*position"),
        ({"extra": np.zeros(2)}, "extra"),
        ({"time": np.array([0, 1, 2])}, "floating-point"),
        ({"time": np.array([0.0, 2.0, 1.0])}, "increase"),
        ({"reward": np.array([0.0, np.inf, 1.0])}, "finite"),
        ({"activation": np.zeros((3, 1))}, "shape"),
        ({"ball": np.zeros((3, 1, 3))}, "shape"),
        ({"meta": np.array("{")}, "sound"),
        ({"meta": np.array("[" * 100_000)}, "sound"),
        ({"meta": np.array("[]")}, "meta must be"),
        ({"meta": np.array(3.0)}, "must be one text"),
    ],
)
def test_inconsistent_members_are_refused(
    saved: tuple[Path, Trajectory], tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    """Sound zip files that are no sound trajectories."""
    target = tmp_path / "edited.npz"
    rewrite(saved[0], target, **changes)
    with pytest.raises(ValueError, match=rf"edited\.npz.*{words}"):
        Trajectory.load(target)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"version": 1}, "version 1"),
        ({"format": "song"}, "song"),
        ({"task": 3}, "task"),
        ({"outcome": "abc"}, "outcome"),
        ({"outcome": []}, "one a frame"),
        ({"design": "{"}, "JSON"),
        ({"design": []}, "JSON"),
        ({"design": '{"height": -1}'}, "height"),
        ({"design": "{}"}, "position has shape"),
        ({"layout": {}}, "layout"),
        ({"world": {}}, "layout and world JSON text"),
        ({"world": '{"moon": 1}'}, "moon"),
        ({"world": '{"ball": {}}'}, "ball has shape"),
        ({"layout": "{}"}, "layout"),
        ({"layout": '{"muscles": [3]}'}, "muscles"),
        ({"layout": json.dumps(MuscleLayout().to_dict())}, "shape"),
    ],
)
def test_inconsistent_meta_is_refused(
    saved: tuple[Path, Trajectory], tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    """Sound arrays under a description that is not."""
    target = tmp_path / "edited.npz"
    rewrite(saved[0], target, meta=edited(saved[0], **changes))
    with pytest.raises(ValueError, match=rf"edited\.npz.*{words}"):
        Trajectory.load(target)


def test_pickled_objects_are_refused(saved: tuple[Path, Trajectory], tmp_path: Path) -> None:
    """Loading runs no code from the file."""
    target = tmp_path / "pickled.npz"
    rewrite(saved[0], target, time=np.array([None, 1.0, {}], dtype=object))
    with pytest.raises(ValueError, match=r"pickled\.npz"):
        Trajectory.load(target)


def test_missing_file_is_no_value_error(tmp_path: Path) -> None:
    """A wrong path is told as such."""
    with pytest.raises(FileNotFoundError):
        Trajectory.load(tmp_path / "none.npz")


def write_half(path: Path) -> None:
    """Fail half-way."""
    path.write_text("half")
    raise ZeroDivisionError


def test_failed_save_leaves_the_old_file(tmp_path: Path) -> None:
    """And no temporary one."""
    path = tmp_path / "deep" / "file.txt"
    with replacing(path) as temporary:
        temporary.write_text("first")
    with pytest.raises(ZeroDivisionError), replacing(path) as temporary:
        write_half(temporary)
    assert path.read_text() == "first"
    assert [p.name for p in path.parent.iterdir()] == ["file.txt"]


def test_save_replaces(saved: tuple[Path, Trajectory], tmp_path: Path) -> None:
    """The last one saved counts."""
    path = tmp_path / "again.npz"
    saved[1].save(path)
    second = example(layout=replace(LAYOUT), task="other")
    second.save(path)
    assert_same(Trajectory.load(path), second)


def test_it_says_what_it_holds() -> None:
    """In one line."""
    text = repr(example(world=World(ball=Ball(radius=0.01)), ball=np.zeros((3, 1, 3))))
    counts = f"{N_NODE} nodes, {len(LAYOUT)} muscles, a ball, 0 markers"
    assert text == f"Trajectory(extension: 3 frames from 0 to 0.666667 s, {counts})"
