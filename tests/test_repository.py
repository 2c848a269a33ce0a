"""What stands around the code is true: citation, guide, forms, hooks and workflows agree with the package."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import lattice_gym

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PAGES = sorted((ROOT / ".github").glob("*.md"))
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


def read(name: str) -> str:
    """Text of a file of the repository."""
    return (ROOT / name).read_text(encoding="utf-8")


def test_citation_is_of_this_version() -> None:
    """Its version, licence and authors are those of the package; the authors are an entity, not a person."""
    citation = read("CITATION.cff")
    top = dict(re.findall(r"^([a-z-]+): (.+)$", citation, re.MULTILINE))
    assert (top["version"], top["license"]) == (PROJECT["version"], PROJECT["license"])
    authors = re.search(r"^authors:\n((?:  .+\n)+)", citation, re.MULTILINE)
    assert authors is not None
    assert authors.group(1) == "".join(f"  - name: {author['name']}\n" for author in PROJECT["authors"])


def test_hooks_are_those_of_make_lint() -> None:
    """In the same order, whatever files are named to them."""
    linted = re.search(r"^lint:.*\n((?:\t.+\n)+)", read("Makefile"), re.MULTILINE)
    assert linted is not None
    commands = [line.strip().removeprefix("$(BIN)/") for line in linted.group(1).splitlines()]
    entries = re.findall(r"^ +entry: (.+)$", read(".pre-commit-config.yaml"), re.MULTILINE)
    assert [entry.replace(" --force-exclude", "") for entry in entries] == commands


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page: Path) -> None:
    """Every path is one of the repository."""
    linked = re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text(encoding="utf-8"))
    assert [path for path in linked if not (page.parent / path).exists()] == []


@pytest.mark.parametrize("file", [*PAGES, *WORKFLOWS], ids=lambda file: file.stem)
def test_named_files_exist(file: Path) -> None:
    """Tests and scripts that are called, and constraints."""
    named = re.findall(r"(?<![\w/])((?:tests|\.ci|docs)/[\w./-]*\w)", file.read_text(encoding="utf-8"))
    assert [path for path in named if not (ROOT / path).exists()] == []


def test_workflows_run_on_the_oldest_python() -> None:
    """What they build and check with is what the package promises."""
    oldest = PROJECT["requires-python"].removeprefix(">=")
    for name in ("docs", "package"):
        assert f'python-version: "{oldest}"' in read(f".github/workflows/{name}.yml"), name


@pytest.mark.slow
def test_versions_can_be_reported() -> None:
    """The command of the form for reports prints them."""
    command = re.search(r'python -c "(.+)"', read(".github/ISSUE_TEMPLATE/bug.yml"))
    assert command is not None
    ran = subprocess.run([sys.executable, "-c", command.group(1)], cwd=ROOT, capture_output=True, text=True, check=True)
    for name in ("lattice_gym", "numba", "numpy", "gymnasium", "Python"):
        assert re.search(rf"{name} \d", ran.stdout), name
    assert ran.stderr == ""


def test_distributions_are_made_of_what_is_there() -> None:
    """The script steps ids that exist in an empty environment, and what it keeps out of the wheel is there."""
    script = read(".ci/package.py")
    ids = set(re.findall(r"lattice_gym:(LatticeWorm\w*-v\d)", script))
    assert ids
    assert all(f"`{name}`" in str(lattice_gym.LatticeWormEnv.__doc__) for name in ids)
    for folder in re.findall(r'"(\w+(?:/\w+)?)/"', script):
        assert (ROOT / folder).is_dir(), folder
