"""Commands that messages and pages name work: their packages, extras, modules and targets exist."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

from lattice_gym.rendering.extras import VIDEO, extra

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS: dict[str, list[str]] = PROJECT["optional-dependencies"]
PATHS = ("lattice_gym", "agents", "docs", ".github", ".ci", "README.md", "Makefile", "train.py")
SUFFIXES = (".py", ".md", ".yml", ".yaml", "")


def texts() -> Iterator[tuple[str, str]]:
    """Name and text of every file that may name a command; results tell by what they were made."""
    for path in (ROOT / name for name in PATHS):
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.is_file() and file.suffix in SUFFIXES and not {"__pycache__", "results"} & set(file.parts):
                yield file.relative_to(ROOT).as_posix(), file.read_text(encoding="utf-8")


def found(pattern: str) -> set[tuple[str, ...]]:
    """Every match of a pattern in these files: the file, then its groups."""
    return {(name, *match.groups()) for name, text in texts() for match in re.finditer(pattern, text)}


def package(requirement: str) -> str:
    """Name of what a requirement asks for, and its extra."""
    return re.sub(r"[^\w.\-\[\],].*", "", requirement).lower()


def test_no_index_is_asked_for_this_package() -> None:
    """It is on none: an extra of it can be named in a clone only."""
    assert found(r"lattice[_-]gym(\[\w+\])") == set()
    assert {name for name, *_ in found(r"pip install (lattice[_-]gym)\b")} == set()


def test_named_extras_exist() -> None:
    """In double quotes, which every shell takes; make has one of its own."""
    named = found(r"pip install [^`\n]*?(.)\.\[([\w,]+)\]")
    assert {"README.md", "agents/__init__.py"} <= {name for name, *_ in named}
    for name, quote, extras in named:
        assert quote == '"' or name == "Makefile", name
        assert set(extras.split(",")) <= set(EXTRAS), name


def test_missing_packages_are_those_of_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    """The message gives a command with every one of them, as a shell reads it."""
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(ImportError, match=r"^pictures and videos need pyvista: pip install ") as raised:
        extra("pyvista")
    words = shlex.split(str(raised.value).partition(": ")[2])
    assert words == ["pip", "install", *VIDEO]
    assert sorted(VIDEO) == sorted(package(requirement) for requirement in EXTRAS["video"])


def test_named_programs_exist() -> None:
    """`python -m` of a package runs its `__main__`, of a module the module."""
    named = {name for _, name in found(r"python -m ((?:agents|lattice_gym)[\w.]*\w)")}
    assert {"agents.evaluation", "agents.rollouts", "lattice_gym.benchmarks"} <= named
    for name in named:
        spec = find_spec(name)
        assert spec is not None, name
        source = spec if spec.submodule_search_locations is None else find_spec(f"{name}.__main__")
        assert source is not None, name
        assert source.origin is not None, name
        assert "__main__" in Path(source.origin).read_text(encoding="utf-8"), name


def test_named_targets_exist() -> None:
    """Of make, with the variables that they take."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    named = found(r"(?m)(?:`|with: |run: |^)make ([a-z]+)((?: [A-Z]+=)?)")
    assert {"demo", "test"} <= {target for _, target, _ in named}
    for name, target, variable in named:
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), (name, target)
        assert not variable or re.search(rf"^{variable[1:-1]} \?=", makefile, re.MULTILINE), (name, variable)


def test_id_with_its_package_needs_no_import(tmp_path: Path) -> None:
    """The README says so, and it is so, for one worm and for many."""
    (call,) = {call for _, call in found(r'`(gymnasium\.make\("lattice_gym:LatticeWorm-v0"\))`, needs no')}
    many = call.replace("make(", "make_vec(").replace(")", ", num_envs=2)")
    code = f"import gymnasium; print({call}.reset(seed=0)[0].shape, {many}.reset(seed=0)[0].shape)"
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r}); {code}"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert re.fullmatch(r"\((\d+),\) \(2, \1\)\n", ran.stdout)
