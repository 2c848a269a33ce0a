"""The compiled code itself: no index leaves its array, which optimised code would not tell."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

from lattice_gym.engines.fused import kernels


def test_no_index_leaves_its_array(tmp_path: Path) -> None:
    """A general assembly and a lattice run with numba's bounds checks on, and still agree with PyElastica."""
    checks = [
        "test_engines_agree[options4]",
        "test_engines_agree_on_any_assembly",
        "test_each_failure_is_named",
        "test_large_rotations_are_exact",
        "test_momentum",
        "test_list_is_that_of_brute_force",
    ]
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
        "tests/test_engines.py",
        "tests/test_bolus.py",
        "tests/test_contact.py",
    ]
    # A cache of its own: code with bounds checks must not be taken for the fast code, nor the other way round.
    environment = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [*command, "-k", " or ".join(checks)],
        env=environment,
        cwd=Path(__file__).parent.parent,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]


def test_no_edit_runs_stale_machine_code() -> None:
    """Numba's cache is as old as this one file: nothing that is compiled in may come from another of ours."""
    source = Path(kernels.__file__).read_text()
    imported = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            imported |= {name.name.split(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add("." if node.level else str(node.module).split(".")[0])
    assert imported == {"__future__", "collections", "typing", "numpy", "numba"}
