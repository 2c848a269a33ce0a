"""Run folders: claimed once, made and trained by one process at a time, whole whatever ends it, under any name."""

from __future__ import annotations

import errno
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from odd_files import ODD, leftovers, limited
from runs import TINY
from stable_baselines3 import PPO
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from agents import demo, rollouts, run_folder, training
from agents.command_line import as_program, command
from agents.config import InputError
from agents.evaluation import evaluate
from agents.rollouts import export
from agents.run_folder import Run
from agents.training import create_run, resume_settings, train
from lattice_gym.benchmarks.__main__ import main as report_main
from lattice_gym.recording import files
from lattice_gym.rendering.video import render_video

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent


@pytest.fixture
def mounted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Empty folder where a disk is mounted, which can be neither replaced nor removed nor renamed."""
    disk = tmp_path / "disk"
    (disk / "lost+found").mkdir(parents=True)

    def busy(call: Any) -> Any:
        def refuse(*paths: Any, **named: Any) -> Any:
            if any(Path(os.fspath(path)) == disk for path in paths[:2]):
                raise OSError(errno.EBUSY, os.strerror(errno.EBUSY), *map(str, paths[:1]))
            return call(*paths, **named)

        return refuse

    for name in ("rename", "replace", "rmdir"):
        monkeypatch.setattr(os, name, busy(getattr(os, name)))
    return disk


class Killed(BaseException):
    """What ends a process at once: nothing after it is done, nothing is cleaned up."""


# Claimed once


def test_a_run_on_an_empty_disk(mounted: Path) -> None:
    """It is filled, not replaced; what is on it already is refused."""
    path = create_run(replace(TINY, run_dir=mounted))
    assert path == mounted
    assert Run.open(mounted).config.seed == 3
    assert not leftovers(mounted)
    with pytest.raises(InputError, match=r"run_dir = .*: must be a new or empty folder; to continue that run give"):
        create_run(replace(TINY, run_dir=mounted))


@pytest.mark.parametrize("cut", range(4))
def test_a_run_that_was_killed_while_it_filled_a_disk(mounted: Path, cut: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is no run yet, and the same command makes it; what others left there is never taken for one."""
    write, written = run_folder.write_json, 0

    def killed(path: Path, values: object) -> None:
        nonlocal written
        if written == cut:
            raise Killed
        written += 1
        write(path, values)

    monkeypatch.setattr(run_folder, "write_json", killed)
    with pytest.raises(Killed):
        create_run(replace(TINY, run_dir=mounted, seed=5))
    monkeypatch.setattr(run_folder, "write_json", write)
    assert written == cut
    with pytest.raises(InputError, match="no such file"):
        Run.open(mounted)
    (mounted / "thesis.txt").touch()
    with pytest.raises(InputError, match="must be a new or empty folder"):
        create_run(replace(TINY, run_dir=mounted))
    assert (mounted / "thesis.txt").exists()
    (mounted / "thesis.txt").unlink()
    assert Run.open(create_run(replace(TINY, run_dir=mounted))).config.seed == 3


@pytest.mark.parametrize("names", [["design.json"], ["config.json"], ["config.json", "notes.txt"]])
def test_files_of_others_are_never_cleared(tmp_path: Path, names: list[str]) -> None:
    """Not those of another program either, whose settings have the name of ours."""
    for name in names:
        (tmp_path / name).write_text('{"name": "package"}')
    with pytest.raises(InputError, match="must be a new or empty folder"):
        create_run(replace(TINY, run_dir=tmp_path))
    assert {path.name for path in tmp_path.iterdir()} == set(names)


def test_two_runs_in_one_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both have a folder; one that others hold is refused, whoever came between."""

    class Stopped(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> Stopped:
            return cls(2026, 1, 1, tzinfo=tz)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(training, "datetime", Stopped)
    made = [create_run(TINY) for _ in range(3)]
    name = "runs/extension-3-20260101-000000"
    assert made == [Path(name), Path(f"{name}-2"), Path(f"{name}-3")]
    assert all(Run.open(path).config.seed == 3 for path in made)
    exists = os.path.lexists
    monkeypatch.setattr(os.path, "lexists", lambda path: path != made[0] and exists(path))
    with pytest.raises(InputError, match="must be a new or empty folder"):
        create_run(replace(TINY, run_dir=made[0], seed=4))
    assert Run.open(made[0]).config.seed == 3


def test_a_task_of_any_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The default folder's name has no character that means something in a path."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(TINY.task_class, "name", "../a:b/c*")
    path = create_run(TINY)
    assert path.parent == Path("runs")
    assert path.name.startswith("..-a-b-c-")


def test_a_run_is_trained_by_one_process(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A second one is refused before it changes anything, and may evaluate meanwhile."""
    before = {file: file.read_bytes() for file in copy.rglob("*") if file.is_file()}
    settings = replace(resume_settings(copy), total_steps=240)
    with files.claimed(copy):
        with pytest.raises(SystemExit, match=f"^error: {copy}: another process is writing it$"), as_program():
            train(settings)
        with pytest.raises(BlockingIOError, match="another process"):
            demo.demo(copy, TINY, fresh=True, video=False)
        assert {file: file.read_bytes() for file in copy.rglob("*") if file.is_file() and file in before} == before
        evaluate(copy, episodes=1)
    assert "steps done" not in capsys.readouterr().out
    train(settings)
    assert Run.open(copy).steps == 240


def test_two_processes_on_one_run(copy: Path) -> None:
    """The second says why it does not train, and the first never knows of it."""
    arguments = [sys.executable, "train.py", "--resume", str(copy), "--total-steps", "1000000"]
    with subprocess.Popen(arguments, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == f"{copy}: 160 of 1000000 steps done\n"
        with pytest.raises(SystemExit, match=f"^error: {copy}: another process is writing it$"), as_program():
            train(replace(resume_settings(copy), total_steps=240))
        first.terminate()
        told = first.communicate(timeout=60)[1]
    assert told == f"stopped by SIGTERM; continue with: python train.py --resume {copy}\n"
    run = Run.open(copy)
    assert [session["from_step"] for session in run_folder.read_sessions(copy / "versions.json")] in ([0], [0, 160])
    assert not leftovers(copy)
    assert run.steps >= 160


def test_starting_over_keeps_the_folder(copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may be a link to another disk; an empty one is as good as a new one."""
    link = tmp_path / "demo"
    link.symlink_to(copy)
    monkeypatch.setattr(demo, "evaluate", lambda *_, **__: {})
    monkeypatch.setattr(demo, "format_scores", lambda _: "")
    monkeypatch.setattr(demo, "verdict", lambda *_: "")
    monkeypatch.setattr(demo, "beats_baselines", lambda _: True)
    (copy / "evaluation.json").write_text("{}")
    assert demo.demo(link, replace(TINY, seed=5), fresh=True, video=False)
    assert link.is_symlink()
    assert Run.open(copy).config.seed == 5
    assert not (copy / "evaluation.json").exists()
    run_folder.clear(copy)
    assert demo.demo(link, TINY, fresh=True, video=False)
    assert Run.open(copy).config.seed == 3


@pytest.mark.parametrize("cut", [0, 1, 4, 5, 6, 7])
def test_a_run_that_was_killed_while_it_was_cleared(copy: Path, cut: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is a run with fewer checkpoints, or one to be made anew."""
    discard, discarded = files.discard, 0

    def killed(path: Path) -> None:
        nonlocal discarded
        if discarded == cut:
            raise Killed
        discarded += 1
        discard(path)

    (copy / "thesis.txt").touch()
    monkeypatch.setattr(files, "discard", killed)
    with pytest.raises(Killed):
        run_folder.clear(copy)
    monkeypatch.setattr(files, "discard", discard)
    assert discarded == cut
    if (copy / "versions.json").exists():
        train(resume_settings(copy))
    else:
        train(replace(TINY, run_dir=copy))
    assert Run.open(copy).steps == 160


# Checkpoints


def test_only_checkpoints_are_dropped(copy: Path) -> None:
    """Not a copy that somebody keeps beside them."""
    kept = Path(shutil.copytree(copy / "checkpoints" / "000000000080", copy / "checkpoints" / "000000000080-best"))
    for steps in range(240, 640, 80):
        run_folder.save_checkpoint(copy, steps, {})
    assert [int(folder.name) for folder in Run.open(copy).checkpoints()] == [560, 480, 400]
    assert (kept / "model.zip").exists()


def test_a_checkpoint_that_is_damaged_again(copy: Path) -> None:
    """Every damaged one is kept for inspection."""
    for total in (160, 160, 160):
        (Run.open(copy).newest / "model.zip").write_bytes(b"")
        train(replace(resume_settings(copy), total_steps=total + 80))
        shutil.rmtree(copy / "checkpoints" / "000000000240")
    assert sorted(path.name for path in (copy / "checkpoints").glob("damaged-*")) == [
        "damaged-000000000160",
        "damaged-000000000160-2",
        "damaged-000000000160-3",
    ]


# A full disk


@pytest.mark.parametrize("size", [100, 2_000, 60_000])
def test_full_disk_ends_training_with_a_line(
    copy: Path, size: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the log or in a checkpoint: the last checkpoint is whole, and goes on when there is space again."""
    learn = PPO.learn

    def learn_on_a_full_disk(*arguments: Any, **named: Any) -> Any:
        with limited(size):
            return learn(*arguments, **named)

    monkeypatch.setattr(PPO, "learn", learn_on_a_full_disk)
    with pytest.raises(SystemExit) as ended, as_program():
        train(replace(resume_settings(copy), total_steps=400))
    monkeypatch.setattr(PPO, "learn", learn)
    what = rf"({copy}/progress\.csv|{copy}/tensorboard/events\.[\w.]+|{copy}/checkpoints/000000000240)"
    line = rf"error: {what}: File too large; continue with: python train\.py --resume {copy}"
    assert re.fullmatch(line, str(ended.value.code))
    assert capsys.readouterr().err == ""
    assert not leftovers(copy)
    assert Run.open(copy).steps == 160
    train(replace(resume_settings(copy), total_steps=240))
    assert [row[run_folder.STEPS] for row in Run.open(copy).rows()] == [80.0, 160.0, 240.0]


@pytest.mark.parametrize("what", ["evaluation", "rollout", "report"])
def test_what_cannot_be_written_is_told_before_the_work(
    what: str, copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not after minutes of it."""

    def read_only(path: Any, *_: Any, **__: Any) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), os.fspath(path))

    monkeypatch.setattr(os, "mkdir", read_only)
    place = tmp_path / "reports" if what == "report" else copy
    use: dict[str, Callable[[Path], object]] = {
        "evaluation": evaluate,
        "rollout": export,
        "report": lambda path: report_main(["--out", str(path), "engines"]),
    }
    with pytest.raises(SystemExit, match=f"^error: {place}: Read-only file system$"), as_program():
        use[what](place)
    assert capsys.readouterr() == ("", "")


# Names, and what is told


def test_a_run_of_an_odd_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Trained, continued, evaluated and filmed; what it prints can be copied into a shell."""
    monkeypatch.chdir(tmp_path)
    path = Path("-" + ODD["colon"] + ODD["quotes"] + ODD["percent"] + ODD["newline"] + ODD["no UTF-8"])
    options = ["--task=extension", "--total-steps=80", "--n-envs=1", "--n-steps=80", "--batch-size=40"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}

    program = [sys.executable, str(ROOT / "train.py"), *options, f"--run-dir={path}"]
    told = subprocess.run(program, env=environment, stdout=subprocess.PIPE, check=True).stdout.decode()
    words = shlex.split(told.split("score it with: ")[1])
    assert words[:3] == ["python", "-m", "agents.evaluation"]
    assert words[3] == f"./{path}".replace("\udce9", "\\udce9")
    train(replace(resume_settings(path), total_steps=160))
    assert Run.open(path).steps == 160
    evaluate(path, episodes=1)
    monkeypatch.setattr(rollouts, "render_video", partial(render_video, size=(96, 64)))
    assert all(file.stat().st_size > 0 for file in export(path).paths().values())
    assert not leftovers(tmp_path)


def test_errors_are_one_line(finished: Path, tmp_path: Path) -> None:
    """Whatever is in a path, and however torch tells of weights of another shape."""
    copy = Path(shutil.copytree(finished, tmp_path / "two\nlines"))
    settings = json.loads((copy / "config.json").read_text())
    (copy / "config.json").write_text(json.dumps(settings | {"hidden_sizes": [8]}))
    with pytest.raises(SystemExit) as ended, as_program():
        train(replace(resume_settings(copy), total_steps=240))
    line = str(ended.value.code)
    assert re.match(
        r"error: .*two lines/checkpoints/\d+/model\.zip: damaged or not of this kind: .*size mismatch", line
    )
    assert "\n" not in line


def test_commands_can_be_copied() -> None:
    """Into a shell, whatever is in a path."""
    assert command("python", "train.py", "--resume", Path("a b")) == "python train.py --resume 'a b'"
    assert command("python", Path("-x")) == "python ./-x"


def test_the_board_shows_the_table(copy: Path) -> None:
    """TensorBoard reads what progress.csv has, also of a run that was continued or killed in the middle of a record."""
    (events,) = (copy / "tensorboard").iterdir()
    events.write_bytes(events.read_bytes()[:-5])
    train(replace(resume_settings(copy), total_steps=320))
    board = EventAccumulator(str(copy / "tensorboard"))
    board.Reload()
    rows = [row for row in Run.open(copy).rows() if row[run_folder.STEPS] != 160]
    shown = {event.step: event.value for event in board.Scalars("worm/return_mean")}
    expected = {int(row[run_folder.STEPS]): row["worm/return_mean"] for row in rows}
    assert shown == pytest.approx(expected)
    named = {name for row in rows for name in row}
    assert {"train/loss", "worm/diverged_episodes"} < set(board.Tags()["scalars"]) < named
