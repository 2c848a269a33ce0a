"""The run folder: what training leaves on disk, how it is made and read back.

config.json      settings (`TrainConfig.to_dict`); the first file of a run that is made in a folder that was there
versions.json    Python, packages and commit of every session that trained the run; the last: with it the run is whole
design.json      LatticeDesign
muscles.json     MuscleLayout
environment.json further arguments of the environment, if any were given
progress.csv     one row an update
checkpoints/     the newest few checkpoints, each in a folder named by its environment steps that appears once complete:
                 model.zip          policy and optimiser, as Stable-Baselines3 writes them
                 normalisation.npz  means and spreads of observations and rewards that belong to it
tensorboard/     the same numbers as progress.csv, for TensorBoard
evaluation.json  scores beside baselines, and the steps of the checkpoint they are of, once it was evaluated;
                 evaluation-fine.json those at a fidelity that was asked for

Nothing that is read here runs code: no file is unpickled, and a task, a term or a law of somebody's own, which
config.json and environment.json name as "module:Class", is taken only where its module is imported already.
`stable_baselines3.PPO.load` on a model.zip does unpickle: give it only files that you trust.
"""

from __future__ import annotations

import contextlib
import csv
import errno
import io
import itertools
import json
import os
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from inspect import signature
from pathlib import Path
from typing import Any, Self, TypeVar, get_args

from agents.config import LEARNER_RANGE, InputError, TaskError, TrainConfig, input_errors
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import MuscleLayout, resolve_layout
from lattice_gym.checks import choice, code_names, whole, without_imports
from lattice_gym.envs.fidelity import FidelityName
from lattice_gym.envs.scene import Scene
from lattice_gym.recording import files
from lattice_gym.recording.provenance import PACKAGES, provenance
from lattice_gym.tasks.registry import resolve_task

CONFIG = "config.json"
VERSIONS = "versions.json"
DESIGN = "design.json"
MUSCLES = "muscles.json"
ENVIRONMENT = "environment.json"
MODEL = "model.zip"
NORMALISATION = "normalisation.npz"
PROGRESS = "progress.csv"
CHECKPOINTS = "checkpoints"
TENSORBOARD = "tensorboard"
EVALUATION = "evaluation.json"

T = TypeVar("T")

STEPS = "time/total_timesteps"
_KEPT = 3


@dataclass(frozen=True)
class Source:
    """Where a policy comes from, and the arguments that rebuild its environment."""

    path: Path
    env_arguments: dict[str, Any]

    @property
    def fidelity(self) -> FidelityName:
        """How finely the worm is computed here."""
        name: FidelityName = self.env_arguments.get("fidelity", "default")
        return name

    def at(self, fidelity: FidelityName | None) -> Self:
        """Source with its worm computed as finely as that, None: as in training; InputError if it cannot be."""
        if fidelity is None or fidelity == self.fidelity:
            return self
        with input_errors():
            choice("fidelity", fidelity, get_args(FidelityName))
            observed = self.env_arguments.get("observation")
            if observed is None and "task" in self.env_arguments:
                observed = resolve_task(self.env_arguments["task"]).observation
        if observed is not None and "nodes" in observed:
            raise InputError(
                f"fidelity = {fidelity!r}: must be {self.fidelity!r}, as {self.path} observes all nodes, not sites"
            )
        return replace(self, env_arguments=self.env_arguments | {"fidelity": fidelity})

    @property
    def allowance(self) -> str:
        """Option with which a program takes the code that it names, to write after a command; empty for most."""
        named = {name: value for name, value in self.env_arguments.items() if name != "id"}
        modules = dict.fromkeys(text.partition(":")[0] for _, text in code_names("", named))
        return f" --allow {' '.join(modules)}" if modules else ""

    def place(self, name: str) -> Path:
        """Where a file about it is written: in the run folder."""
        return self.path / name


@dataclass(frozen=True)
class Run(Source):
    """A run folder that has been read."""

    config: TrainConfig

    @classmethod
    def open(cls, path: Path) -> Run:
        """Read settings, design and muscles; raises InputError that names the missing or damaged file."""
        if not path.is_dir():
            raise InputError(f"{path}: no such run folder")
        config = read_file(path / CONFIG, _parse_settings)
        design = read_file(path / DESIGN, _parse_design)
        layout = read_file(path / MUSCLES, lambda file: resolve_layout(_parse_json(file), build_lattice(design)))
        file = path / ENVIRONMENT
        further = read_environment(file) if file.exists() else {}
        if not (path / VERSIONS).exists():
            cut_short = "the run was killed while it was made; make it again with the same --run-dir"
            raise InputError(f"{path / VERSIONS}: no such file: {cut_short}")
        return cls(path=path, config=config, env_arguments=env_arguments(config, design, layout, further))

    def rows(self) -> list[dict[str, float]]:
        """Rows of progress.csv; what an update did not log is absent from its row."""
        return read_file(self.path / PROGRESS, read_rows)

    @property
    def steps(self) -> int:
        """Environment steps of the newest checkpoint; 0 before the first."""
        known = self.checkpoints()
        return int(known[0].name) if known else 0

    @property
    def newest(self) -> Path:
        """Folder of the newest checkpoint; raises InputError before the first."""
        known = self.checkpoints()
        if not known:
            raise InputError(f"{self.path / CHECKPOINTS}: no checkpoint yet")
        return known[0]

    def checkpoints(self) -> list[Path]:
        """Folders of the complete checkpoints, newest first."""
        return checkpoints(self.path)


def env_arguments(
    config: TrainConfig, design: LatticeDesign, muscles: MuscleLayout | str | None, further: Mapping[str, Any]
) -> dict[str, Any]:
    """JSON-safe arguments of `gymnasium.make` for a run's environment; `further` as `read_environment` gives them."""
    return {
        "id": "lattice_gym:LatticeWorm-v0",
        "task": config.task,
        "max_episode_steps": config.task_class.time_limit,
        "design": design.to_dict(),
        "muscles": muscles.to_dict() if isinstance(muscles, MuscleLayout) else muscles,
        "control": config.resolved_control,
        "action_range": list(LEARNER_RANGE),
        "rhythm": config.rhythm,
        "engine": config.engine,
        "control_dt": config.control_dt,
        "observation": None if config.observation is None else list(config.observation),
        "fidelity": config.fidelity,
        **further,
    }


def requested_arguments(config: TrainConfig) -> dict[str, Any]:
    """Environment arguments of a new run, with the files that the settings name.

    A design file changes the task's own design, by field.
    """
    own = config.task_class.design
    if config.design is None:
        design = LatticeDesign.from_dict(own)
    else:
        design = read_file(config.design, lambda file: LatticeDesign.from_dict({**own, **_parse_json(file)}))
    muscles: MuscleLayout | str | None = config.muscles
    if config.muscles is not None and config.muscles.endswith(".json"):
        muscles = read_file(Path(config.muscles), lambda file: MuscleLayout.from_dict(_parse_json(file)))
    further = {} if config.environment is None else read_environment(config.environment)
    return env_arguments(config, design, muscles, further)


def at_fidelity(name: str, fidelity: FidelityName | None) -> str:
    """Name of a file with the fidelity that was asked for, if any, lest one score or film overwrite another."""
    path = Path(name)
    return name if fidelity is None else f"{path.stem}-{fidelity}{path.suffix}"


def make(path: Path, contents: Mapping[str, object]) -> None:
    """Make a run folder of JSON files by name, whole or not at all, in a new place or in a folder that is empty.

    What is there cannot be replaced at once, as it may be where a disk is mounted: config.json is written first and
    versions.json last, and a run that has the first alone was killed meanwhile and is made anew. FileExistsError where
    something else is in the folder.
    """
    in_order = sorted(contents.items(), key=lambda item: (item[0] == VERSIONS, item[0] != CONFIG))
    if not os.path.lexists(path):
        with files.replacing(path) as folder:
            folder.mkdir()
            for name, values in in_order:
                write_json(folder / name, values)
        return
    if not path.is_dir():
        raise FileExistsError(errno.EEXIST, "is no folder", str(path))
    with files.claimed(path):
        if _is_half_made(path):
            clear(path)
        if not is_empty(path):
            raise FileExistsError(errno.EEXIST, "is not empty", str(path))
        for name, values in in_order:
            write_json(path / name, values)


def clear(path: Path) -> None:
    """Delete all that a run folder holds, but not itself.

    One that is half cleared is a run that has fewer checkpoints, or none, or one that was killed while it was made.
    """
    order = {VERSIONS: 1, DESIGN: 2, MUSCLES: 2, ENVIRONMENT: 2, CONFIG: 3}
    for name in sorted(_names(path), key=lambda name: order.get(name, 0)):
        files.discard(path / name)


def is_empty(path: Path) -> bool:
    """Whether a folder holds nothing, as an empty disk does that is mounted there."""
    return path.is_dir() and not _names(path)


def _names(path: Path) -> set[str]:
    return {entry.name for entry in files.content(path)} - {"lost+found"}


def _is_half_made(path: Path) -> bool:
    """Whether a folder holds what `make` or `clear` leaves when it is killed, and nothing else."""
    names = _names(path)
    if CONFIG not in names or not names <= {CONFIG, DESIGN, MUSCLES, ENVIRONMENT}:
        return False
    with contextlib.suppress(InputError):
        read_file(path / CONFIG, _parse_settings)
        return True
    return False


def save_checkpoint(run: Path, steps: int, contents: Mapping[str, Callable[[Path], object]]) -> None:
    """Write one checkpoint whole or not at all, and drop the oldest.

    `contents` maps a file name to what writes that file.
    """
    folder = run / CHECKPOINTS / f"{steps:012d}"
    if folder.exists():
        files.discard(folder)
    with files.replacing(folder) as unfinished:
        unfinished.mkdir()
        for name, write in contents.items():
            write(unfinished / name)
    for old in checkpoints(run)[_KEPT:]:
        with contextlib.suppress(PermissionError):  # Windows has it while another process reads it
            files.discard(old)


def set_aside(checkpoint: Path) -> Path:
    """Rename a damaged checkpoint, which is kept for inspection; its new place."""
    for number in itertools.count(1):
        aside = checkpoint.with_name(f"damaged-{checkpoint.name}{f'-{number}' if number > 1 else ''}")
        if not aside.exists():
            return checkpoint.rename(aside)
    raise AssertionError


def checkpoints(run: Path) -> list[Path]:
    """Folders of the complete checkpoints of a run folder, newest first."""
    folders = (run / CHECKPOINTS).glob("[0-9]*")
    named = (folder for folder in folders if folder.name.isdecimal())
    return sorted(named, key=lambda folder: int(folder.name), reverse=True)


def write_json(path: Path, values: object) -> None:
    """Write JSON whole or not at all; NaN is an error."""
    files.write(path, (json.dumps(values, indent=1, allow_nan=False) + "\n").encode())


def read_environment(path: Path) -> dict[str, Any]:
    """Arguments of LatticeWormEnv that no setting gives; raises InputError that names the file and the argument.

    Their values are checked where the environment is built.
    """
    given = read_json(path)
    if not isinstance(given, dict):
        raise InputError(f"{path}: must hold a JSON object of arguments of LatticeWormEnv by name")
    with input_errors():
        without_imports(f"{path}", given)
    taken = set(signature(Scene).parameters) - {"goals_apart"}
    settings = {field.name for field in fields(TrainConfig)}
    for name in given:
        if name in taken & settings:
            raise InputError(f"{path}: {name}: must be given by its own option, --{name.replace('_', '-')}")
        if name not in taken:
            raise InputError(f"{path}: {name}: unknown argument; known are {', '.join(sorted(taken - settings))}")
    return given


def read_json(path: Path) -> Any:
    """Value of a JSON file; raises InputError that names the file if it is missing or damaged."""
    return read_file(path, _parse_json)


def read_sessions(path: Path) -> list[dict[str, Any]]:
    """Sessions of versions.json; raises InputError that names the file."""

    def read(file: Path) -> list[dict[str, Any]]:
        sessions = _parse_json(file)
        if not isinstance(sessions, list):
            raise ValueError("not a list of sessions")
        for session in sessions:
            session["from_step"] = whole("from_step", session["from_step"], 0)
        return sessions

    return read_file(path, read)


def read_rows(path: Path) -> list[dict[str, float]]:
    """Rows of a CSV file of numbers, without the cells that are empty."""
    with path.open(newline="", encoding="utf-8") as file:
        table = csv.DictReader(file, strict=True)
        rows = list(table)
    if STEPS not in (table.fieldnames or ()) or not rows:
        raise ValueError(f"no column {STEPS}, or no row")
    if any(None in row or None in row.values() or not row[STEPS] for row in rows):
        raise ValueError("a row that does not fit the columns")
    return [{name: float(cell) for name, cell in row.items() if cell} for row in rows]


def write_rows(path: Path, rows: list[dict[str, float]]) -> None:
    """Write `read_rows`' rows whole or not at all; a column for every name in any row."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, names)
    table.writeheader()
    table.writerows(rows)
    files.write(path, text.getvalue().encode())


def made_by(command: str) -> dict[str, Any]:
    """Command, date, processor, versions and, in a git checkout, the commit."""
    made = provenance(command, (*PACKAGES, "stable_baselines3", "torch"))
    git = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=40"]
    with contextlib.suppress(OSError, subprocess.CalledProcessError):  # a copy without git has no commit
        made["commit"] = subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()
    return made


def session(steps: int) -> dict[str, Any]:
    """Entry of versions.json for training that starts now, after so many environment steps."""
    made = made_by("")
    del made["command"]  # it may name places on this machine
    return {"from_step": steps} | made


def _parse_json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def _parse_settings(path: Path) -> TrainConfig:
    settings = _parse_json(path)
    try:
        without_imports("", settings)
    except ValueError as error:
        raise TaskError(str(error)) from error
    return TrainConfig.from_dict(settings)


def _parse_design(path: Path) -> LatticeDesign:
    return LatticeDesign.from_dict(_parse_json(path))


def read_file(path: Path, read: Callable[[Path], T]) -> T:
    """Read a file; whatever goes wrong becomes an InputError that names the file."""
    try:
        return read(path)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except TaskError as error:  # the file is sound, what it names is elsewhere or not to be had
        raise TaskError(f"{path}: {error}") from error
    except Exception as error:
        raise InputError(f"{path}: damaged or not of this kind: {error}") from error
