"""Writes docs/clients.md out of a whole run: a row for every client, with its version and what became of it."""

from __future__ import annotations

import ast
from importlib import metadata
from pathlib import Path

import pytest

from lattice_gym.recording.provenance import footer, provenance

PAGE = Path(__file__).resolve().parents[2] / "docs" / "clients.md"
PACKAGES = {
    "client_gymnasium": "gymnasium",
    "client_stable_baselines3": "stable-baselines3",
    "client_sb3_contrib": "sb3-contrib",
    "client_rl_zoo3": "rl_zoo3",
    "client_cleanrl": None,
    "client_torchrl": "torchrl",
    "client_skrl": "skrl",
    "client_tianshou": "tianshou",
    "client_rllib": "ray",
    "client_minari": "minari",
    "client_optuna": "optuna",
}
"""What each file is a client of, in the order of the table; None: no package."""
NAMES = {"client_cleanrl": "CleanRL", "client_rllib": "RLlib"}
HEAD = """# Clients

Libraries that the worms were run with, each for seconds: `make clients` runs `tests/clients` in an environment of its
own, with the versions of `.ci/clients.txt`, and writes this page.

| client | version | what is run | result |
|---|---|---|---|
"""
NOTES = """
- torchrl takes many worms with `autoreset_mode="Disabled"`, which it prefers; `"SameStep"` from no environment whose
  `info` has dicts within, and `"NextStep"` not at all.
- gymnasium's vector wrappers that change observations, and its `NumpyToTorch`, take no environment with `"SameStep"`.
- Stable-Baselines3 takes many worms as `lattice_gym.sb3.WormVecEnv`, with `"SameStep"`.
"""


class Page:
    """Outcomes of the tests by file."""

    def __init__(self) -> None:
        self.outcomes: dict[str, list[str]] = {}

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Keep the file that could not even be read, or that skips itself."""
        if report.outcome != "passed" and report.nodeid.endswith(".py"):
            self.outcomes.setdefault(Path(report.nodeid).stem, []).append(report.outcome)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep what became of a test, once."""
        if report.when == "call" or report.outcome != "passed":
            self.outcomes.setdefault(Path(report.nodeid.partition("::")[0]).stem, []).append(report.outcome)

    def pytest_sessionfinish(self) -> None:
        """Write the page, if all clients were asked for."""
        if set(self.outcomes) >= set(PACKAGES):
            rows = [self._row(file, package) for file, package in PACKAGES.items()]
            made = provenance("make clients", ("lattice_gym", "gymnasium", "numpy", "numba", "torch"))
            PAGE.write_text(HEAD + "".join(rows) + NOTES + f"\n{footer(made)}\n", encoding="utf-8")

    def _row(self, file: str, package: str | None) -> str:
        said = ast.get_docstring(ast.parse(Path(__file__).with_name(f"{file}.py").read_text(encoding="utf-8"))) or ""
        version = "none" if package is None else metadata.version(package)
        outcomes = self.outcomes[file]
        number = {name: outcomes.count(name) for name in ("passed", "failed", "skipped") if name in outcomes}
        result = ", ".join(f"{count} {name}" for name, count in number.items())
        return f"| {NAMES.get(file, package)} | {version} | {said} | {result} |\n"


def pytest_configure(config: pytest.Config) -> None:
    """Follow the run."""
    config.pluginmanager.register(Page())
