"""Paths that are written and read, damaged files of runs and of settings: refused by name, and nothing half written."""

from __future__ import annotations

import io
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from functools import cache
from pathlib import Path
from typing import Any

from bad_bodies import JSON
from bad_recordings import good_trajectory
from hunting import Target, fixed
from hypothesis import strategies as st
from junk import JUNK
from matplotlib.figure import Figure
from odd_files import ODD, leftovers

from agents import run_folder
from agents.config import TrainConfig
from agents.rollouts import evaluated_returns
from agents.run_folder import Run
from lattice_gym.benchmarks import results_files
from lattice_gym.recording import files
from lattice_gym.recording.trajectory import Trajectory
from lattice_gym.rendering.figures import save

_DEEP = "1/2/3/4/5/6"
"""Where paths start, so that none of a few ".." leads out of the folder of a call."""
_THERE = ("file", "full", "empty", "link", "loop", "dangling", "to full", "pipe")
"""What stands there before."""


@contextmanager
def _place() -> Iterator[Path]:
    """Work in a new folder in which various things stand."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / _DEEP
        (place / "full" / "empty").mkdir(parents=True)
        (place / "empty").mkdir()
        (place / "full" / "file").write_text("text")
        (place / "file").write_text("text")
        os.mkfifo(place / "pipe")
        for link, target in {"link": "file", "loop": "loop", "dangling": "absent", "to full": "full"}.items():
            (place / link).symlink_to(target)
        os.chdir(place)
        try:
            yield Path(folder)
        finally:
            os.chdir(before)


_COMPONENTS = st.one_of(
    st.sampled_from([*_THERE, *ODD.values(), "..", ".", "y" * 300, "\0", "\ud800", "con", "a.npz", "checkpoints"]),
    st.text(min_size=1, max_size=8),
).map(lambda part: part.replace("/", "") or "x")
_RELATIVE = st.lists(_COMPONENTS, min_size=1, max_size=4).map("/".join)
_PATHS = st.one_of(_RELATIVE, _RELATIVE.map(Path), JUNK.filter(lambda junk: not isinstance(junk, str)), st.just(""))


def _write_report(path: Any) -> None:
    with redirect_stdout(io.StringIO()):
        results_files.write(files.checked_path("path", path), "name", {"a": 1}, ["text"], "command")


_WRITERS: dict[str, Callable[[Any], object]] = {
    "bytes": lambda path: files.write(path, b"whole"),
    "trajectory": good_trajectory().save,
    "figure": lambda path: save(Figure(figsize=(0.2, 0.2)), path, 20),
    "JSON": lambda path: run_folder.write_json(path, {"a": 1}),
    "table": lambda path: run_folder.write_rows(path, [{run_folder.STEPS: 1.0}]),
    "report": _write_report,
    "run": lambda path: run_folder.make(files.checked_path("path", path), {"config.json": 1, "versions.json": 2}),
}


def _state(folder: Path) -> dict[str, bytes | str]:
    """Files and links below a folder, with what they hold; folders do not count."""
    state: dict[str, bytes | str] = {}
    for top, inner, names in os.walk(folder):
        for name in (*inner, *names):
            path = os.path.join(top, name)
            if os.path.islink(path):
                state[path] = os.readlink(path)
            elif os.path.isfile(path):
                state[path] = Path(path).read_bytes()
    return state


def _refused(path: object, error: OSError) -> ValueError:
    """Return the error of the path that the system's is about: it, a folder above it or a file in it."""
    about, given = Path(os.fsdecode(error.filename or "-")), Path(str(path))
    assert about in (given, *given.parents) or given in about.parents, f"names {str(about)!r}, not the path"
    return ValueError(f"path: {files.reason(error)}")


def make_written(call: tuple[str, Any]) -> None:
    """Check that a path is written whole and read back, or refused and nothing changed."""
    kind, path = call
    with _place() as folder:
        before = _state(folder)
        try:
            _WRITERS[kind](path)
        except OSError as error:
            raise _refused(path, error) from None
        finally:
            assert not leftovers(folder), "something is left"
            changed = {name for name, held in _state(folder).items() if before.get(name) != held}
            lost = {name for name in before if not os.path.lexists(name)}
            assert not lost, f"lost {lost}"
            if sys.exc_info()[0] is not None:
                assert not changed, f"changed {changed}"
        assert 1 <= len(changed) <= 2, f"wrote {changed}"
        assert all(Path(name).stat().st_size > 0 for name in changed), "empty"


_READERS: dict[str, Callable[[Any], object]] = {
    "trajectory": Trajectory.load,
    "run": lambda path: Run.open(files.checked_path("path", path)),
    "environment": lambda path: run_folder.read_environment(files.checked_path("path", path)),
    "design": lambda path: run_folder.requested_arguments(TrainConfig(design=files.checked_path("path", path))),
    "sessions": lambda path: run_folder.read_sessions(files.checked_path("path", path)),
}


def make_read(call: tuple[str, Any]) -> None:
    """Check that a path that is no such file is refused, and nothing changed."""
    kind, path = call
    if isinstance(path, str | Path) and "pipe" in str(path):
        return  # whoever reads a pipe waits for its writer
    with _place() as folder:
        before = _state(folder)
        try:
            _READERS[kind](path)
        except OSError as error:
            raise _refused(path, error) from None
        finally:
            assert _state(folder) == before, "changed"


# Files of a run and of settings

_TABLE = "time/total_timesteps,worm/return_mean\n80,1.5\n160,2.5\n"


@cache
def _run_files() -> dict[str, bytes]:
    """Return the files of a run, without checkpoints."""
    config = TrainConfig(task="extension").resolved()
    arguments = run_folder.requested_arguments(config)
    named: dict[str, Any] = {
        "config.json": config.to_dict(),
        "design.json": arguments["design"],
        "muscles.json": "extension",
        "environment.json": {"hill": {}},
        "versions.json": [{"from_step": 0}],
        "evaluation.json": {
            "steps": 160,
            "policies": {name: {"return_mean": 1.0} for name in ("policy", "nothing", "random")},
        },
    }
    return {name: json.dumps(values).encode() for name, values in named.items()} | {"progress.csv": _TABLE.encode()}


def _damage(name: str) -> st.SearchStrategy[bytes | str | None]:
    """Draw what a file holds instead; text for what is no file there, None for nothing."""
    good = _run_files()[name]
    return st.one_of(
        st.sampled_from(["folder", "loop", None]),
        st.binary(max_size=40),
        JSON.map(lambda value: json.dumps(value).encode()),
        st.integers(0, len(good) - 1).map(lambda end: good[:end]),
        st.tuples(st.integers(0, len(good) - 1), st.integers(0, 255)).map(
            lambda hit: good[: hit[0]] + bytes([hit[1]]) + good[hit[0] + 1 :]
        ),
        st.text(max_size=12).map(lambda text: good + text.encode("utf-8", "surrogatepass")),
    )


_CHECKPOINTS = st.lists(
    st.sampled_from(["000000000080", "80", "1e3", "-5", "\u0663", "\u00b2", "damaged-80", "80-best", "x"]), max_size=3
)
_RUNS = st.tuples(
    st.lists(st.sampled_from(sorted(_run_files())), min_size=1, max_size=2, unique=True).flatmap(
        lambda names: st.fixed_dictionaries({name: _damage(name) for name in names})
    ),
    _CHECKPOINTS,
)


def _put(path: Path, content: bytes | str | None) -> None:
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content == "folder":
        path.mkdir()
    elif content == "loop":
        path.symlink_to(path.name)


def make_run(call: tuple[dict[str, bytes | str | None], list[str]]) -> None:
    """Read all of a damaged run folder, which is left as it is and from which nothing is imported."""
    changes, checkpoints = call
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run"
        path.mkdir()
        for name, content in {**_run_files(), **changes}.items():
            _put(path / name, content)
        for name in checkpoints:
            (path / "checkpoints" / name).mkdir(parents=True, exist_ok=True)
        before, modules = _state(path), set(sys.modules)
        try:
            run = Run.open(path)
            run.rows()
            run_folder.read_sessions(path / "versions.json")
            evaluated_returns(run)
            assert run.steps in (0, 3, 80)
        finally:
            assert _state(path) == before, "changed"
            assert set(sys.modules) == modules, "imported"


_SETTINGS = {"design": "design.json", "muscles": "muscles.json", "environment": "environment.json"}
_SETTING_FILES = st.sampled_from(sorted(_SETTINGS)).flatmap(
    lambda name: st.tuples(st.just(name), _damage(_SETTINGS[name]))
)


def make_settings(call: tuple[str, bytes | str | None]) -> None:
    """Read a damaged file of settings."""
    name, content = call
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / _SETTINGS[name]
        _put(path, content)
        given: Any = {name: str(path) if name == "muscles" else path}
        run_folder.requested_arguments(TrainConfig(task="extension", **given))


def make_cleared(call: tuple[dict[str, bytes | str | None], list[str]]) -> None:
    """Make a run where a damaged one is: refused, but for one that was killed while it was made, and nothing lost."""
    changes, checkpoints = call
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run"
        path.mkdir()
        for name, content in changes.items():
            _put(path / name, content)
        for name in checkpoints:
            (path / "checkpoints" / name).mkdir(parents=True, exist_ok=True)
        before = _state(path)
        held = {entry.name for entry in path.iterdir()}
        with suppress(FileExistsError):
            run_folder.make(path, {"config.json": 1, "versions.json": 2})
            assert held <= {"config.json", "design.json", "muscles.json", "environment.json"}, "cleared what is not its"
            assert {entry.name for entry in path.iterdir()} == {"config.json", "versions.json"}
            return
        assert _state(path) == before, "changed"


TARGETS = [
    Target("paths that are written", st.tuples(st.sampled_from(sorted(_WRITERS)), _PATHS), make_written, fixed("path")),
    Target("paths that are read", st.tuples(st.sampled_from(sorted(_READERS)), _PATHS), make_read,
           lambda call: ("path", str(Path(str(call[1])).name), ".json")),
    Target("files of a run", _RUNS, make_run, lambda call: (*call[0], "run")),
    Target("files of settings", _SETTING_FILES, make_settings, lambda call: (_SETTINGS[call[0]],)),
    Target("a run where another is", _RUNS, make_cleared, fixed("run")),
]  # fmt: skip
