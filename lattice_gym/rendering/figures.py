"""Stills and plots as PNG files."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.checks import FloatArray, array, require
from lattice_gym.physics.assembly import RodModel
from lattice_gym.recording.files import write
from lattice_gym.recording.trajectory import Trajectory
from lattice_gym.rendering import colours
from lattice_gym.rendering.colours import activation_colour
from lattice_gym.rendering.extras import extra
from lattice_gym.rendering.scene import Renderer


@dataclass(frozen=True, kw_only=True, eq=False)
class Still:
    """What one picture of a strip shows; position (n_node, 3) [m], activation (n_muscle,), by default 0."""

    lattice: Lattice
    model: RodModel
    position: npt.ArrayLike
    activation: npt.ArrayLike | None = None
    title: str = ""


def render_still(
    lattice: Lattice,
    model: RodModel,
    position: npt.ArrayLike,
    path: str | os.PathLike[str],
    activation: npt.ArrayLike | None = None,
    title: str = "",
) -> None:
    """Write a PNG of one shape with a scale and a colour bar."""
    render_strip([Still(lattice=lattice, model=model, position=position, activation=activation, title=title)], path)


def render_strip(
    stills: Sequence[Still], path: str | os.PathLike[str], size: tuple[int, int] = (640, 840), dpi: int = 200
) -> None:
    """Write a PNG of shapes side by side at one scale, each of the size [pixels], with a scale and a colour bar."""
    require(len(stills) > 0, "stills is empty: a strip shows at least one")
    view = np.concatenate([array("position", still.position, (still.model.n_node, 3)) for still in stills])
    pictures = []
    for still in stills:
        with Renderer(still.lattice, still.model, size, view=view, bare=True, fine=True) as renderer:
            pictures.append(renderer.update(still.position, still.activation))
            scale = renderer.pixels_per_metre
    width, height = size[0] / dpi, size[1] / dpi
    title, scale_bar, colour_bar = 0.32, 0.3, 0.75
    across, up = width * len(stills) + colour_bar, title + height + scale_bar
    figure = _figure(across, up)
    for k, (still, picture) in enumerate(zip(stills, pictures, strict=True)):
        axes = figure.add_axes((k * width / across, scale_bar / up, width / across, height / up))
        axes.imshow(picture)
        axes.set_axis_off()
        axes.set_title(still.title, fontsize=10, color=colours.TEXT, pad=4)
    length = round_length(0.3 * size[0] / scale)
    left, right = 0.12 / across, (0.12 + length * scale / dpi) / across
    figure.add_artist(
        extra("matplotlib.lines").Line2D([left, right], [0.1 / up] * 2, color=colours.TEXT, linewidth=1.5)
    )
    figure.text((left + right) / 2, 0.14 / up, f"{length * 1e3:g} mm", fontsize=8, color=colours.TEXT, ha="center")
    if any(still.model.n_muscle for still in stills):
        bottom = (scale_bar + 0.3 * height) / up
        _colour_bar(figure, cax=figure.add_axes((1.0 - 0.62 / across, bottom, 0.1 / across, 0.4 * height / up)))
    save(figure, path, dpi)


def round_length(most: float) -> float:
    """Longest of 1, 2, 5, 10, ... that is no more than most."""
    decade = 10.0 ** math.floor(math.log10(most))
    return max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= most)


def plot_activation(trajectory: Trajectory, path: str | os.PathLike[str]) -> None:
    """Write a PNG of every muscle's activation over time, the muscles grouped by orientation and lower level."""
    muscles = trajectory.layout.active
    require(len(muscles) > 0, "trajectory: no muscle is on, so there is no activation to plot")
    lattice = build_lattice(trajectory.design)
    kinds = sorted({muscle.orientation for muscle in muscles})
    sites = np.array([(muscle.start, muscle.end) for muscle in muscles])
    level, azimuth = lattice.site_level[sites].min(axis=1), lattice.site_azimuth[sites[:, 0]]
    of_kind = [np.array([k for k, muscle in enumerate(muscles) if muscle.orientation == kind]) for kind in kinds]
    figure = _figure(7.2, 1.2 + max(1.5, 0.055 * len(muscles)), layout="constrained")
    figure.suptitle(f"{trajectory.task}: muscle activation", fontsize=11)
    rows = figure.subplots(len(kinds), 1, sharex=True, squeeze=False, height_ratios=[len(k) for k in of_kind])[:, 0]
    for axes, kind, members in zip(rows, kinds, of_kind, strict=True):
        order = members[np.lexsort((azimuth[members], level[members]))]
        values = trajectory.activation[:, order].T
        axes.pcolormesh(_edges(trajectory.time), np.arange(len(order) + 1), values, cmap=_colour_map(), clim=(0.0, 1.0))
        levels, first, count = np.unique(level[order], return_index=True, return_counts=True)
        axes.set_yticks(first + count / 2, [str(k) if k >= 0 else "" for k in levels.tolist()])
        axes.set_ylabel(f"{kind} muscles, by level" if lattice.n_level else f"{kind} muscles", fontsize=9)
        for row in first[1:]:
            axes.axhline(row, color="white", linewidth=0.8)
        axes.tick_params(axis="y", length=0)
        axes.tick_params(labelsize=8)
        axes.spines[:].set_visible(False)
    rows[-1].set_xlabel("time [s]", fontsize=9)
    _colour_bar(figure, ax=rows, shrink=0.5, aspect=25)
    save(figure, path, 200)


def _edges(time: FloatArray) -> FloatArray:
    """Edges of the frames: midway between their times, shape (n_frame,) -> (n_frame + 1,)."""
    half = np.diff(time) / 2 if len(time) > 1 else np.array([0.5])
    return np.concatenate([[time[0] - half[0]], time[:-1] + half[: len(time) - 1], [time[-1] + half[-1]]])


def _figure(width: float, height: float, layout: str | None = None) -> Any:
    """Empty figure of the size [inch], free of pyplot's global state."""
    return extra("matplotlib.figure").Figure(figsize=(width, height), layout=layout)


def _colour_map() -> Any:
    shades = activation_colour(np.linspace(0.0, 1.0, 256)) / 255.0
    return extra("matplotlib.colors").ListedColormap(shades, name="activation")


def _colour_bar(figure: Any, **place: Any) -> None:
    scale = extra("matplotlib.cm").ScalarMappable(cmap=_colour_map())
    bar = figure.colorbar(scale, ticks=[0.0, 0.5, 1.0], **place)
    bar.set_label("activation", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    bar.outline.set_visible(False)


def save(figure: Any, path: str | os.PathLike[str], dpi: int) -> None:
    """Write a figure of matplotlib as a PNG with so many pixels an inch."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dpi)
    write(path, content.getvalue())
