"""Every exact case on both engines, and orders of convergence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial

from tqdm import tqdm

from lattice_gym.benchmarks.benchmark_scene import ENGINES
from lattice_gym.engines.registry import EngineName
from lattice_gym.verification.case import Case, Outcome, run
from lattice_gym.verification.cases import CASES
from lattice_gym.verification.orders import Orders, slope, step_orders, step_trials

MESH_ORDER, MESH_ORDER_BAND = 2.0, 0.35
"""Order expected in the element count, and by how much the fitted one may differ."""


@dataclass(frozen=True)
class MeshOrder:
    """Errors of one case on one engine over its meshes, and the order that fits them."""

    case: Case
    engine: EngineName
    n_elem: tuple[int, ...]
    error: tuple[float, ...]

    @property
    def fitted(self) -> float:
        """Slope of log(error) over log(element size)."""
        return -slope(self.n_elem, self.error)

    @property
    def passed(self) -> bool:
        """True if the fitted order is near enough to 2."""
        return abs(self.fitted - MESH_ORDER) <= MESH_ORDER_BAND


@dataclass(frozen=True)
class Validation:
    """All that the report shows."""

    outcomes: tuple[tuple[Outcome, Outcome], ...]
    """One pair, fused and pyelastica, a case."""
    meshes: tuple[MeshOrder, ...]
    steps: tuple[Orders, ...]

    @property
    def passed(self) -> bool:
        """True if every error and every order is within its tolerance."""
        errors = all(outcome.passed for pair in self.outcomes for outcome in pair)
        return errors and all(mesh.passed for mesh in self.meshes) and all(steps.passed for steps in self.steps)


def validate(cases: Sequence[Case] = CASES, *, quick: bool = False) -> Validation:
    """Run the cases; the quick form takes coarse meshes, and fits orders to two of them on the fused engine."""
    pairs: list[tuple[Outcome, Outcome]] = []
    meshes: list[MeshOrder] = []
    for case in tqdm(cases, desc="exact cases", unit="case"):
        measure = cache(partial(run, case))
        n_elem = case.coarse if quick else case.n_elem
        pairs.append((measure("fused", n_elem), measure("pyelastica", n_elem)))
        counts = case.meshes[:2] if quick else case.meshes
        for engine in ENGINES[:1] if quick else ENGINES:
            if counts:
                errors = tuple(measure(engine, mesh).reading.error for mesh in counts)
                meshes.append(MeshOrder(case, engine, counts, errors))
    trials = tqdm(list(step_trials(quick=quick)), desc="orders in dt", unit="order")
    return Validation(tuple(pairs), tuple(meshes), tuple(step_orders(*trial) for trial in trials))
