"""Worms side by side move to the last bit as each would alone, whatever the others do."""

from __future__ import annotations

import multiprocessing
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.base import Engine
from lattice_gym.engines.fused.engine import FusedEngine
from lattice_gym.engines.fused.pack import Pack
from lattice_gym.engines.health import Status
from lattice_gym.engines.registry import make_engine
from lattice_gym.engines.simulation import Simulation, simulate
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.laws.contact import Contact
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.laws.loads import PointTorque
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.state import RodState
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model

pytestmark = pytest.mark.slow

FIELDS = ("position", "velocity", "directors", "omega", "ball_position", "ball_velocity", "ball_omega")
DT = 1e-4
SMALL = {"n_pairs": 3, "elements_per_segment": 3, "elements_per_muscle": 2}
LYING = World(medium=Medium(drag=0.1), ground=Ground(), lying=True)
BY_DIRECTION = replace(LYING, ground=Ground(forward=0.3))


def worm(world: World | None = None, hill: Hill | None = None, layout: str = "extension", **design: Any) -> RodModel:
    """Build a small worm: 3 pairs of rods, so that two and a half fit into a block."""
    lattice = build_lattice(LatticeDesign(**(SMALL | design)))
    return build_model(lattice, named_layout(layout, lattice), world, hill=hill)


def pulls(model: RodModel, n_worm: int, seed: int = 0) -> FloatArray:
    """Ramps of tension [N], shape (2, n_worm, n_muscle)."""
    return np.random.default_rng(seed).uniform(0.0, 0.5, (2, n_worm, model.n_muscle))


def assert_equal(one: RodState, other: RodState) -> None:
    """Compare two states to the last bit, NaN with NaN."""
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field), field)
    assert one.time == other.time


def assert_as_alone(batch: Engine, engines: list[Simulation], tension: FloatArray, n_substeps: int) -> list[Status]:
    """Advance worms side by side and alone, and compare all that a batch shows; return how they ended."""
    before = batch.position.copy(), batch.velocity.copy()
    codes = batch.advance(tension, n_substeps)
    healths = [engine.advance(tension[:, k], n_substeps) for k, engine in enumerate(engines)]
    assert codes.tolist() == [health.status for health in healths]
    for k, (engine, health) in enumerate(zip(engines, healths, strict=True)):
        state = engine.state
        assert batch.health(k) == health
        assert_equal(batch.state(k), state)
        shown = (state.position, state.velocity) if health.ok else (before[0][k], before[1][k])
        np.testing.assert_array_equal(batch.position[k], shown[0])
        np.testing.assert_array_equal(batch.velocity[k], shown[1])
        if health.ok:
            np.testing.assert_array_equal(batch.ball_position[k], state.ball_position)
            np.testing.assert_array_equal(batch.ball_velocity[k], state.ball_velocity)
    return [health.status for health in healths]


SCENES: dict[str, tuple[RodModel, Splitting]] = {
    "extension": (worm(), "pyelastica"),
    "symmetric": (worm(layout="all"), "symmetric"),
    "ground": (worm(LYING, base="free", damping=1e-3), "symmetric"),
    "by direction": (worm(BY_DIRECTION, base="free", damping=1e-3, muscle_model="line"), "symmetric"),
    "hill": (worm(hill=Hill()), "symmetric"),
    "lines": (worm(muscle_model="line", joint_damping=0.01), "symmetric"),
    "contact": (worm(World(contact=Contact(stiffness=10.0))), "symmetric"),
    "ball": (worm(World(medium=Medium(), ball=Ball())), "symmetric"),
}


@pytest.mark.parametrize("name", SCENES)
def test_worms_side_by_side_move_as_alone(name: str) -> None:
    """Seven of three materials, which fill no whole number of blocks or packs, through ramps of their own."""
    base, splitting = SCENES[name]
    softness = [1.0, 0.8, 1.3]
    models = [soften(base, softness[k % 3]) for k in range(7)]
    batch = make_engine("fused", models, DT, splitting, num_threads=2)
    engines = [simulate("fused", model, DT, splitting) for model in models]
    for call in range(3):
        ends = assert_as_alone(batch, engines, pulls(base, 7, call), 40)
        assert set(ends) == {Status.OK}
    apart = np.abs(batch.position[0] - batch.position[1:]).max(axis=(1, 2))
    assert (apart > 0.0).all()
    assert isinstance(batch, FusedEngine)
    # What cannot share a pack has one of its own.
    assert (len(batch.packs) == len(models)) == (name in ("by direction", "contact", "ball"))
    batch.close()


def soften(model: RodModel, factor: float) -> RodModel:
    """Scale the moduli, masses and damping of all rods and the stiffness of all joints."""
    rods = tuple(
        replace(
            rod,
            youngs_modulus=factor * rod.youngs_modulus,
            density=rod.density / factor,
            rotational_damping=factor * rod.rotational_damping,
        )
        for rod in model.rods
    )
    return replace(model, rods=rods, joints=tuple(replace(j, stiffness=factor * j.stiffness) for j in model.joints))


@pytest.fixture
def four() -> Iterator[tuple[Engine, list[Simulation], RodModel]]:
    """Four worms in one thread, and the same alone."""
    model = worm(layout="all", base="free")
    batch = make_engine("fused", [model] * 4, DT, "symmetric", num_threads=1)
    yield batch, [simulate("fused", model, DT, "symmetric") for _ in range(4)], model
    batch.close()


@pytest.mark.parametrize("number", [1e200, 2e4])
def test_a_neighbour_that_fails_is_not_felt(four: tuple[Engine, list[Simulation], RodModel], number: float) -> None:
    """One worm turns NaN, or its elements turn so fast and bend so far that they leave the reach of the series."""
    batch, engines, model = four
    rest = model.rest_state()
    omega = rest.omega.copy()
    omega[::3, 0] = number
    wild = replace(rest, omega=omega)
    batch.restore(1, wild)
    engines[1].restore(wild)
    ends = [assert_as_alone(batch, engines, pulls(model, 4, call), 15) for call in range(2)]
    assert [end[1] for end in ends] != [Status.OK] * 2
    assert {end[k] for end in ends for k in (0, 2, 3)} == {Status.OK}
    batch.restore(1, rest)
    engines[1].restore(rest)
    assert batch.health(1).status == ends[1][1]
    assert set(assert_as_alone(batch, engines, pulls(model, 4, 2), 15)) == {Status.OK}


def test_a_large_turn_takes_no_lane_along(four: tuple[Engine, list[Simulation], RodModel]) -> None:
    """A neighbour that turns by more than the series hold, and survives, changes no bit of the others."""
    batch, engines, model = four
    rest = model.rest_state()
    omega, directors = rest.omega.copy(), rest.directors.copy()
    first = model.elements(0)
    omega[first] = directors[first] @ np.array([0.0, 0.0, 0.6 / DT])
    assert (np.linalg.norm(omega[first], axis=1) * DT > 0.5).all()
    wild = replace(rest, omega=omega)
    batch.restore(2, wild)
    engines[2].restore(wild)
    assert_as_alone(batch, engines, pulls(model, 4), 1)


def test_restore_and_replace(four: tuple[Engine, list[Simulation], RodModel]) -> None:
    """A worm goes back to where it was, one begins anew of another material, and one with a torque of its own."""
    batch, engines, model = four
    assert_as_alone(batch, engines, pulls(model, 4), 20)
    kept = batch.state(3)
    assert_as_alone(batch, engines, pulls(model, 4, 1), 20)
    batch.restore(3, kept)
    engines[3].restore(kept)
    np.testing.assert_array_equal(batch.position[3], kept.position)
    other = soften(model, 0.7)
    batch.replace(-4, other)
    engines[0] = simulate("fused", other, DT, "symmetric")
    np.testing.assert_array_equal(batch.position[0], other.rest_state().position)
    assert set(assert_as_alone(batch, engines, pulls(model, 4, 2), 20)) == {Status.OK}
    torque = replace(other, torques=(PointTorque(0, 1, (0.0, 0.0, 1e-3)),))
    before = batch.state(1)
    batch.replace(2, torque)
    engines[2] = simulate("fused", torque, DT, "symmetric")
    assert_equal(batch.state(1), before)
    assert set(assert_as_alone(batch, engines, pulls(model, 4, 3), 20)) == {Status.OK}
    assert batch.models[2] is torque


def test_repacking_keeps_what_a_failed_worm_showed(four: tuple[Engine, list[Simulation], RodModel]) -> None:
    """Another worm's new feature neither heals a worm that failed nor shows where it went."""
    batch, _, model = four
    batch.restore(1, replace(model.rest_state(), velocity=np.full((model.n_node, 3), 1e200)))
    batch.advance(pulls(model, 4), 5)
    assert not batch.health(1).ok
    shown = batch.position.copy()
    batch.replace(3, replace(model, torques=(PointTorque(0, 1, (0.0, 0.0, 1e-3)),)))
    np.testing.assert_array_equal(batch.position[:3], shown[:3])
    assert not batch.health(1).ok
    assert not np.isfinite(batch.state(1).position).all()


def test_checks_and_the_reference_behind_the_same_face() -> None:
    """Both engines give the statuses of worms alone, with the checks too."""
    model = SCENES["extension"][0]
    reference = make_engine("pyelastica", [model] * 2, DT)
    assert_as_alone(reference, [simulate("pyelastica", model, DT) for _ in range(2)], pulls(model, 2), 5)
    checked = make_engine("fused", [model] * 2, DT, energy_check=True, step_check=True, num_threads=2)
    engines = [simulate("fused", model, DT, energy_check=True, step_check=True) for _ in range(2)]
    assert set(assert_as_alone(checked, engines, pulls(model, 2), 20)) == {Status.OK}
    checked.replace(0, soften(model, 0.7))
    engines[0] = simulate("fused", soften(model, 0.7), DT, energy_check=True, step_check=True)
    assert set(assert_as_alone(checked, engines, pulls(model, 2), 20)) == {Status.OK}
    checked.close()


def test_threads_change_no_bit() -> None:
    """One thread or three, held tension or a ramp between equals: the same numbers; a closed batch can go on."""
    model = SCENES["symmetric"][0]
    batches = [make_engine("fused", [model] * 9, DT, "symmetric", num_threads=n) for n in (1, 3)]
    pull = pulls(model, 9)[0]
    for _ in range(2):
        batches[0].advance(pull, 15)
    batches[1].advance(np.stack([pull, pull]), 15)
    batches[1].close()
    batches[1].advance(pull, 15)
    np.testing.assert_array_equal(batches[0].position, batches[1].position)
    np.testing.assert_array_equal(batches[0].velocity, batches[1].velocity)
    batches[1].close()


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")
def test_a_fork_has_threads_of_its_own() -> None:
    """A process that is forked after threads have run goes on in it."""
    model = SCENES["symmetric"][0]
    batch = make_engine("fused", [model] * 8, DT, "symmetric", num_threads=2)
    pull = pulls(model, 8)
    batch.advance(pull, 5)
    child = multiprocessing.get_context("fork").Process(target=batch.advance, args=(pull, 5))
    child.start()
    child.join(60.0)
    assert child.exitcode == 0
    batch.close()


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Let SIGINT interrupt, which shells keep from what they run in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("waiting", [False, True])
def test_an_interrupted_call_leaves_no_thread_at_work(waiting: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Be it at work or waiting for others: what they have begun ends first, and nothing more begins."""
    models = [worm(), worm(), worm(hill=Hill()), worm(hill=Hill())]
    batch, twin = (make_engine("fused", models, DT, num_threads=threads) for threads in (2, 1))
    advance, main, begun = Pack.advance, threading.main_thread(), threading.Event()
    theirs, ended, ours = list[Pack](), list[Pack](), list[Pack]()

    def interrupted(pack: Pack, *arguments: Any) -> Any:
        if threading.current_thread() is main:
            ours.append(pack)
            assert begun.wait(60.0)
            if not waiting:
                raise KeyboardInterrupt
            return advance(pack, *arguments)
        theirs.append(pack)
        begun.set()
        time.sleep(0.1)
        if waiting:
            signal.pthread_kill(main.ident or 0, signal.SIGINT)
        time.sleep(0.1)
        codes = advance(pack, *arguments)
        ended.append(pack)
        return codes

    pull = pulls(models[0], 4)
    with monkeypatch.context() as patched:
        patched.setattr(Pack, "advance", interrupted)
        with pytest.raises(KeyboardInterrupt):
            batch.advance(pull, 5)
        assert (len(theirs), len(ended), len(ours)) == (1, 1, 3 if waiting else 1)
    for k, model in enumerate(models):
        batch.restore(k, model.rest_state())
    assert batch.advance(pull, 5).tolist() == twin.advance(pull, 5).tolist()
    np.testing.assert_array_equal(batch.position, twin.position)
    batch.close()


def test_bad_input() -> None:
    """Every mistake is one ValueError that names what is wrong."""
    model = SCENES["extension"][0]
    for arguments, message in (
        (([], DT), r"models = \[\]: must be a sequence of RodModel, at least one"),
        ((model, DT), r"models = RodModel(.|\n)*: must be a sequence"),
        (([model, None], DT), r"models\[1\]: must have the shape of models\[0\], but differs in being None"),
        (([model, worm(n_pairs=6)], DT), r"models\[1\]: .* differs in the elements of its rods"),
        (([model, replace(model, joints=model.joints[1:])], DT), r"models\[1\]: .* differs in what its joints join"),
        (([model, replace(model, muscles=())], DT), r"models\[1\]: .* differs in its muscles"),
        (([model], 0.0), "dt = 0.0: must be a finite number above 0"),
        (([model], DT, "other"), "splitting = 'other': must be one of"),
    ):
        with pytest.raises(ValueError, match=message):
            make_engine("fused", *arguments)
    for count in (0, -1, 1.5, True, "2"):
        with pytest.raises(ValueError, match=r"num_threads = .*: must be a whole number, at least 1, or None"):
            make_engine("fused", [model], DT, num_threads=cast(int, count))
    with pytest.raises(ValueError, match="engine = 'other': must be one of"):
        make_engine("other", [model], DT)
    batch = make_engine("fused", [model] * 2, DT, num_threads=1)
    n = model.n_muscle
    for tension in (np.zeros(n), np.zeros((3, n)), np.zeros((2, 3, n)), np.zeros((2, n + 1))):
        with pytest.raises(ValueError, match=r"tension has shape .*: must have \(2, \d+\) or \(2, 2, \d+\)"):
            batch.advance(tension, 1)
    with pytest.raises(ValueError, match=r"tension\[0, 0\] = -1.0: must be a finite number, at least 0 \[N\]"):
        batch.advance(np.full((2, n), -1.0), 1)
    with pytest.raises(ValueError, match="n_substeps = 0: must be a whole number"):
        batch.advance(np.zeros((2, n)), 0)
    with pytest.raises(ValueError, match=r"model: must have the shape of the one before, but differs in its muscles"):
        batch.replace(0, replace(model, muscles=()))
    with pytest.raises(ValueError, match=r"RodState\.position\[0, 0\] = nan"):
        batch.restore(0, replace(model.rest_state(), position=np.full((model.n_node, 3), np.nan)))
