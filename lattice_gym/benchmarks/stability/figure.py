"""The picture of the stability report."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lattice_gym.benchmarks.figures import COLOURS, INK, dress, new_figure, save
from lattice_gym.benchmarks.stability.limits import Limit

LABELS = {
    "modulus": "Young's moduli / default",
    "connection": "connection stiffness / default",
    "radius": "radii / default",
    "elements": "elements per segment",
    "tension": "tension / default",
    "damping": "damping / default",
    "ground": "ground's stiffness / default",
    "dashpot": "ground's damping ratio / default",
    "ball": "stiffness of the ball / default",
    "density": "its density / default",
    "contact": "stiffness of rods that touch / default",
}


AIMS = ((1.0, "-"), (0.7, "--"), (0.4, ":"))
"""Predicted over measured: nowhere above the first, half above the second, all above the third; styles of lines."""


def draw(limits: list[Limit], path: Path) -> None:
    """Heat maps of ratio and limit for each pair of parameters, and predicted over measured for every case."""
    groups: dict[str, list[Limit]] = {}
    for limit in limits:
        groups.setdefault(limit.case.group, []).append(limit)
    grids = [members for members in groups.values() if members[0].case.factors]
    figure = new_figure(max(18.0, 3.6 * len(grids)), 11.5)
    columns = max(len(grids), 2)
    grid = figure.add_gridspec(3, columns, height_ratios=[1.0, 1.0, 1.35])
    for column, members in enumerate(grids):
        for row, kind in enumerate(("ratio", "limit")):
            _heat_map(figure, figure.add_subplot(grid[row, column]), members, kind)
    _scatter(figure.add_subplot(grid[2, : columns // 2]), limits)
    _histogram(figure.add_subplot(grid[2, columns // 2 :]), groups)
    save(figure, path)


def _heat_map(figure: Figure, axes: Axes, members: list[Limit], kind: str) -> None:
    x, y = members[0].case.factors
    xs, ys = (sorted({limit.case.factors[name] for limit in members}) for name in (x, y))
    values = np.full((len(ys), len(xs)), np.nan)
    for limit in members:
        at = ys.index(limit.case.factors[y]), xs.index(limit.case.factors[x])
        value = limit.ratio if kind == "ratio" else (math.nan if limit.beyond else 1e6 * (limit.stable or math.nan))
        values[at] = value
        mark = {"collapse": "none\nholds", "no limit": "none\nfails"}.get(limit.beyond)
        text = mark or (f"{value:.2f}" if kind == "ratio" else f"{value:.0f}" if value >= 100.0 else f"{value:.3g}")
        axes.text(at[1], at[0], text, ha="center", va="center", fontsize=7.5, color="0.35" if mark else "black")
    shown = values if kind == "ratio" else np.log10(values)
    low, high = (0.4, 1.0) if kind == "ratio" else (0.0, 4.5)
    colours = colormaps["YlGn"].with_extremes(under="gold", over="tomato")
    image = axes.imshow(shown, origin="lower", aspect="auto", vmin=low, vmax=high, cmap=colours, alpha=0.85)
    dress(axes, "predicted / measured" if kind == "ratio" else "measured critical step [us]", LABELS[x], LABELS[y])
    axes.grid(False)
    axes.set_facecolor("0.9")
    axes.set_xticks(range(len(xs)), [f"{value:g}" for value in xs])
    axes.set_yticks(range(len(ys)), [f"{value:g}" for value in ys])
    if kind == "ratio":
        figure.colorbar(image, ax=axes, pad=0.01, extend="both")


def _scatter(axes: Axes, limits: list[Limit]) -> None:
    counted = [limit for limit in limits if not math.isnan(limit.ratio)]
    for group, colour in (("random", COLOURS[0]), ("grid", COLOURS[1])):
        members = [limit for limit in counted if (limit.case.group == "random") == (group == "random")]
        axes.loglog(
            [1e6 * (limit.stable or math.nan) for limit in members],
            [1e6 * limit.usable for limit in members],
            "o",
            color=colour,
            markersize=4.5,
            alpha=0.7,
            label=f"{group}, {len(members)} cases",
        )
    span = np.array([0.7, 1.4]) * [f(1e6 * (limit.stable or math.nan) for limit in counted) for f in (min, max)]
    for share, style in AIMS:
        axes.loglog(span, share * span, style, color=INK, linewidth=1, label=f"predicted = {share:g} measured")
    dress(axes, "Every counted case", "critical step [us]", "predicted [us]")
    axes.legend(fontsize=9)


def _histogram(axes: Axes, groups: dict[str, list[Limit]]) -> None:
    ratios = [[limit.ratio for limit in members if not math.isnan(limit.ratio)] for members in groups.values()]
    edges = np.arange(0.2, 1.525, 0.025)
    axes.hist([np.clip(group, 0.2, 1.499) for group in ratios], edges.tolist(), stacked=True, label=[*groups])
    for share, style in AIMS:
        axes.axvline(share, linestyle=style, color=INK, linewidth=1)
    title = "Aims: none above 1, half above 0.7, all above 0.4 (limit of stability)"
    dress(axes, title, "predicted / measured", "cases")
    axes.legend(fontsize=9, loc="upper left")
