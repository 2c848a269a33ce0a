"""What several test modules share: order of the files, both engines, worms, tasks, and a tiny training run."""

from __future__ import annotations

import gc
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from runs import TINY

from agents.training import train
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.engines.registry import ENGINES, EngineName
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.worm import build_model
from lattice_gym.recording.trajectory import Recorder, Trajectory
from lattice_gym.tasks.base import Task
from lattice_gym.tasks.registry import TASKS, design_for

# The same examples every time: a suite that fails must fail again.
settings.register_profile("seeded", derandomize=True)
settings.load_profile("seeded")


# The compiler makes millions of objects: by looking for garbage less often it is a twelfth faster.
gc.set_threshold(100_000, 50, 100)

LONGEST = ("test_env", "test_training", "test_tasks", "test_energy", "test_hill", "test_evaluation", "test_physics")
"""Files that begin first, so that no process is left alone with one of them at the end."""


REFERENCE: EngineName = "pyelastica"
"""Engine that the others are compared with."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of the longest files first."""
    place = {name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.stem, len(place)))


@pytest.fixture(params=list(ENGINES))
def engine_name(request: pytest.FixtureRequest) -> EngineName:
    """Run the test on every engine."""
    name: EngineName = request.param
    return name


@pytest.fixture(params=[name for name in ENGINES if name != REFERENCE])
def engine_pair(request: pytest.FixtureRequest) -> tuple[EngineName, EngineName]:
    """Compare every engine with the reference."""
    return request.param, REFERENCE


@pytest.fixture(scope="session")
def lattice() -> Lattice:
    """Build the default lattice."""
    return build_lattice(LatticeDesign())


@pytest.fixture(params=list(TASKS))
def task(request: pytest.FixtureRequest) -> Task:
    """Build each task, with its own changes to the default design."""
    lattice = build_lattice(design_for(request.param))
    return TASKS[request.param](lattice, 0.05)


@pytest.fixture(scope="session")
def coarse_lattice() -> Lattice:
    """Return the default worm, coarse."""
    return build_lattice(LatticeDesign(elements_per_segment=2))


@pytest.fixture(scope="session")
def coarse_model(coarse_lattice: Lattice) -> RodModel:
    """Return its model with all muscles."""
    return build_model(coarse_lattice, named_layout("all", coarse_lattice))


@pytest.fixture(scope="session")
def trajectory(coarse_lattice: Lattice, coarse_model: RodModel) -> Trajectory:
    """Return a worm that grows by 60 % in 0.6 s while its muscles switch on one after another."""
    share = np.linspace(0.0, 1.0, 7)
    recorder = Recorder(coarse_lattice.design, named_layout("all", coarse_lattice), "extension")
    for s in share:
        position = coarse_model.rest_state().position * (1.0 + s * (np.array([0.8, 0.8, 1.6]) - 1.0))
        on = (np.arange(coarse_model.n_muscle) < s * coarse_model.n_muscle).astype(float)
        recorder.append(0.6 * s, position, on, outcome=f"strain {60 * s:.0f} %")
    return recorder.build()


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run folder of a tiny finished run; tests that change it copy it first."""
    return train(replace(TINY, run_dir=tmp_path_factory.mktemp("runs") / "tiny"))


@pytest.fixture
def copy(finished: Path, tmp_path: Path) -> Path:
    """Copy of the finished run that a test may damage."""
    return Path(shutil.copytree(finished, tmp_path / "copy"))
