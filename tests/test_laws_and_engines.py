"""Every law that acts within a step stands in one file of its name, in the physics and in each engine."""

from __future__ import annotations

from pathlib import Path

import pytest

import lattice_gym
from lattice_gym.physics.assembly import LAWS

PACKAGE = Path(lattice_gym.__file__).parent
BETWEEN_STEPS = {"base", "activation", "adaptation"}
"""What else stands among the laws: what they have in common, and what acts once a control step."""


def modules(folder: str) -> set[str]:
    """Names of the modules of a folder of the package."""
    return {path.stem for path in (PACKAGE / folder).glob("*.py")} - {"__init__"}


def test_every_file_among_the_laws_is_a_law_of_models() -> None:
    """One law a file, and none that no model can obey."""
    assert modules("physics/laws") - BETWEEN_STEPS == {law.__module__.rsplit(".", 1)[1] for law in LAWS}


@pytest.mark.parametrize("folder", ["engines/fused/kernels", "engines/pyelastica"])
def test_every_law_has_a_file_in_each_engine(folder: str) -> None:
    """Where the physics has a law, an engine has it under the same name."""
    assert modules("physics/laws") - BETWEEN_STEPS <= modules(folder)
