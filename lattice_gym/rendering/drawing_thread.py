"""The one thread that draws.

What OpenGL draws with belongs to the thread that made it: another gets a wrong picture of it and is not told. Nor does
it survive a fork: the child waits for ever. So scenes are made, used and freed in one thread of a process, to which all
others send what is to be done there.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from itertools import count
from queue import SimpleQueue
from typing import Any, Generic, Protocol, TypeVar
from weakref import finalize

CLOSING_TIME = 10.0
"""How long `Drawn.close` waits for a scene to be freed [s]."""

Result = TypeVar("Result")


class Closable(Protocol):
    """What can be freed."""

    def close(self) -> None:
        """Free it."""


Scene = TypeVar("Scene", bound=Closable)


class Drawn(Generic[Scene]):
    """A scene that is made, used and freed in the thread that draws; any thread may do all of it.

    One that is no longer used is freed too. Many scenes, and many threads, take turns.

    Parameters
    ----------
    make
        Makes the scene.

    Raises
    ------
    RuntimeError
        This process is a fork of one that has drawn.
    """

    def __init__(self, make: Callable[[], Scene]) -> None:
        self._key = next(_KEYS)
        self._thread = _DRAWING.open(self._key)
        self._freed: Future[None] = Future()
        free = partial(_do, self._freed, partial(self._thread.free, self._key))
        self._free = finalize(self, self._thread.tasks.put, free)
        self._free.atexit = False
        try:
            self._in_thread(partial(self._thread.make, self._key, make))
        except BaseException:  # An interrupt too, which leaves the thread at work.
            self._free()
            raise

    def use(self, function: Callable[[Scene], Result]) -> Result:
        """Call a function of the scene there; a RuntimeError once it is closed, or in a fork."""
        return self._in_thread(partial(self._thread.use, self._key, function))

    def close(self) -> None:
        """Free the scene, or leave it alone in a fork and where Python is about to end."""
        self._free()
        here = threading.current_thread() is self._thread
        if self._thread.is_alive() and not here and not sys.is_finalizing():
            # It may be called where an object is collected, and there one must not wait for ever.
            with suppress(TimeoutError):
                self._freed.result(CLOSING_TIME)

    def _in_thread(self, task: Callable[[], Result]) -> Result:
        return task() if threading.current_thread() is self._thread else _DRAWING.send(self._thread, task).result()


class _DrawingThread(threading.Thread):
    """Does one task after another, and ends when no scene is left: a process with one thread may be forked.

    A daemon, it does not end with Python but is stopped: what is still open is left alone, and may be drawn until then.
    """

    def __init__(self) -> None:
        super().__init__(name="drawing", daemon=True)
        # Unlike a ThreadPoolExecutor it may be given a task where it was interrupted in taking one.
        self.tasks: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self.keys: set[int] = set()
        """Of scenes that are not yet freed, or made."""
        self._scenes: dict[int, Any] = {}

    def run(self) -> None:
        """Do tasks until neither a scene nor a task is left."""
        while True:
            self.tasks.get()()
            if not self.keys and _DRAWING.end(self):
                return

    def make(self, key: int, make: Callable[[], Closable]) -> None:
        """Make a scene."""
        self._scenes[key] = make()

    def use(self, key: int, function: Callable[[Any], Result]) -> Result:
        """Call a function of a scene."""
        if key not in self._scenes:
            raise RuntimeError("renderer: it is closed; make a new one")
        return function(self._scenes[key])

    def free(self, key: int) -> None:
        """Free a scene, if it was made."""
        self.keys.discard(key)
        if key in self._scenes:
            self._scenes.pop(key).close()


class _Drawing:
    """The thread in which this process draws, if it does now.

    Its lock is held where a task is given. Tasks that free a scene are given without it, and the thread never waits for
    it: they come from wherever objects are collected, which may be within the lock.
    """

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.thread: _DrawingThread | None = None
        self.before_fork: list[_DrawingThread] = []
        """Threads of the processes that this one was forked from, kept so that nothing of theirs is freed here."""
        self._has_drawn = self._forked = False

    def open(self, key: int) -> _DrawingThread:
        """Thread that a new scene is to be made in."""
        if self._forked:
            raise _of_fork()
        with self.lock:
            if self.thread is None:
                thread = _DrawingThread()
                thread.start()
                self.thread, self._has_drawn = thread, True
            self.thread.keys.add(key)
            return self.thread

    def send(self, thread: _DrawingThread, task: Callable[[], Result]) -> Future[Result]:
        """Have a task done in a thread."""
        if thread in self.before_fork:
            raise _of_fork()
        future: Future[Result] = Future()
        with self.lock:
            if thread is self.thread:
                thread.tasks.put(partial(_do, future, task))
            else:  # It has ended: `task` will say why not.
                _do(future, task)
        return future

    def end(self, thread: _DrawingThread) -> bool:
        """Whether a thread without scenes is to end: unless another is about to give it a task."""
        if not self.lock.acquire(blocking=False):
            return False
        try:
            if thread.keys or not thread.tasks.empty():
                return False
            self.thread = None
            return True
        finally:
            self.lock.release()

    def after_fork(self) -> None:
        """Begin anew in a child: no thread but that which forked lives on in it."""
        self.lock = threading.Lock()
        if self.thread is not None:
            self.before_fork.append(self.thread)
        self.thread, self._forked = None, self._has_drawn


def _do(future: Future[Result], task: Callable[[], Result]) -> None:
    """Do a task and tell how it went."""
    try:
        future.set_result(task())
    except BaseException as error:
        future.set_exception(error)


def _of_fork() -> RuntimeError:
    return RuntimeError(
        "pictures: this process was forked from one that has drawn, and OpenGL does not survive a fork; start it by "
        'spawn, as by multiprocessing.get_context("spawn") or AsyncVectorEnv(..., context="spawn"), or draw nothing '
        "before the fork"
    )


_KEYS = count()
_DRAWING = _Drawing()
if sys.platform != "win32":
    os.register_at_fork(after_in_child=_DRAWING.after_fork)
