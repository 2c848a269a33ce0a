"""The scene that every picture and video is made of."""

from __future__ import annotations

import ctypes
import math
import re
import sys
import textwrap
from contextlib import suppress
from functools import partial
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from lattice_gym.body.lattice import Lattice
from lattice_gym.checks import FloatArray, array, items, require, whole
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.measures import top_centre
from lattice_gym.physics.rod import straight_rod
from lattice_gym.recording.trajectory import ACTIVATION_RANGE
from lattice_gym.rendering import colours
from lattice_gym.rendering.colours import activation_colour, rgb
from lattice_gym.rendering.drawing_thread import Drawn
from lattice_gym.rendering.extras import extra
from lattice_gym.rendering.shapes import Balls, Tubes, overwrite

RGB = npt.NDArray[np.uint8]

# Drawn radius over true radius; the balls at the sites are in radii of the structure rods.
ROD_SCALE, MUSCLE_SCALE, SITE_SCALE = 0.42, 0.56, 0.56
# Pieces that each is drawn in at least, and the share of its radius that a muscle loses towards its ends.
ROD_PIECES, MUSCLE_PIECES, TAPER = 32, 8, 0.45
# Corners around a ball, or a marker.
BALL_CORNERS = 48
# Radii of a marker and of the top's centre beside it, in diameters of the worm.
MARKER_RADIUS, TOP_RADIUS = 0.06, 0.035
# Depth offset of what is drawn in front of everything, and opacity with which a ball shows through what is before it.
FORWARD, BALL_GLOW = -1e6, 0.45
# Elements that a muscle without nodes is drawn with.
LINE_ELEMENTS = 2
# Share of white in the colour of what is furthest from the camera.
HAZE = 0.6
MATERIAL = {"ambient": 0.35, "diffuse": 0.75, "specular": 0.1, "specular_power": 25}
# Where the lights stand about a camera at (0, 0, 1) that looks at the origin, and how strong they are.
LIGHTS = (((-0.5, 0.9, 0.9), 0.75), ((0.8, 0.2, 0.9), 0.4))
# Azimuth and elevation of the camera, and its vertical angle of view [rad].
AZIMUTH, ELEVATION, VIEW_ANGLE = math.radians(-53.0), math.radians(20.0), math.radians(16.0)
# Left, right, bottom and top of the colour bar, of the worm's place beside it and of its place in a bare picture, in
# shares of the picture.
BAR, STAGE, BARE_STAGE = (0.915, 0.935, 0.30, 0.70), (0.03, 0.85, 0.03, 0.86), (0.03, 0.97, 0.03, 0.97)
# Each pixel is the mean of this many drawn ones, squared.
SUPERSAMPLE = 2
# Letters of the line of text, in heights of the picture.
LINE_HEIGHT = 0.032
NO_BREAK = "\u00a0"
# Radius and depth of the base plate, in diameters of the worm.
PLATE_RADIUS, PLATE_DEPTH = 0.68, 0.05
# How far the ground is drawn beyond what is shown, in diameters of the worm.
GROUND_MARGIN = 0.2


def _plotter(size: list[int]) -> Any:
    """Empty off-screen scene of the size [pixels]."""
    pyvista = extra("pyvista")
    # Where there is no X server, VTK takes EGL or else OSMesa by itself, but warns of the missing server first.
    with pyvista.vtk_verbosity("error"):
        plotter = pyvista.Plotter(off_screen=True, window_size=size, lighting="none")
    if plotter.render_window.GetClassName() == "vtkOSOpenGLRenderWindow" and not has_osmesa():
        plotter.close()
        raise RuntimeError("nothing here can draw: install EGL (libegl1) or OSMesa (libosmesa6), or set DISPLAY")
    plotter.disable_anti_aliasing()
    plotter.background_color = "white"
    for place, intensity in LIGHTS:
        plotter.add_light(pyvista.Light(position=place, light_type="camera light", intensity=intensity))
    return plotter


def _bring_forward(actor: Any, share: float = 1.0) -> None:
    """Draw an actor before what would hide it; of two, that of the larger share."""
    actor.mapper.SetResolveCoincidentTopologyToPolygonOffset()
    actor.mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(0.0, share * FORWARD)


def has_osmesa() -> bool:
    """Whether OSMesa can be loaded; VTK falls back on it unasked, and crashes where it is missing."""
    if not sys.platform.startswith("linux"):
        return True
    for name in ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so"):
        with suppress(OSError):
            ctypes.CDLL(name)
            return True
    return False


def _line_nodes(model: RodModel, position: FloatArray) -> FloatArray:
    """Nodes [m] of straight rods that stand for the lines of a model, one after another, shape (n, 3)."""
    start, end = (position[rows] for rows in model.tie_nodes(model.lines))
    share = np.linspace(0.0, 1.0, LINE_ELEMENTS + 1)[:, None]
    return np.reshape(start[:, None] + share * (end - start)[:, None], (-1, 3))


def _drawn_lines(model: RodModel, radius: float) -> RodModel | None:
    """Rods to draw in place of the lines of a model, at rest; None where it has none."""
    nodes = _line_nodes(model, model.rest_state().position) if model.lines else np.empty((0, 3))
    rods = tuple(
        straight_rod(
            ends[0], ends[-1], LINE_ELEMENTS, radius=radius, density=1.0, youngs_modulus=1.0, shear_modulus=1.0
        )
        for ends in nodes.reshape(-1, LINE_ELEMENTS + 1, 3)
    )
    return RodModel(rods=rods) if rods else None


def in_lines(text: str, width: int) -> str:
    """Text in lines of at most so many letters, which end before a bracket rather than in it."""

    def unbroken(bracket: re.Match[str]) -> str:
        inside = bracket.group()
        return inside.replace(" ", NO_BREAK) if len(inside) <= width else inside

    whole = re.sub(r"\([^()]*\)|\[[^][]*\]", unbroken, text)
    return textwrap.fill(whole, width, break_on_hyphens=False).replace(NO_BREAK, " ")


class _Scene:
    """What a `Renderer` draws, with its arguments; all of it belongs to the thread that draws."""

    def __init__(
        self,
        lattice: Lattice,
        model: RodModel,
        size: tuple[int, int],
        view: npt.ArrayLike | None,
        n_marker: int,
        bare: bool,
        fine: bool,
    ) -> None:
        width, height = items("size", size, partial(whole, low=64, high=4096), 2, "pixel counts: width and height")
        if view is None:
            rest = model.rest_state().position[: lattice.n_rod * lattice.n_node]
            stretch = np.array([1.0, 1.0, 1.6])
            ahead = np.array([lattice.design.height, 0.0, 0.0])
            lies = not np.array_equal(rest, lattice.position.reshape(-1, 3))
            shown = np.concatenate([rest - ahead, rest + ahead] if lies else [rest, rest * stretch])
        else:
            shown = array("view", view, ("n", 3))
            require(len(shown) > 0, "view is empty: must hold at least one point")
        self.size, self._n_marker, self._bare = (width, height), n_marker, bare
        self._lattice, self._model = lattice, model
        self._plotter = _plotter([SUPERSAMPLE * width, SUPERSAMPLE * height])
        muscles = set(model.muscles)
        structure = [rod for rod in range(model.n_rod) if rod not in muscles]
        lines = _drawn_lines(model, lattice.design.muscle_radius)
        self._rods = Tubes(model, structure, ROD_SCALE, ROD_PIECES, 0.0)
        self._sites = Balls(lattice.n_site, SITE_SCALE * lattice.design.structure_radius)
        self._muscles = Tubes(model, model.muscles, MUSCLE_SCALE, MUSCLE_PIECES, TAPER) if muscles else None
        self._lines = Tubes(lines, range(lines.n_rod), MUSCLE_SCALE, MUSCLE_PIECES, TAPER) if lines else None
        self._ball = Balls(1, model.ball.radius, BALL_CORNERS) if model.ball else None
        self._markers = Balls(n_marker, MARKER_RADIUS * lattice.design.diameter, BALL_CORNERS) if n_marker else None
        self._top = Balls(1, TOP_RADIUS * lattice.design.diameter, BALL_CORNERS) if n_marker else None
        for part in self._parts():
            actor = self._plotter.add_mesh(part.mesh, scalars="colour", rgb=True, smooth_shading=False, **MATERIAL)
            actor.prop.interpolation = "Phong"
            if part in (self._markers, self._top):
                _bring_forward(actor, 2.0 if part is self._top else 1.0)
        if self._ball:
            glow = self._plotter.add_mesh(
                self._ball.mesh, scalars="colour", rgb=True, opacity=BALL_GLOW, culling="back", **MATERIAL
            )
            glow.prop.interpolation = "Phong"
            _bring_forward(glow)
        self._colour_bar = model.n_muscle > 0 and not bare
        if self._colour_bar:
            self._write("activation", 0.5 * (BAR[0] + BAR[1]), BAR[3] + 0.03, 0.03, ("center", "bottom"))
            for value in (0.0, 0.5, 1.0):
                self._write(f"{value:g}", BAR[1] + 0.01, BAR[2] + value * (BAR[3] - BAR[2]), 0.028, ("left", "center"))
        self._time = self._write("", 0.03, 0.965, 0.036, ("left", "top"))
        self._line = self._write("", 0.03, 0.915, LINE_HEIGHT, ("left", "top"))
        if lattice.design.base == "clamped":
            shown = np.concatenate([shown, self._add_plate(lattice, model)])
        elif model.ground is not None:
            shown = np.concatenate([shown, self._add_ground(shown, lattice.design.diameter)])
        self._aim(shown)
        if fine:
            radius = 0.12 * lattice.design.diameter
            self._plotter.enable_ssao(radius=radius, bias=0.08 * radius, kernel_size=64)

    def update(
        self,
        position: npt.ArrayLike,
        activation: npt.ArrayLike | None,
        time: float | None,
        text: str,
        ball: npt.ArrayLike | None,
        markers: npt.ArrayLike | None,
    ) -> RGB:
        """Picture, as of `Renderer.update`."""
        model = self._model
        x = array("position", position, (model.n_node, 3))
        relaxed = np.zeros(model.n_muscle)
        a = array("activation", relaxed if activation is None else activation, relaxed.shape, *ACTIVATION_RANGE)
        centre = array("ball", model.rest_state().ball_position if ball is None else ball, (model.n_ball, 3))
        marked = array("markers", np.empty((0, 3)) if markers is None else markers, (self._n_marker, 3))
        self._move(self._rods, x, rgb(colours.ROD))
        self._move(self._sites, x[self._lattice.site_nodes].mean(axis=1), rgb(colours.SITE))
        if self._muscles:
            self._move(self._muscles, x, activation_colour(a[: len(model.muscles)]))
        if self._lines:
            self._move(self._lines, _line_nodes(model, x), activation_colour(a[len(model.muscles) :]))
        if self._ball:
            self._move(self._ball, centre, rgb(colours.BALL))
        if self._markers:
            self._move(self._markers, marked, rgb(colours.MARKER), haze=0.0)
        if self._top:
            self._move(self._top, top_centre(self._lattice, x)[None], rgb(colours.TOP), haze=0.0)
        if not self._bare:
            self._time.input = "" if time is None else f"t = {time:.2f} s"
            # A letter is about half as wide as it is high.
            self._line.input = in_lines(text, int(0.94 * self.size[0] / (0.5 * LINE_HEIGHT * self.size[1])))
        return self._picture()

    def close(self) -> None:
        """Free it."""
        self._plotter.close()

    def _parts(self) -> list[Tubes | Balls]:
        parts = self._rods, self._sites, self._muscles, self._lines, self._ball, self._markers, self._top
        return [part for part in parts if part]

    def _write(self, text: str, x: float, y: float, size: float, justified: tuple[str, str]) -> Any:
        """Text at a place and of a size in shares of the picture; it may be changed later."""
        pyvista = extra("pyvista")
        actor = pyvista.Text(text=text, position=(x, y))
        actor.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
        actor.prop = pyvista.TextProperty(color=colours.TEXT, font_size=round(size * self.size[1] * SUPERSAMPLE))
        actor.prop.justification_horizontal, actor.prop.justification_vertical = justified
        self._plotter.add_actor(actor)
        return actor

    def _add_plate(self, lattice: Lattice, model: RodModel) -> FloatArray:
        """Add the base that a clamped worm stands on; the points to show of it, shape (n, 3) [m].

        With a ball it is a ring: whatever comes out of the lattice goes through it, and is shown below it.
        """
        diameter, pyvista = lattice.design.diameter, extra("pyvista")
        radius, depth = PLATE_RADIUS * diameter, PLATE_DEPTH * diameter
        place: dict[str, Any] = {"center": (0.0, 0.0, -0.5 * depth), "direction": (0, 0, 1), "height": depth}
        below = np.empty((0, 3))
        if model.ball is None:
            plate = pyvista.Cylinder(radius=radius, resolution=128, **place)
        else:
            hole = 0.5 * diameter - lattice.design.structure_radius
            plate = pyvista.CylinderStructured(radius=[hole, radius], theta_resolution=128, z_resolution=2, **place)
            below = np.array([[0.0, 0.0, -1.25 * model.ball.radius]])
        self._plotter.add_mesh(plate, color=colours.PLATE, ambient=0.6, diffuse=0.45, specular=0.0)
        return np.concatenate([np.asarray(plate.points, dtype=np.float64), below])

    def _add_ground(self, points: FloatArray, diameter: float) -> FloatArray:
        """Add a slab of the ground under what is shown; its points, shape (n, 3) [m]."""
        margin, depth = GROUND_MARGIN * diameter, PLATE_DEPTH * diameter
        (left, front, _), (right, back, _) = points.min(axis=0) - margin, points.max(axis=0) + margin
        slab = extra("pyvista").Box(bounds=(left, right, front, back, -depth, 0.0))
        self._plotter.add_mesh(slab, color=colours.PLATE, ambient=0.6, diffuse=0.45, specular=0.0)
        return np.asarray(slab.points, dtype=np.float64)

    def _aim(self, points: FloatArray) -> None:
        """Bring the camera so near that the points fill the stage, seen from the fixed direction."""
        left, right, bottom, top = BARE_STAGE if self._bare else STAGE
        tall = math.tan(0.5 * VIEW_ANGLE) * (top - bottom)
        wide = math.tan(0.5 * VIEW_ANGLE) * (right - left) * self.size[0] / self.size[1]
        self._back = np.array([math.cos(AZIMUTH), math.sin(AZIMUTH), math.tan(ELEVATION)]) * math.cos(ELEVATION)
        across = np.array([-math.sin(AZIMUTH), math.cos(AZIMUTH), 0.0])
        axes = np.stack([across, np.cross(self._back, across), self._back])
        seen = points @ axes.T
        low, high = seen.min(axis=0), seen.max(axis=0)
        x, y, z = (seen - 0.5 * (low + high)).T
        distance = float(np.max(np.maximum(np.abs(x) / wide, np.abs(y) / tall) + z))
        focus = 0.5 * (low + high) @ axes
        camera = self._plotter.camera
        camera.focal_point, camera.position, camera.up = focus, focus + distance * self._back, (0.0, 0.0, 1.0)
        camera.view_angle = math.degrees(VIEW_ANGLE)
        camera.SetWindowCenter(1.0 - left - right, 1.0 - bottom - top)
        self._plotter.reset_camera_clipping_range()
        self._depth = low[2], high[2]

    def _move(self, part: Tubes | Balls, places: FloatArray, colour: FloatArray, haze: float = HAZE) -> None:
        """Move a part and colour its n equal pieces, shape (n, 3) or (3,) for all, 0 to 255, paler towards the back."""
        part.update(places)
        depth = np.asarray(part.mesh.points) @ self._back
        pale = haze * np.clip((self._depth[1] - depth) / (self._depth[1] - self._depth[0]), 0.0, 1.0)
        pieces = np.atleast_2d(colour)
        shown = np.repeat(pieces, len(depth) // len(pieces), axis=0)
        shown += pale[:, None] * (rgb(colours.HAZE) - shown)
        overwrite(part.mesh.point_data["colour"], shown)

    def _picture(self) -> RGB:
        n, (width, height) = SUPERSAMPLE, self.size
        window, pixels = self._plotter.render_window, extra("vtkmodules.vtkCommonCore").vtkUnsignedCharArray()
        self._plotter.reset_camera_clipping_range()
        window.Render()
        window.GetPixelData(0, 0, n * width - 1, n * height - 1, 0, pixels, 0)
        drawn = np.frombuffer(pixels, np.uint8).reshape(n * height, n * width, 3)[::-1]
        total = np.full((height, width, 3), n * n // 2, np.uint16)
        for row in range(n):
            for column in range(n):
                total += drawn[row::n, column::n]
        picture = (total // (n * n)).astype(np.uint8)
        if self._colour_bar:
            left, right, bottom, top = BAR
            rows = slice(round((1.0 - top) * height), round((1.0 - bottom) * height))
            shades = activation_colour(np.linspace(1.0, 0.0, rows.stop - rows.start)).round()
            picture[rows, round(left * width) : round(right * width)] = shades[:, None]
        return picture

    def pixels_per_metre(self) -> float:
        """Scale of the picture where the middle of the view stands [1/m]."""
        camera = self._plotter.camera
        return float(self.size[1] / (2.0 * math.tan(0.5 * VIEW_ANGLE) * camera.distance))


class Renderer:
    """A scene that is built once and then moved; close it, or use it in a with statement.

    It may be used by any thread, as all is drawn in one of its own; see `drawing_thread`.

    Parameters
    ----------
    lattice, model
        The worm: its structure rods first, then its muscles.
    size
        Width and height of the pictures [pixels].
    view
        Points that every picture shows [m], shape (n, 3); by default the worm at rest and 60 % taller, or, if it
        lies, up to its height further along x either way.
    n_marker
        Number of places for the top's centre to go to, which each picture marks with small balls, and itself with a
        smaller one; nothing hides them.
    bare
        The worm fills the picture, with neither colour bar nor text.
    fine
        Shade where parts meet, for stills: about 6 times slower.

    Raises
    ------
    RuntimeError
        Nothing here can draw, or this process is a fork of one that has drawn.
    """

    def __init__(
        self,
        lattice: Lattice,
        model: RodModel,
        size: tuple[int, int] = (640, 480),
        *,
        view: npt.ArrayLike | None = None,
        n_marker: int = 0,
        bare: bool = False,
        fine: bool = False,
    ) -> None:
        self._scene = Drawn(partial(_Scene, lattice, model, size, view, n_marker, bare, fine))

    def update(
        self,
        position: npt.ArrayLike,
        activation: npt.ArrayLike | None = None,
        time: float | None = None,
        text: str = "",
        ball: npt.ArrayLike | None = None,
        markers: npt.ArrayLike | None = None,
    ) -> RGB:
        """Picture, shape (height, width, 3).

        Takes node positions (n_node, 3) [m], activations (n_muscle,) from 0 (the default) to 1, a time [s], a line of
        text to print, the place of the ball (n_ball, 3) [m], by default where it starts, and places to mark
        (n_marker, 3) [m]. Wrong shapes and numbers that are not finite are a ValueError, a closed renderer and a fork
        of the process that made it a RuntimeError.
        """
        return self._scene.use(lambda scene: scene.update(position, activation, time, text, ball, markers))

    @property
    def pixels_per_metre(self) -> float:
        """Scale of the picture where the middle of the view stands [1/m]."""
        return self._scene.use(_Scene.pixels_per_metre)

    def close(self) -> None:
        """Free the scene."""
        self._scene.close()

    def __enter__(self) -> Self:
        """Return the renderer."""
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the renderer."""
        self.close()


def render_frame(
    lattice: Lattice,
    model: RodModel,
    position: npt.ArrayLike,
    activation: npt.ArrayLike | None = None,
    time: float | None = None,
    text: str = "",
    size: tuple[int, int] = (640, 480),
    ball: npt.ArrayLike | None = None,
    markers: npt.ArrayLike | None = None,
) -> RGB:
    """One picture, as Renderer.update makes it, shape (height, width, 3); for many keep a Renderer."""
    with Renderer(lattice, model, size, n_marker=0 if markers is None else np.size(markers) // 3) as renderer:
        return renderer.update(position, activation, time, text, ball, markers)
