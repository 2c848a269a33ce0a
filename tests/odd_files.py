"""Odd names, full disks and what is left behind: what tests of files share."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

ODD = {
    "colon": "a:b",
    "protocol": "file:x",
    "spaces": " two  spaces ",
    "percent": "100%d%20",
    "quotes": 'it\'s "so"',
    "dash": "-y",
    "unicode": "wörm \u87f2 \U0001f41b",
    "newline": "two\nlines",
    "shell": "$HOME `x`; & | > <",
    "pattern": "[0-9]*?{a,b}",
    "home": "~",
    "backslash": "a\\b",
    "long": "x" * 240,
    "no UTF-8": os.fsdecode(b"caf\xe9"),
    "a lock": "lock",
}
"""What file names hold elsewhere."""
if sys.platform == "win32":
    ODD = {kind: ODD[kind] for kind in ("spaces", "percent", "dash", "unicode", "home", "a lock")}


def leftovers(folder: Path) -> list[Path]:
    """List what is being written below a folder, or was left by a killed process."""
    return [path for path in folder.rglob("*") if path.name.startswith(".lattice_gym-")]


@contextmanager
def limited(size: int) -> Iterator[None]:
    """Let every file end at so many bytes, as on a disk that is full."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
