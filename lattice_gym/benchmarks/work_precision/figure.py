"""The picture of the work-precision report: error against run time, one column a scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from lattice_gym.benchmarks.figures import COLOURS, INK, dress, new_figure, save
from lattice_gym.benchmarks.work_precision.study import DEFAULT_MESH, TARGETS, Point, Study

SYMMETRIC = COLOURS[7]
CURVES = (
    ("pyelastica", "pyelastica", COLOURS[1], "s", "PyElastica"),
    ("fused", "pyelastica", COLOURS[0], "o", "fused, PyElastica's damping"),
    ("fused", "symmetric", SYMMETRIC, "D", "fused, symmetric damping"),
)
Colour = tuple[float, float, float, float]
MARKERS = {"rod": "o", "line": "^"}


def draw(studies: list[Study], path: Path) -> None:
    """Write the PNG: above the error in time on the default mesh, below the error of the whole."""
    figure = new_figure(4.1 * len(studies) + 1.0, 8.4)
    rows = figure.subplots(2, len(studies), squeeze=False, sharey="row")
    meshes = sorted({p.setting.elements_per_segment for m in studies for p in m.points})
    shades = colormaps["viridis"](np.linspace(0.0, 0.93, len(meshes)))
    colours: dict[int, Colour] = {mesh: tuple(shade) for mesh, shade in zip(meshes, shades, strict=True)}
    computing = "computing [s per simulated s]"
    for k, measured in enumerate(studies):
        upper, lower = rows[:, k]
        in_time = f"error in time alone\n({DEFAULT_MESH} elements per segment, muscles as rods)"
        whole = "error of the whole\n(against vanishing elements; fused engine)"
        dress(upper, f"{measured.scene.name}: {measured.scene.outcome}", computing, "" if k else in_time)
        dress(lower, "", computing, "" if k else whole)
        _draw_time(upper, measured)
        _draw_whole(lower, measured, colours)
    for row, room in zip(rows, (5.0, 2.5), strict=True):
        row[0].set_ylim(top=room * row[0].get_ylim()[1])
    rows[0, -1].legend(fontsize=9, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    _legend_whole(rows[1, -1], colours)
    save(figure, path)


def _draw_time(axes: Axes, measured: Study) -> None:
    own = [p for p in measured.points if p.setting.mesh == (DEFAULT_MESH, "rod")]
    for row, (engine, splitting, colour, marker, label) in enumerate(CURVES):
        points = [p for p in own if (p.engine, p.setting.splitting) == (engine, splitting)]
        sound = [p for p in points if p.status == "ok"]
        costs, errors = [p.cost for p in sound], [p.time_error.outcome for p in sound]
        axes.loglog(costs, errors, color=colour, marker=marker, markersize=5, linewidth=1.4, label=label)
        _draw_failed(axes, points, colour, row)
    axes.plot([], [], "x", color=INK, markersize=5, label="diverged")
    for target in TARGETS:
        axes.axhline(target, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))


def _draw_whole(axes: Axes, measured: Study, colours: dict[int, Colour]) -> None:
    shown = [p for p in measured.points if p.engine == "fused" and p.setting.splitting == "symmetric"]
    for row, (mesh, colour) in enumerate(colours.items()):
        for model, marker in MARKERS.items():
            points = [p for p in shown if p.setting.mesh == (mesh, model) and p.status == "ok"]
            costs, errors = [p.cost for p in points], [p.error.outcome for p in points]
            alpha = 0.9 if model == "rod" else 0.5
            axes.loglog(costs, errors, color=colour, marker=marker, markersize=4.5, linewidth=0.7, alpha=alpha)
        _draw_failed(axes, [p for p in shown if p.setting.mesh == (mesh, "rod")], colour, row)
    best = measured.best()
    axes.loglog([p.cost for p in best], [p.error.outcome for p in best], color=INK, linewidth=1.2, linestyle=":")
    halo = [withStroke(linewidth=3.0, foreground="white")]
    for name, point in measured.fidelities.items():
        place = point.cost, point.error.outcome
        axes.plot(*place, marker="*", markersize=15, color=SYMMETRIC, markeredgecolor="white")
        axes.annotate(
            name, place, xytext=(0, 10), textcoords="offset points", ha="center", fontsize=10, fontweight="bold",
            color=SYMMETRIC, path_effects=halo,
        )  # fmt: skip


def _draw_failed(axes: Axes, points: list[Point], colour: str | Colour, row: int) -> None:
    """Crosses in a row at the top edge: diverged, at the run time they would have had."""
    costs = [p.cost for p in points if p.status != "ok"]
    height = np.full(len(costs), 0.98 - 0.022 * row)
    axes.plot(costs, height, "x", color=colour, markersize=5, markeredgewidth=1.3, transform=axes.get_xaxis_transform())


def _legend_whole(axes: Axes, colours: dict[int, Colour]) -> None:
    handles = [
        Line2D([], [], color=colour, marker="o", markersize=5, label=f"{mesh}") for mesh, colour in colours.items()
    ]
    handles += [
        Line2D([], [], color=INK, marker=MARKERS["line"], markersize=5, linewidth=0.7, label="muscles as lines"),
        Line2D([], [], color=INK, linestyle=":", label="best"),
        Line2D([], [], color=INK, marker="x", linestyle="none", label="diverged"),
        Line2D([], [], color=SYMMETRIC, marker="*", markersize=11, linestyle="none", label="fidelity"),
    ]
    axes.legend(
        handles=handles, title="elements per segment", title_fontsize=9, fontsize=8.5, frameon=False,
        loc="center left", bbox_to_anchor=(1.0, 0.5),
    )  # fmt: skip
