"""On what machine, with which versions and by which command a result was made; and how results are written."""

from __future__ import annotations

import json
import math
import os
import platform
import sys
from collections.abc import Iterable, Sequence
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


def write(folder: Path, name: str, result: dict[str, Any], tables: Sequence[str]) -> None:
    """Write NAME.json and NAME.md; `result["made"]` is what `provenance` gave. Prints the tables as well."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.json").write_text(json.dumps(_finite(result), indent=1, allow_nan=False) + "\n")
    text = "\n\n".join([*tables, footer(result["made"])]) + "\n"
    (folder / f"{name}.md").write_text(text)
    sys.stdout.write(text)


def _finite(value: Any) -> Any:
    """Copy with None for what JSON cannot hold: numbers that are not finite."""
    if isinstance(value, dict):
        return {name: _finite(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Markdown table with columns as wide as their widest entry."""
    lines = [list(header), *(list(row) for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    text = [
        "| " + " | ".join(entry.ljust(width) for entry, width in zip(line, widths, strict=True)) + " |"
        for line in lines
    ]
    return "\n".join([text[0], "|" + "|".join("-" * (width + 2) for width in widths) + "|", *text[1:]])


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"
