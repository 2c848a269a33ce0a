"""Result files of the reports: JSON, and Markdown with tables and a footer."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from lattice_gym.recording import files
from lattice_gym.recording.provenance import footer, provenance


def write(folder: Path, name: str, result: dict[str, Any], parts: Sequence[str], command: str) -> None:
    """Write NAME.json and NAME.md, both with what `command` made them; prints the text as well."""
    made = provenance(command)
    content = json.dumps(_finite(result | {"made": made}), indent=1, allow_nan=False) + "\n"
    text = "\n\n".join([*parts, footer(made)]) + "\n"
    files.write(folder / f"{name}.json", content.encode())
    files.write(folder / f"{name}.md", text.encode())
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
