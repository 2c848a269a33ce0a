"""The pages of docs/ say what is there: their examples run, their tables name what exists."""

from __future__ import annotations

import inspect
import re
import shlex
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from inspect import get_annotations
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, get_type_hints

import gymnasium
import pytest

import lattice_gym
from agents.command_line import options
from agents.config import TrainConfig
from lattice_gym.engines.registry import ENGINES
from lattice_gym.tasks.base import Task

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
EXAMPLES = sorted((DOCS / "examples").glob("*.py"))
LINK = re.compile(r"\]\((?!https?:)([^)#]+)")
PART = re.compile(r"`(\w+)(?:\(([^)]*)\))?`")


def blocks(page: Path, language: str) -> list[str]:
    """Blocks of a language on a page, in order."""
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), re.DOTALL)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Work in a folder that holds the examples; forget afterwards what they have registered."""
    for example in EXAMPLES:
        shutil.copy(example, tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    tables: tuple[dict[str, Any], ...] = (gymnasium.registry, ENGINES)
    before = [dict(table) for table in tables]
    yield tmp_path
    for table, kept in zip(tables, before, strict=True):
        table.clear()
        table.update(kept)
    for example in EXAMPLES:
        sys.modules.pop(example.stem, None)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_examples_run(page: Path, folder: Path) -> None:
    """As they stand, one after the other."""
    names: dict[str, Any] = {"__name__": "page"}
    for number, block in enumerate(blocks(page, "python")):
        exec(compile(block, f"{page.name}, block {number}", "exec", dont_inherit=True), names)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.stem)
def test_examples_are_quoted_whole(example: Path) -> None:
    """What a page shows of a file is what the file holds."""
    quoting = [page for page in PAGES if f"(examples/{example.name})" in page.read_text()]
    assert any(example.read_text() in blocks(page, "python") for page in quoting)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page: Path) -> None:
    """Every path is one of the repository."""
    linked = LINK.findall(page.read_text())
    assert [path for path in linked if not (page.parent / path).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_names_beside_files_exist(page: Path) -> None:
    """In a row of a table names stand after the files that hold them, the last of them or an earlier one."""
    bad = []
    for row in page.read_text().splitlines():
        modules: list[Any] = []
        for path, name in re.findall(r"\]\(\.\./([\w/]+\.py)\)|`([A-Za-z_][\w.]*)`", row if row[:1] == "|" else ""):
            if path:
                modules.append(resolve_name(path.removesuffix(".py").replace("/", ".")))
            elif modules and not any(has(module, name) for module in modules):
                bad.append((name, row))
    assert bad == []


def has(module: object, name: str) -> bool:
    """Tell whether a module holds a dotted name, be it a method or a field."""
    for part in name.split("."):
        if not hasattr(module, part):
            return False
        module = inspect.getattr_static(module, part)
    return True


def test_parts_of_a_task_exist() -> None:
    """What the tables of a task's parts name is there, and methods take the arguments that are shown."""
    tables = re.findall(r"^\| part \|.*\n((?:\|.*\n)+)", (DOCS / "tasks.md").read_text(), re.M)
    shown = [part for table in tables for row in table.splitlines() for part in PART.findall(row.split("|")[1])]
    assert len(shown) > 20
    bad = []
    for name, arguments in shown:
        part = getattr(Task, name, None) or get_annotations(Task).get(name) or getattr(lattice_gym, name, None)
        if part is None or (arguments and arguments.split(", ") != argument_names(part)):
            bad.append(name)
    assert bad == []


def argument_names(method: Any) -> list[str]:
    """Names of the arguments of a method, with the class or the object first."""
    return list(inspect.signature(getattr(method, "__func__", method)).parameters)


def test_every_law_has_its_row() -> None:
    """No file of a law is left out of the index, in any of the three folders."""
    text = (DOCS / "README.md").read_text()
    laws = {path.stem for path in (ROOT / "lattice_gym/physics/laws").glob("*.py")} - {"__init__", "base"}
    for folder in ("physics/laws", "engines/fused/kernels", "engines/pyelastica"):
        for file in (ROOT / "lattice_gym" / folder).glob("*.py"):
            assert file.stem not in laws or f"(../lattice_gym/{folder}/{file.name})" in text, file


def test_every_page_is_in_the_index() -> None:
    """And in the README the index is."""
    text = (DOCS / "README.md").read_text()
    assert [page.name for page in PAGES if f"({page.name})" not in text] == ["README.md"]
    assert "(docs/README.md)" in (ROOT / "README.md").read_text()


def option_names(main: Callable[..., object]) -> set[str]:
    """Options of a program: the arguments of its main function, and the fields of settings among them."""
    hints = get_type_hints(main)
    return hints.keys() | {field.name for kind in hints.values() if is_dataclass(kind) for field in fields(kind)}


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda page: page.stem)
def test_commands_exist(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs that a page calls are there, with the options that it gives."""
    monkeypatch.syspath_prepend(DOCS / "examples")
    lines = [line for block in blocks(page, "sh") for line in block.splitlines()]
    for command in lines:
        words = shlex.split(command.split("#")[0])
        if words[:2] == ["python", "train.py"]:
            options(TrainConfig, "train.py", words[2:])
        elif words[:2] == ["python", "-m"]:
            known = option_names(resolve_name(f"{words[2]}:main"))
            given = {word[2:].replace("-", "_") for word in words[3:] if word.startswith("--")}
            assert given <= known, command
        else:
            assert not words or words[0] in {"make", "export"}, command
    sys.modules.pop("twist", None)


def test_moved_names_are_where_the_changelog_says() -> None:
    """Every name in the table of what moved stands in its new module."""
    rows = re.findall(
        r"^\| `lattice_gym[\w.]*` \| (.+) \| `(lattice_gym[\w.]*)` \|$", (ROOT / "CHANGELOG.md").read_text(), re.M
    )
    assert len(rows) > 50
    for names, place in rows:
        module = resolve_name(place)
        assert [name for name in re.findall(r"`(\w+)`", names) if not has(module, name)] == [], place
