"""Whole calls with random and hostile arguments: each works, or one ValueError names what is wrong.

`python tests/test_bad_input.py --count 10000` makes that many generated calls and prints how many escaped: raised
anything else, named nothing, warned, hung, or worked and returned what is not finite or not what was asked for. As a
test a few hundred calls are made on every target.
"""

from __future__ import annotations

import argparse
import sys

import bad_bodies
import bad_environments
import bad_files
import bad_physics
import bad_recordings
import numpy as np
import pytest
from hunting import Target, fixed, hunt
from hypothesis import strategies as st
from junk import finite

IN_TESTS = 250
"""Calls on each target in the tests."""

KINDS = (bad_bodies, bad_environments, bad_physics, bad_recordings, bad_files)
TARGETS = [target for kind in KINDS for target in kind.TARGETS]


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_nothing_escapes(target: Target) -> None:
    """A few hundred calls on each target."""
    _, escapes = hunt(target, IN_TESTS, seed=0)
    assert escapes == {}


def test_escapes_are_seen() -> None:
    """Every kind of escape is one, or the test above would show nothing."""

    def call(what: str) -> object:
        if what == "fine":
            return None
        if what == "named":
            raise ValueError("size = -1: must be positive")
        if what == "unnamed":
            raise ValueError("bad")
        if what == "warned":
            return np.sqrt(np.array(-1.0))
        if what == "crashed":
            raise KeyError(what)
        finite(np.nan)
        return None

    kinds = ["fine", "named", "unnamed", "warned", "crashed", "wrong"]
    target = Target("target", st.sampled_from(kinds), call, fixed("size"))
    _, escapes = hunt(target, 200, seed=0)
    assert set(escapes.values()) == set(kinds[2:])


def main() -> int:
    """Hunt over all targets; exit status 1 where anything escaped."""
    options = argparse.ArgumentParser(description="Call everything with generated input and count what escapes.")
    options.add_argument("--count", type=int, default=10_000, help="calls in all (default: 10000)")
    options.add_argument("--seed", type=int, default=0, help="of the generator (default: 0)")
    options.add_argument("--only", default="", help="part of the names of the targets to call")
    given_ = options.parse_args()
    chosen = [target for target in TARGETS if given_.only in target.name]
    total, kinds = 0, 0
    for target in chosen:
        made, escapes = hunt(target, -(-given_.count // len(chosen)), given_.seed)
        total, kinds = total + made, kinds + len(escapes)
        sys.stdout.write(f"{target.name}: {made} inputs, {len(escapes)} escapes\n")
        for problem, call in escapes.items():
            sys.stdout.write(f"  {problem}\n    {str(call)[:400]}\n")
        sys.stdout.flush()
    sys.stdout.write(f"{total} generated inputs, {kinds} kinds of escape\n")
    return 1 if kinds else 0


if __name__ == "__main__":
    sys.exit(main())
