"""Generated calls, and what is wrong with how they end."""

from __future__ import annotations

import signal
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as seeded
from hypothesis import strategies as st

HANG = 30.0
"""A call that takes longer hangs [s]."""

Call = Any


@dataclass(frozen=True)
class Target:
    """What is called, with what, and the names one of which a refusal must hold."""

    name: str
    calls: st.SearchStrategy[Call]
    make: Callable[[Call], object]
    """Makes the call and checks what it returns; AssertionError where that is wrong."""
    names: Callable[[Call], tuple[str, ...]]


class Hang(BaseException):
    """What a call that takes too long is stopped with."""


@contextmanager
def bounded(seconds: float) -> Iterator[None]:
    """Raise `Hang` where the body takes longer."""

    def give_up(*_: object) -> None:
        raise Hang

    old = signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, old)


def escape(target: Target, call: Call) -> str | None:
    """Say what is wrong with how a call ended, if anything is."""
    try:
        with warnings.catch_warnings(), bounded(HANG):
            warnings.simplefilter("error")
            target.make(call)
    except ValueError as error:
        message = str(error)
        if not any(name.lower() in message.lower() for name in target.names(call)):
            return f"the message names nothing: {message[:300]!r}"
    except Hang:
        return f"no answer within {HANG:g} s"
    except (Exception, SystemExit) as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {str(error)[:200]} ({Path(at.filename).name}:{at.lineno})"
    return None


def hunt(target: Target, count: int, seed: int) -> tuple[int, dict[str, Call]]:
    """Make `count` generated calls; how many there were, and an example of every kind of escape."""
    made, escapes = 0, dict[str, Call]()

    @seeded(seed)
    @settings(max_examples=count, deadline=None, phases=[Phase.generate], database=None,
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(target.calls)
    def run(call: Call) -> None:
        nonlocal made
        made += 1
        if (problem := escape(target, call)) is not None:
            escapes.setdefault(problem, call)

    run()
    return made, escapes


def fixed(*names: str) -> Callable[[Call], tuple[str, ...]]:
    """Names that do not depend on the call."""
    return lambda call: names
