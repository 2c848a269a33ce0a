"""Command line: `python -m lattice_gym.reports {paper,engines} [options]`."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

from lattice_gym.engines import EngineName

RESULTS = Path("runs/reports")


def _tension(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(text)
    return value


def parser() -> argparse.ArgumentParser:
    """Build the command line's parser."""
    top = argparse.ArgumentParser(prog="python -m lattice_gym.reports", description="Measure what the engines reach.")
    top.add_argument(
        "--out", type=Path, default=RESULTS, help=f"folder for tables, figures and pictures (default: {RESULTS})"
    )
    names = top.add_subparsers(dest="name", required=True)
    paper = names.add_parser("paper", help="the paper's three motions beside its Table 2")
    paper.add_argument("--engine", choices=get_args(EngineName), default="fused", help="default: fused")
    paper.add_argument(
        "--tension", type=_tension, nargs="+", default=[0.5, 1.0], help="tension in each muscle [N] (default: 0.5 1)"
    )
    paper.add_argument("--no-pictures", action="store_true", help="leave out the picture of the final shapes")
    names.add_parser("engines", help="agreement and speed of the fused engine against PyElastica")
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one report; exit status 1 where it shows a failure."""
    options = parser().parse_args(arguments)
    command = f"python -m lattice_gym.reports {options.name}"
    if options.name == "paper":
        from lattice_gym.reports.paper import report as report_paper

        command += f" --engine {options.engine} --tension {' '.join(f'{tension:g}' for tension in options.tension)}"
        pictures = not options.no_pictures
        good = report_paper(options.engine, options.tension, options.out, pictures=pictures, command=command)
    else:
        from lattice_gym.reports.engines import report as report_engines

        good = report_engines(options.out, command=command)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
