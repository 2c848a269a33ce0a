"""How files and folders are written: each place claimed by one process at a time, and whole or not there at all.

What is being written stands in a folder `.lattice_gym-...` beside its place, and is moved there once it is complete and
on the disk. A lock in that folder is released by the system when its process ends, however it ends: whoever writes next
in the same folder removes what killed processes left. An OSError names the place that was asked for.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from hashlib import blake2b
from pathlib import Path
from typing import TYPE_CHECKING

from lattice_gym.checks import invalid_value

if TYPE_CHECKING:
    from filelock import BaseFileLock

_UNFINISHED = re.compile(r"\.lattice_gym-[0-9a-f]{16}")
_LOCK = "lock"
_WAIT, _POLL = 10.0, 0.01
"""How long another process that writes the same file is waited for, and how often it is looked at [s]."""
_WINDOWS = os.name == "nt"
_REPLACE_AGAIN = 2.0
"""How long Windows is asked again to replace a file that another program has open [s]."""
_NEVER_FLUSHED = {errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP}
"""What file systems say that write at once and know no fsync."""


def checked_path(name: str, path: object) -> Path:
    """Path that the system can take, or a ValueError that names the argument."""
    if not isinstance(path, str | os.PathLike) or not isinstance(os.fspath(path), str):
        raise invalid_value(name, path, "must be a path, as text or pathlib.Path")
    try:
        encoded = os.fsencode(path)
    except UnicodeEncodeError:
        raise invalid_value(name, os.fspath(path), "must be text that this system can write in a path") from None
    if b"\0" in encoded:
        raise invalid_value(name, os.fspath(path), "must not hold a NUL character")
    return Path(path)


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path, with the suffix of `path`, at which the body writes a file or makes a folder.

    Once the body ends, what is there is flushed to the disk and takes the place of `path`: of a file, or of nothing.
    If the body raises, it is deleted. Folders above it that are missing are made.

    Raises
    ------
    OSError
        It cannot be written; FileExistsError where a folder or a device has that name, BlockingIOError where another
        process is writing it.
    """
    given = checked_path("path", path)
    with _named(given):
        target = Path(os.path.realpath(given)) if given.is_symlink() else given
        if os.path.lexists(target) and not target.is_file():  # a folder would be lost, and so would /dev/null
            raise FileExistsError(errno.EEXIST, "is there already, and not a file that could be replaced", str(given))
        target.parent.mkdir(parents=True, exist_ok=True)
        with _own_folder(target.parent, target.name) as folder:
            new = folder / f"new{target.suffix}"
            yield new
            _flush(new)
            _replace(new, target)
            _flush_folder(target.parent)


def write(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file as `replacing` does."""
    with replacing(path) as new:
        new.write_bytes(content)


def prepare(folder: Path) -> None:
    """Make a folder if it is missing, and see that files can be written in it; an OSError says why not.

    For before long work. What killed processes left there is removed.
    """
    with _named(folder):
        checked_path("folder", folder).mkdir(parents=True, exist_ok=True)
        with _own_folder(folder, "."):
            pass


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Keep other processes from claiming the same folder, which must exist; BlockingIOError if one has.

    They may read and write in it none the less.
    """
    with ExitStack() as claim:
        with _named(folder):
            claim.enter_context(_own_folder(folder, ""))
        yield


def content(folder: Path) -> list[Path]:
    """Files and folders in a folder, without what is being written or was left by a killed process."""
    return [folder / name for name in os.listdir(folder) if not _UNFINISHED.fullmatch(name)]


def discard(path: Path) -> None:
    """Delete a file or a folder whole: at no time is only a part of it there."""
    with _named(path), _own_folder(path.parent, path.name) as folder:
        try:
            path.rename(folder / "old")
        except OSError as error:
            if error.errno != errno.EXDEV:  # as a layered file system has it for a folder of a layer below
                raise
            shutil.rmtree(path)


def reason(error: OSError) -> str:
    """Name the file and say why, in one line."""
    why = error.strerror or str(error)
    return one_line(why if error.filename is None else f"{os.fsdecode(error.filename)}: {why}")


def one_line(text: str) -> str:
    """Text without line breaks, which a path or another package's message may have."""
    return re.sub(r"\s*[\r\n]+\s*", " ", text)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Let an OSError of the body name a path in place of what stands there for it meanwhile, or of nothing."""
    try:
        yield
    except OSError as error:
        about = None if error.filename is None else Path(os.fsdecode(error.filename))
        ours = about is None or any(_UNFINISHED.fullmatch(part) for part in about.parts)
        if error.errno is None or not ours:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


@contextmanager
def _own_folder(parent: Path, name: str) -> Iterator[Path]:
    """Empty folder in another, for as long as the body runs; only one process at a time has the one of a name."""
    folder = parent / f".lattice_gym-{blake2b(name.encode('utf-8', 'surrogatepass'), digest_size=8).hexdigest()}"
    lock = _lock(folder, _WAIT if name else 0.0)
    if lock is None:
        raise BlockingIOError(errno.EAGAIN, "another process is writing it", str(folder))
    try:
        _remove_content(folder)
        _remove_abandoned(parent, folder)
        yield folder
    finally:
        _remove(folder, lock)


def _lock(folder: Path, wait: float) -> BaseFileLock | None:
    """Make the folder and take its lock; None where another process has it for longer than `wait` [s]."""
    from filelock import FileLock, Timeout  # costs 15 ms, of a package that is imported to step worms

    until = time.monotonic() + wait
    while True:
        with suppress(FileExistsError):
            folder.mkdir()
        lock = FileLock(folder / _LOCK, thread_local=False)
        try:
            lock.acquire(timeout=max(0.0, until - time.monotonic()), poll_interval=_POLL)
        except Timeout:
            return None
        except (FileNotFoundError, FileExistsError):  # its last owner has removed it meanwhile
            if time.monotonic() > until + _WAIT:
                raise
            continue
        return lock


def _remove(folder: Path, lock: BaseFileLock) -> None:
    """Remove a folder whose lock we have, unless another process is about to take it."""
    _remove_content(folder)
    with suppress(OSError):  # Windows removes an open file only with its release
        (folder / _LOCK).unlink()
    lock.release()
    with suppress(OSError):
        folder.rmdir()


def _remove_content(folder: Path) -> None:
    for name in os.listdir(folder):
        entry = folder / name
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry, ignore_errors=True)
        elif name != _LOCK:
            with suppress(OSError):
                entry.unlink()


def _remove_abandoned(parent: Path, own: Path) -> None:
    """Remove from a folder what processes left there that are no more."""
    for name in os.listdir(parent):
        folder = parent / name
        if _UNFINISHED.fullmatch(name) and folder != own and not folder.is_symlink():
            with suppress(OSError):  # it may be another user's
                lock = _lock(folder, 0.0)
                if lock is not None:
                    _remove(folder, lock)


def _flush(path: Path) -> None:
    """Have a file, or a folder and all within, written to the disk itself."""
    if path.is_dir():
        for entry in path.iterdir():
            _flush(entry)
        _flush_folder(path)
        return
    with path.open("r+b") as file:  # Windows flushes no file that is open for reading only
        _fsync(file.fileno())


def _flush_folder(folder: Path) -> None:
    if not _WINDOWS:  # which opens no folder, and keeps the names in it by itself
        handle = os.open(folder, os.O_RDONLY)
        try:
            _fsync(handle)
        finally:
            os.close(handle)


def _fsync(handle: int) -> None:
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in _NEVER_FLUSHED:
            raise


def _replace(new: Path, target: Path) -> None:
    """Move into place; Windows refuses that while a reader, a virus scanner or a spreadsheet has the target open."""
    until = time.monotonic() + _REPLACE_AGAIN
    while True:
        try:
            return os.replace(new, target)
        except OSError as error:
            if error.errno == errno.ENOTEMPTY:  # a folder that somebody else has made meanwhile
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target)) from error
            if not (_WINDOWS and isinstance(error, PermissionError)) or time.monotonic() > until:
                raise
            time.sleep(0.05)
