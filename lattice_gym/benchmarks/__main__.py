"""Command line: `python -m lattice_gym.benchmarks NAME [options]`."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

from lattice_gym.engines.registry import EngineName

FRESH_SEED = 1000
"""Of the stability report's random designs: those below were looked at while the prediction was made."""

RESULTS = Path("runs/reports")


def _tension(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(text)
    return value


def _seed(text: str) -> int:
    value = int(text)
    if value < 0:
        raise ValueError(text)
    return value


def parser() -> argparse.ArgumentParser:
    """Build the command line's parser."""
    top = argparse.ArgumentParser(
        prog="python -m lattice_gym.benchmarks", description="Measure what the engines reach."
    )
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
    precision = names.add_parser("work-precision", help="error against run time, over step, mesh, damping and muscles")
    precision.add_argument("--quick", action="store_true", help="shorter motions, fewer settings: half a minute")
    names.add_parser("engines", help="agreement and speed of the fused engine against PyElastica")
    stability = names.add_parser("stability", help="the predicted stable step against the measured one")
    stability.add_argument("--quick", action="store_true", help="fewer cases: less than a minute")
    stability.add_argument("--jobs", type=int, choices=range(1, 65), default=2, metavar="N", help="processes, 1 to 64")
    stability.add_argument(
        "--seed", type=_seed, default=FRESH_SEED, help="of the random designs (default: %(default)s)"
    )
    validation = names.add_parser("validation", help="both engines on every exact case, and orders of convergence")
    validation.add_argument("--quick", action="store_true", help="coarse meshes, fewer orders")
    validation.add_argument("--no-pictures", action="store_true", help="leave out the picture")
    divergence = names.add_parser("divergence", help="is every run that goes wrong caught, and no other")
    divergence.add_argument("--quick", action="store_true", help="a tenth of the runs: half a minute")
    throughput = names.add_parser("throughput", help="cost of a step as worms, features and elements grow")
    throughput.add_argument("--quick", action="store_true", help="smaller batches, fewer repeats: a minute")
    return top


def _command(options: argparse.Namespace) -> str:
    """Command line that makes a report again: every option that is not its default, without the folder."""
    words = ["python -m lattice_gym.benchmarks", options.name]
    defaults = vars(parser().parse_args([options.name]))
    for name, value in vars(options).items():
        if name != "out" and value != defaults[name]:
            words.append(f"--{name.replace('_', '-')}")
            if value is not True:
                words += map(str, value if isinstance(value, list) else [value])
    return " ".join(words)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one report; exit status 1 where it shows a failure."""
    options = parser().parse_args(arguments)
    command = _command(options)
    if options.name == "paper":
        from lattice_gym.benchmarks.paper import report as report_paper

        pictures = not options.no_pictures
        good = report_paper(options.engine, options.tension, options.out, pictures=pictures, command=command)
    elif options.name == "work-precision":
        from lattice_gym.benchmarks.work_precision import report as report_precision

        good = report_precision(options.out, quick=options.quick, command=command)
    elif options.name == "stability":
        from lattice_gym.benchmarks.stability import report as report_stability

        jobs, seed = options.jobs, options.seed
        good = report_stability(options.out, command=command, quick=options.quick, jobs=jobs, seed=seed)
    elif options.name == "validation":
        from lattice_gym.benchmarks.validation import report as report_validation

        good = report_validation(options.out, quick=options.quick, pictures=not options.no_pictures, command=command)
    elif options.name == "divergence":
        from lattice_gym.benchmarks.divergence import report as report_divergence

        good = report_divergence(options.out, quick=options.quick, command=command)
    elif options.name == "throughput":
        from lattice_gym.benchmarks.throughput import report as report_throughput

        good = report_throughput(options.out, quick=options.quick, command=command)
    else:
        from lattice_gym.benchmarks.engines import report as report_engines

        good = report_engines(options.out, command=command)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
