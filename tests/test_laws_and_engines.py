"""Every law that acts within a step stands in one file of its name, in the physics and in each engine."""

from __future__ import annotations

from pathlib import Path

import pytest

import lattice_gym

PACKAGE = Path(lattice_gym.__file__).parent
LAWS = {
    "elasticity", "damping", "joints", "muscles", "lines", "hill", "medium", "loads", "ground", "ball", "contact",
}  # fmt: skip
"""Laws that act within a step."""
BETWEEN_STEPS = {"base", "activation", "adaptation"}
"""What else stands among the laws: what they have in common, and what acts once a control step."""
ENGINES = {"fused": "engines/fused/kernels", "pyelastica": "engines/pyelastica"}
"""Where each engine has its laws."""
TO_SPLIT = {"physics/laws": {"damping", "hill", "contact"}}
"""Folders whose laws are not all in files of their own, with those that are; to go with the last of them."""


def modules(folder: str) -> set[str]:
    """Names of the modules of a folder of the package; none where there is no such folder."""
    return {path.stem for path in (PACKAGE / folder).glob("*.py")} - {"__init__"}


def test_every_law_is_listed() -> None:
    """A new file among the laws is either one of a step, and then in both engines, or named as none."""
    found = modules("physics/laws") - BETWEEN_STEPS
    assert found <= LAWS
    assert found == LAWS or "physics/laws" in TO_SPLIT


@pytest.mark.parametrize("folder", ENGINES.values())
def test_every_law_has_a_file_in_each_engine(folder: str) -> None:
    """Where the physics has a law, an engine has it under the same name."""
    missing = LAWS - modules(folder)
    assert missing == LAWS - TO_SPLIT.get(folder, LAWS)
