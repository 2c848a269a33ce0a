"""Error against run time: its quick form holds what it claims, and fidelities are what they say."""

from __future__ import annotations

import json
import pickle
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from lattice_gym.benchmarks.__main__ import main
from lattice_gym.benchmarks.work_precision import motions, report, study
from lattice_gym.benchmarks.work_precision.motions import SCENES, Course, Setting, compare, extrapolated, run
from lattice_gym.benchmarks.work_precision.pefrl import pefrl_faults
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.engines.health import Status
from lattice_gym.envs.env import LatticeWormEnv
from lattice_gym.envs.fidelity import FIDELITIES, FidelityName, named_fidelity
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.worm import build_model
from lattice_gym.tasks.registry import TASKS

pytestmark = pytest.mark.slow

BRIEF = replace(SCENES[0], duration=0.1)
QUICK = replace(
    study.QUICK,
    scenes=tuple(replace(scene, duration=0.1 if scene.duration < 1.0 else 0.5) for scene in SCENES),
    steps=(50, 100, 250),
    repeats=1,
)
"""The quick form with shorter motions and fewer coarse steps."""
RESULTS = Path(report.__file__).parents[1] / "results"
SHARE = r"-?[\d.]+(?= %)"


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Folder and figures of the quick report."""
    folder = tmp_path_factory.mktemp("reports")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "QUICK", QUICK)
        status = main(["--out", str(folder), "work-precision", "--quick"])
    result = json.loads((folder / "work-precision.json").read_text())
    assert status == (0 if result["least_ratio"] >= report.MIN_GAIN else 1)
    return folder, result


def model_of(design: LatticeDesign) -> RodModel:
    """Model of a design with all muscles."""
    lattice = build_lattice(design)
    return build_model(lattice, named_layout("all", lattice))


# The report


def test_quick_report_is_whole(quick: tuple[Path, dict[str, Any]]) -> None:
    """Table, figures and picture; the text names no folder; speed is for the report to judge."""
    folder, result = quick
    text = (folder / "work-precision.md").read_text()
    assert str(folder) not in text
    assert "`python -m lattice_gym.benchmarks work-precision --quick`" in text
    assert (folder / "work-precision.png").read_bytes()[1:4] == b"PNG"
    assert result["same_course"] < 1e-11
    assert result["least_ratio"] > 0.0


def test_errors_are_ordered(quick: tuple[Path, dict[str, Any]]) -> None:
    """In time, order one with PyElastica's damping and two with the symmetric one; in space, finer is better."""
    for scene in quick[1]["studies"]:
        for splitting, order in (("pyelastica", 1.0), ("symmetric", 2.0)):
            wanted: dict[str, Any] = {"engine": "fused", "splitting": splitting, "status": "ok"}
            wanted |= {"elements_per_segment": 5, "muscle_model": "rod"}
            own = [point for point in scene["points"] if wanted.items() <= point.items()]
            errors = [point["time_error"][0] for point in own]
            slope = np.polyfit(np.log([point["dt"] for point in own]), np.log(errors), 1)[0]
            assert slope == pytest.approx(order, abs=0.3)
        rods = [row for row in scene["mesh_errors"] if row["muscle_model"] == "rod"]
        errors = [row["error"][0] for row in sorted(rods, key=lambda row: row["elements_per_segment"])]
        assert len(errors) == 4
        assert errors == sorted(errors, reverse=True)
        assert scene["reference_error"][0] < errors[-1]


def test_failed_points_stay(quick: tuple[Path, dict[str, Any]]) -> None:
    """A step of 1 ms fails on every mesh: it is listed with its cost and status, and without an error."""
    for scene in quick[1]["studies"]:
        failed = [point for point in scene["points"] if point["status"] != "ok"]
        assert {(point["n_substeps"], point["elements_per_segment"]) for point in failed} >= {(50, 1), (50, 2), (50, 5)}
        assert all(point["error"] == [None, None] and point["cost"] > 0.0 for point in failed)


def test_fidelities_are_ordered(quick: tuple[Path, dict[str, Any]]) -> None:
    """From fast to fine each costs more and errs less, in every scene, and gaits earn much the same on all."""
    for returns in quick[1]["gait_returns"].values():
        assert returns["fast"] == pytest.approx(returns["fine"], rel=0.1)
        assert returns["default"] == pytest.approx(returns["fine"], rel=0.04)
    for scene in quick[1]["studies"]:
        points = [scene["fidelities"][name] for name in get_args(FidelityName)]
        costs, errors = [point["cost"] for point in points], [point["error"][0] for point in points]
        assert costs == sorted(costs)
        assert errors == sorted(errors, reverse=True)


def test_pefrl_is_unusable() -> None:
    """External forces pile up over its stages, and its damper acts at each: figures that no exact stepper has."""
    assert pefrl_faults() == pytest.approx((2.5, 4.0), rel=1e-6)


def test_engines_take_the_same_course() -> None:
    """What lets the report time PyElastica without running it out."""
    assert study.same_course(SCENES[1], 1) < 1e-12


# Runs and their errors


def course(sites: float, outcome: float, status: str = "ok") -> Course:
    """Two samples of one site and one outcome, from nought."""
    return Course(np.array([[[0.0] * 3], [[0.0, 0.0, sites]]]), np.array([[0.0], [outcome]]), status)


def test_errors_are_relative_to_what_moved() -> None:
    """Half as far is an error of one half; a failed run has none."""
    error = compare(course(0.5, 3.0), course(1.0, 2.0))
    assert (error.sites, error.outcome) == pytest.approx((0.5, 0.5))
    failed = compare(course(0.5, 3.0, "non_finite"), course(1.0, 2.0))
    assert np.isnan([failed.sites, failed.outcome]).all()


def test_extrapolation_is_exact_for_errors_linear_in_the_element() -> None:
    """1 + 1/n from n = 2 and 6."""
    limit = extrapolated(course(1.5, 2.5), course(1.0 + 1.0 / 6.0, 2.0 + 1.0 / 6.0), 3.0)
    assert compare(limit, course(1.0, 2.0)).sites == pytest.approx(0.0, abs=1e-15)
    assert limit.outcome[1, 0] == pytest.approx(2.0)


def test_a_run_that_diverges_says_so() -> None:
    """A step far above the critical one."""
    assert "rod" in run(BRIEF, Setting(n_substeps=20)).status


def test_samples_start_at_rest() -> None:
    """The outcome begins at nought, or at the rest radius, and then moves."""
    for scene in SCENES:
        made = run(replace(scene, duration=0.1), Setting(elements_per_segment=1, n_substeps=200))
        assert made.ok
        assert len(made.sites) == len(made.outcome) == 3
        np.testing.assert_allclose(made.outcome[0], made.outcome[0, 0], atol=1e-12)
        assert np.abs(made.outcome[2] - made.outcome[0]).max() > 1e-5


def test_a_worm_is_built_once() -> None:
    """Bodies are shared between settings of one mesh."""
    assert motions.worm(BRIEF, 2, "rod") is motions.worm(BRIEF, 2, "rod")


# Damping on other meshes


@pytest.mark.parametrize("mesh", [1, 2, 8])
def test_damping_mesh_keeps_damping_per_length(mesh: int) -> None:
    """The structure's damping per element, and so per length, is that of the named mesh; muscles keep theirs."""
    stated, kept = (LatticeDesign(elements_per_segment=n, damping_mesh=5) for n in (5, mesh))
    coarse, other = model_of(stated), model_of(kept)
    for name in ("damping", "rotational_damping"):
        assert getattr(other.rods[0], name) * mesh == pytest.approx(5 * getattr(coarse.rods[0], name))
        assert getattr(other.rods[-1], name) == getattr(coarse.rods[-1], name) == getattr(stated, name)
    assert model_of(LatticeDesign(elements_per_segment=mesh)).rods[0].damping == LatticeDesign().damping


@pytest.mark.parametrize("mesh", [0, -1, 2.5, True, "5", 10**9, float("nan")])
def test_bad_damping_mesh(mesh: Any) -> None:
    """One error that names it."""
    with pytest.raises(ValueError, match="damping_mesh"):
        LatticeDesign(damping_mesh=mesh)


# Fidelities


@pytest.mark.parametrize("name", get_args(FidelityName))
def test_fidelity_builds_and_survives_a_spec(name: FidelityName) -> None:
    """The mesh and splitting are its own; the design keeps all else; a JSON spec makes an equal environment."""
    design = LatticeDesign(structure_youngs_modulus=60e3)
    env = gymnasium.make("LatticeWormExtension-v0", design=design.to_dict(), fidelity=name)
    assert env.spec is not None
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    made, other = env.unwrapped, again.unwrapped
    assert isinstance(made, LatticeWormEnv)
    assert isinstance(other, LatticeWormEnv)
    preset = FIDELITIES[name]
    assert made.splitting == other.splitting == preset.splitting
    assert made.design == other.design == preset.remesh(design)
    assert made.design.elements_per_segment == {"fast": 2, "default": 5, "fine": 16}[name]
    back = replace(made.design, elements_per_segment=design.elements_per_segment, damping_mesh=None)
    assert back == design
    np.testing.assert_allclose(made.model.rods[0].damping * made.design.elements_per_segment, 5 * design.damping)
    for worm in (made, other):
        worm.reset(seed=1)
        assert worm.step(np.ones(48))[4]["status"] == Status.OK
    np.testing.assert_array_equal(made.state.position, other.state.position)


def test_two_meshes_keep_the_first_damping() -> None:
    """What the damping is stated for is not forgotten, and a mesh already there is left alone."""
    fast, fine = FIDELITIES["fast"], FIDELITIES["fine"]
    assert fine.remesh(fast.remesh(LatticeDesign())) == fine.remesh(LatticeDesign())
    assert fast.remesh(LatticeDesign(elements_per_segment=2)) == LatticeDesign(elements_per_segment=2)


@pytest.mark.parametrize(
    ("name", "meshes"), [("fast", (1, 2, 2, 2)), ("default", (1, 5, 16, 25)), ("fine", (16, 16, 16, 25))]
)
def test_fast_is_never_finer_and_fine_never_coarser(name: FidelityName, meshes: tuple[int, ...]) -> None:
    """Than the design, whose own mesh is at that end or beyond it."""
    for own, wanted in zip((1, 5, 16, 25), meshes, strict=True):
        design = LatticeDesign(elements_per_segment=own)
        remeshed = FIDELITIES[name].remesh(design)
        assert remeshed.elements_per_segment == wanted
        assert (remeshed == design) == (wanted == own)


def test_splitting_wins_over_the_fidelity() -> None:
    """It may be given, reaches the engine, and outlives a pickle; PyElastica refuses the symmetric one."""
    choices: tuple[Splitting | None, ...] = ("pyelastica", "symmetric", None)
    states = []
    for splitting in choices:
        env = LatticeWormEnv("extension", fidelity="fast", splitting=splitting)
        env.reset(seed=0)
        for worm in (env, pickle.loads(pickle.dumps(env))):
            worm.step(np.ones(48))
            states.append(worm.state.position)
    assert np.abs(states[0] - states[2]).max() > 1e-7
    for one, same in ((0, 1), (2, 3), (4, 5), (2, 4)):
        np.testing.assert_array_equal(states[one], states[same])
    with pytest.raises(ValueError, match="splitting"):
        LatticeWormEnv("extension", splitting="symmetric", engine="pyelastica")
    wrong: Any = "none"
    with pytest.raises(ValueError, match="splitting"):
        LatticeWormEnv("extension", splitting=wrong)


@pytest.fixture(scope="module")
def measured() -> dict[str, Any]:
    """Figures of the report that the docstring of the environment cites."""
    result: dict[str, Any] = json.loads((RESULTS / "work-precision.json").read_text())
    return result


def stated() -> str:
    """Return what the environment's docstring says about fidelities, on one line."""
    text = (LatticeWormEnv.__doc__ or "").partition("## Fidelity")[2].partition("Arguments\n")[0]
    return " ".join(text.split())


def like(given: str, value: float) -> str:
    """Value with as many decimals as a number that is given."""
    return f"{value:.{len(given.partition('.')[2])}f}"


@pytest.mark.parametrize("name", get_args(FidelityName))
def test_the_table_of_fidelities_is_measured(name: FidelityName, measured: dict[str, Any]) -> None:
    """Every cell is the report's, rounded as it is given; costs are the mean of the scenes, to one digit."""
    row = re.search(rf'\| "{name}" \|([^|]*)\|([^|]*)\|([^|]*)\|([^|]*)\|([^|]*)\|', stated())
    assert row is not None
    mesh, splitting, errors, earned, cost = (cell.strip() for cell in row.groups())
    shares, returns = re.findall(SHARE, errors), re.findall(SHARE, earned) or ["0", "0"]

    studies = measured["studies"]
    assert [scene["scene"]["outcome"] for scene in studies] == ["strain", "bend angle", "ring radii"]
    points = [scene["fidelities"][name] for scene in studies]
    changes = [gained[name] / gained["fine"] - 1.0 for gained in measured["gait_returns"].values()]
    mean_cost = sum(point["cost"] for point in points) / len(points)
    assert {
        "elements per segment": re.findall(r"\d+", mesh),
        "splitting": splitting,
        "error": shares,
        "return": returns,
        "cost": cost,
    } == {
        "elements per segment": [str(points[0]["elements_per_segment"])],
        "splitting": f'"{points[0]["splitting"]}"',
        "error": [like(given, 100.0 * point["error"][0]) for given, point in zip(shares, points, strict=True)],
        "return": [like(returns[0], 100.0 * sum(changes) / len(changes)), like(returns[1], 100.0 * min(changes))],
        "cost": f"{float(f'{1e3 * mean_cost:.1g}'):.0f} ms",
    }
    assert points[0]["splitting"] == FIDELITIES[name].splitting


def test_the_text_on_fidelities_is_measured(measured: dict[str, Any]) -> None:
    """The errors of the time step, the tasks whose returns are averaged, and how much cheaper the fast one is."""
    text, studies = stated(), measured["studies"]
    errors = {splitting: share for share, splitting in re.findall(r'([\d.]+) %(?: or less)? with "(\w+)"', text)}
    averaged = re.search(r"mean over (.+?) \(and worst\)", text)
    cheaper = re.search(r'"fast", which is (\w+) times cheaper than "default"', text)
    assert averaged is not None
    assert cheaper is not None

    worst: dict[str, float] = {}
    for point in (point for scene in studies for point in scene["fidelities"].values()):
        worst[point["splitting"]] = max(worst.get(point["splitting"], 0.0), point["time_error"][0])
    cost = {name: sum(scene["fidelities"][name]["cost"] for scene in studies) for name in ("fast", "default")}
    words = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
    assert {
        "time errors": errors,
        "tasks": sorted(TASKS if averaged[1] == "the tasks" else re.split(r", | and ", averaged[1])),
        "times cheaper": cheaper[1],
    } == {
        "time errors": {name: like(errors.get(name, ""), 100.0 * share) for name, share in worst.items()},
        "tasks": sorted(measured["gait_returns"]),
        "times cheaper": words[round(cost["default"] / cost["fast"])],
    }


@pytest.mark.parametrize("name", ["best", None, 3, ["fast"]])
def test_unknown_fidelity(name: Any) -> None:
    """The error lists what there is."""
    with pytest.raises(ValueError, match=r"fidelity = .* fast, default, fine"):
        named_fidelity(name)
