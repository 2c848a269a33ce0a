"""Settings of a training run and the command lines: what is refused, and how runs are stopped and continued."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from agents.command_line import Progress, as_program, on_signal
from agents.config import InputError, TrainConfig
from agents.run_folder import Run
from lattice_gym.tasks.registry import TASKS
from train import main as train_main

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("task", "swimming"),
        ("task", None),
        ("task", ["bending"]),
        ("control", "leg"),
        ("engine", "warp"),
        ("observation", "sites"),
        ("observation", ()),
        ("observation", (1,)),
        ("fidelity", "coarse"),
        ("total_steps", 0),
        ("total_steps", 1.5),
        ("seed", -1),
        ("n_envs", 0),
        ("n_envs", True),
        ("n_steps", 1),
        ("batch_size", 3),
        ("n_epochs", 0),
        ("learning_rate", 0.0),
        ("learning_rate", math.nan),
        ("gamma", 1.01),
        ("gae_lambda", -0.1),
        ("clip_range", 0.0),
        ("entropy_coefficient", -1.0),
        ("value_coefficient", math.inf),
        ("max_gradient_norm", 0.0),
        ("hidden_sizes", ()),
        ("hidden_sizes", (64, 0)),
        ("hidden_sizes", 64),
        ("log_std_init", 5.0),
        ("rhythm", 0.0),
        ("control_dt", math.inf),
        ("checkpoint_every", 0),
        ("time_limit", 0.0),
        ("torch_threads", 0),
        ("num_threads", 0),
        ("anneal", 1),
        ("gsde", None),
        ("design", "worm.json"),
        ("environment", {}),
        ("muscles", 3),
        ("muscles", "vertical"),
    ],
)
def test_bad_settings_name_field_and_value(field: str, value: Any) -> None:
    """One error names the field and what was given."""
    with pytest.raises(ValueError, match=rf"^{field}(\[\d\] = [01]| = {re.escape(repr(value))}): must "):
        TrainConfig(**{field: value})


@given(
    st.builds(
        TrainConfig,
        task=st.sampled_from(list(TASKS)),
        fidelity=st.sampled_from(["fast", "default", "fine"]),
        seed=st.integers(0, 2**32 - 1),
        rhythm=st.none() | st.floats(0.1, 10.0),
        observation=st.none() | st.just(("nodes", "clock")),
        gamma=st.none() | st.floats(0.0, 1.0, exclude_min=True),
        hidden_sizes=st.lists(st.integers(1, 512), min_size=1, max_size=4).map(tuple),
        anneal=st.booleans(),
    )
)
def test_settings_survive_json(config: TrainConfig) -> None:
    """config.json holds every setting."""
    assert TrainConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


@example({"n_envs": 1})
@given(
    st.dictionaries(st.sampled_from([f.name for f in fields(TrainConfig)] + ["x"]), st.integers() | st.text(max_size=3))
)
def test_settings_from_anything_are_sound_or_refused(values: dict[str, Any]) -> None:
    """Nothing is taken over silently changed."""
    refused: str | None = None
    try:
        taken = TrainConfig.from_dict(values).to_dict()
    except InputError as error:
        refused = str(error).split()[0].rstrip(":")
    else:
        assert all(taken[name] == type(taken[name])(value) for name, value in values.items())
    # Worms and their steps may be too few for the batch that was not given.
    fits = refused == "batch_size" and {"n_envs", "n_steps"} & values.keys()
    unknown = refused == "settings" and values.keys() - TrainConfig().to_dict().keys()
    assert refused is None or refused in values or fits or unknown


def test_errors_say_what_to_change() -> None:
    """In terms of the options of the command line."""
    with pytest.raises(InputError, match=r"^batch_size = 100: must divide n_envs \* n_steps = 3 \* 128 = 384; change"):
        TrainConfig(n_envs=3, batch_size=100)
    with pytest.raises(
        InputError, match=r"^muscles = 'vertical': must be one of extension, .*, a file \*\.json, or None$"
    ):
        TrainConfig(muscles="vertical")


def test_training_ends_with_what_comes_next(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command that scores the policy, in one line."""
    run = tmp_path / "run"
    sizes = ["--n-envs", "1", "--n-steps", "40", "--batch-size", "40", "--total-steps", "40"]
    train_main(["--task", "extension", "--run-dir", str(run), *sizes])
    assert capsys.readouterr().out.endswith(f"\nrun folder: {run}; score it with: python -m agents.evaluation {run}\n")


def test_bending_is_not_driven_by_rings() -> None:
    """Rings that contract alike all around cannot bend a worm."""
    assert TrainConfig(task="bending").resolved_control == "column"
    assert TrainConfig(task="peristalsis").resolved_control == "ring"
    assert TrainConfig(task="bending", control="muscle").resolved_control == "muscle"
    with pytest.raises(InputError, match=r"^control = 'ring': must be "):
        TrainConfig(task="bending", control="ring")
    TrainConfig(task="bending", control="ring", muscles="one-sided.json")


def test_discount_depends_on_the_task() -> None:
    """A worm that moves on needs to look further ahead than one that changes its shape."""
    discounts = {task: TrainConfig(task=task).resolved_gamma for task in TASKS}
    assert discounts == dict.fromkeys(TASKS, 0.8) | {"crawl": 0.95, "transport": 0.95}
    assert TrainConfig(task="crawl", gamma=0.8).resolved() == TrainConfig(task="crawl", gamma=0.8, control="ring")


def test_killed_run_resumes_and_a_signal_saves(tmp_path: Path) -> None:
    """Neither SIGKILL nor the end of a batch job loses a run; ctrl-C in a terminal is handled alike, see below."""
    path, number = tmp_path / "run", signal.SIGTERM
    options = ["--fidelity", "fast", "--n-envs", "2", "--n-steps", "40", "--batch-size", "40", "--n-epochs", "1"]
    options += ["--checkpoint-every", "80"]
    first = _start(["--task", "extension", "--total-steps", "1000000", "--run-dir", str(path), *options])
    _wait_for(lambda: path.exists() and Run.open(path).steps >= 160, first)
    first.kill()
    first.communicate()
    steps = Run.open(path).steps
    second = _start(["--resume", str(path)])
    _wait_for(lambda: Run.open(path).steps > steps, second)
    os.killpg(second.pid, number)  # as a terminal or a batch system does: to the group
    os.kill(second.pid, number)  # and as make and timeout do: to the program once more
    out, err = second.communicate(timeout=30)
    assert second.returncode == 128 + number, err
    assert f"{path}: {steps} of 1000000 steps done\nstarting 2 worms" in out
    assert err == f"stopped by {number.name}; continue with: python train.py --resume {path}\n"
    assert [session["from_step"] for session in json.loads((path / "versions.json").read_text())] == [0, steps]
    assert not list(path.rglob("unfinished-*"))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_while_the_worms_start(tmp_path: Path, number: signal.Signals) -> None:
    """No traceback, whatever it was doing."""
    path = tmp_path / "run"
    process = _start(["--task", "extension", "--n-envs", "2", "--run-dir", str(path)])
    _wait_for(path.exists, process)
    time.sleep(0.5)
    os.killpg(process.pid, number)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 128 + number, err
    assert err == f"stopped by {number.name}; continue with: python train.py --resume {path}\n"


def test_a_signal_that_comes_twice_at_once_is_one() -> None:
    """One is often sent to a process and to its group; a later one is another."""
    came: list[int] = []
    before = signal.getsignal(signal.SIGINT)
    with on_signal(came.append):
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1.1)
        os.kill(os.getpid(), signal.SIGTERM)
    assert came == [signal.SIGINT, signal.SIGTERM]
    assert signal.getsignal(signal.SIGINT) == before


def test_programs_end_with_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    """A signal outside of training, or bad input: no traceback, and a status that says which."""
    with pytest.raises(SystemExit) as ended, as_program():
        signal.raise_signal(signal.SIGTERM)
    assert ended.value.code == 143
    assert capsys.readouterr().err == "stopped by SIGTERM\n"
    with pytest.raises(SystemExit, match=r"^error: gamma = 2$"), as_program():
        raise InputError("gamma = 2")


def test_progress_is_told_now_and_then(capsys: pytest.CaptureFixture[str]) -> None:
    """Silent at first and between two lines."""
    silent, chatty = Progress(every=60.0), Progress(every=0.0)
    for number in range(3):
        silent("trained policy", f"episode {number} of 3")
        chatty("trained policy", f"episode {number} of 3")
    assert capsys.readouterr().err == "".join(f"trained policy, episode {number} of 3\n" for number in range(3))


def _start(arguments: list[str]) -> subprocess.Popen[str]:
    command = [sys.executable, "train.py", *arguments]
    return subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def _wait_for(condition: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    until = time.monotonic() + 60.0
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until
        time.sleep(0.05)


PROGRAMS = ("train.py", "agents.evaluation", "agents.rollouts", "agents.benchmark", "agents.demo")
_CALLS = """
import runpy, sys
for call in sys.argv[1:]:
    sys.argv = call.split()
    try:
        if sys.argv[0].endswith(".py"):
            runpy.run_path(sys.argv[0], run_name="__main__")
        else:
            runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
    except SystemExit as end:
        print(f"end of {call}:", end.code)
"""


@pytest.fixture(scope="module")
def told() -> dict[str, str]:
    """Call each program for help, and one for a run that is not there: what each printed, and how it ended.

    All in one process, of which half would go into importing.
    """
    calls = [*(f"{name} --help" for name in PROGRAMS), "agents.evaluation nowhere"]
    here = partial(subprocess.run, cwd=ROOT, capture_output=True, text=True, check=True)
    text, found = here([sys.executable, "-c", _CALLS, *calls]).stdout, {}
    for call in calls:
        before, text = text.split(f"end of {call}:", 1)
        status, text = text.split("\n", 1)
        found[call] = f"{before}{status}"
    assert not text
    return found


def test_programs_name_themselves(told: dict[str, str]) -> None:
    """The help tells how a program is called."""
    for name in PROGRAMS:
        program = name if name == "train.py" else f"-m {name}"
        text = told[f"{name} --help"]
        assert text.startswith(f"usage: python {program} [-h]")
        assert text.endswith(" 0")


def test_every_setting_has_a_docstring_on_the_command_line(told: dict[str, str]) -> None:
    """Options and units show in the help."""
    text = told["train.py --help"]
    for field in fields(TrainConfig):
        assert f"--{field.name.replace('_', '-')}" in text
    assert "but not annealed: anneal goes by total_steps alone" in " ".join(re.sub(r"[│|]", "", text).split())
    assert "[Hz]" in text
    assert "[s]" in text


@pytest.mark.parametrize("name", PROGRAMS)
def test_programs_need_their_packages(name: str) -> None:
    """An interpreter without the packages says how to get them."""
    program = [name] if name == "train.py" else ["-m", name]
    command = [sys.executable, "-S", *program]  # -S: without site-packages
    bare = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (bare.returncode, bare.stdout) == (1, "")
    assert re.fullmatch(r"error: .*tyro not installed .*source \.venv/bin/activate.*pip install .*\n", bare.stderr)


def test_command_line_prints_one_line_for_a_missing_run(told: dict[str, str]) -> None:
    """Bad input gives a message, with which Python ends and status 1, not a traceback."""
    assert told["agents.evaluation nowhere"] == " error: nowhere: no such run folder"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--resume", "nowhere"], "nowhere: no such run folder"),
        (["--seed", "1", "--design", "nowhere.json"], r"nowhere\.json: no such file"),
    ],
)
def test_training_refuses_what_is_not_there(arguments: list[str], message: str) -> None:
    """Nothing is made of nothing."""
    with pytest.raises(InputError, match=f"^{message}"):
        train_main(arguments)


def test_bad_options_end_with_the_reason(capsys: pytest.CaptureFixture[str]) -> None:
    """The settings' own message reaches the terminal."""
    with pytest.raises(SystemExit):
        train_main(["--gamma", "2"])
    assert "gamma = 2.0: must be a number above 0" in " ".join(capsys.readouterr().err.split())
