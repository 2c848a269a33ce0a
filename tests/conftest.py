"""What several test modules share: both engines, and one lattice model built once."""

from __future__ import annotations

import gc

import pytest
from hypothesis import settings

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.engines.registry import EngineName

# The same examples every time: a suite that fails must fail again.
settings.register_profile("seeded", derandomize=True)
settings.load_profile("seeded")


# The compiler makes millions of objects: by looking for garbage less often it is a twelfth faster.
gc.set_threshold(100_000, 50, 100)

LONGEST = ("test_env", "test_tasks", "test_agents", "test_energy", "test_hill", "test_ball", "test_physics")
"""Files that begin first, so that no process is left alone with one of them at the end."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of the longest files first."""
    place = {name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.stem, len(place)))


@pytest.fixture(params=["fused", "pyelastica"])
def engine_name(request: pytest.FixtureRequest) -> EngineName:
    """Run the test on either engine."""
    name: EngineName = request.param
    return name


@pytest.fixture(scope="session")
def lattice() -> Lattice:
    """Build the default lattice."""
    return build_lattice(LatticeDesign())
