"""Command line: `python -m lattice_gym.benchmarks NAME [options]`."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import tyro

from lattice_gym.checks import Parameters, checked, choice, count, items, number
from lattice_gym.engines.registry import ENGINES, EngineName
from lattice_gym.recording.files import prepare, reason

_TENSION = partial(number, low=0.0, unit="N", above=True)


@dataclass(frozen=True, kw_only=True)
class Paper(Parameters):
    """The paper's three motions beside its Table 2."""

    engine: EngineName = checked("fused", choice, choices=ENGINES)
    """Name of the engine: fused or pyelastica."""
    tension: tuple[float, ...] = checked((0.5, 1.0), items, each=_TENSION, what="tensions")
    """Tension in each muscle [N]; one table row a motion for each."""
    pictures: bool = True
    """Draw the final shapes."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.tension:
            raise self._refused("tension", "must hold at least one")


@dataclass(frozen=True, kw_only=True)
class Engines:
    """Agreement and speed of the fused engine against PyElastica."""


@dataclass(frozen=True, kw_only=True)
class Validation:
    """Both engines on every exact case, and orders of convergence."""

    quick: bool = False
    """Coarse meshes, fewer orders."""
    pictures: bool = True
    """Draw the figure."""


@dataclass(frozen=True, kw_only=True)
class WorkPrecision:
    """Error against run time, over step, mesh, damping and muscles."""

    quick: bool = False
    """Shorter motions, fewer settings: half a minute."""


@dataclass(frozen=True, kw_only=True)
class Stability(Parameters):
    """The predicted critical step against the measured one."""

    quick: bool = False
    """Fewer cases: less than a minute."""
    jobs: int = count(2, 1, 64)
    """Processes, 1 to 64."""
    seed: int = count(1000)
    """Of the random designs; those below the default were looked at while the prediction was made."""


@dataclass(frozen=True, kw_only=True)
class Divergence:
    """Is every run that goes wrong caught, and no other."""

    quick: bool = False
    """A tenth of the runs: half a minute."""


@dataclass(frozen=True, kw_only=True)
class Throughput:
    """Cost of a step as worms, features and elements grow."""

    quick: bool = False
    """Smaller batches, fewer repeats: a minute."""


@dataclass(frozen=True, kw_only=True)
class Unchanged:
    """Are states, observations and rewards those of an older commit, to the last bit, and no slower."""

    old: Path
    """Checkout of the older commit."""
    quick: bool = False
    """Fewer control steps and rounds."""


Report = Paper | Engines | Validation | WorkPrecision | Stability | Divergence | Throughput | Unchanged
MODULES: dict[type[Report], str] = {
    Paper: "paper",
    Engines: "engine_comparison",
    Validation: "validation.report",
    WorkPrecision: "work_precision.report",
    Stability: "stability.report",
    Divergence: "divergence.report",
    Throughput: "throughput.report",
    Unchanged: "unchanged.report",
}
"""Where the function `report(folder, *, command, ...)` of each stands; a choice costs its imports only when made."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Measure what the engines reach."""

    report: Report
    out: Path = Path("runs/reports")
    """Folder for tables, figures and pictures."""


def parse(arguments: Sequence[str] | None = None) -> Options:
    """Read the command line; ends with status 2 and a line that says why where it is wrong."""
    plain = (tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes, tyro.conf.CascadeSubcommandArgs)
    return tyro.cli(Options, prog="python -m lattice_gym.benchmarks", args=arguments, config=plain)


def command(report: Report) -> str:
    """Command line that makes a report again: every option that is not its default, but no folder."""
    words = ["python -m lattice_gym.benchmarks", re.sub(r"(?<!^)(?=[A-Z])", "-", type(report).__name__).lower()]
    for field in fields(report):
        value: Any = getattr(report, field.name)
        if value != field.default and not isinstance(value, Path):
            words.append(f"--{'no-' if value is False else ''}{field.name}")
            if not isinstance(value, bool):
                words += map(str, value if isinstance(value, tuple) else [value])
    return " ".join(words)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one report; exit status 1 where it shows a failure."""
    options = parse(arguments)
    report = resolve_name(f"lattice_gym.benchmarks.{MODULES[type(options.report)]}:report")
    try:
        prepare(options.out)
        return 0 if report(options.out, command=command(options.report), **vars(options.report)) else 1
    except OSError as error:
        if error.errno is None:
            raise
        sys.exit(f"error: {reason(error)}")


if __name__ == "__main__":
    sys.exit(main())
