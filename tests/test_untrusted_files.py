"""No file runs code: whatever a file names or holds, reading it imports nothing and unpickles nothing."""

from __future__ import annotations

import base64
import importlib
import io
import json
import os
import pickle
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

import agents
from agents.config import InputError, TrainConfig
from agents.evaluation import evaluate
from agents.evaluation import main as evaluation_main
from agents.export import main as export_main
from agents.rollouts import export as export_rollout
from agents.run_folder import Run
from agents.training import resume_settings, train
from lattice_gym import LatticeDesign, MuscleLayout, World, load_policy, record
from lattice_gym.checks import without_imports
from lattice_gym.policies.baselines import DoNothing
from lattice_gym.recording.trajectory import Trajectory
from train import main as train_main

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent
EVIL = """
from pathlib import Path

import numpy as np

from lattice_gym import ObservationTerm
from lattice_gym.physics.laws.activation import FirstOrder
from lattice_gym.tasks.extension import Extension

Path({flag!r}).touch()


class Law(FirstOrder):
    law = "evil"


class Term(ObservationTerm):
    name = "evil"
    low, high = np.zeros(1), np.ones(1)

    def __call__(self, worms):
        return np.zeros((worms.n_worm, 1))


class Boom(Extension.__bases__[0]):
    name, time_limit, layout, sign = "boom", 40, "extension", 1.0
"""
TINY = TrainConfig(
    task="extension", control="ring", fidelity="fast", total_steps=80, seed=3, n_envs=1, n_steps=80, batch_size=40
)


class Trap:
    """Unpickles to a call that leaves a file."""

    def __init__(self, flag: Path) -> None:
        self.flag = flag

    def __reduce__(self) -> Any:
        """Name the call."""
        return Path.touch, (self.flag,)


@pytest.fixture
def flag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Appears as soon as the module `evil`, which Python finds, is imported, or a trap unpickled."""
    flag = tmp_path / "flag"
    (tmp_path / "code").mkdir()
    (tmp_path / "code" / "evil.py").write_text(EVIL.format(flag=str(flag)))
    monkeypatch.syspath_prepend(tmp_path / "code")
    yield flag
    sys.modules.pop("evil", None)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run folder of a tiny run."""
    return train(replace(TINY, run_dir=tmp_path_factory.mktemp("runs") / "run"))


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    """Copy of it to spoil."""
    return Path(shutil.copytree(finished, tmp_path / "run"))


def _nothing_ran(flag: Path) -> bool:
    return not flag.exists() and "evil" not in sys.modules


def _edit(path: Path, **changes: Any) -> None:
    values = json.loads(path.read_text()) if path.exists() else {}
    path.write_text(json.dumps(values | changes))


SPOILT: dict[str, Callable[[Path], None]] = {
    "task": lambda run: _edit(run / "config.json", task="evil:Boom"),
    "module": lambda run: _edit(run / "config.json", task="evil:"),
    "term": lambda run: _edit(run / "config.json", observation=["sites", "evil:Term"]),
    "law": lambda run: _edit(run / "environment.json", activation="evil:Law"),
    "law of a dict": lambda run: _edit(run / "environment.json", activation={"law": "evil:Law"}),
    "deep": lambda run: _edit(run / "environment.json", world={"medium": [{"density": "evil:Boom"}]}),
}
READERS: dict[str, Callable[[Path], object]] = {
    "open": Run.open,
    "load_policy": agents.load_policy,
    "evaluate": lambda run: evaluate(run, episodes=1),
    "record": lambda run: export_rollout(run, "gait"),
    "export": lambda run: export_main(run, run / "policy.npz"),
    "resume": lambda run: train(replace(resume_settings(run), total_steps=160)),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("spoilt", SPOILT)
def test_run_folder_imports_nothing(run: Path, flag: Path, spoilt: str, reader: str) -> None:
    """Whatever reads it names the file and the place, and says what would let it."""
    SPOILT[spoilt](run)
    with pytest.raises(InputError, match=r"\.json: .* = 'evil:\w*': names code, .*import evil first.*--allow evil$"):
        READERS[reader](run)
    assert _nothing_ran(flag)


@pytest.mark.parametrize("activation", ["evil:Law", {"law": "evil:Law", "rise_time": 0.02}])
def test_environment_file_imports_nothing(tmp_path: Path, flag: Path, activation: Any) -> None:
    """Unless its module is allowed: then it is trained with, and its run folder needs no more in this process."""
    file = tmp_path / "further.json"
    _edit(file, activation=activation)
    with pytest.raises(InputError, match=rf"^{re.escape(str(file))}: activation.* = 'evil:Law': names code"):
        train(replace(TINY, environment=file, run_dir=tmp_path / "run"))
    assert _nothing_ran(flag)
    assert not (tmp_path / "run").exists()
    path = train(replace(TINY, environment=file, run_dir=tmp_path / "run", allow=("evil",)))
    assert flag.exists()
    assert "allow" not in json.loads((path / "config.json").read_text())
    assert len(evaluate(path, episodes=1)) == 4
    assert Run.open(path).allowance == " --allow evil"


def test_a_file_cannot_allow_itself(run: Path, flag: Path) -> None:
    """What is allowed comes from the caller alone."""
    _edit(run / "config.json", allow=["evil"], task="evil:Boom")
    with pytest.raises(InputError, match=r"names code"):
        Run.open(run)
    _edit(run / "config.json", task="extension")
    with pytest.raises(InputError, match=r"config\.json: .*there is no 'allow'"):
        Run.open(run)
    assert _nothing_ran(flag)


@pytest.mark.parametrize("spoilt", ["task", "term"])
def test_what_the_caller_imports_may_be_named(run: Path, flag: Path, spoilt: str) -> None:
    """By import, by --allow, or by naming it on the command line."""
    SPOILT[spoilt](run)
    assert Run.open(_imported(run)).allowance == " --allow evil"
    assert flag.exists()


def _imported(run: Path) -> Path:
    importlib.import_module("evil")
    return run


def test_programs_allow_what_they_are_told(run: Path, flag: Path) -> None:
    """A run with a task of one's own is scored and continued where that is allowed, or named, on the command line."""
    _edit(run / "config.json", task="evil:Boom")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(flag.parent / "code")])}
    command = [sys.executable, "-m", "agents.evaluation", str(run), "--episodes", "1", "--allow", "evil"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    assert flag.exists()
    flag.unlink()
    with pytest.raises(InputError, match=r"config\.json: task = .*names code"):
        train_main(["--resume", str(run), "--total-steps", "160"])
    assert _nothing_ran(flag)
    train_main(["--resume", str(run), "--total-steps", "160", "--task", "evil:Boom"])
    assert Run.open(run).steps == 160


def _trajectory_file(path: Path, **changes: Any) -> None:
    """Write a sound trajectory with other texts in it."""
    arguments = {"id": "LatticeWormExtension-v0", "control": "ring", "fidelity": "fast", "max_episode_steps": 2}
    record(DoNothing(), arguments).save(path)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    meta = json.loads(np.lib.format.read_array(io.BytesIO(members["meta.npy"])).item())
    members["meta.npy"] = _member(np.array(json.dumps(meta | changes)))
    _write(path, members)


def _member(values: Any) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array(file, values, allow_pickle=True)
    return file.getvalue()


def _write(path: Path, members: dict[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def test_trajectory_imports_nothing(tmp_path: Path, flag: Path) -> None:
    """A task is but a text; a design, a layout or a world that names code is none."""
    file = tmp_path / "episode.npz"
    _trajectory_file(file, task="evil:Boom", outcome=["evil:Boom"] * 3)
    assert Trajectory.load(file).task == "evil:Boom"
    spoilt: list[dict[str, Any]] = [
        {"design": json.dumps("evil:Boom")},
        {"design": json.dumps({"muscle_model": "evil:Boom"})},
        {"layout": json.dumps({"muscles": "evil:Boom"})},
        {"layout": json.dumps({"muscles": [{"orientation": "evil:Boom", "start": 0, "end": 1}]})},
        {"world": json.dumps({"ball": "evil:Boom"})},
        {"world": json.dumps({"medium": {"density": "evil:Boom"}})},
        {"format": "evil:Boom"},
    ]
    for changes in spoilt:
        _trajectory_file(file, **changes)
        with pytest.raises(ValueError, match=r"episode\.npz: not a sound lattice_gym trajectory"):
            Trajectory.load(file)
    assert _nothing_ran(flag)


def test_dict_forms_import_nothing(flag: Path) -> None:
    """Of a design, a layout and a world, which come from JSON files too."""
    forms: list[tuple[Callable[[Any], object], Any]] = [
        (LatticeDesign.from_dict, {"base": "evil:Boom"}),
        (LatticeDesign.from_json, '{"phases": ["evil:Boom"]}'),
        (LatticeDesign.from_json, '"evil:Boom"'),
        (MuscleLayout.from_dict, {"muscles": ["evil:Boom"]}),
        (World.from_dict, {"ground": "evil:Boom"}),
        (World.from_dict, {"evil:Boom": 1}),
    ]
    for make, form in forms:
        with pytest.raises(ValueError, match=r"evil:Boom|not JSON|must be"):
            make(form)
    assert _nothing_ran(flag)


def _policy_file(finished: Path, path: Path, **changes: Any) -> None:
    policy = agents.load_policy(finished)
    replace(policy, environment={**policy.environment, **changes}).save(path)


@pytest.mark.parametrize(
    "changes",
    [
        {"task": "evil:Boom"},
        {"observation": ["sites", "evil:Term"]},
        {"activation": {"law": "evil:Law"}},
        {"muscles": "evil:Boom"},
        {"world": {"ball": {"force": ["evil:Boom"]}}},
    ],
    ids=str,
)
def test_policy_file_imports_nothing(finished: Path, tmp_path: Path, flag: Path, changes: Any) -> None:
    """Its environment is arguments, and names code only where that is imported."""
    file = tmp_path / "policy.npz"
    _policy_file(finished, file, **changes)
    with pytest.raises(ValueError, match=r"policy\.npz: not a sound .*'evil:\w+': names code, .* import evil first"):
        load_policy(file)
    for program in (evaluation_main, export_rollout):
        with pytest.raises(InputError, match=r"policy\.npz: .*names code"):
            program(file)
    assert _nothing_ran(flag)
    importlib.import_module("evil")
    if "task" in changes:
        assert load_policy(file).environment["task"] == "evil:Boom"


@pytest.mark.parametrize(
    "name", ["evil:Worm-v0", "evil:LatticeWorm-v0", "CartPole-v1", "phys2d/CartPole-v1", ["a"], None]
)
def test_policy_file_makes_worms_alone(finished: Path, tmp_path: Path, flag: Path, name: Any) -> None:
    """An id could import a module, or have Gymnasium import another environment."""
    file, before = tmp_path / "policy.npz", set(sys.modules)
    _policy_file(finished, file, id=name)
    with pytest.raises(ValueError, match=r"environment: id = .*: must be that of a worm"):
        load_policy(file)
    assert _nothing_ran(flag)
    assert not any(module.startswith(("gymnasium.envs.classic", "jax")) for module in set(sys.modules) - before)


def test_a_registered_task_of_ones_own_is_a_worm(finished: Path, tmp_path: Path, flag: Path) -> None:
    """By its id, once the caller has registered it."""
    import lattice_gym

    file = tmp_path / "policy.npz"
    _policy_file(finished, file, id="Boom-v0", task="extension")
    with pytest.raises(ValueError, match=r"environment: id = 'Boom-v0': must be that of a worm"):
        load_policy(file)
    lattice_gym.register_task("evil:Boom", "Boom-v0")
    try:
        assert load_policy(file).environment["id"] == "Boom-v0"
    finally:
        gymnasium.registry.pop("Boom-v0")


def test_loaded_modules_are_not_made_to_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flag: Path) -> None:
    """A name is looked up without running anything: neither a module's own __getattr__ nor a property."""
    (tmp_path / "code" / "lazy.py").write_text("def __getattr__(name):\n    import evil\n    return evil.Boom\n")
    importlib.import_module("lazy")
    with pytest.raises(ValueError, match=r"^task = 'lazy:Boom': must be a class of lazy"):
        without_imports("", {"task": "lazy:Boom"})
    for text in ("os:system", "os:path", "os:", ":", ":os", "os:path.join", "os.path:join", "sys:modules"):
        with pytest.raises(ValueError, match=r"^task = "):
            without_imports("", {"task": text})
    without_imports("", {"task": "lattice_gym.tasks.crawl:Crawl", "note": "no code", "list": [1, None, {"a": 0.5}]})
    assert _nothing_ran(flag)
    sys.modules.pop("lazy")


# Pickles


def _pickled_model(flag: Path) -> dict[str, Callable[[bytes], bytes]]:
    """Traps in the parts of model.zip, each in place of what was there."""
    trap = pickle.dumps(Trap(flag))
    torch_file = io.BytesIO()
    torch.save({"action_net.bias": Trap(flag)}, torch_file)
    serialised = {":type:": "<class 'type'>", ":serialized:": base64.b64encode(trap).decode()}

    def settings(content: bytes) -> bytes:
        return json.dumps(dict.fromkeys(json.loads(content), serialised)).encode()

    return {
        "data": settings,
        "policy.pth": lambda _: torch_file.getvalue(),
        "policy.optimizer.pth": lambda _: torch_file.getvalue(),
        "pytorch_variables.pth": lambda _: trap,
    }


@pytest.mark.parametrize("part", ["data", "policy.pth", "policy.optimizer.pth", "pytorch_variables.pth"])
def test_model_is_not_unpickled(run: Path, flag: Path, part: str) -> None:
    """Evaluating, exporting and continuing a run read weights alone, and say where those are none."""
    model = Run.open(run).newest / "model.zip"
    with zipfile.ZipFile(model) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members[part] = _pickled_model(flag)[part](members[part])
    _write(model, members)
    for name in ("load_policy", "export", "evaluate", "resume"):
        weights = part == "policy.pth" or (part == "policy.optimizer.pth" and name == "resume")
        if weights:
            with pytest.raises(InputError, match=r"model\.zip: damaged or not of this kind: .*[Ww]eights.only"):
                READERS[name](run)
        else:
            READERS[name](run)
        assert not flag.exists()
    with pytest.raises(Exception, match=r".*"):  # that the trap works
        _load_by_hand(model, part)
    assert flag.exists() or part == "pytorch_variables.pth"


def _load_by_hand(model: Path, part: str) -> None:
    with zipfile.ZipFile(model) as archive:
        content = archive.read(part)
    if part == "data":
        for value in json.loads(content).values():
            pickle.loads(base64.b64decode(value[":serialized:"]))
    else:
        torch.load(io.BytesIO(content), weights_only=False)
    raise ValueError("it was loaded")


def test_normalisation_is_not_unpickled(run: Path, flag: Path) -> None:
    """Arrays of objects, a pickle in its place, and one beside it."""
    file = Run.open(run).newest / "normalisation.npz"
    with zipfile.ZipFile(file) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    trap = pickle.dumps(Trap(flag))
    spoilt = [members | {name: _member(np.array(Trap(flag), dtype=object))} for name in members]
    spoilt += [members | {"observation_mean.npy": trap}, members | {"more.npy": trap}]
    for content in spoilt:
        _write(file, content)
        with pytest.raises(InputError, match=r"normalisation\.npz: damaged or not of this kind"):
            evaluate(run, episodes=1)
    file.write_bytes(trap)
    with pytest.raises(InputError, match=r"normalisation\.npz: damaged or not of this kind"):
        evaluate(run, episodes=1)
    assert not flag.exists()
    (file.parent / "vecnormalize.pkl").write_bytes(trap)  # which older runs had, and nobody reads
    _write(file, members)
    evaluate(run, episodes=1)
    assert not flag.exists()


def test_files_of_arrays_are_not_unpickled(finished: Path, tmp_path: Path, flag: Path) -> None:
    """Policies and trajectories: no member may be an object."""
    policy, episode = tmp_path / "policy.npz", tmp_path / "episode.npz"
    _policy_file(finished, policy)
    _trajectory_file(episode)
    for file, load in ((policy, load_policy), (episode, Trajectory.load)):
        with zipfile.ZipFile(file) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        for name in members:
            _write(file, members | {name: _member(np.array(Trap(flag), dtype=object))})
            with pytest.raises(ValueError, match=rf"{file.name}: not a sound"):
                load(file)
    assert not flag.exists()


def test_damaged_policies_are_refused(finished: Path, tmp_path: Path, flag: Path) -> None:
    """Bytes of members that were hit, and texts of any kind: a sound policy, or a ValueError of the file."""
    sound, file, generator = tmp_path / "policy.npz", tmp_path / "damaged.npz", np.random.default_rng(0)
    _policy_file(finished, sound)
    with zipfile.ZipFile(sound) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    meta = json.loads(np.lib.format.read_array(io.BytesIO(members["meta.npy"])).item())
    junk: list[Any] = [None, True, -1, "", "evil:Boom", ":", [], {}, ["evil:Term"], {"law": "evil:Law"}, 10**400]
    refused = 0
    for _ in range(400):
        spoilt = dict(members)
        if generator.random() < 0.5:
            name = str(generator.choice(list(members)))
            content = bytearray(members[name])
            content[generator.integers(min(200, len(content)))] = generator.integers(256)
            spoilt[name] = bytes(content)
        else:
            changed = json.loads(json.dumps(meta))
            part = changed["environment"] if generator.random() < 0.5 else changed
            part[str(generator.choice(list(part)))] = junk[generator.integers(len(junk))]
            spoilt["meta.npy"] = _member(np.array(json.dumps(changed)))
        _write(file, spoilt)
        try:
            assert np.isfinite(load_policy(file)(np.zeros(296))).all()
        except ValueError as error:
            refused += str(error).startswith(f"{file}: ")
    assert 100 < refused < 400
    assert _nothing_ran(flag)


UNPICKLES = re.compile(
    r"\bpickle\.loads?\(|\bcloudpickle\b|\bPPO\.load\(|VecNormalize\.load\(|\byaml\b|\bnp\.load\(|\beval\("
    r"|torch\.load\((?!.*weights_only=True)"
)
CACHE = ROOT / "lattice_gym" / "engines" / "fused" / "machine_code.py"
"""Keeps compiled code, which is as trusted as Python's own in __pycache__."""


def test_nothing_here_unpickles() -> None:
    """No source of the package or the agents calls what does: new code had better read arrays."""
    sources = [source for folder in ("lattice_gym", "agents") for source in (ROOT / folder).rglob("*.py")]
    assert [source for source in sources if UNPICKLES.search(source.read_text())] == [CACHE]
