"""Machine code is kept between processes, never runs stale, and whatever befalls it never stops the work."""

from __future__ import annotations

import hashlib
import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import pytest

from lattice_gym.engines.fused.kernels import compiling, elasticity

FOLDER = Path(compiling.__file__).parent
PACKAGE = FOLDER.parents[2]
NAME = "elasticity.force_along_d3-*.nbc"
CALL = """
from lattice_gym.engines.fused.kernels.elasticity import force_along_d3
print(force_along_d3(2.0, 1.0, 0.0, 1.0, 2.0), len(force_along_d3.stats.cache_hits))
"""
COMPILED, LOADED = "2.0 0\n", "2.0 1\n"


def python(code: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process and a folder of its own, with the package that lies there, or else this one."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"NUMBA_CACHE_DIR": "", "PYTHONPATH": str(PACKAGE.parent)} | environment,
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done


def called_anew() -> str:
    """Do in this process what `CALL` does in one of its own: a function made anew looks for its code on the disk."""
    function: Any = elasticity.force_along_d3
    made: Any = compiling.compiled(function.py_func)
    return f"{made(2.0, 1.0, 0.0, 1.0, 2.0)} {len(made.stats.cache_hits)}\n"


@pytest.fixture(scope="module")
def install(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a copy of the package, where nothing was compiled and nothing can be kept beside the sources."""
    path = tmp_path_factory.mktemp("install")
    shutil.copytree(PACKAGE, path / PACKAGE.name, ignore=shutil.ignore_patterns("__pycache__", "benchmarks"))
    (path / FOLDER.relative_to(PACKAGE.parent) / "__pycache__").touch()
    return path


@pytest.fixture(scope="module")
def compiled_install(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a copy of the package, with machine code beside the sources; tests that change it copy it first."""
    path = tmp_path_factory.mktemp("compiled")
    shutil.copytree(PACKAGE, path / PACKAGE.name, ignore=shutil.ignore_patterns("__pycache__", "benchmarks"))
    assert python(CALL, path).stdout == COMPILED
    return path


def test_no_edit_runs_stale_machine_code(compiled_install: Path, tmp_path: Path) -> None:
    """What is compiled of one file is kept, and is compiled anew when a helper in another file was edited."""
    shutil.copytree(compiled_install, tmp_path, dirs_exist_ok=True)
    folder = tmp_path / FOLDER.relative_to(PACKAGE.parent)
    helper = folder / "arithmetic.py"
    assert python(CALL, tmp_path).stdout == LOADED
    (folder / "__pycache__" / "elasticity.force_along_d3-0-0.nbc.1234.part").touch()  # left by a killed process
    helper.write_text(helper.read_text().replace("builder.fma(*values)", "builder.fneg(builder.fma(*values))"))
    assert python(CALL, tmp_path).stdout == "-2.0 0\n"
    # What was kept of the version before is gone, and what numba is told of places holds.
    assert len(list((folder / "__pycache__").glob("elasticity.force_along_d3*"))) == 1
    assert python(CALL, tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "kept")).stdout == "-2.0 0\n"
    assert len(list((tmp_path / "kept").rglob(NAME))) == 1


def test_says_once_that_it_compiles(tmp_path: Path) -> None:
    """One line for a process that compiles, none for one that does not."""
    use = CALL + "force_along_d3(2, 1, 0, 1, 2)"
    first, second = (python(use, tmp_path, NUMBA_CACHE_DIR=str(tmp_path)).stderr for _ in range(2))
    assert first.count("compiling") == 1
    assert second == ""


@pytest.mark.parametrize("home", ["/dev/null", ""])
def test_nothing_can_be_written(install: Path, home: str) -> None:
    """A read-only install and no home, as in a container or a module of a cluster: it runs, with one warning."""
    done = python(CALL, install, HOME=home, XDG_CACHE_HOME="/dev/null/caches")
    assert done.stdout == COMPILED
    assert done.stderr.count("RuntimeWarning") == 1
    assert "NUMBA_CACHE_DIR" in done.stderr


def test_no_home_at_all(install: Path) -> None:
    """A user without a home in the list of users leaves "~" in the path: no folder of that name is made."""
    use = "import os; os.path.expanduser = lambda path: path\n" + CALL
    assert "NUMBA_CACHE_DIR" in python(use, install, XDG_CACHE_HOME="").stderr
    assert not (install / "~").exists()


def test_kept_in_the_users_folder(install: Path, tmp_path: Path) -> None:
    """Where the package cannot be written, one user compiles once."""
    runs = [python(CALL, install, XDG_CACHE_HOME=str(tmp_path)) for _ in range(2)]
    assert [run.stdout for run in runs] == [COMPILED, LOADED]
    assert runs[1].stderr == ""


def test_installed_with_machine_code(compiled_install: Path) -> None:
    """Where somebody who may write compiled before, nobody else has to, though they may only read."""
    read_only = "import pathlib\ndef refuse(*_, **__): raise PermissionError('read-only')\n"
    read_only += "pathlib.Path.mkdir = pathlib.Path.write_bytes = pathlib.Path.unlink = refuse\n"
    assert python(read_only + CALL, compiled_install).stdout == LOADED


def test_full_disk(tmp_path: Path) -> None:
    """Nothing half written is left, and the work goes on."""
    full = "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
    full += "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
    done = python(full + CALL, tmp_path, NUMBA_CACHE_DIR=str(tmp_path), PYTHONDONTWRITEBYTECODE="1")
    assert done.stdout == COMPILED
    assert "NUMBA_CACHE_DIR" in done.stderr
    assert [file for file in tmp_path.rglob("*") if file.is_file()] == []


def _flip(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


def _something_else(content: bytes) -> bytes:
    """Make a whole file of something else, as another build of numba might leave."""
    code = pickle.dumps(("not", "code"))
    return hashlib.sha256(code).digest() + code


@pytest.mark.parametrize(
    "damage",
    [lambda content: b"", lambda content: content[:-1], lambda content: b"\0" * len(content), _flip, _something_else],
    ids=["empty", "cut short", "zeros", "one bit", "something else"],
)
def test_damage_is_mended(damage: Callable[[bytes], bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A damaged file, or one that numba refuses, is compiled anew and is whole for the next who looks for it."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert [called_anew() for _ in range(2)] == [COMPILED, LOADED]
    (file,) = tmp_path.rglob(NAME)
    file.write_bytes(damage(file.read_bytes()))
    assert [called_anew() for _ in range(2)] == [COMPILED, LOADED]


def test_other_code_keeps_its_own_cache(tmp_path: Path) -> None:
    """The rule of this folder is not that of the process, even while its modules are being imported."""
    (tmp_path / "foreign.py").write_text("def double(x):\n    return 2.0 * x\n")
    use = """
import threading
from numba import njit
from numba.core import config
import foreign
done = threading.Event()
def loop():
    while not done.is_set():
        njit(cache=True)(foreign.double)(1.0)
thread = threading.Thread(target=loop)
thread.start()
import lattice_gym.engines.fused.kernels.step
done.set()
thread.join()
print(len(njit(cache=True)(foreign.double).stats.cache_path) > 0, config.CACHE_LOCATOR_CLASSES)
"""
    path = os.pathsep.join([str(PACKAGE.parent), str(tmp_path)])
    assert python(use, tmp_path, PYTHONPATH=path).stdout.split(maxsplit=1)[0] == "True"
    assert len(list((tmp_path / "__pycache__").glob("foreign.double*.nbc"))) == 1
