"""Files and folders: under any name, whole or not there at all, claimed by one process at a time, on every system."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import random
import re
import signal
import stat
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from odd_files import ODD, leftovers, limited

from agents import run_folder
from lattice_gym.benchmarks import results_files
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import MuscleLayout
from lattice_gym.physics.worm import build_model
from lattice_gym.recording import files
from lattice_gym.recording.trajectory import Recorder, Trajectory
from lattice_gym.rendering.extras import extra
from lattice_gym.rendering.figures import save
from lattice_gym.rendering.video import render_video


@pytest.fixture(scope="module")
def short() -> Trajectory:
    """Return three frames of a small worm at rest."""
    design = LatticeDesign(n_pairs=3, period_ratio=1.5, elements_per_segment=2)
    lattice, layout = build_lattice(design), MuscleLayout()
    rest = build_model(lattice, layout).rest_state().position
    recorder = Recorder(design, layout, "extension")
    for time in (0.0, 0.1, 0.2):
        recorder.append(time, rest, [])
    return recorder.build()


# Names


@pytest.mark.parametrize("kind", ODD)
def test_any_name(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, short: Trajectory) -> None:
    """Trajectories, tables, pictures and reports are found under the name that was asked for, in a folder of it too."""
    monkeypatch.chdir(tmp_path)
    name = ODD[kind]
    for place in (Path(name + ".npz"), Path(name) / name):
        short.save(place)
        assert repr(Trajectory.load(place)) == repr(short)
    run_folder.write_json(Path(name) / "a.json", {"a": 1})
    run_folder.write_rows(Path(name) / "a.csv", [{run_folder.STEPS: 1.0}])
    save(Figure(figsize=(1, 1)), Path(name) / f"{name}.png", 20)
    results_files.write(Path(name), name, {}, [], "command")
    assert run_folder.read_json(Path(name) / "a.json") == {"a": 1}
    made = {"a.json", "a.csv", name, *(f"{name}.{suffix}" for suffix in ("png", "json", "md"))}
    assert {path.name for path in Path(name).iterdir()} == made


@pytest.mark.slow
def test_any_name_of_a_video(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, short: Trajectory) -> None:
    """No colon makes a protocol of it for ffmpeg, no dash an option."""
    monkeypatch.chdir(tmp_path)
    names = [ODD[kind] for kind in ("colon", "protocol", "percent", "dash", "newline", "no UTF-8") if kind in ODD]
    for path in (Path(f"{names[0]}.mp4"), *(Path(name) / f"{name}.mp4" for name in names)):
        render_video(short, path, size=(96, 64))
        (tmp_path / "plain.mp4").write_bytes(path.read_bytes())
        assert extra("imageio_ffmpeg").count_frames_and_secs("plain.mp4")[0] == 3
    assert not leftovers(tmp_path)


@pytest.mark.parametrize("path", [None, 5, b"bytes", "n\0l", "\ud800", 1.5, ["a"], object()])
def test_what_is_no_path_is_named(path: object, short: Trajectory) -> None:
    """Whatever takes a path says so."""
    takers: list[Callable[..., object]] = [
        short.save,
        Trajectory.load,
        lambda path: render_video(short, path),
        lambda path: files.write(path, b""),
    ]
    for take in takers:
        with pytest.raises(ValueError, match=r"^path = .*: must "):
            take(path)


# What is there


@pytest.mark.parametrize("other", ["folder", "empty folder", "link to a folder", "loop", "pipe", "device"])
def test_only_files_are_replaced(other: str, tmp_path: Path, short: Trajectory) -> None:
    """A folder is not lost, and neither is the system's /dev/null, which its owner could replace."""
    path = tmp_path / "other"
    if other == "loop":
        path.symlink_to(path)
    elif other == "link to a folder":
        path.symlink_to(tmp_path)
    elif "folder" in other:
        path.mkdir()
        if other == "folder":
            (path / "thesis.txt").touch()
    elif other == "pipe":
        os.mkfifo(path)
    elif os.geteuid() == 0:  # who could replace the real one
        os.mknod(path, 0o666 | stat.S_IFCHR, os.stat("/dev/null").st_rdev)
    else:
        path = Path("/dev/null")
    before = path.lstat()
    with pytest.raises(FileExistsError, match=f"not a file that could be replaced: '{path}'"):
        short.save(path)
    assert (path.lstat().st_mode, path.lstat().st_ino) == (before.st_mode, before.st_ino)
    assert not leftovers(tmp_path)


def test_what_a_link_points_at_is_replaced(tmp_path: Path) -> None:
    """A link to another disk stays one."""
    (tmp_path / "disk").mkdir()
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "disk" / "file")
    for content in (b"first", b"second"):
        files.write(link, content)
        assert link.is_symlink()
        assert (tmp_path / "disk" / "file").read_bytes() == content


def test_modes_are_those_of_any_new_file(tmp_path: Path) -> None:
    """Not the private ones of a temporary file."""
    old = os.umask(0o027)
    try:
        files.write(tmp_path / "file", b"")
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == 0o640


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="an administrator may write anywhere")
def test_what_may_not_be_written_is_named(tmp_path: Path) -> None:
    """Not the temporary place beside it."""
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(PermissionError) as refused:
            files.write(tmp_path / "file", b"")
    finally:
        tmp_path.chmod(0o700)
    assert files.reason(refused.value) == f"{tmp_path / 'file'}: Permission denied"


def test_a_place_below_a_file_is_named(tmp_path: Path) -> None:
    """Whatever cannot be written says where and why in a line."""
    (tmp_path / "file").touch()
    for use in (files.prepare, lambda path: files.write(path, b"")):
        with pytest.raises(OSError, match=r"Not a directory|File exists") as refused:
            use(tmp_path / "file" / "below")
        assert str(tmp_path / "file") in files.reason(refused.value)


def test_an_error_about_another_file_stays_one(tmp_path: Path) -> None:
    """Reading while writing: the name is that of what could not be read."""
    with pytest.raises(FileNotFoundError, match=r"absent"), files.replacing(tmp_path / "file"):
        (tmp_path / "absent").read_bytes()
    assert not list(tmp_path.iterdir())
    with pytest.raises(OSError, match="full") as refused, files.claimed(tmp_path):
        raise OSError(errno.ENOSPC, "full")  # as where the output of a program goes to a full disk
    assert refused.value.filename is None


# A full disk


@pytest.mark.slow
def test_full_disk_keeps_what_was_there(tmp_path: Path, short: Trajectory) -> None:
    """At whatever byte it is full: the old file is whole, nothing else is left, and one line names it."""
    writers: dict[str, Callable[[Path], object]] = {
        "a.npz": short.save,
        "a.json": lambda path: run_folder.write_json(path, list(range(2000))),
        "a.csv": lambda path: run_folder.write_rows(path, [{run_folder.STEPS: float(k)} for k in range(2000)]),
        "a.png": lambda path: save(Figure(figsize=(4, 4), facecolor="red"), path, 100),
        "a.md": lambda path: results_files.write(path.parent, "a", {}, ["x" * 20_000], "command"),
        "a.gif": lambda path: render_video(short, path, size=(96, 64)),
        "a.mp4": lambda path: render_video(short, path, size=(96, 64)),
    }
    generator = random.Random(0)
    for name, write in writers.items():
        path = tmp_path / name
        write(path)
        content = path.read_bytes()
        for _ in range(2 if name in ("a.mp4", "a.gif") else 10):
            with limited(generator.randrange(len(content) - 1)), pytest.raises(OSError, match="too large") as full:
                write(path)
            assert full.value.errno == errno.EFBIG
            assert re.fullmatch(rf"{re.escape(str(tmp_path))}/a\.\w+: File too large", files.reason(full.value))
            assert path.read_bytes() == content
            assert not leftovers(tmp_path)


def test_disk_that_is_full_only_when_flushed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a network's may be: the write is not taken for done."""
    files.write(tmp_path / "file", b"old")

    def full(_handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as refused:
        files.write(tmp_path / "file", b"new")
    assert refused.value.filename == str(tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == b"old"
    assert not leftovers(tmp_path)


def test_disk_that_knows_no_flush(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some network disks say EINVAL, and write at once."""

    def unknown(_handle: int) -> None:
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    monkeypatch.setattr(os, "fsync", unknown)
    files.write(tmp_path / "file", b"new")
    assert (tmp_path / "file").read_bytes() == b"new"


# Windows


@pytest.fixture
def windows(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Let the calls that differ on Windows fail here as they do there."""
    fcntl = pytest.importorskip("fcntl")
    fsync, opened = os.fsync, os.open

    def flush(handle: int) -> None:
        if fcntl.fcntl(handle, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        fsync(handle)

    def open_file(path: str, flags: int, *others: int, **named: int) -> int:
        if os.path.isdir(path):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)
        return opened(path, flags, *others, **named)

    monkeypatch.setattr(os, "fsync", flush)
    monkeypatch.setattr(os, "open", open_file)
    monkeypatch.setattr(files, "_WINDOWS", True)
    return monkeypatch


@pytest.mark.usefixtures("windows")
def test_windows_flushes_what_is_open_for_writing_and_no_folder(tmp_path: Path) -> None:
    """Files and whole checkpoints."""
    run_folder.write_json(tmp_path / "a.json", {"a": 1})
    assert run_folder.read_json(tmp_path / "a.json") == {"a": 1}
    run_folder.save_checkpoint(tmp_path, 80, {"model.zip": lambda path: path.write_bytes(b"model")})
    assert (tmp_path / "checkpoints" / "000000000080" / "model.zip").read_bytes() == b"model"


def test_windows_replaces_what_a_reader_closes_soon(tmp_path: Path, windows: pytest.MonkeyPatch) -> None:
    """A table that somebody reads does not end a run; one that stays open is named."""
    replace, refused = os.replace, [0]

    def busy(source: Path, target: Path) -> None:
        refused[0] += 1
        if refused[0] % 3:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(source))
        replace(source, target)

    windows.setattr(os, "replace", busy)
    files.write(tmp_path / "progress.csv", b"rows")
    assert (tmp_path / "progress.csv").read_bytes() == b"rows"
    windows.setattr(files, "_REPLACE_AGAIN", 0.0)
    with pytest.raises(PermissionError) as open_elsewhere:
        files.write(tmp_path / "progress.csv", b"more")
    assert files.reason(open_elsewhere.value) == f"{tmp_path / 'progress.csv'}: Permission denied"


def test_windows_keeps_old_checkpoints_that_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It deletes no file that is open; the next checkpoint has them removed."""

    def in_use(path: Path) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    with monkeypatch.context() as reading:
        reading.setattr(files, "discard", in_use)
        for steps in range(1, 6):
            run_folder.save_checkpoint(tmp_path, steps, {})
        assert len(run_folder.checkpoints(tmp_path)) == 5
    run_folder.save_checkpoint(tmp_path, 6, {})
    assert [int(folder.name) for folder in run_folder.checkpoints(tmp_path)] == [6, 5, 4]


_REPORT = r"""
from pathlib import Path
from agents import run_folder
from lattice_gym.benchmarks import results_files
results_files.write(Path(), "a", {}, ["\u00b5 \u2264 \U0001f41b"], "command")
run_folder.write_json(Path("b.json"), ["\u00b5"])
"""


def test_reports_are_the_same_on_every_system(tmp_path: Path) -> None:
    """UTF-8 and line feeds, whatever the system writes text in."""
    plain = {"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "C", "PYTHONIOENCODING": "utf-8"}
    path = {"PYTHONPATH": str(Path(__file__).parent.parent)}
    subprocess.run([sys.executable, "-c", _REPORT], cwd=tmp_path, env=os.environ | plain | path, check=True)
    assert (tmp_path / "a.md").read_bytes().startswith("\u00b5 \u2264 \U0001f41b\n\nMade".encode())
    assert json.loads((tmp_path / "b.json").read_bytes()) == ["\u00b5"]


# One process at a time

_HOLDER = """
import sys, time
from pathlib import Path
from lattice_gym.recording import files
with files.replacing(sys.argv[1]) as new, files.claimed(Path(sys.argv[1]).parent):
    new.write_bytes(b"half")
    print("writing", flush=True)
    time.sleep(100.0)
"""
_HAMMER = """
import sys
from lattice_gym.recording import files
for k in range(40):
    files.write(sys.argv[1], sys.argv[2].encode() * 1000)
    assert set(open(sys.argv[1]).read()) <= set("ABC") and len(open(sys.argv[1]).read()) == 1000
"""


@contextmanager
def holder(path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Have another process write a file for as long as the body runs, then kill it."""
    command = [sys.executable, "-c", _HOLDER, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=Path(__file__).parent.parent) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == b"writing\n"
            yield process
        finally:
            process.kill()


def test_what_is_being_written_is_claimed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second writer of the same is refused with its name, others go on; what a killed one left is removed."""
    monkeypatch.setattr(files, "_WAIT", 0.1)
    with holder(tmp_path / "film.mp4") as process:
        with pytest.raises(BlockingIOError) as refused:
            files.write(tmp_path / "film.mp4", b"")
        assert files.reason(refused.value) == f"{tmp_path / 'film.mp4'}: another process is writing it"
        with pytest.raises(BlockingIOError), files.claimed(tmp_path):
            pass
        files.write(tmp_path / "other", b"")
        files.prepare(tmp_path)
        assert len(leftovers(tmp_path)) == 2
        assert [path.name for path in files.content(tmp_path)] == ["other"]
        process.send_signal(getattr(signal, "SIGKILL", signal.SIGTERM))
        process.wait()
        assert len(leftovers(tmp_path)) == 2
    with files.claimed(tmp_path):
        assert len(leftovers(tmp_path)) == 1
        files.write(tmp_path / "film.mp4", b"whole")
    assert {path.name for path in tmp_path.iterdir()} == {"other", "film.mp4"}


def test_many_processes_write_one_file(tmp_path: Path) -> None:
    """Every reader sees one that is whole, and the last leaves nothing else."""
    command = [sys.executable, "-c", _HAMMER, str(tmp_path / "file")]
    writers = [subprocess.Popen([*command, letter], cwd=Path(__file__).parent.parent) for letter in "ABC"]
    assert [writer.wait(120) for writer in writers] == [0, 0, 0]
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_many_threads_write_one_file(tmp_path: Path) -> None:
    """As many processes do."""
    failed: list[BaseException] = []

    def hammer(letter: bytes) -> None:
        try:
            for _ in range(10):
                files.write(tmp_path / "file", letter * 1000)
        except BaseException as error:
            failed.append(error)

    threads = [threading.Thread(target=hammer, args=(letter,)) for letter in (b"A", b"B", b"C")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed
    assert set((tmp_path / "file").read_text()) < set("ABC")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_foreign_folder_is_never_taken_for_a_leftover(tmp_path: Path) -> None:
    """Neither one of nearly that name, nor what a link of that name points at."""
    digits = "0123456789abcdef"
    for name in (f".lattice_gym-{digits}.bak", f".lattice_gym-{digits[1:]}", f"lattice_gym-{digits}", "thesis"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "years.txt").touch()
    (tmp_path / f".lattice_gym-{digits}").symlink_to(tmp_path / "thesis")
    files.write(tmp_path / "file", b"")
    assert len(list(tmp_path.rglob("years.txt"))) == 4


def test_locks_that_the_disk_does_not_know(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The existence of the file is the lock then, and a disk that refuses any lock is told by name."""
    fcntl = pytest.importorskip("fcntl")
    number = errno.ENOSYS

    def unknown(_handle: int, _operation: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", unknown)
    with pytest.warns(UserWarning, match="flock not supported"):
        files.write(tmp_path / "file", b"x")
    unsupported = pytest.warns(UserWarning, match="flock not supported")
    with unsupported, files.claimed(tmp_path), pytest.raises(BlockingIOError), files.claimed(tmp_path):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    number = errno.ENOLCK
    with pytest.raises(OSError, match="No locks available") as refused:
        files.write(tmp_path / "file", b"y")
    assert refused.value.filename == str(tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == b"x"


def test_what_is_discarded_goes_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a folder never only a part is there; one that cannot be moved is deleted file by file."""
    for moves in (True, False):
        (tmp_path / "old" / "deep").mkdir(parents=True)
        (tmp_path / "old" / "deep" / "file").touch()
        if not moves:

            def refuse(*_: object) -> None:
                raise OSError(errno.EXDEV, os.strerror(errno.EXDEV))

            monkeypatch.setattr(os, "rename", refuse)
        files.discard(tmp_path / "old")
        assert not list(tmp_path.iterdir())
    with contextlib.suppress(FileNotFoundError):
        files.discard(tmp_path / "absent")
    assert not list(tmp_path.iterdir())


def test_arrays_survive(tmp_path: Path, short: Trajectory) -> None:
    """What is written through memory is what was given."""
    short.save(tmp_path / "a.npz")
    again = Trajectory.load(tmp_path / "a.npz")
    np.testing.assert_array_equal(again.position, short.position)
