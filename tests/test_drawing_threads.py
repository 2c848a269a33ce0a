"""Pictures are right from any thread, and in a fork of a process that has drawn there is an error, not a wait."""

from __future__ import annotations

import gc
import multiprocessing
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import named_layout
from lattice_gym.checks import FloatArray
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.worm import build_model
from lattice_gym.rendering import drawing_thread
from lattice_gym.rendering.drawing_thread import Drawn
from lattice_gym.rendering.figures import Still, render_strip
from lattice_gym.rendering.scene import Renderer

Result = TypeVar("Result")
Picture = npt.NDArray[np.uint8]
SIZE = (160, 120)
SHAPES = ((1.0, 1.0, 1.0), (0.8, 0.8, 1.5), (1.1, 1.1, 0.7))
WAIT = 60.0
"""Longest that a child or a thread is waited for [s]."""


@pytest.fixture(scope="module")
def lattice() -> Lattice:
    """Return the default worm, coarse."""
    return build_lattice(LatticeDesign(elements_per_segment=2))


@pytest.fixture(scope="module")
def model(lattice: Lattice) -> RodModel:
    """Return its model with ring muscles."""
    return build_model(lattice, named_layout("extension", lattice))


@pytest.fixture
def draw(lattice: Lattice, model: RodModel) -> Iterator[Callable[[int], Picture]]:
    """Return what draws one of the shapes, in one scene."""
    with Renderer(lattice, model, SIZE) as renderer:
        yield partial(draw_shape, renderer, model.rest_state().position)


@pytest.fixture(scope="module")
def expected(lattice: Lattice, model: RodModel) -> list[Picture]:
    """Return pictures of all shapes, drawn by this thread alone."""
    with Renderer(lattice, model, SIZE) as renderer:
        return [draw_shape(renderer, model.rest_state().position, k) for k in range(len(SHAPES))]


def draw_shape(renderer: Renderer, rest: FloatArray, k: int) -> Picture:
    """Picture of a shape."""
    return renderer.update(rest * SHAPES[k], text=f"shape {k}")


def in_thread(function: Callable[[], Result]) -> Result:
    """Return what a function does, called in a thread of its own."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(function).result(WAIT)


def drawing_threads() -> list[threading.Thread]:
    """Threads that draw."""
    return [thread for thread in threading.enumerate() if thread.name == "drawing"]


def nothing_draws() -> bool:
    """Whether the thread ends, as it does once the last scene is freed."""
    gc.collect()
    for thread in drawing_threads():
        thread.join(WAIT)
    return drawing_threads() == []


@pytest.mark.slow
def test_any_thread_draws(draw: Callable[[int], Picture], expected: list[Picture]) -> None:
    """The thread that drew first, another, the first again, and four at once."""
    pictures = [draw(0), in_thread(partial(draw, 1)), draw(2)]
    for picture, right in zip(pictures, expected, strict=True):
        np.testing.assert_array_equal(picture, right)
    start = threading.Barrier(4)

    def all_at_once(k: int) -> Picture:
        start.wait(WAIT)
        return draw(k % len(SHAPES))

    with ThreadPoolExecutor(4) as pool:
        for k, picture in enumerate(pool.map(all_at_once, range(8))):
            np.testing.assert_array_equal(picture, expected[k % len(SHAPES)])


@pytest.mark.slow
def test_scenes_of_several_threads(lattice: Lattice, model: RodModel, expected: list[Picture]) -> None:
    """Made in three threads at once, used in two others and here."""
    rest, start = model.rest_state().position, threading.Barrier(3)

    def make(k: int) -> Renderer:
        start.wait(WAIT)
        return Renderer(lattice, model, SIZE)

    def draw_all() -> list[Picture]:
        return [draw_shape(renderer, rest, k) for k, renderer in enumerate(renderers)]

    with ThreadPoolExecutor(3) as pool:
        renderers = list(pool.map(make, range(3)))
    for pictures in (in_thread(draw_all), in_thread(draw_all), draw_all()):
        np.testing.assert_array_equal(pictures, expected)
    for renderer in renderers:
        renderer.close()
    assert nothing_draws()


@pytest.mark.slow
def test_environments_draw_from_any_thread() -> None:
    """One worm and a batch; closed by another thread they draw again, in a scene made anew."""
    one = gymnasium.make("lattice_gym:LatticeWorm-v0", render_mode="rgb_array", fidelity="fast")
    many = gymnasium.make_vec("lattice_gym:LatticeWorm-v0", 2, render_mode="rgb_array", fidelity="fast")
    one.reset(seed=0)
    many.reset(seed=0)
    first = one.render()
    pictures = in_thread(many.render)
    assert pictures is not None
    for picture in (*pictures[:1], in_thread(one.render), many.render()[0]):  # type: ignore[index]
        np.testing.assert_array_equal(picture, first)
    for env in (one, many):
        in_thread(env.close)
    assert nothing_draws()
    np.testing.assert_array_equal(one.render(), first)
    one.close()


@pytest.mark.slow
def test_figures_are_drawn_by_several_threads(lattice: Lattice, model: RodModel, tmp_path: Path) -> None:
    """Strips with titles and scales, in two threads at once, are the same files."""
    still = Still(lattice=lattice, model=model, position=model.rest_state().position, title="rest")
    names = [tmp_path / f"{k}.png" for k in range(2)]
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda path: render_strip([still], path, (80, 100), 100), names))
    assert len({path.read_bytes() for path in names}) == 1


@pytest.mark.slow
def test_what_is_dropped_is_freed(lattice: Lattice, model: RodModel, expected: list[Picture]) -> None:
    """Without close(), in whatever thread the last reference goes; others go on."""
    plotters = pytest.importorskip("pyvista.plotting.plotter")._ALL_PLOTTERS
    before = len(plotters)
    with Renderer(lattice, model, SIZE) as stays:
        dropped = [Renderer(lattice, model, SIZE)]
        in_thread(dropped.clear)
        np.testing.assert_array_equal(draw_shape(stays, model.rest_state().position, 1), expected[1])
        assert len(plotters) == before + 1
    assert len(plotters) == before


@pytest.mark.slow
def test_closed_renderer_says_so(lattice: Lattice, model: RodModel) -> None:
    """In place of what the graphics library would say; a second close does nothing."""
    renderer = Renderer(lattice, model, SIZE)
    renderer.close()
    renderer.close()
    with pytest.raises(RuntimeError, match=r"^renderer: it is closed"):
        renderer.update(model.rest_state().position)
    with Renderer(lattice, model, SIZE), pytest.raises(RuntimeError, match=r"^renderer: it is closed"):
        renderer.update(model.rest_state().position)


# The thread, without graphics


class Trace:
    """A scene that notes who made, used and freed it."""

    alive: list[weakref.ref[Trace]] = []  # noqa: RUF012, cleared by each test

    def __init__(self, broken: bool = False) -> None:
        self.threads = [threading.current_thread()]
        self.closed = threading.Event()
        if broken:
            raise ValueError("broken")

    def use(self) -> threading.Thread:
        """Note who uses it."""
        self.threads.append(threading.current_thread())
        return self.threads[-1]

    def close(self) -> None:
        """Note who frees it."""
        self.threads.append(threading.current_thread())
        self.closed.set()


def test_one_thread_does_it_all_and_ends() -> None:
    """Made, used and freed there; it lives as long as there is a scene."""
    assert nothing_draws()
    scene = Drawn(Trace)
    (drawing,) = drawing_threads()
    trace = scene.use(lambda trace: trace)
    assert in_thread(lambda: scene.use(Trace.use)) is drawing
    with pytest.raises(ZeroDivisionError):
        scene.use(lambda trace: 1 / 0)
    other = Drawn(Trace)
    scene.close()
    assert trace.closed.is_set()
    assert other.use(Trace.use) is drawing
    other.close()
    assert set(trace.threads) == {drawing}
    assert nothing_draws()


def test_scene_that_cannot_be_made_leaves_nothing() -> None:
    """Its error comes out, and the thread ends."""
    with pytest.raises(ValueError, match="broken"):
        Drawn(lambda: Trace(broken=True))
    assert nothing_draws()


def test_scenes_are_freed_where_they_are_collected() -> None:
    """In the drawing thread itself, or where a task is being given, nothing waits for ever."""

    class Owner:
        """Closes its scene when it is collected, as gymnasium's vector environments do."""

        def __init__(self) -> None:
            self.me, self.scene = self, Drawn(Trace)

        def __del__(self) -> None:
            self.scene.close()

    stays = Drawn(Trace)
    freed = []
    for collect in (lambda: stays.use(lambda _: gc.collect()), within_lock(gc.collect)):
        owner = Owner()
        freed.append(owner.scene.use(lambda trace: trace.closed))
        del owner
        in_thread(collect)
    stays.close()
    assert all(event.is_set() for event in freed)
    assert nothing_draws()


def within_lock(function: Callable[[], object]) -> Callable[[], None]:
    """Call a function where a task is being given."""

    def call() -> None:
        with drawing_thread._DRAWING.lock:
            function()

    return call


def test_an_interrupt_waits_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Interrupted while a scene is made or used, the next call is right, and what was being made is freed."""
    go_on, made = threading.Event(), []

    def slow() -> Trace:
        go_on.wait(WAIT)
        made.append(Trace())
        return made[0]

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Future, "result", interrupt)
        with pytest.raises(KeyboardInterrupt):
            Drawn(slow)
    scene_made = threading.Thread(target=lambda: Drawn(Trace).use(Trace.use))
    scene_made.start()
    go_on.set()
    scene_made.join(WAIT)
    assert made[0].closed.wait(WAIT)
    assert nothing_draws()


# Other processes


def draw_in_child(env: gymnasium.Env[Any, Any], mine: bool, sent: Connection) -> None:
    """Draw a worm of the parent, or one of this process, and send the error."""
    try:
        if not mine:
            env = gymnasium.make("lattice_gym:LatticeWorm-v0", render_mode="rgb_array", fidelity="fast")
            env.reset(seed=0)
        sent.send(env.render())
    except RuntimeError as error:
        env.close()  # which leaves alone what is the parent's
        sent.send(str(error))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="forks are for Linux")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")
@pytest.mark.parametrize("mine", [True, False])
@pytest.mark.parametrize("closed", [True, False])
def test_fork_of_what_has_drawn_says_so(mine: bool, closed: bool) -> None:
    """The parent's worm or the child's own, and even where the parent's was closed before; the parent goes on."""
    env = gymnasium.make("lattice_gym:LatticeWorm-v0", render_mode="rgb_array", fidelity="fast")
    env.reset(seed=0)
    before = env.render()
    if closed:
        env.close()
    received, sent = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(target=draw_in_child, args=(env, mine, sent))
    child.start()
    try:
        assert received.poll(WAIT), "the child waits for ever"
        assert 'get_context("spawn")' in received.recv()
        child.join(WAIT)
        assert child.exitcode == 0
    finally:
        child.kill()
    np.testing.assert_array_equal(env.render(), before)
    env.close()


FORK_FIRST = """
import multiprocessing
import threading
import gymnasium
import pyvista

env = gymnasium.make_vec("lattice_gym:LatticeWorm-v0", 1, render_mode="rgb_array", fidelity="fast")
env.reset(seed=0)
received, sent = multiprocessing.Pipe()
child = multiprocessing.get_context("fork").Process(target=lambda: sent.send(env.render()[0]))
child.start()
assert received.poll(60.0)
picture = received.recv()
child.join()
drawn = []
thread = threading.Thread(target=lambda: drawn.extend(env.render()))
thread.start()
thread.join()
env.cycle = env
print((drawn[0] == picture).all(), picture.std() > 5)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="forks are for Linux")
def test_fork_before_the_first_picture_and_an_end_without_close() -> None:
    """The child draws, the parent draws in a thread that ends, and Python ends with all of it open."""
    ran = subprocess.run([sys.executable, "-c", FORK_FIRST], capture_output=True, text=True, timeout=120, check=False)
    assert (ran.returncode, ran.stdout.strip(), ran.stderr) == (0, "True True", "")
