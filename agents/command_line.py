"""What the command lines share: options, signals, and errors as one line of text in place of a traceback."""

from __future__ import annotations

import io
import os
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TypeVar

import tyro

from agents.config import InputError
from lattice_gym.recording.files import one_line, reason

SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""What ctrl-C, a batch system or make send to end a program."""
LINE_EVERY = 10.0
"""Least time between two lines of progress [s]."""
_ONE_SIGNAL = 1.0
"""A signal that comes again within this is the same one, sent to the process and to its group [s]."""

T = TypeVar("T")


class Stopped(KeyboardInterrupt):
    """A signal ended the work; `again` is the command that continues it."""

    def __init__(self, number: int, again: str = "") -> None:
        super().__init__(f"stopped by {signal.Signals(number).name}" + (f"; continue with: {again}" if again else ""))
        self.number = number


class Progress:
    """Prints what it is told on stderr, a line now and then, so that nothing long is silent."""

    def __init__(self, every: float = LINE_EVERY) -> None:
        """Print at most one line in so many seconds, the first of them after as many."""
        self._every = every
        self._printed_at = time.monotonic()

    def __call__(self, *parts: str) -> None:
        """Print a line of these parts if it is time."""
        if time.monotonic() - self._printed_at >= self._every:
            self._printed_at = time.monotonic()
            print(*parts, sep=", ", file=sys.stderr, flush=True)


@contextmanager
def on_signal(act: Callable[[int], object]) -> Iterator[None]:
    """Let ctrl-C and termination call `act` with the signal's number; outside the main thread nothing changes."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    last = -_ONE_SIGNAL

    def handle(number: int, _frame: FrameType | None) -> None:
        nonlocal last
        before, last = last, time.monotonic()
        if last - before >= _ONE_SIGNAL:
            act(number)

    previous = {number: signal.signal(number, handle) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _stop(number: int) -> None:
    raise Stopped(number)


def command(*words: str | Path) -> str:
    """Command to copy into a shell, whatever characters are in a path of it."""
    safe = [f".{os.sep}{word}" if isinstance(word, Path) and str(word).startswith("-") else str(word) for word in words]
    return subprocess.list2cmdline(safe) if os.name == "nt" else shlex.join(safe)


@contextmanager
def as_program() -> Iterator[None]:
    """End with a line of text, not a traceback.

    On an InputError or what the system refuses, as on a full disk, the status is 1; on a signal 128 and its number.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # not every path can be written in every encoding
    with on_signal(_stop):
        try:
            yield
        except InputError as error:
            sys.exit(f"error: {one_line(str(error))}")
        except OSError as error:
            if error.errno is None:
                raise
            sys.exit(f"error: {reason(error)}")
        except Stopped as stopped:
            print(stopped, file=sys.stderr, flush=True)
            sys.exit(128 + stopped.number)


def options(settings: type[T], name: str, arguments: Sequence[str] | None = None, default: T | None = None) -> T:
    """Read settings from the arguments of the program `name`, by default those of this process."""
    if default is None:
        return tyro.cli(settings, prog=name, args=arguments)
    return tyro.cli(settings, prog=name, args=arguments, default=default)


def run(main: Callable[..., None], name: str) -> None:
    """Call `main` as the program `name`, with the arguments of this process's command line."""
    with as_program():
        tyro.cli(main, prog=name)
