"""Which pairs of elements touch: as brute force finds them, in both engines, at a cost that grows with size."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contact_scenes import FIELDS, REACH, ROD, crossing, moved, touching, worm
from hypothesis import given, settings
from hypothesis import strategies as st

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import IntArray
from lattice_gym.engines.fused.engine import FusedEngine
from lattice_gym.engines.fused.kernels import contact as kernel
from lattice_gym.engines.fused.pack import Pack
from lattice_gym.engines.pyelastica.contact import touchable_pairs
from lattice_gym.engines.registry import ENGINES
from lattice_gym.engines.simulation import Simulation, simulate
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws import contact
from lattice_gym.physics.laws.contact import Contact
from lattice_gym.physics.laws.joints import Joint
from lattice_gym.physics.rod import straight_rod
from lattice_gym.physics.worm import build_model

pytestmark = pytest.mark.slow


def test_who_touches() -> None:
    """No rod touches itself, no muscle anything, and never what overlaps at rest, nor what is near and joined."""
    near = crossing(-1e-3)
    assert contact.excluded(near).tolist() == [[1, 4]]
    joined = crossing(1e-3, joints=(Joint(0, 0, 1, 0, 1e-9),))
    assert contact.excluded(joined).tolist() == [[1, 4]]
    for model in (near, joined, crossing(1e-3, muscles=(1,))):
        for name in ENGINES:
            engine = simulate(name, model, 1e-5)
            start = moved(model, 1, (0.0, 0.0, -0.003))
            engine.restore(start)
            assert engine.advance(np.zeros(model.n_muscle), 1).ok
            assert np.abs(engine.state.velocity).max() < 1e-12
    bare = crossing(1e-3, muscles=(0, 1))
    assert simulate("fused", bare, 1e-5).advance([0.0, 0.0], 2).ok
    assert len(contact.overlapping(bare, bare.rest_state().position)) == 0


@pytest.mark.parametrize("n", [2, 3, 4, 5, 8])
def test_rounding_decides_nothing(n: int) -> None:
    """A radius that differs by less than can be made changes nothing in who never touches."""
    never = [
        contact.excluded(worm(Contact(), 0.5, elements_per_segment=n, structure_radius=5e-3 * (1.0 + change))[0])
        for change in (-1e-9, 0.0, 1e-9)
    ]
    assert np.array_equal(never[0], never[1])
    assert np.array_equal(never[2], never[1])


def pack_of(engine: Simulation) -> Pack:
    """Pack of a simulation."""
    assert isinstance(engine.engine, FusedEngine)
    return engine.engine.packs[0]


def engine_of(model: RodModel) -> Simulation:
    """Compiled engine of a model."""
    return simulate("fused", model, 1e-5)


def listed(engine: Simulation) -> tuple[IntArray, kernel.Contact]:
    """Pairs of elements that the compiled code lists as they stand, sorted, and its tables."""
    tables = pack_of(engine).laws.contact
    assert tables is not None
    pairs, count = kernel.list_pairs(pack_of(engine).blocks.cells, tables)
    pairs = contact.touchable(engine.model)[pairs[:count]]
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))], tables


def scattered(rng: np.random.Generator, n_rod: int, size: float, **changes: Any) -> RodModel:
    """Rods of three to five elements anywhere in a cube."""
    rods = []
    for _ in range(n_rod):
        start, side = rng.uniform(0.0, size, 3), rng.normal(size=3)
        end = start + 0.1 * side / np.linalg.norm(side)
        rods.append(straight_rod(start, end, int(rng.integers(3, 6)), **ROD | {"radius": rng.uniform(0.005, 0.01)}))
    return RodModel(rods=tuple(rods), contact=Contact(), **changes)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10**6), st.integers(1, 25), st.sampled_from([0.01, 0.1, 0.3, 1.0]), st.sampled_from([0.0, 1e6]))
def test_list_is_that_of_brute_force(seed: int, n_rod: int, size: float, far: float) -> None:
    """Whatever moves wherever: all pairs within reach and skin that may touch, and no others. Some rods are joined."""
    rng = np.random.default_rng(seed)
    ends = [sorted(rng.choice(n_rod, 2, replace=False).tolist()) for _ in range(n_rod // 2)]
    joints = [Joint(a, 0, b, 1, 1.0) for a, b in ends]
    muscles = tuple(range(int(rng.integers(0, n_rod + 1))))
    model = scattered(rng, n_rod, size, muscles=muscles, joints=tuple(joints))
    engine, rod = engine_of(model), model.element_rod
    solid = ~np.isin(rod, model.muscles)
    every = np.argwhere(solid[:, None] & solid & (rod[:, None] < rod))
    rest, now = model.rest_state(), model.rest_state().copy()
    now.position[:] += rng.normal(0.0, 0.02, now.position.shape) + far
    engine.restore(now)
    margin = np.array([contact.MARGIN * ([rod[i], rod[j]] in ends) for i, j in every])
    at_rest = contact.depths(model, rest.position, every) > -margin * model.element_radius[every].sum(axis=1)
    assert np.array_equal(contact.excluded(model), every[at_rest])
    assert np.array_equal(
        contact.overlapping(model, now.position), every[contact.depths(model, now.position, every) > 0]
    )
    found, tables = listed(engine)
    near = contact.depths(model, now.position, every) > -tables.skin
    assert np.array_equal(found, every[near & ~at_rest])


def assert_engines_select_alike(model: RodModel) -> int:
    """Compare the pairs that the reference engine tries with those that the law leaves; return how many it excludes."""
    rod, excluded = model.element_rod, contact.excluded(model)
    solid = ~np.isin(rod, model.muscles)
    every = np.argwhere(solid[:, None] & solid & (rod[:, None] < rod))
    left = every[~np.isin(every @ [model.n_elem, 1], excluded @ [model.n_elem, 1])]
    assert np.array_equal(touchable_pairs(model), left)
    return len(excluded)


@pytest.mark.parametrize(
    "design",
    [
        {},
        {"n_pairs": 3, "elements_per_segment": 3},
        {"n_pairs": 2, "period_ratio": 2.0, "elements_per_segment": 1, "structure_radius": 4e-3},
        {"n_pairs": 8, "period_ratio": 1.6, "elements_per_segment": 7, "diameter": 0.05},
    ],
)
def test_engines_select_the_same_pairs(design: dict[str, Any]) -> None:
    """The reference engine finds by itself which elements of a lattice may touch, and leaves out the same."""
    lattice = build_lattice(LatticeDesign(**design))
    assert assert_engines_select_alike(build_model(lattice, named_layout("all", lattice))) > 0


@pytest.mark.parametrize("seed", range(5))
def test_engines_select_the_same_pairs_of_odd_rods(seed: int) -> None:
    """Joined and not, parallel, in one line, and through each other."""
    rng = np.random.default_rng(seed)
    model = scattered(rng, 12, 0.1, joints=tuple(Joint(k, 0, k + 1, 1, 1.0) for k in range(0, 10, 2)))
    along = [straight_rod((0, 0, z), (0.1, 0, z), 3, **ROD) for z in (0.0, 2.0 * REACH, REACH, 1.5 * REACH)]
    in_line = straight_rod((0.1 + 1.3 * REACH, 0, 0), (0.3, 0, 0), 4, **ROD)
    joints = (*model.joints, Joint(12, 1, 13, 1, 1.0), Joint(12, 3, 16, 0, 1.0))
    assert assert_engines_select_alike(replace(model, rods=(*model.rods, *along, in_line), joints=joints)) > 0


WHOLE = st.lists(st.integers(-3, 3), min_size=12, max_size=12)


@settings(deadline=None, max_examples=300)
@given(WHOLE, st.sampled_from([0.0, 1e-7, 1e-5, 0.3]), st.integers(0, 1000))
def test_nearest_points(whole: list[int], noise: float, seed: int) -> None:
    """Compiled code and numpy by two ways; no sample of the segments is nearer. Parallel ones are among them."""
    rng = np.random.default_rng(seed)
    ends = np.array(whole, float).reshape(2, 2, 3) + noise * rng.uniform(-1.0, 1.0, (2, 2, 3))
    ends[:, 1] += 10.0 * (ends[:, 1] == ends[:, 0]).all(axis=1)[:, None]
    (a, p), (b, q) = ends
    s, t = (float(share[0]) for share in contact.nearest(a[None], (p - a)[None], b[None], (q - b)[None]))
    distance = np.linalg.norm(a + s * (p - a) - b - t * (q - b))
    s2, t2, *gap, square = kernel.nearest(ends, 0, 1)
    assert np.linalg.norm(a + s2 * (p - a) - b - t2 * (q - b) - gap) < 1e-12
    lengths = float(np.linalg.norm(p - a) + np.linalg.norm(q - b))
    sine = np.linalg.norm(np.cross(p - a, q - b)) / (np.linalg.norm(p - a) * np.linalg.norm(q - b))
    # Segments that count as parallel, or do for one of both, are nearest in their middle, to their slant.
    slack = 1e-6 * lengths if sine < 2e-6 else 1e-9 * lengths
    assert np.sqrt(square) == pytest.approx(distance, abs=1e-7 + slack)
    if sine == 0.0 or sine > 1e-4:
        assert (s2, t2) == pytest.approx((s, t), abs=1e-6)
    grid = np.linspace(0.0, 1.0, 21)
    first, second = a + grid[:, None] * (p - a), b + grid[:, None] * (q - b)
    assert distance <= np.linalg.norm(first[:, None] - second, axis=2).min() + slack


def test_cost_grows_with_size() -> None:
    """At one density eight times the rods make about eight times the pairs that are tried, and that are listed."""
    tried, kept = [], []
    for n_rod in (100, 800):
        engine = engine_of(scattered(np.random.default_rng(0), n_rod, 0.05 * n_rod ** (1.0 / 3.0)))
        pairs, tables = listed(engine)
        apart = np.abs(tables.grid[:, None] - tables.grid).max(axis=2)
        tried.append(np.count_nonzero(apart <= 1))
        kept.append(len(pairs))
    # Rods at the surface have fewer neighbours: a share that falls as the size grows.
    assert 8.0 <= tried[1] / tried[0] < 14.0
    assert 8.0 <= kept[1] / kept[0] < 14.0


def crowd(tables: kernel.Contact) -> int:
    """Elements in one list of the grid's table, at most."""
    most = 0
    for element in tables.head.tolist():
        size = 0
        while element >= 0:
            size, element = size + 1, int(tables.next_in_bucket[element])
        most = max(most, size)
    return most


@pytest.mark.parametrize("where", [1e4, 1e300, np.inf, np.nan])
@pytest.mark.parametrize("n_gone", [1, 200])
def test_a_diverging_run_costs_no_more(where: float, n_gone: int) -> None:
    """Nodes that have gone anywhere neither make cells larger nor crowd one; restored, the engine is as it was."""
    engine = engine_of(scattered(np.random.default_rng(0), 100, 1.0))
    start = engine.state
    sound, tables = listed(engine)
    before = crowd(tables)
    gone = start.copy()
    gone.position[:n_gone] += where
    pack_of(engine).restore(0, gone)
    assert len(listed(engine)[0]) <= len(sound)
    assert crowd(tables) <= 2 * before
    engine.restore(start)
    assert engine.advance([], 1).ok
    assert len(sound) == tables.n_listed[0]


@pytest.mark.parametrize("room", [1, 1000])
def test_when_the_list_was_made_does_not_show(room: int) -> None:
    """An engine that goes on with its list and one that makes it anew, also where a list outgrows its room."""
    model = scattered(np.random.default_rng(0), 60, 0.15)
    first, second = engine_of(model), engine_of(model)
    for engine in (first, second):
        tables = pack_of(engine).laws.contact
        assert tables is not None
        tables = tables._replace(pairs=np.zeros((room, 2), np.int64))
        pack_of(engine).laws = pack_of(engine).laws._replace(contact=tables)
    start = model.rest_state().copy()
    start.velocity[:] = np.random.default_rng(1).normal(0.0, 0.3, start.velocity.shape)
    first.restore(start)
    pressed = 0
    for _ in range(30):
        second.restore(first.state)
        for engine in (first, second):
            assert engine.advance([], 7).ok
        pressed += len(touching(model, first.state.position))
        for field in FIELDS:
            assert np.array_equal(getattr(first.state, field), getattr(second.state, field)), field
    assert pressed > 0


def test_overlaps_are_found_in_little_memory() -> None:
    """What is tried at a time has a bound: all pairs of these 3200 elements that are near along one axis have none."""
    model = scattered(np.random.default_rng(0), 800, 0.3)
    tracemalloc.start()
    contact.overlapping(model, model.rest_state().position)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 400 * contact._AT_A_TIME
