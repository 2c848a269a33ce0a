"""Imports go one way, stay light, and what is installed is pinned."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("agents", "elastica", "imageio", "matplotlib", "pyvista", "stable_baselines3", "torch", "vtk", "vtkmodules")


def _lint_imports(folder: Path) -> subprocess.CompletedProcess[str]:
    """Check the contracts of pyproject.toml in a folder."""
    command = [sys.executable, "-c", "from importlinter.cli import lint_imports_command; lint_imports_command()"]
    return subprocess.run([*command, "--no-cache"], cwd=folder, capture_output=True, text=True, check=False)


def test_contracts_hold() -> None:
    """Benchmarks to checks, and nothing that learns."""
    result = _lint_imports(ROOT)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "3 kept, 0 broken" in result.stdout


@pytest.mark.parametrize(
    ("module", "line", "broken"),
    [
        ("lattice_gym/checks.py", "from lattice_gym.body import lattice", "Imports go one way"),
        ("lattice_gym/checks.py", "import torch", "knows nothing of what learns"),
        ("lattice_gym/checks.py", "from agents import config", "knows nothing of what learns"),
        ("lattice_gym/envs/vector.py", "import stable_baselines3", "knows nothing of what learns"),
        ("lattice_gym/sb3.py", "import torch", "knows nothing of what learns"),
        ("lattice_gym/envs/vector.py", "from lattice_gym import sb3", "Imports go one way"),
        ("agents/config.py", "import train", "know nothing of the command line"),
    ],
)
def test_contracts_can_break(tmp_path: Path, module: str, line: str, broken: str) -> None:
    """One import the wrong way is found, or the test above would show nothing."""
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for package in ("lattice_gym", "agents"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    with (tmp_path / module).open("a") as file:
        file.write(f"\n{line}\n")
    result = _lint_imports(tmp_path)
    assert result.returncode == 1, result.stdout + result.stderr
    assert re.search(rf"{broken}.* BROKEN", result.stdout)


def test_import_is_light() -> None:
    """Importing the package loads neither an engine's, a picture's nor a learner's library."""
    code = f"import sys, lattice_gym; print([name for name in {HEAVY!r} if name in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_every_dependency_is_pinned() -> None:
    """Each requirement of pyproject.toml has one exact version in constraints.txt, fit for any machine."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    required = project["dependencies"] + [name for extra in project["optional-dependencies"].values() for name in extra]
    lines = [line for line in (ROOT / ".ci" / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    pins = {}
    for line in lines:
        name, version = line.split("==")
        assert re.fullmatch(r"[0-9][0-9A-Za-z.]*", version), line
        pins[re.sub(r"[-_.]+", "-", name).lower()] = version
    for requirement in required:
        name = re.split(r"[^A-Za-z0-9_.-]", requirement)[0]
        assert re.sub(r"[-_.]+", "-", name).lower() in pins
    assert pins["torch"] == "2.13.0"
