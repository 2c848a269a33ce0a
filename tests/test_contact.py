"""Rods that push at each other: by formula, in both engines, in the books and in the predicted step."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contact_scenes import FIELDS, ROD, crossing, moved, touching, worm
from hypothesis import given, settings
from hypothesis import strategies as st

from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.engines.registry import EngineName
from lattice_gym.engines.simulation import simulate
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.critical_step import SAFETY, critical_dt
from lattice_gym.physics.energy import EnergyMeter
from lattice_gym.physics.laws import contact
from lattice_gym.physics.laws.contact import Contact
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.laws.loads import PointForce
from lattice_gym.physics.measures import dilatation
from lattice_gym.physics.rod import straight_rod
from lattice_gym.physics.state import RodState
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model

pytestmark = pytest.mark.slow

SOFT: dict[str, Any] = {"radius": 0.05, "density": 1000.0, "youngs_modulus": 1e3, "shear_modulus": 3e2}


def test_depth(engine_name: EngineName) -> None:
    """Two crossed free rods pressed together with a force sink in by it over the stiffness.

    They are about to slip off each other, as any round things: the force is too small for that to show in the time.
    """
    force = 0.01
    forces = [
        PointForce(rod, node, (0.0, 0.0, sign * 0.5 * force)) for rod, sign in ((0, 1.0), (1, -1.0)) for node in (1, 2)
    ]
    model = crossing(1e-3, forces=tuple(forces), contact=Contact(stiffness=10.0, damping=0.5), rod={"damping": 0.3})
    engine = simulate(engine_name, model, 0.9 * critical_dt(model))
    assert engine.advance([], round(3.0 / engine.dt)).ok
    position = engine.state.position
    pairs = touching(model, position)
    assert pairs.tolist() == [[1, 4]]
    assert contact.depths(model, position, pairs) == pytest.approx([force / 10.0], rel=1e-6)


def test_a_bounce_from_afar(engine_name: EngineName) -> None:
    """Within one call a short stiff rod comes from far beyond the list and leaves as from an elastic collision."""
    stiff = {"youngs_modulus": 1e8, "shear_modulus": 4e7}
    rods = [
        straight_rod((-0.02, 0, 0), (0.02, 0, 0), 2, **ROD | stiff),
        straight_rod((0, -0.02, 0.1), (0, 0.02, 0.1), 2, **ROD | stiff),
    ]
    model = RodModel(rods=tuple(rods), contact=Contact(stiffness=250.0, damping=0.0))
    engine = simulate(engine_name, model, 0.5 * critical_dt(model))
    engine.restore(moved(model, 1, 0.0, (0.0, 0.0, -1.0)))
    assert engine.advance([], round(0.11 / engine.dt)).ok
    share = model.node_mass[:3] / model.node_mass[:3].sum()
    left = [float(share @ engine.state.velocity[rows, 2]) for rows in (slice(0, 3), slice(3, 6))]
    assert left == pytest.approx([-1.0, 0.0], abs=0.01)


def momenta(model: RodModel, state: RodState) -> FloatArray:
    """Momentum and angular momentum about the origin, shape (2, 3)."""
    moving = model.node_mass[:, None] * state.velocity
    inertia = model.rod_array("inertia") / dilatation(model, state.position)
    spin = np.einsum("nji,nj->i", state.directors, inertia[:, None] * [1.0, 1.0, 2.0] * state.omega)
    return np.stack([moving.sum(axis=0), np.cross(state.position, moving).sum(axis=0) + spin])


@pytest.mark.parametrize(
    ("x", "y", "angle"),
    [(0.0, 0.0, 90.0), (0.02, 0.01, 60.0), (0.05, 0.05, 80.0), (0.151, 0.02, 90.0), (0.155, 0.155, 90.0),
     (0.03, 0.004, 0.0), (0.31, 0.005, 0.0), (0.04, 0.0, 0.001)],
)  # fmt: skip
def test_momentum(engine_name: EngineName, x: float, y: float, angle: float) -> None:
    """Free rods that hit each other within elements, at nodes, past ends and side by side."""
    model = crossing(1e-3, x, y, angle, contact=Contact(stiffness=1e4, damping=3.0))
    engine = simulate(engine_name, model, 1e-5)
    start = moved(model, 1, (-0.002 if x > 0.3 else 0.0, 0.0, -0.011), (0.3, -0.2, -1.0))
    assert len(touching(model, start.position))
    engine.restore(start)
    before = momenta(model, start)
    assert engine.advance([], 1).ok
    after = engine.state
    assert np.abs(after.velocity - start.velocity).max() > 1e-3
    assert np.abs(momenta(model, after) - before).max() < 1e-15
    assert engine.advance([], 300).ok
    # The rods' own discrete law keeps angular momentum to the order of the step.
    assert np.abs(momenta(model, engine.state)[0] - before[0]).max() < 1e-14
    assert np.abs(momenta(model, engine.state)[1] - before[1]).max() < 1e-9


def test_engines_agree_in_contact(engine_pair: tuple[EngineName, EngineName]) -> None:
    """To rounding in a step from a squeezed state with contacts, to 1e-9 m over a squeeze."""
    model, dt = worm(Contact(stiffness=200.0), 2.0, n_pairs=3, period_ratio=1.5, elements_per_segment=3)
    engines = [simulate(name, model, dt) for name in engine_pair]
    pull, n_steps = np.full(model.n_muscle, 2.0), round(0.2 / dt)
    for engine in engines:
        assert engine.advance(np.stack([0.0 * pull, pull]), n_steps).ok
    a, b = (engine.state for engine in engines)
    assert len(touching(model, b.position)) > 5
    for field in FIELDS:
        scale = max(1.0, np.abs(getattr(b, field)).max())
        assert np.abs(getattr(a, field) - getattr(b, field)).max() < 1e-9 * scale, field
    for engine in engines:
        engine.restore(b)
        assert engine.advance(pull, 1).ok
    a, b = (engine.state for engine in engines)
    for field in ("position", "velocity", "directors"):
        scale = np.abs(getattr(b, field)).max()
        assert np.abs(getattr(a, field) - getattr(b, field)).max() < 2e-12 * scale, field


def deepest(law: Contact | None) -> float:
    """Largest depth over the reach in a second in which the default worm is compressed by 3 N."""
    model, dt = worm(law, 3.0, max_tension=3.0)
    engine, worst = simulate("fused", model, dt, "symmetric"), 0.0
    pull = np.full(model.n_muscle, 3.0)
    for k in range(20):
        ramp = np.minimum([[k / 4.0], [(k + 1.0) / 4.0]], 1.0) * pull
        assert engine.advance(ramp, round(0.05 / dt)).ok
        position = engine.state.position
        depth = contact.depths(model, position, touching(model, position))
        worst = max(worst, float(depth.max(initial=0.0)))
    return worst / float(2.0 * model.rods[0].radius[0])


def test_a_squeezed_worm_keeps_apart() -> None:
    """Strongly compressed, rods that would go deep into each other keep nineteen twentieths of their radii apart."""
    assert deepest(None) > 0.3
    assert deepest(Contact()) < 0.05


def test_restart_is_exact(engine_name: EngineName) -> None:
    """A state with contacts is all that is needed to go on to the last bit."""
    model = crossing(1e-3, 0.02, 0.01, 60.0)
    first, second = (simulate(engine_name, model, 1e-5) for _ in range(2))
    first.restore(moved(model, 1, (0.0, 0.0, -0.004), (0.3, -0.2, -1.0)))
    assert first.advance([], 200).ok
    second.restore(first.state)
    assert first.advance([], 200).ok
    assert second.advance([], 200).ok
    for field in FIELDS:
        assert np.array_equal(getattr(first.state, field), getattr(second.state, field)), field


def shortening(tension: float, n: int) -> float:
    """By how much the default worm on a mesh of n elements a segment is shorter after half a second [m]."""
    model, dt = worm(Contact(), tension, elements_per_segment=n)
    engine, start = simulate("fused", model, dt, "symmetric"), model.rest_state().position
    pull = np.full(model.n_muscle, tension)
    for k in range(10):
        assert engine.advance(np.minimum([[k / 5.0], [(k + 1.0) / 5.0]], 1.0) * pull, round(0.05 / dt)).ok
    top = np.isclose(start[:, 2], start[:, 2].max())
    return float((start - engine.state.position)[top, 2].mean())


@pytest.mark.parametrize(("tension", "share"), [(1.0, 0.02), (2.0, 0.1)])
def test_how_short_it_gets_hangs_little_on_the_mesh(tension: float, share: float) -> None:
    """At twice a muscle's strength, where crossings are free to close, and at four times, where rods are held apart.

    Where contact acts the mesh shows by where beyond a crossing its first element begins.
    """
    coarse, fine = shortening(tension, 3), shortening(tension, 5)
    assert coarse == pytest.approx(fine, rel=share)


def test_energy_by_hand() -> None:
    """Half the spring of the contact on either element."""
    model = crossing(1e-3)
    stored = EnergyMeter(model).stored(moved(model, 1, (0.0, 0.0, -0.004)))
    half = 0.25 * 1e3 * 0.003**2
    assert stored.parts["contact"] == pytest.approx([0.0, half, 0.0, 0.0, half, 0.0], abs=1e-15)
    assert "contact" not in EnergyMeter(crossing(1e-3, contact=None)).stored(model.rest_state()).parts


def test_the_ledger_balances(engine_name: EngineName) -> None:
    """A damped collision: all that is lost is counted, to the order of the step."""
    model = crossing(1e-3, contact=Contact(stiffness=1e3, damping=2.0))
    left = []
    for dt in (4e-5, 2e-5, 1e-5):
        engine = simulate(engine_name, model, dt, energy_check=True)
        engine.restore(moved(model, 1, 0.0, (0.0, 0.0, -0.2)))
        assert engine.advance([], round(0.01 / dt)).ok
        entry = engine.ledger
        assert entry is not None
        assert entry.dissipated > 1e-4
        left.append(abs(entry.residual) / entry.scale)
    assert left[0] < 3e-3
    assert left[2] < 0.5 * left[0]


def test_side_by_side_no_energy_comes_from_nowhere(engine_name: EngineName) -> None:
    """An undamped collision of parallel rods that tilt as they touch: to the sine at which they count as parallel.

    A depth that jumps by the sine times half an element, over a depth of 1 mm, would show at a sine of 1e-4.
    """
    model, dt = crossing(1e-3, 0.01, 0.002, 0.0), 1e-5
    engine = simulate(engine_name, model, dt, energy_check=True)
    engine.restore(moved(model, 1, 0.0, (0.0, 0.0, -0.2)))
    for _ in range(8):
        assert engine.advance([], round(0.002 / dt)).ok
        entry = engine.ledger
        assert entry is not None
        assert abs(entry.residual) < 3e-4 * entry.scale


def stack(n_rod: int, damping: float) -> tuple[RodModel, RodState]:
    """Soft crossed rods, node on node, held by their ends and pressed together, and their state of balance."""
    depth, stiffness, height = 1e-7, 1e4, 0.1 + 1e-9
    rods, clamps = [], []
    for k in range(n_rod):
        side, place = np.eye(3)[k % 2], np.array([0.0, 0.0, k * height])
        rods.append(straight_rod(place - side, place + side, 2, **SOFT))
        clamps += [Clamp(k, node=0), Clamp(k, node=2)]
    push = 4.0 * stiffness * depth
    forces = PointForce(0, 1, (0.0, 0.0, push)), PointForce(n_rod - 1, 1, (0.0, 0.0, -push))
    law = Contact(stiffness=stiffness, damping=damping)
    model = RodModel(rods=tuple(rods), clamps=tuple(clamps), forces=forces, contact=law)
    state = model.rest_state().copy()
    state.position[1::3, 2] -= (depth + 1e-9) * (np.arange(n_rod) - 0.5 * (n_rod - 1))
    state.velocity[1::3] = 1e-10 * np.random.default_rng(0).standard_normal((n_rod, 3))
    return model, state


@pytest.mark.parametrize("splitting", ["pyelastica", "symmetric"])
@pytest.mark.parametrize("damping", [0.0, 50.0])
def test_never_above_the_measured_limit(damping: float, splitting: Splitting) -> None:
    """Crossed rods stacked node on node are what the critical step reckons with: it holds, and no longer one does."""
    model, state = stack(12, damping)
    limit = critical_dt(model, splitting=splitting) / SAFETY
    for share, holds in ((0.99, True), (1.05, False)):
        engine = simulate("fused", model, share * limit, splitting)
        engine.restore(state)
        health = engine.advance([], 4000)
        assert (health.ok and np.abs(engine.state.velocity).max() < 1e-7) == holds, share


def beside(n_elem: int) -> tuple[RodModel, RodState]:
    """Three soft parallel rods pressed into each other by a tenth of the reach, and their state of balance."""
    length, height, depth = 0.4, 0.1 + 1e-8, contact.MAX_DEPTH * 2.0 * SOFT["radius"]
    rods = tuple(straight_rod((0.0, 0.0, k * height), (length, 0.0, k * height), n_elem, **SOFT) for k in range(3))
    law = Contact(stiffness=1e4, damping=0.0)
    model = RodModel(rods=rods, contact=law)
    state = model.rest_state().copy()
    for rod in (0, 2):
        state.position[model.nodes(rod), 2] += (1 - rod) * depth
    tick = 1e-9
    engine = simulate("fused", model, tick)
    engine.restore(state)
    assert engine.advance([], 1).ok
    push = -engine.state.velocity / tick * model.node_mass[:, None]
    forces = [PointForce(rod, k, tuple(push[model.nodes(rod)][k])) for rod in range(3) for k in range(n_elem + 1)]
    state.velocity[:, 2] = 1e-10 * np.random.default_rng(0).standard_normal(model.n_node)
    return replace(model, forces=tuple(forces)), state


@pytest.mark.parametrize("n_elem", [8, 20, 40])
def test_never_above_what_short_elements_bear(n_elem: int) -> None:
    """Down to elements of a tenth of the reach, each of which touches many of the next rod."""
    model, state = beside(n_elem)
    dt = critical_dt(model) / SAFETY
    engine = simulate("fused", model, dt)
    engine.restore(state)
    # An unstable step makes a disturbance grow by orders of magnitude in this time.
    assert engine.advance([], 24).ok
    assert np.abs(engine.state.velocity[:, 2]).max() < 1e-8


def test_what_it_costs(lattice: Lattice) -> None:
    """The default contact leaves half of the predicted step of the default lattice, whose elements are short."""
    layout = named_layout("compression", lattice)
    plain, with_contact = (
        critical_dt(build_model(lattice, layout, World(contact=law)), 0.5) for law in (None, Contact())
    )
    assert 0.5 < with_contact / plain <= 1.0


def test_the_world_has_it(lattice: Lattice) -> None:
    """None unless asked for; its dict form is JSON."""
    layout = named_layout("extension", lattice)
    assert build_model(lattice, layout).contact is None
    world = World(contact=Contact(stiffness=70.0, damping=0.2))
    assert build_model(lattice, layout, world).contact == world.contact
    assert World.from_dict(json.loads(json.dumps(world.to_dict()))) == world
    assert World.from_dict({"contact": {"stiffness": 70.0}}).contact == replace(Contact(), stiffness=70.0)


ODD: st.SearchStrategy[object] = st.one_of(
    st.floats(max_value=0.0, exclude_max=True), st.sampled_from([np.nan, np.inf, "1", None, True, [], 1j, 1e12])
)


@settings(deadline=None, max_examples=50)
@given(st.sampled_from(["stiffness", "damping"]), ODD)
def test_refused_numbers(name: str, value: Any) -> None:
    """Each is named."""
    with pytest.raises(ValueError, match=rf"Contact\.{name}"):
        Contact(**{name: value})


@settings(deadline=None, max_examples=20)
@given(st.sampled_from([1, "hard", (), True, {"stiffness": 1.0}, World()]))
def test_refused_contacts(value: Any) -> None:
    """What is no contact, in a model and in a world."""
    with pytest.raises(ValueError, match="contact"):
        crossing(1e-3, contact=value)
    if not isinstance(value, dict):
        with pytest.raises(ValueError, match=r"World\.contact"):
            World(contact=value)
    with pytest.raises(ValueError, match="friction"):
        Contact.from_dict({"friction": 0.1})
