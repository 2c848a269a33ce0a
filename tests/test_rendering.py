"""Pictures show what they are given, whole and in scale; videos keep time; nothing half-written is left behind."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from matplotlib.image import imread
from pictured import SIZE, STRETCH, green, imageio_ffmpeg, rest_of

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import MuscleLayout, named_layout, tie
from lattice_gym.checks import FloatArray
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.rod import straight_rod
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model
from lattice_gym.recording.trajectory import Recorder, Trajectory
from lattice_gym.rendering import scene, shapes
from lattice_gym.rendering.colours import activation_colour
from lattice_gym.rendering.figures import Still, plot_activation, render_still, render_strip, round_length
from lattice_gym.rendering.scene import Renderer, render_frame
from lattice_gym.rendering.video import render_video

pytestmark = pytest.mark.slow


def drawn(picture: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """Where a picture is not white."""
    return np.asarray(np.any(picture < 250, axis=2))


def crimson(picture: npt.NDArray[np.uint8]) -> int:
    """How many pixels show muscles that are on."""
    red, green, blue = picture.astype(int).transpose(2, 0, 1)
    return int(np.sum((red > green + 60) & (blue > green + 10)))


def test_picture_shows_positions_activations_time_and_text(coarse_lattice: Lattice, coarse_model: RodModel) -> None:
    """Each argument of update changes the picture where it should."""
    rest = rest_of(coarse_model)
    with Renderer(coarse_lattice, coarse_model, (320, 240)) as renderer:
        plain = renderer.update(rest)
        on = renderer.update(rest, np.ones(coarse_model.n_muscle))
        tall = renderer.update(rest * STRETCH)
        told = renderer.update(rest, time=1.25, text="strain")
    assert plain.shape == (240, 320, 3)
    assert plain.dtype == np.uint8
    # All but the colour bar shows no activation at first.
    assert crimson(on) > crimson(plain) + 1000
    assert (
        np.flatnonzero(drawn(tall[40:, :260]).any(axis=1))[0] < np.flatnonzero(drawn(plain[40:, :260]).any(axis=1))[0]
    )
    changed = np.argwhere(np.any(told != plain, axis=2))
    assert len(changed) > 100
    assert changed.max(axis=0)[0] < 0.15 * 240


def test_long_line_stays_in_the_picture(coarse_lattice: Lattice, coarse_model: RodModel) -> None:
    """It goes on in the next one."""
    rest = rest_of(coarse_model)
    with Renderer(coarse_lattice, coarse_model, (320, 240)) as renderer:
        plain = renderer.update(rest)
        changed = np.any(renderer.update(rest, text="travelling wave index 0.95 " * 5) != plain, axis=2)
    rows, columns = np.nonzero(changed)
    assert np.ptp(rows) > 12
    assert 5 < columns.min() < 15
    assert 220 < columns.max() < 318


def test_a_line_ends_before_a_bracket_rather_than_in_it() -> None:
    """What was asked stands on a line of its own, where all does not fit on one; a bracket too long is broken."""
    told, asked = "return -96.93   wave index 0.87, up at 0.108 m/s, amplitude 3.3 %", "(asked: up at 0.096 m/s, 5.6 %)"
    assert scene.in_lines(f"{told} {asked}", 78) == f"{told}\n{asked}"
    assert scene.in_lines(f"{told} {asked}   [0.5 x real time]", 78) == f"{told}\n{asked}   [0.5 x real time]"
    assert scene.in_lines(f"strain 3 % {asked}", 78) == f"strain 3 % {asked}"
    assert max(len(line) for line in scene.in_lines(f"{told} {asked}", 20).splitlines()) <= 20
    assert scene.in_lines("", 20) == ""


def test_each_muscle_has_its_own_colour(coarse_lattice: Lattice, coarse_model: RodModel) -> None:
    """A muscle at the back is paler but shown; the order is that of the model's muscles."""
    rest = rest_of(coarse_model)
    sites = [
        coarse_lattice.site_position[[m.start, m.end]].mean(axis=0) for m in named_layout("all", coarse_lattice).active
    ]
    high = np.array([place[2] for place in sites]) > 0.06
    with Renderer(coarse_lattice, coarse_model, (320, 240), view=rest, bare=True) as renderer:
        top, bottom = (renderer.update(rest, mask.astype(float)) for mask in (high, ~high))
    assert crimson(top[:110]) > 5 * crimson(top[130:])
    assert crimson(bottom[130:]) > 5 * crimson(bottom[:110])


def test_muscles_as_lines_look_like_rods(coarse_lattice: Lattice, coarse_model: RodModel) -> None:
    """At rest the pictures are the same to the last bit, colours included; lines follow their ends, and are filmed."""
    design = replace(coarse_lattice.design, muscle_model="line")
    layout = named_layout("all", coarse_lattice)
    lines = build_model(build_lattice(design), layout)
    assert lines.n_node < coarse_model.n_node
    on = np.linspace(0.0, 1.0, coarse_model.n_muscle)
    with (
        Renderer(coarse_lattice, coarse_model, (320, 240)) as rods,
        Renderer(coarse_lattice, lines, (320, 240)) as renderer,
    ):
        rest = renderer.update(rest_of(lines), on, 0.5, "a")
        np.testing.assert_array_equal(rest, rods.update(rest_of(coarse_model), on, 0.5, "a"))
        tall = renderer.update(rest_of(lines) * STRETCH, on, 0.5, "a")
        np.testing.assert_array_equal(tall, rods.update(rest_of(coarse_model) * STRETCH, on, 0.5, "a"))
    assert np.any(rest != tall)
    recorder = Recorder(design, layout, "extension")
    recorder.append(0.0, rest_of(lines), on)
    assert recorder.build().n_frame == 1


def test_picture_depends_on_nothing_shown_before(coarse_lattice: Lattice, coarse_model: RodModel) -> None:
    """A scene that was moved and moved back looks as before, and as one freshly built."""
    rest, half = rest_of(coarse_model), np.full(coarse_model.n_muscle, 0.5)
    with Renderer(coarse_lattice, coarse_model, SIZE) as renderer:
        first = renderer.update(rest, half, 0.5, "a")
        renderer.update(rest[:, [2, 0, 1]] * 3.0, np.ones(coarse_model.n_muscle), 9.0, "b")
        again = renderer.update(rest, half, 0.5, "a")
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(first, render_frame(coarse_lattice, coarse_model, rest, half, 0.5, "a", SIZE))


@pytest.mark.parametrize("size", [(160, 120), (200, 96), (96, 200)])
def test_whole_worm_is_in_the_picture_and_fills_it(
    coarse_lattice: Lattice, coarse_model: RodModel, size: tuple[int, int]
) -> None:
    """The points to keep in view come close to an edge of the stage but cross none."""
    shape = rest_of(coarse_model) * STRETCH
    for view in (None, shape):
        with Renderer(coarse_lattice, coarse_model, size, view=view, bare=True) as renderer:
            rows, columns = np.nonzero(drawn(renderer.update(shape)))
        low = np.array([rows.min() / size[1], columns.min() / size[0]])
        high = np.array([rows.max() / size[1], columns.max() / size[0]])
        assert low.min() > 0.0
        assert high.max() < 0.995
        assert max(high - low) > 0.85


def test_scale_is_that_of_the_picture(coarse_lattice: Lattice, coarse_model: RodModel) -> None:
    """The base plate measures its diameter times the stated scale."""
    with Renderer(coarse_lattice, coarse_model, (400, 400), view=rest_of(coarse_model), bare=True) as renderer:
        _, columns = np.nonzero(drawn(renderer.update(rest_of(coarse_model))))
        diameter = 2 * scene.PLATE_RADIUS * coarse_lattice.design.diameter
        assert np.ptp(columns) == pytest.approx(diameter * renderer.pixels_per_metre, rel=0.03)


def test_colour_bar_is_the_muscles_scale(coarse_lattice: Lattice, coarse_model: RodModel) -> None:
    """It runs from the colour of 1 at the top to that of 0; without muscles there is none."""
    left, right, bottom, top = scene.BAR
    picture = render_frame(coarse_lattice, coarse_model, rest_of(coarse_model), size=(320, 240))
    bar = picture[round((1 - top) * 240) : round((1 - bottom) * 240), round((left + right) / 2 * 320)]
    np.testing.assert_allclose(bar[[0, -1]], activation_colour([1.0, 0.0]), atol=0.51)
    assert np.all(np.diff(bar.astype(int).sum(axis=1)) >= 0)
    bald = build_model(coarse_lattice, MuscleLayout())
    assert np.all(render_frame(coarse_lattice, bald, rest_of(bald), size=(320, 240))[:, 280:] == 255)


def test_free_worm_has_no_plate() -> None:
    """Only a clamped worm stands on a base."""
    counts = []
    for base in ("clamped", "free"):
        lattice = build_lattice(LatticeDesign(elements_per_segment=1, base=base))
        model = build_model(lattice, MuscleLayout())
        with Renderer(lattice, model, SIZE, view=rest_of(model), bare=True) as renderer:
            rows, columns = np.nonzero(drawn(renderer.update(rest_of(model))))
        counts.append(np.ptp(columns[rows > 90]) / np.ptp(columns[rows < 60]))
    assert counts[0] > 1.2 > counts[1]


def test_ball_is_where_it_is_said_to_be(coarse_lattice: Lattice, coarse_model: RodModel) -> None:
    """By default where it starts; nowhere without one, and then a place for it is refused."""
    ball = build_model(coarse_lattice, named_layout("all", coarse_lattice), World(ball=Ball(level=2.0)))
    x, start = rest_of(coarse_model), ball.rest_state().ball_position
    blue = []
    for centre in (None, start, start + np.array([0.0, 0.0, 0.04])):
        picture = render_frame(coarse_lattice, ball, x, size=SIZE, ball=centre).astype(int)
        blue.append(picture[..., 2] - picture[..., 0] > 25)
    assert blue[0].any()
    assert np.array_equal(blue[0], blue[1])
    rows = [np.flatnonzero(mask.any(axis=1)).mean() for mask in blue]
    assert rows[2] < rows[0] - 5.0
    for wrong, centre in ((coarse_model, start), (ball, start[0]), (ball, np.full((1, 3), np.nan))):
        with pytest.raises(ValueError, match="ball"):
            render_frame(coarse_lattice, wrong, x, size=SIZE, ball=centre)


def test_nothing_hides_a_ball(coarse_lattice: Lattice) -> None:
    """It shines through the rods, and where it comes out at the base there is a hole in the plate."""
    world = World(ball=Ball(radius=0.03, level=2.0))
    ball = build_model(coarse_lattice, named_layout("all", coarse_lattice), world)
    x = rest_of(ball)
    with Renderer(coarse_lattice, ball, (320, 240)) as renderer:
        for height in (0.05, -0.01):
            pictures = [renderer.update(x, ball=[[0.0, 0.0, z]]).astype(int) for z in (height, 1e3)]
            changed = (np.abs(pictures[0] - pictures[1]).sum(axis=2) > 20).sum()
            disc = np.pi * (0.03 * renderer.pixels_per_metre) ** 2
            assert changed == pytest.approx(disc, rel=0.1)


def test_markers_are_where_they_are_asked_for(coarse_lattice: Lattice, coarse_model: RodModel) -> None:
    """And nothing hides them; none without any, and as many as were announced."""
    x = rest_of(coarse_model)
    seen = []
    with Renderer(coarse_lattice, coarse_model, (320, 240), n_marker=2) as renderer:
        for height in (0.03, 0.08):
            picture = renderer.update(x, markers=[[0.0, 0.0, height]] * 2)
            seen.append(green(picture))
        with pytest.raises(ValueError, match=r"^markers has shape \(1, 3\): must have \(2, 3\)"):
            renderer.update(x, markers=[[0.0, 0.0, 0.1]])
    low, high = (np.argwhere(mask) for mask in seen)
    assert len(low) == pytest.approx(len(high), rel=0.2)
    assert low.mean(axis=0)[0] - high.mean(axis=0)[0] > 20.0
    assert abs(low.mean(axis=0)[1] - high.mean(axis=0)[1]) < 1.0
    assert not green(render_frame(coarse_lattice, coarse_model, x, size=SIZE)).any()
    assert green(render_frame(coarse_lattice, coarse_model, x, size=SIZE, markers=[[0.0, 0.0, 0.1]])).any()
    for wrong in (1.0, [0.0, 0.0, 0.1], [[0.0, 0.1]]):
        with pytest.raises(ValueError, match=r"^markers has shape"):
            render_frame(coarse_lattice, coarse_model, x, size=SIZE, markers=wrong)


def test_the_top_is_shown_where_markers_are(coarse_lattice: Lattice, coarse_model: RodModel) -> None:
    """Its centre, which is to go there, moves with the body, and shows on the marker that it has reached."""
    seen = []
    with Renderer(coarse_lattice, coarse_model, (320, 240), n_marker=1) as renderer:
        for rise in (0.0, 0.04):
            moved = rest_of(coarse_model) + np.array([0.0, 0.0, rise])
            picture = renderer.update(moved, markers=[[0.0, 0.0, 0.1]]).astype(int)
            seen.append(np.argwhere(picture[:, :250].max(axis=2)[60:] < 60))
            middle = np.argwhere(green(picture.astype(np.uint8))).mean(axis=0) - [60.0, 0.0]
            assert (np.abs(seen[-1].mean(axis=0) - middle) < 2.0).all() == (rise == 0.0)
    assert seen[0].mean(axis=0)[0] - seen[1].mean(axis=0)[0] > 20.0


def test_wrong_arguments_are_refused(coarse_lattice: Lattice, coarse_model: RodModel) -> None:
    """Each names itself."""
    rest = rest_of(coarse_model)
    sizes: list[Any] = [(0, 120), (160.5, 120), (160, 120, 3), (160, 5000)]
    for size in sizes:
        with pytest.raises(ValueError, match="size"):
            Renderer(coarse_lattice, coarse_model, size)
    for view in (np.zeros((0, 3)), np.zeros(3), np.full((2, 3), np.nan)):
        with pytest.raises(ValueError, match="view"):
            Renderer(coarse_lattice, coarse_model, SIZE, view=view)
    with Renderer(coarse_lattice, coarse_model, SIZE) as renderer:
        with pytest.raises(ValueError, match="position has shape"):
            renderer.update(rest[1:])
        with pytest.raises(ValueError, match=r"^position\[.* = nan: must be a finite number"):
            renderer.update(np.where(rest > 0.05, np.nan, rest))
        with pytest.raises(ValueError, match="activation has shape"):
            renderer.update(rest, np.zeros(3))
        with pytest.raises(ValueError, match=r"^activation\[\d+\] = 1\..*: must be a number from"):
            renderer.update(rest, np.linspace(0.0, 1.5, coarse_model.n_muscle))


@given(n_node=st.integers(3, 12), samples=st.integers(1, 6), data=st.data())
@settings(max_examples=50, deadline=None)
def test_spline_passes_through_nodes_and_keeps_lines(n_node: int, samples: int, data: st.DataObject) -> None:
    """Weights sum to 1, nodes are met, and equal steps along a line stay so."""
    matrix = shapes.catmull_rom(n_node, samples)
    node = data.draw(hnp.arrays(np.float64, (n_node, 3), elements=st.floats(-1, 1)))
    np.testing.assert_allclose((matrix @ node)[::samples], node, atol=1e-12)
    np.testing.assert_allclose(matrix @ np.arange(n_node), np.arange(len(matrix)) / samples, atol=1e-12)


def rod_model(n_elem: int = 4) -> RodModel:
    """Two parallel rods of 0.1 m along x, radius 4 mm."""
    material = {"radius": 4e-3, "density": 1e3, "youngs_modulus": 1e5, "shear_modulus": 4e4}
    return RodModel(rods=tuple(straight_rod([0, y, 0], [0.1, y, 0], n_elem, **material) for y in (0.0, 0.05)))


@pytest.mark.parametrize("stretch", [1.0, 1.44, 0.64])
def test_tube_keeps_radius_volume_and_round_ends(stretch: float) -> None:
    """A straight rod is a cylinder of the scaled radius, r sqrt(1/stretch), with caps one radius long."""
    model = rod_model()
    tubes = shapes.Tubes(model, [0, 1], 0.5, 8, 0.0)
    tubes.update(rest_of(model) * [stretch, 1.0, 1.0])
    point = np.asarray(tubes.mesh.points, dtype=np.float64).reshape(2, -1, 3)
    normal = np.asarray(tubes.mesh.point_data["normal"])
    radius = 2e-3 / np.sqrt(stretch)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-6)
    for y, cloud in zip((0.0, 0.05), point, strict=True):
        body = cloud[(cloud[:, 0] > -1e-9) & (cloud[:, 0] < 0.1 * stretch + 1e-9)]
        np.testing.assert_allclose(np.hypot(body[:, 1] - y, body[:, 2]), radius, rtol=1e-5)
        assert cloud[:, 0].min() == pytest.approx(-radius, rel=1e-5)
        assert cloud[:, 0].max() == pytest.approx(0.1 * stretch + radius, rel=1e-5)


def test_taper_thins_the_ends_only() -> None:
    """The middle keeps its radius, the ends lose the share."""
    model = rod_model()
    tubes = shapes.Tubes(model, [0], 1.0, 8, 0.45)
    tubes.update(rest_of(model))
    point = np.asarray(tubes.mesh.points, dtype=np.float64)
    radius = np.hypot(point[:, 1], point[:, 2])
    np.testing.assert_allclose(radius[np.abs(point[:, 0] - 0.05) < 1e-6], 4e-3, rtol=1e-5)
    np.testing.assert_allclose(radius[np.abs(point[:, 0]) < 1e-6], 0.55 * 4e-3, rtol=1e-5)


@given(hnp.arrays(np.float64, (10, 3), elements=st.sampled_from([0.0, 1.0, -1.0, 1e-9, 0.3])))
@settings(max_examples=100, deadline=None)
def test_any_shape_makes_a_finite_mesh(position: FloatArray) -> None:
    """Coinciding nodes, reversals and collapsed rods included."""
    tubes = shapes.Tubes(rod_model(), [0, 1], 1.0, 8, 0.4)
    tubes.update(position)
    assert np.all(np.isfinite(tubes.mesh.points))
    assert np.all(np.isfinite(tubes.mesh.point_data["normal"]))
    assert np.max(np.abs(tubes.mesh.points)) < 5.0


@given(st.floats(0.0, 0.99))
@settings(max_examples=50, deadline=None)
def test_more_activation_is_darker(activation: float) -> None:
    """By an even step in the sum of the channels' light."""
    light = activation_colour([activation, activation + 0.01]) @ [0.2126, 0.7152, 0.0722]
    assert 0.5 < light[0] - light[1] < 4.0


def test_still_and_strip(coarse_lattice: Lattice, coarse_model: RodModel, tmp_path: Path) -> None:
    """A strip of two is two pictures wide; a bent worm is drawn at the scale of a straight one."""
    rest = rest_of(coarse_model)
    render_still(coarse_lattice, coarse_model, rest, tmp_path / "one.png", np.ones(coarse_model.n_muscle), "rest")
    stills = [
        Still(lattice=coarse_lattice, model=coarse_model, position=rest * k, title="x") for k in (STRETCH, np.ones(3))
    ]
    render_strip(stills, tmp_path / "two.png", size=(200, 240), dpi=100)
    one, two = (imread(tmp_path / name) for name in ("one.png", "two.png"))
    assert one.shape[0] > 840
    assert two.shape[1] == 2 * 200 + 75
    tops = [np.flatnonzero((two[32:, part, :3] < 0.9).any(axis=(1, 2)))[0] for part in (slice(0, 200), slice(200, 400))]
    assert tops[0] + 50 < tops[1]
    with pytest.raises(ValueError, match="stills"):
        render_strip([], tmp_path / "none.png")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.png", "two.png"]


@pytest.mark.parametrize(("most", "length"), [(0.05, 0.05), (0.0499, 0.02), (0.19, 0.1), (3.0, 2.0)])
def test_scale_bar_is_a_round_length(most: float, length: float) -> None:
    """The longest that fits."""
    assert round_length(most) == pytest.approx(length)


def test_heat_map_shows_activation(trajectory: Trajectory, tmp_path: Path) -> None:
    """Twice as many active muscles make twice as much dark area."""
    plot_activation(trajectory, tmp_path / "half.png")
    picture = imread(tmp_path / "half.png")[:, :, :3]
    dark = np.all(np.abs(picture - activation_colour([1.0])[0] / 255) < 0.02, axis=2)
    light = np.all(np.abs(picture - activation_colour([0.0])[0] / 255) < 0.02, axis=2)
    assert dark.sum() / (dark.sum() + light.sum()) == pytest.approx(0.5, abs=0.02)


def test_heat_map_of_one_frame_of_hand_tied_muscles(tmp_path: Path) -> None:
    """A lattice with uneven phases has no levels, and one frame no step."""
    phases = (0.0, 1.3, 3.1, 0.0, 1.3, 3.1)
    lattice = build_lattice(LatticeDesign(n_pairs=3, phases=phases, period_ratio=2.0, structure_radius=2e-3))
    layout = tie(lattice, [(0, 4), (1, 5)])
    model = build_model(lattice, layout)
    recorder = Recorder(lattice.design, layout, "x")
    recorder.append(1.0, rest_of(model), [0.0, 1.0])
    trajectory = recorder.build()
    plot_activation(trajectory, tmp_path / "a.png")
    assert imread(tmp_path / "a.png").std() > 0.05
    render_video(trajectory, tmp_path / "a.mp4", size=(64, 64))
    assert imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "a.mp4"))[0] == 1


def test_heat_map_needs_a_muscle(coarse_lattice: Lattice, tmp_path: Path) -> None:
    """Nothing is written without."""
    model = build_model(coarse_lattice, MuscleLayout())
    recorder = Recorder(coarse_lattice.design, MuscleLayout(), "x")
    recorder.append(0.0, rest_of(model), [])
    bald = recorder.build()
    with pytest.raises(ValueError, match="no muscle is on"):
        plot_activation(bald, tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


def python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run code in a fresh interpreter with no display."""
    inherited = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "VTK_DEFAULT_OPENGL_WINDOW")}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**inherited, **environment}, check=False
    )


DRAW = """
from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import MuscleLayout
from lattice_gym.physics.worm import build_model
from lattice_gym.rendering.scene import render_frame
lattice = build_lattice(LatticeDesign(elements_per_segment=1))
model = build_model(lattice, MuscleLayout())
print(render_frame(lattice, model, model.rest_state().position, size=(64, 64)).std() > 5)
"""


def test_no_display_no_complaint() -> None:
    """A picture is drawn and nothing is said on stderr."""
    ran = python(DRAW)
    assert (ran.returncode, ran.stdout.strip(), ran.stderr) == (0, "True", "")


def test_machine_that_cannot_draw_says_so() -> None:
    """With no EGL driver and no OSMesa, VTK would crash; where the libraries are found after all, it draws."""
    hide = "import ctypes\ndef missing(name, *a, **k): raise OSError(name)\nctypes.CDLL = missing\n"
    nowhere = {"__EGL_VENDOR_LIBRARY_DIRS": "/nonexistent", "__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent"}
    ran = python("import numpy\n" + DRAW.replace("lattice =", hide + "lattice =", 1), **nowhere)
    assert ran.stdout.strip() == "True" or "install EGL" in ran.stderr
    assert ran.returncode in (0, 1)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="VTK falls back on OSMesa unasked on Linux only")
def test_osmesa_is_found_by_loading_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any of its names will do, and none will not."""

    def load(name: str) -> None:
        if name != installed:
            raise OSError(name)

    monkeypatch.setattr(ctypes, "CDLL", load)
    installed = "libOSMesa.so.6"
    assert scene.has_osmesa()
    installed = "libGL.so"
    assert not scene.has_osmesa()


def test_import_is_light() -> None:
    """No drawing library is loaded before it is used."""
    heavy = ("pyvista", "vtkmodules", "matplotlib", "imageio", "imageio_ffmpeg")
    ran = python(f"import sys, lattice_gym.rendering; print([m for m in {heavy} if m in sys.modules])")
    assert ran.stdout.strip() == "[]"


@pytest.mark.parametrize("missing", ["pyvista", "matplotlib.figure", "imageio_ffmpeg"])
def test_missing_extra_is_named(
    monkeypatch: pytest.MonkeyPatch, trajectory: Trajectory, tmp_path: Path, missing: str
) -> None:
    """The message says what to install."""
    monkeypatch.setitem(sys.modules, missing, None)
    write: Callable[..., None] = plot_activation if missing == "matplotlib.figure" else render_video
    with pytest.raises(ImportError, match=f"need {missing}: pip install "):
        write(trajectory, tmp_path / "a")
    assert not list(tmp_path.iterdir())
