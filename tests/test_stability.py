"""The predicted critical step, held against what the engine bears."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lattice_gym.benchmarks.stability import cases
from lattice_gym.benchmarks.stability.cases import Case, lying, random_cases
from lattice_gym.benchmarks.stability.limits import Limit, Trial, measure
from lattice_gym.benchmarks.stability.report import report, summarise
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.simulation import simulate
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.critical_step import DT_MARGIN, SAFETY, critical_dt, default_dt, largest_eigenvalue
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.laws.joints import Joint
from lattice_gym.physics.laws.lines import Line
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.laws.muscles import contraction
from lattice_gym.physics.rod import straight_rod
from lattice_gym.physics.state import RodState
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model

pytestmark = pytest.mark.slow

STEEL: dict[str, Any] = {"radius": 0.05, "density": 1000.0, "youngs_modulus": 1e6, "shear_modulus": 4e5}
SOFT: dict[str, Any] = STEEL | {"youngs_modulus": 1.0, "shear_modulus": 1.0}


def worm(**design: Any) -> RodModel:
    """Model of a worm with every muscle."""
    lattice = build_lattice(LatticeDesign(**design))
    return build_model(lattice, named_layout("all", lattice))


def holds_still(model: RodModel, dt: float, splitting: Splitting, state: RodState, tension: float) -> bool:
    """Whether 4,000 steps from a slightly shaken balance stay finite and small."""
    engine = simulate("fused", model, dt, splitting)
    shake = 1e-6 * np.random.default_rng(0).standard_normal(state.velocity.shape)
    for clamp in model.clamps:
        if clamp.node is not None:
            shake[model.node_offset[clamp.rod] + clamp.node] = 0.0
    engine.restore(replace(state, velocity=shake))
    health = engine.advance(np.full(model.n_muscle, tension), 4000)
    return health.ok and bool(np.abs(engine.state.velocity).max() < 1e-3)


def measured_dt(
    model: RodModel, splitting: Splitting = "pyelastica", state: RodState | None = None, tension: float = 0.0
) -> float:
    """Largest step that holds still, by bisection to 1 %."""
    low = high = 0.5 * critical_dt(model, splitting=splitting)
    state = model.rest_state() if state is None else state
    while holds_still(model, high, splitting, state, tension):
        low, high = high, 1.5 * high
    while not holds_still(model, low, splitting, state, tension):
        low, high = low / 1.5, low
    while high / low > 1.01:
        middle = np.sqrt(low * high)
        low, high = (middle, high) if holds_still(model, middle, splitting, state, tension) else (low, middle)
    return low


def assert_exact(model: RodModel, splitting: Splitting = "pyelastica") -> None:
    """Around rest the computed limit, before the safety, is the measured one to 2 %."""
    assert critical_dt(model, splitting=splitting) / SAFETY == pytest.approx(measured_dt(model, splitting), rel=0.02)


@pytest.mark.parametrize(("n_elem", "radius"), [(2, 0.05), (4, 0.05), (20, 0.05), (20, 0.005), (10, 0.2)])
def test_a_straight_rod(n_elem: int, radius: float) -> None:
    """Stretch, shear, bending and twist of slender and of thick elements."""
    assert_exact(RodModel(rods=(straight_rod((0, 0, 0), (0, 0, 1), n_elem, **(STEEL | {"radius": radius})),)))


@pytest.mark.parametrize("radius", [0.001, 0.01, 0.04])
def test_a_rod_by_formula(radius: float) -> None:
    """Nodes move and elements turn in opposite senses: a 2 x 2 problem of deflection (shear) and turning."""
    model = RodModel(rods=(straight_rod((0, 0, 0), (0, 0, 1), 100, **(STEEL | {"radius": radius})),))
    bend, deflect, turn = 1e6 / 0.01**2, 27.0 / 28.0 * 4e5 / 0.01**2, 27.0 / 28.0 * 4e5 / radius**2
    trace = bend + deflect + turn
    square = 2.0 / 1e3 * (trace + math.sqrt(trace**2 - 4.0 * deflect * bend))
    assert critical_dt(model) == pytest.approx(SAFETY * 2.0 / math.sqrt(square), rel=2e-3)


def star(n_arm: int, stiffness: float, damping: float = 0.0) -> RodModel:
    """Soft rods that all meet in one node of the first."""
    angle = 2.0 * np.pi * np.arange(n_arm) / n_arm
    rods = tuple(straight_rod((0, 0, 0), (np.cos(a), np.sin(a), 0), 2, **SOFT) for a in angle)
    return RodModel(rods=rods, joints=tuple(Joint(0, 0, arm, 0, stiffness, damping) for arm in range(1, n_arm)))


@pytest.mark.parametrize("n_arm", [2, 3, 7])
def test_springs_on_one_node(n_arm: int) -> None:
    """With n nodes of mass m on stiff springs to one the highest squared frequency is n k / m."""
    model = star(n_arm, 1e6)
    exact = 2.0 / math.sqrt(n_arm * 1e6 / model.rods[0].mass[0])
    assert critical_dt(model) == pytest.approx(SAFETY * exact, rel=1e-3)
    assert_exact(model)


@pytest.mark.parametrize("damping", [30.0, 300.0, 3000.0])
def test_dashpots(damping: float) -> None:
    """Dashpots see the velocity before the kick, and lower the limit."""
    assert critical_dt(star(3, 1e6, damping)) < critical_dt(star(3, 1e6))
    assert_exact(star(3, 1e6, damping))


@pytest.mark.parametrize("splitting", ["pyelastica", "symmetric"])
@pytest.mark.parametrize(("stiffness", "damping"), [(1e6, 0.0), (1e6, 300.0), (1e6, 3000.0), (1e4, 10.0)])
def test_the_ground(splitting: Splitting, stiffness: float, damping: float) -> None:
    """Nodes of a soft rod that rest on the ground: the computed limit is the measured one to 2 %, and the formula's."""
    rod = straight_rod((0, 0, 0.05), (1, 0, 0.05), 4, **SOFT)
    model = RodModel(
        rods=(rod,), gravity=np.array([0.0, 0.0, -9.81]), ground=Ground(stiffness=stiffness, damping=damping)
    )
    rest = model.rest_state()
    sunk = rest.position + model.node_weight / stiffness
    limit = critical_dt(model, splitting=splitting) / SAFETY
    assert limit == pytest.approx(measured_dt(model, splitting, replace(rest, position=sunk)), rel=0.02)
    spring, dashpot = stiffness / rod.mass[0], damping / rod.mass[0]
    assert limit == pytest.approx(4.0 / (math.sqrt(dashpot**2 + 4.0 * spring) + dashpot), rel=1e-3)


@pytest.mark.parametrize(("stiffness", "ratio"), [(2e3, 1.0), (2e3, 2.0)])
def test_never_above_the_measured_limit_on_the_ground(stiffness: float, ratio: float) -> None:
    """A worm in water under random bang-bang activation, by factors on the default ground that shorten the step."""
    design = {"n_pairs": 3, "elements_per_segment": 2, "base": "free", "damping": 1e-3}
    limit = measure(Case("ground", design, world=lying(stiffness, ratio).to_dict()))
    assert limit.predicted < 0.7 * critical_dt(worm(**design), LatticeDesign().max_tension)
    assert 0.4 <= limit.ratio <= 1.0


@pytest.mark.parametrize("splitting", ["pyelastica", "symmetric"])
def test_a_strong_fast_crawl(splitting: Splitting) -> None:
    """A hardly damped worm that crawls at 1 N and 2 Hz bears the predicted step, to 1 % of its height in a second."""
    lattice = build_lattice(LatticeDesign(base="free", damping=1e-3, max_tension=1.0))
    layout = named_layout("all", lattice)
    model = build_model(lattice, layout, World(medium=Medium(), ground=Ground(), lying=True))
    ends = lattice.site_position[[[muscle.start, muscle.end] for muscle in layout.active], 2].mean(axis=1)
    phase = 2.0 * np.pi * ends / lattice.design.height
    phase += np.where([muscle.orientation == "vertical" for muscle in layout.active], np.pi, 0.0)
    n_step, places = math.ceil(0.05 / critical_dt(model, 1.0, splitting)), []
    assert 0.05 / n_step > 2e-4
    for refinement in (1, 4):
        engine = simulate("fused", model, 0.05 / n_step / refinement, splitting)
        for k in range(20):
            tension = [0.5 + 0.5 * np.cos(4.0 * np.pi * 0.05 * end - phase) for end in (k, k + 1)]
            assert engine.advance(np.array(tension), n_step * refinement).ok
        places.append(engine.state.position)
    assert np.linalg.norm(places[0] - places[1], axis=1).max() < 0.01 * lattice.design.height


def test_lines() -> None:
    """A line is a spring along its length, with half its mass at either end."""
    rods = tuple(straight_rod((0, 0, z), (0, 1, z), 2, **SOFT) for z in (0, 1))
    model = RodModel(rods=rods, lines=(Line(0, 0, 1, 0, 1.0, 1e6, mass=0.5),))
    assert critical_dt(model) == pytest.approx(SAFETY * 2.0 / math.sqrt(2e6 / model.node_mass[0]), rel=1e-3)
    assert_exact(model)


@pytest.mark.parametrize(
    "design",
    [
        {},
        {"muscle_model": "line", "muscle_youngs_modulus": 1e7, "n_pairs": 3},
        {"joint_stiffness": 1e4, "base": "free", "n_pairs": 3},
        {"structure_radius": 1e-3, "joint_damping": 0.02, "n_pairs": 3},
        {"n_pairs": 3, "elements_per_segment": 1},
    ],
)
def test_the_lattice_at_rest(design: dict[str, Any]) -> None:
    """Curved rods, springs, clamps and muscles together."""
    assert_exact(worm(**design))


@pytest.mark.parametrize("splitting", ["pyelastica", "symmetric"])
def test_dampers_raise_the_limit(splitting: Splitting) -> None:
    """Dampers on nodes and on elements; however heavy, only those of PyElastica's splitting hold every step."""
    soft = {"n_pairs": 3, "elements_per_segment": 2}
    for damping, spin in ((10.0, 0.0), (10.0, 1e-5)):
        damped = worm(**soft, damping=damping, rotational_damping=spin)
        assert critical_dt(damped, splitting=splitting) > 1.01 * critical_dt(
            worm(**soft, rotational_damping=0.0), splitting=splitting
        )
        assert_exact(damped, splitting)
    frozen = worm(**soft, damping=300.0, rotational_damping=3e-4)
    if splitting == "pyelastica":
        assert critical_dt(frozen, splitting=splitting) == math.inf
        assert holds_still(frozen, 0.05, splitting, frozen.rest_state(), 0.0)
    else:
        assert_exact(frozen, splitting)


def test_heavy_dampers_by_formula() -> None:
    """With the symmetric splitting heavy dampers c make a step stable up to 2 c / K, whatever the mass."""
    c, thin = 1e6, STEEL | {"radius": 1e-3, "shear_modulus": 1e-3}
    rod = straight_rod((0, 0, 0), (0, 0, 1), 2, damping=c, rotational_damping=c, **thin)
    model = RodModel(rods=(rod,), clamps=(Clamp(0, node=0), Clamp(0, node=2)))
    exact = 2.0 * c / (2.0 * rod.stretch_stiffness[0] / 0.5)
    assert c * exact / rod.mass[1] > 1e6
    assert critical_dt(model, splitting="symmetric") == pytest.approx(SAFETY * exact, rel=1e-2)


@pytest.mark.parametrize("splitting", ["pyelastica", "symmetric"])
def test_nothing_free(splitting: Splitting) -> None:
    """Where clamps hold every node and element no step is too long, and the default one is the control step."""
    rods = tuple(straight_rod((0, 0, z), (0, 1, z), 2, **SOFT) for z in (0, 1))
    clamps = tuple(Clamp(k, node, min(node, 1)) for k in range(2) for node in range(3))
    model = RodModel(rods=rods, clamps=clamps, joints=(Joint(0, 0, 1, 0, 1.0, 1.0),))
    assert critical_dt(model, splitting=splitting) == math.inf
    assert default_dt(model, 0.05) == 0.05


def test_dampers_do_not_lengthen_the_default_step() -> None:
    """Where they alone make a step stable it does not resolve them."""
    soft = {"n_pairs": 3, "elements_per_segment": 2}
    steps = [default_dt(worm(**soft, damping=d, rotational_damping=1e-6 * d), 0.05, 0.5) for d in (0.0, 3.0, 300.0)]
    assert steps == [steps[0]] * 3
    limit = critical_dt(worm(**soft, damping=0.0, rotational_damping=0.0), 0.5)
    assert 0.9 * DT_MARGIN * limit < steps[0] <= DT_MARGIN * limit
    assert 0.05 / steps[0] == pytest.approx(round(0.05 / steps[0]), abs=1e-9)


def contracted(tension: float) -> tuple[RodModel, RodState, float]:
    """Make a muscle held at one end and in balance under its own tension, and its length over that at rest."""
    muscle = straight_rod((0, 0, 0), (0, 0, 1), 10, **(STEEL | {"radius": 0.2}))
    model = RodModel(rods=(muscle,), muscles=(0,), clamps=(Clamp(0, node=0, element=0),))
    length = muscle.stretch_stiffness[0] / (muscle.stretch_stiffness[0] + tension)
    return model, replace(model.rest_state(), position=length * muscle.position), length


def test_a_contracted_muscle() -> None:
    """It is stiffer than at rest: what is stable at rest is not, what is predicted for the tension is."""
    stiffness = 1e6 * np.pi * 0.04
    model, state, length = contracted(stiffness)
    assert length == pytest.approx(0.5)
    limit = measured_dt(model, state=state, tension=stiffness)
    assert limit < critical_dt(model, 0.0)
    assert 0.4 * limit < critical_dt(model, stiffness) < limit
    assert contraction(model, stiffness)[0] < length


def isometric(muscle: str, hill: Hill) -> RodModel:
    """Make a muscle of four elements held at both ends, or two lines with a node between them."""
    clamps = (Clamp(0, node=0, element=0), Clamp(0, node=4, element=3))
    soft = {"youngs_modulus": 1e4, "shear_modulus": 4e3, "rotational_damping": 1e-6}
    rod = straight_rod((0, 0, 0), (0, 0, 1), 4, **(STEEL | soft))
    if muscle == "rod":
        return RodModel(rods=(rod,), muscles=(0,), clamps=clamps, hill=hill)
    lines = tuple(Line(0, a, 0, a + 2, 0.5, 100.0, 0.1) for a in (0, 2))
    return RodModel(rods=(rod,), lines=lines, clamps=clamps, hill=hill)


@pytest.mark.parametrize("splitting", ["pyelastica", "symmetric"])
@pytest.mark.parametrize("muscle", ["rod", "line"])
@pytest.mark.parametrize(
    ("hill", "tension"),
    [(Hill(max_speed=0.5), 20.0), (Hill(max_speed=5.0), 20.0),
     (Hill(max_speed=None, width=0.02, optimal_length=1.0143), 2000.0)],
)  # fmt: skip
def test_the_predicted_step_is_stable(muscle: str, hill: Hill, tension: float, splitting: Splitting) -> None:
    """Held at both ends under tension: the step found by bisection is never below the predicted one.

    The last stands where the force-length curve rises most steeply, which outweighs all other stiffness.
    """
    model = isometric(muscle, hill)
    measured = measured_dt(model, splitting, tension=tension)
    predicted = critical_dt(model, tension, splitting)
    assert 0.4 * measured < predicted < measured


def test_a_fast_damper_shortens_the_step() -> None:
    """The slower the muscle, the stiffer the damper; a line more than halves the step."""
    steps = [critical_dt(isometric("line", Hill(width=None, max_speed=v)), 20.0) for v in (1e9, 1.0, 0.1, 0.01)]
    assert steps == sorted(steps, reverse=True)
    assert steps[3] < 0.5 * steps[0]
    assert steps[0] == pytest.approx(critical_dt(isometric("line", Hill(width=None, max_speed=None)), 20.0), rel=0.05)


def test_contraction() -> None:
    """None without tension or muscles; more with more tension; no rod below its muscles or half its length."""
    model = worm(muscle_youngs_modulus=1e5)
    assert (contraction(model, 0.0)[0] == 1.0).all()
    rods = contraction(replace(model, muscles=()), 1e3)[0]
    assert (rods == 1.0).all()
    before: FloatArray = np.ones(model.n_rod)
    for tension in (0.1, 1.0, 10.0, 100.0):
        now = contraction(model, tension)[0]
        assert (now <= before).all()
        assert now[:12].min() >= max(0.5, now[12:].min())
        before = now
    assert contraction(worm(muscle_model="line"), 1.0)[1].max() < 1.0


@pytest.mark.parametrize("tension", [-1.0, math.nan, math.inf])
def test_bad_tension(tension: float) -> None:
    """It is named."""
    with pytest.raises(ValueError, match="max_tension"):
        critical_dt(star(2, 1.0), tension)


def test_largest_eigenvalue() -> None:
    """Lanczos' iteration against a dense solver, also where it ends early."""
    rng = np.random.default_rng(0)
    for size in (1, 2, 30, 300):
        root = rng.standard_normal((size, size))
        matrix = root @ root.T
        found = largest_eigenvalue(matrix.__matmul__, size)
        assert found == pytest.approx(np.linalg.eigvalsh(matrix)[-1], rel=1e-3)
    assert largest_eigenvalue(lambda x: 3.0 * x, 50) == pytest.approx(3.0)


def cheap(case: Case) -> bool:
    """Whether a case takes about a second."""
    return bool(case.design["elements_per_segment"] <= 4 and case.design["n_pairs"] <= 3)


CHEAP = [case for case in random_cases(30, seed=1) if cheap(case)]


@pytest.mark.parametrize("case", CHEAP, ids=lambda case: case.design["base"])
def test_never_above_the_measured_limit(case: Case) -> None:
    """Random designs under random bang-bang activation."""
    limit = measure(case)
    assert limit.beyond or 0.4 <= limit.ratio <= 1.0


SQUARE = np.zeros((4, 3))


@pytest.mark.parametrize(
    ("one", "other", "forks"),
    [
        (("", [0.0, 0.0]), ("", [0.0, 0.005]), False),
        (("", [0.0, 0.0]), ("", [0.0, 0.02]), True),
        (("", [0.0, 0.0]), ("inverted", []), True),
        (("", [0.0, 0.0]), ("inverted", [0.0]), True),
        (("torn", [0.0]), ("inverted", [0.0]), True),
        (("inverted", []), ("inverted", [0.0, 0.0]), False),
        (("inverted", [0.0, 0.0]), ("inverted", [0.005]), False),
        (("inverted", [0.0, 0.0]), ("inverted", [0.02]), True),
    ],
)
def test_forks(
    monkeypatch: pytest.MonkeyPatch, one: tuple[str, list[float]], other: tuple[str, list[float]], forks: bool
) -> None:
    """Runs apart by more than 1 %, or of which one fails; with the same failure as far as both go, if at all."""
    trial = Trial(LatticeDesign(n_pairs=3, elements_per_segment=1), World())

    def run(dt: float, n_steps: int, refinement: int, noise: float = 0.0) -> tuple[str, list[FloatArray], float]:
        status, moved = other if noise else one
        return status, [SQUARE + np.array([trial.design.height * x, 0.0, 0.0]) for x in moved], 0.0

    monkeypatch.setattr(trial, "_run", run)
    assert trial.forks(1e-4, 10) == forks


def test_shared_designs_are_counted_once() -> None:
    """Two grids that meet in a design, and a random one; a collapse counts nowhere."""
    default = Case("stiffness", {"n_pairs": 3, "joint_stiffness": LatticeDesign().joint_stiffness})
    shared = [default, replace(default, group="damping", design={"n_pairs": 3}), *random_cases(2)]
    limits = [Limit(case, 1.0, 1.5, 1.4, "", "", False, 0.0) for case in shared]
    limits[-1] = replace(limits[-1], beyond="collapse")
    found = summarise(limits)["within_1_percent"]
    assert [found[key] for key in ("n_counted", "n_design", "n_random", "n_collapse")] == [3, 2, 1, 1]


def test_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A case that collapses is listed apart, the others are counted, and all is written."""
    monkeypatch.setattr(cases, "GRID", {"load": {"tension": (0.5, 4.0), "modulus": (0.01, 100.0)}})
    report(tmp_path, command="test", quick=False, jobs=1, seed=0, n_random=0)
    result = json.loads((tmp_path / "stability.json").read_text())
    assert (result["summary"]["n_case"], len(result["cases"])) == (4, 4)
    assert {row["beyond"] for row in result["cases"] if row["case"]["factors"].get("modulus") == 0.01} == {"collapse"}
    found = result["summary"]["stable"]
    counts = [found[key] for key in ("n_counted", "n_design", "n_random", "n_collapse", "n_forked", "n_above_1")]
    assert (counts, found["holds"]) == ([2, 2, 0, 2, 0, 0], True)
    assert (tmp_path / "stability.png").read_bytes()[1:4] == b"PNG"
    assert "| load" in (tmp_path / "stability.md").read_text()
