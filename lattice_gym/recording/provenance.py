"""What a result was made with: command, date, processor, versions."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGES = ("lattice_gym", "pyelastica", "numba", "numpy", "gymnasium")


def provenance(command: str, packages: Iterable[str] = PACKAGES) -> dict[str, Any]:
    """Date, command, processor, cores, Python and package versions: everything but paths and host names."""
    return {
        "command": command,
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in packages},
    }


def footer(made: dict[str, Any]) -> str:
    """One line of Markdown from what `provenance` gave."""
    versions = ", ".join(f"{name} {version}" for name, version in made["versions"].items())
    machine = f"{made['processor']}, {made['cores']} cores, Python {made['python']}"
    return f"Made {made['date']} by `{made['command']}` on {machine}, {versions}."


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"
