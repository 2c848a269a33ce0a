"""Kill -9 at random moments of whatever writes: every folder left is whole, or goes on with the same command.

`python tests/test_kills.py --count 200` kills that many times, in turn while training, evaluation, rollouts, exports
and reports run, and prints what was found wrong. Half of the kills come at a random time. The others come at a random
one of the calls that change the folder, or in the middle of a file that is being written. As a test: once each.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

ROOT = Path(__file__).parent.parent
CHANGES = {"open", "os.mkdir", "os.rename", "os.remove", "os.rmdir"}
"""What the interpreter tells of before it changes a folder."""


@dataclass(frozen=True)
class Work:
    """What is killed, in a folder that holds `run`, and what goes on with it."""

    begin: str
    """What `run` is before: absent, empty or finished."""
    do: Callable[[Path], object]
    again: Callable[[Path], object]


def works() -> dict[str, Work]:
    """Everything that writes, by name; whatever is new to write files is one more entry."""
    from agents import rollouts, run_folder
    from agents.config import TrainConfig
    from agents.evaluation import evaluate
    from agents.export import main as export
    from agents.training import resume_settings, train
    from lattice_gym.benchmarks import figures, results_files
    from lattice_gym.rendering.video import render_video

    tiny = TrainConfig(task="extension", total_steps=160, n_envs=1, n_steps=40, batch_size=40, n_epochs=1)
    tiny = replace(tiny, checkpoint_every=40)

    def new(run: Path) -> None:
        train(replace(tiny, run_dir=run))

    def go_on(run: Path) -> None:
        train(replace(resume_settings(run), total_steps=320))

    def start_or_go_on(run: Path) -> None:
        if (run / run_folder.VERSIONS).exists():
            go_on(run)
        else:
            new(run)

    def start_over(run: Path) -> None:
        if run.exists():
            run_folder.clear(run)
        new(run)

    def film(run: Path) -> None:
        with patch.object(rollouts, "render_video", partial(render_video, size=(96, 64))):
            rollouts.export(run, gif=(0.0, 0.3))

    def copy_out(run: Path) -> None:
        export(run, run / "policy.npz")

    def measure(run: Path) -> None:
        results_files.write(run, "paper", {"values": [0.1] * 10_000}, ["text" * 10_000], "command")
        figures.save(figures.new_figure(8.0, 6.0), run / "paper.png")

    score = partial(evaluate, episodes=1)
    return {
        "training": Work("absent", new, start_or_go_on),
        "training on an empty disk": Work("empty", new, start_or_go_on),
        "training that goes on": Work("finished", go_on, go_on),
        "training that starts over": Work("finished", start_over, start_or_go_on),
        "evaluation": Work("finished", score, score),
        "rollout": Work("finished", film, film),
        "export": Work("finished", copy_out, copy_out),
        "report": Work("absent", measure, measure),
    }


# What is left


def check_whole(folder: Path) -> None:
    """Raise what is wrong with a file below a folder that is not in the way of being written."""
    readers: dict[str, Callable[[Path], object]] = {
        ".json": lambda file: json.loads(file.read_bytes()),
        ".csv": check_table,
        ".zip": check_model,
        ".npz": check_arrays,
        ".mp4": lambda file: check_film(file),
        ".gif": check_picture,
        ".png": check_picture,
        ".md": lambda file: file.read_text(encoding="utf-8").index("\n\nMade "),
    }
    for file in sorted(folder.rglob("*")):
        if file.is_file() and not any(part.startswith(".lattice_gym-") for part in file.parts):
            if file.parent.name == "tensorboard":
                continue  # a log, of which a reader passes over the last record where it is cut
            readers[file.suffix](file)
    run = folder / "run"
    if (run / "versions.json").exists():
        check_run(run)
    elif run.exists() and not list(run.glob("*.md")):
        made = {file.name for file in run.iterdir() if not file.name.startswith(".lattice_gym-")}
        assert made <= {"config.json", "design.json", "muscles.json", "paper.json", "paper.png"}, made


def check_run(path: Path) -> None:
    """Open a run, each of whose checkpoints has two files."""
    from agents.run_folder import Run

    run = Run.open(path)
    for checkpoint in run.checkpoints():
        assert {file.name for file in checkpoint.iterdir()} == {"model.zip", "normalisation.npz"}, checkpoint


def check_table(file: Path) -> None:
    """Read every row."""
    from agents.run_folder import read_rows

    read_rows(file)


def check_model(file: Path) -> None:
    """Load a model."""
    from stable_baselines3 import PPO

    PPO.load(file, device="cpu")


def check_arrays(file: Path) -> None:
    """Load a trajectory, a policy or the normalisation of a checkpoint."""
    from agents.checkpoints import read_normalisation
    from lattice_gym.policies.network import load_policy
    from lattice_gym.recording.trajectory import Trajectory

    if file.name == "normalisation.npz":
        read_normalisation(file.parent)
    elif file.name == "policy.npz":
        load_policy(file)
    else:
        Trajectory.load(file)


def check_film(file: Path) -> None:
    """Decode every picture."""
    from lattice_gym.rendering.extras import extra

    assert extra("imageio_ffmpeg").count_frames_and_secs(str(file))[0] > 10


def check_picture(file: Path) -> None:
    """Decode every picture."""
    from PIL import Image

    with Image.open(file) as picture:
        for number in range(getattr(picture, "n_frames", 1)):
            picture.seek(number)
            picture.load()


# Killing


def watch(folder: Path, act: Callable[[Callable[[], object]], None]) -> None:
    """Call `act` before each change of a folder, with what does half of a write where it is one."""
    write = Path.write_bytes

    def told(event: str, arguments: tuple[Any, ...]) -> None:
        reads = event == "open" and not (isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR))
        if event in CHANGES and not reads and str(arguments[0]).startswith(str(folder)):
            act(lambda: None)

    def write_bytes(path: Path, content: Any) -> int:
        act(lambda: write(path, content[: len(content) // 2]))
        return write(path, content)

    sys.addaudithook(told)
    Path.write_bytes = write_bytes  # type: ignore[method-assign, assignment]


@contextlib.contextmanager
def child(work: Callable[[], object], said: Path) -> Iterator[int]:
    """Fork a process that does the work, its output in a file; yields its number, and waits for it."""
    sys.stdout.flush()
    number = os.fork()
    if number == 0:
        status = 1
        try:
            with said.open("w") as file:
                os.dup2(file.fileno(), 1)
                os.dup2(file.fileno(), 2)
            work()
            status = 0
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
    yield number


def ended(number: int) -> int:
    """Wait for a child; its exit status, or the negative number of the signal that ended it."""
    return os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])


def run_child(work: Callable[[], object], said: Path) -> None:
    """Do work in a child; what it said is the error if it failed."""
    with child(work, said) as number:
        status = ended(number)
    if status != 0:
        raise AssertionError(f"ended with {status}: {said.read_text()[-3000:]}")


class Bench:
    """Kills works in folders of its own, one after another."""

    def __init__(self, folder: Path, seed: int) -> None:
        """Make a finished run, and take the time and the changes of each work alone."""
        self._folder = folder
        self._random = random.Random(seed)
        self._said = folder / "said.txt"
        self.works = works()
        with self._said.open("w") as file, contextlib.redirect_stdout(file):
            self.works["training"].do(folder / "finished")  # here, so that children have what it compiles
        self._takes = {name: self._alone(name) for name in self.works}

    def _begin(self, name: str) -> Path:
        place = self._folder / "place"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        begin = self.works[name].begin
        if begin == "finished":
            shutil.copytree(self._folder / "finished", place / "run")
        elif begin == "empty":
            (place / "run").mkdir()
        return place

    def _alone(self, name: str) -> tuple[float, int]:
        """Seconds and number of changes of a work that is not killed."""
        place, counted = self._begin(name), self._folder / "counted.txt"

        def count() -> None:
            changes = 0

            def one(_half: object) -> None:
                nonlocal changes
                changes += 1

            watch(place, one)
            self.works[name].do(place / "run")
            counted.write_text(str(changes))

        began = time.monotonic()
        run_child(count, self._said)
        return time.monotonic() - began, int(counted.read_text())

    def kill(self, name: str) -> str:
        """Kill a work once and look at what is left; returns in words when, raises what is wrong."""
        place, when = self._folder / "place", ""
        while not when:  # it may have ended before
            place = self._begin(name)
            when = (self._at_a_change if self._random.random() < 0.5 else self._at_a_time)(name, place)
        try:
            run_child(lambda: check_whole(place), self._said)
            run_child(lambda: self.works[name].again(place / "run"), self._said)
            run_child(lambda: check_whole(place), self._said)
            left = [str(path) for path in place.rglob(".lattice_gym-*")]
            assert not left, f"left behind: {left}"
        except AssertionError as error:
            raise AssertionError(f"killed at {when}: {error}") from None
        return when

    def _at_a_time(self, name: str, place: Path) -> str:
        """Kill from outside at a random time."""
        moment = self._random.uniform(0.0, self._takes[name][0])
        with child(lambda: self.works[name].do(place / "run"), self._said) as number:
            time.sleep(moment)
            os.kill(number, signal.SIGKILL)
            status = ended(number)
        return f"{moment:.2f} s" if self._was_killed(status) else ""

    def _at_a_change(self, name: str, place: Path) -> str:
        """Kill before a random change of the folder, or after half of a write."""
        changes = self._takes[name][1]
        last = self._random.randrange(changes)

        def work() -> None:
            left = last

            def count_down(half: Callable[[], object]) -> None:
                nonlocal left
                left -= 1
                if left == -1:
                    half()  # whose changes come here too
                    os.kill(os.getpid(), signal.SIGKILL)

            watch(place, count_down)
            self.works[name].do(place / "run")

        with child(work, self._said) as number:
            status = ended(number)
        return f"change {last} of {changes}" if self._was_killed(status) else ""

    def _was_killed(self, status: int) -> bool:
        assert status in (0, -signal.SIGKILL), f"ended with {status}: {self._said.read_text()[-2000:]}"
        return status != 0


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills forks")
def test_a_kill_leaves_only_what_goes_on() -> None:
    """Once in each of the works, in an interpreter of its own, as it forks."""
    command, environment = [sys.executable, __file__, "--count", "8"], os.environ | {"PYTHONPATH": str(ROOT)}
    told = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert told.returncode == 0, told.stdout + told.stderr
    assert told.stdout.endswith("8 kills, 0 of them left something wrong\n")


def main() -> int:
    """Kill as often as asked; exit status 1 where anything was wrong."""
    options = argparse.ArgumentParser(description="Kill whatever writes at random moments and look at what is left.")
    options.add_argument("--count", type=int, default=200, help="kills in all (default: 200)")
    options.add_argument("--seed", type=int, default=0, help="of the moments (default: 0)")
    options.add_argument("--only", default="", help="part of the names of what is killed")
    given = options.parse_args()
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), given.seed)
        chosen = [name for name in bench.works if given.only in name]
        for number in range(given.count):
            name = chosen[number % len(chosen)]
            try:
                sys.stdout.write(f"{number + 1}: {name}, {bench.kill(name)}\n")
            except AssertionError as error:
                wrong += 1
                sys.stdout.write(f"{number + 1}: WRONG: {error}\n")
            sys.stdout.flush()
    sys.stdout.write(f"{given.count} kills, {wrong} of them left something wrong\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
