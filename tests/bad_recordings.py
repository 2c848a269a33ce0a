"""Trajectories, their files, and options of the reports."""

from __future__ import annotations

import io
import json
import tempfile
import zipfile
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from bad_bodies import JSON
from hunting import Target, fixed
from hypothesis import strategies as st
from junk import ARRAYS, NUMBERS, damaged, finite, small, small_model
from small_worms import N_SMALL

from lattice_gym.benchmarks.__main__ import parse as parse_report
from lattice_gym.body.muscles import named_layout
from lattice_gym.recording.trajectory import Recorder, Trajectory


@cache
def good_trajectory() -> Trajectory:
    """Record three frames of the small worm."""
    layout = named_layout("all", small())
    recorder = Recorder(small().design, layout, "bending")
    for frame in range(3):
        recorder.append(0.1 * frame, small_model().rest_state().position, np.full(N_SMALL, 0.5), 1.0, "line")
    return recorder.build()


_FRAMES = {"time": 0.0, "position": small_model().rest_state().position, "activation": np.zeros(N_SMALL),
           "reward": 0.0, "outcome": "", "ball": None}  # fmt: skip
_TRAJECTORY = {name: getattr(good_trajectory(), name) for name in (
    "time", "position", "activation", "reward", "outcome", "design", "layout", "task", "world", "ball"
)}  # fmt: skip


def make_trajectory(call: tuple[str, dict[str, Any]]) -> None:
    """Check that a trajectory that is taken is finite."""
    kind, arguments = call
    if kind == "frame":
        recorder = Recorder(small().design, good_trajectory().layout, "bending")
        recorder.append(**arguments)
        trajectory = recorder.build()
    else:
        trajectory = Trajectory(**arguments)
    finite(trajectory.time, trajectory.position, trajectory.activation, trajectory.reward)


_TRAJECTORIES = st.one_of(
    st.tuples(st.just("frame"), damaged(_FRAMES, 1, 2)), st.tuples(st.just("whole"), damaged(_TRAJECTORY, 1, 2))
)


@cache
def _saved() -> dict[str, bytes]:
    """Return the members of a saved trajectory."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "good.npz"
        good_trajectory().save(path)
        with zipfile.ZipFile(path) as archive:
            return {name: archive.read(name) for name in archive.namelist()}


def _member(value: Any) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array(file, np.asarray(value), allow_pickle=True)
    return file.getvalue()


_META = ("format", "version", "task", "outcome", "design", "layout", "world")
_FILES = st.one_of(
    st.dictionaries(
        st.sampled_from([*_saved(), "other.npy", "time"]),
        st.one_of(st.none(), st.binary(max_size=80), ARRAYS.map(_member), NUMBERS.map(_member)),
        min_size=1, max_size=2,
    ),
    st.dictionaries(st.sampled_from([*_META, "more"]), JSON, min_size=1, max_size=2).map(
        lambda changes: {"meta.npy": _member(json.dumps({**_meta(), **changes}))}
    ),
    st.tuples(st.sampled_from(sorted(_saved())), st.integers(0, 200), st.integers(0, 255)).map(
        lambda hit: {hit[0]: _hit(_saved()[hit[0]], hit[1], hit[2])}
    ),
)  # fmt: skip


def _meta() -> dict[str, Any]:
    array = np.lib.format.read_array(io.BytesIO(_saved()["meta.npy"]))
    return dict(json.loads(array.item()))


def _hit(content: bytes, place: int, value: int) -> bytes:
    hit = bytearray(content)
    hit[place % len(hit)] = value
    return bytes(hit)


def make_trajectory_file(call: dict[str, bytes | None]) -> None:
    """Load a sound zip file with damaged members; what loads is finite."""
    members = {name: data for name, data in {**_saved(), **call}.items() if data is not None}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "damaged.npz"
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in members.items():
                archive.writestr(name, data)
        trajectory = Trajectory.load(path)
    finite(trajectory.time, trajectory.position, trajectory.activation, trajectory.reward)


_WORDS = st.lists(
    st.one_of(
        st.sampled_from(["paper", "engines", "divergence", "--engine", "--tension", "fused", "warp", "--no-pictures",
                         "--quick", "--out", "0.5", "-1", "nan", "inf", "", "--", "--help"]),
        st.text(max_size=4),
    ),
    max_size=4,
)  # fmt: skip


def make_options(words: list[str]) -> None:
    """Check that options are read, or refused with a line that says why; nothing runs."""
    said = io.StringIO()
    try:
        with redirect_stderr(said), redirect_stdout(io.StringIO()):
            options = parse_report(words).report
    except SystemExit as leaving:
        if leaving.code == 2:
            raise ValueError(said.getvalue()) from None
        if leaving.code != 0:
            raise
        return
    for value in getattr(options, "tension", []):
        assert np.isfinite(value), "not finite"


TARGETS = [
    Target("Trajectory and Recorder", _TRAJECTORIES, make_trajectory, lambda call: (*call[1],)),
    Target("Trajectory.load", _FILES, make_trajectory_file, fixed("damaged.npz")),
    Target("options of the reports", _WORDS, make_options, fixed("--help")),
]
