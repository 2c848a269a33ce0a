"""One picture of the validation: measured against exact in small multiples, and the slopes of convergence."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from lattice_gym.benchmarks.figures import COLOURS, ENGINE_COLOUR, GREY, INK, PALE, dress, new_figure, save
from lattice_gym.benchmarks.validation.study import Validation
from lattice_gym.checks import FloatArray
from lattice_gym.verification.case import Outcome

_MAX_MARKS = 16
_COLUMNS = 6
_ELEMENT_TICKS = (4, 8, 16, 32, 64, 128, 256)


def draw(validation: Validation, path: Path) -> None:
    """Write the picture."""
    curves = [pair for pair in validation.outcomes if len(pair[0].reading.x) > 3]
    numbers = [pair for pair in validation.outcomes if len(pair[0].reading.x) <= 3]
    n_rows = -(-len(curves) // _COLUMNS)
    figure = new_figure(20.0, 2.8 * n_rows + 4.6)
    grid = figure.add_gridspec(2, 1, height_ratios=[2.8 * n_rows, 4.3])
    upper, lower = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
    panels = upper.subplots(n_rows, _COLUMNS, squeeze=False).ravel()
    for axes, pair in zip(panels, curves, strict=False):
        _draw_curve(axes, pair)
    for axes in panels[len(curves) :]:
        axes.set_axis_off()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper right", ncols=3, frameon=False, fontsize=10, labelcolor=INK)
    figure.suptitle("Exact cases on both engines", x=0.01, ha="left", fontsize=14, fontweight="bold", color=INK)
    left, middle, right = lower.subplots(1, 3, width_ratios=[1.0, 1.25, 1.6])
    _draw_numbers(left, numbers)
    _draw_meshes(middle, validation)
    _draw_steps(right, validation)
    save(figure, path)


def _draw_curve(axes: Axes, pair: Sequence[Outcome]) -> None:
    """Exact result as a band, both engines as marks; where zero is exact, sizes on a log scale and the tolerance."""
    case, reading = pair[0].case, pair[0].reading
    errors = " and ".join(dict.fromkeys(f"{outcome.reading.error:.1e}" for outcome in pair))
    note = f"error {errors}, tolerance {pair[0].tolerance:.1e}"
    dress(axes, case.title, case.abscissa, case.quantity, note)
    axes.locator_params(nbins=5)
    zero = not reading.exact.any()
    if zero:
        axes.set_yscale("log")
        axes.set_ylim(_floor(pair), 10.0 * pair[0].tolerance)
        axes.axhline(pair[0].tolerance, color=INK, linewidth=1.0, linestyle="--")
        axes.text(reading.x[0], pair[0].tolerance, "tolerance", fontsize=8, color=INK, va="bottom")
    else:
        lines = axes.plot(reading.x, _shown(pair[0], exact=True), color=PALE, linewidth=7.0, solid_capstyle="round")
        lines[0].set_label("exact")
    every = -(-len(reading.x) // _MAX_MARKS)
    for outcome, mark, size in zip(pair, ("o", "x"), (6.0, 5.0), strict=True):
        y = _shown(outcome, exact=False)
        marks = axes.plot(
            reading.x[::every],
            np.abs(y[::every]) if zero else y[::every],
            mark,
            color=ENGINE_COLOUR[outcome.engine],
            markersize=size,
            markerfacecolor="white" if mark == "o" else None,
            markeredgewidth=1.4,
        )
        marks[0].set_label(outcome.engine)


def _floor(pair: Sequence[Outcome]) -> float:
    sizes = np.abs(np.concatenate([outcome.reading.measured for outcome in pair]))
    return float(0.1 * sizes[sizes > 0.0].min(initial=1e-3 * pair[0].tolerance))


def _shown(outcome: Outcome, *, exact: bool) -> FloatArray:
    """Values to draw, shape (n_x, n): of several components those that are not zero."""
    values = outcome.reading.exact if exact else outcome.reading.measured
    flat = values.reshape(len(outcome.reading.x), -1)
    some = np.abs(outcome.reading.exact.reshape(flat.shape)).max(axis=0) > 0.0
    return flat[:, some] if some.any() else flat


def _draw_numbers(axes: Axes, pairs: Sequence[Sequence[Outcome]]) -> None:
    """Deviations of single numbers from the exact ones, each over the tolerance of its case."""
    dress(axes, "Single results", "deviation over tolerance", "")
    names, row = [], 0
    for pair in pairs:
        labels = pair[0].case.quantity.split(", ")
        for k in range(len(pair[0].reading.x)):
            for outcome, mark in zip(pair, ("o", "x"), strict=True):
                reading = outcome.reading
                deviation = (reading.measured[k] - reading.exact[k]) / np.abs(reading.exact).max() / outcome.tolerance
                face = "white" if mark == "o" else None
                colour = ENGINE_COLOUR[outcome.engine]
                axes.plot(deviation, row, mark, color=colour, markersize=7, markerfacecolor=face, markeredgewidth=1.5)
            several = len(pair[0].reading.x) > 1
            part = labels[k] if len(labels) > k and len(labels) > 1 else f"mode {k + 1}"
            names.append(
                f"{pair[0].case.title.partition(',')[0]}\n{part.partition(' [')[0]}" if several else pair[0].case.title
            )
            row += 1
    axes.axvspan(-1.0, 1.0, color="#e8f3ec", zorder=0)
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    axes.set_xlim(-1.15, 1.15)
    axes.set_yticks(range(row), names)
    axes.set_ylim(row - 0.4, -0.6)


def _draw_meshes(axes: Axes, validation: Validation) -> None:
    dress(axes, "Order in the number of elements", "elements", "relative error")
    axes.set_xscale("log")
    axes.set_yscale("log")
    colours = dict(zip(dict.fromkeys(mesh.case.name for mesh in validation.meshes), COLOURS, strict=False))
    for mesh in validation.meshes:
        colour = colours.get(mesh.case.name, GREY)
        if mesh.engine == "fused":
            label = f"{mesh.case.title.partition(',')[0]}: {mesh.fitted:.2f}"
            lines = axes.plot(mesh.n_elem, mesh.error, "-o", color=colour, markersize=6, markerfacecolor="white")
            lines[0].set_label(label)
        else:
            axes.plot(mesh.n_elem, mesh.error, "x", color=colour, markersize=5.5, markeredgewidth=1.4)
    sizes = [n for mesh in validation.meshes for n in mesh.n_elem]
    if sizes:
        _guide(
            axes, (max(sizes), 0.25 * max(sizes)), min(e for mesh in validation.meshes for e in mesh.error) * 0.25, -2.0
        )
        axes.set_xticks(_ELEMENT_TICKS, [str(n) for n in _ELEMENT_TICKS])
        axes.minorticks_off()
        axes.set_xlim(0.8 * min(sizes), 1.3 * max(sizes))
        axes.set_ylim(top=20.0 * max(e for mesh in validation.meshes for e in mesh.error))
        axes.legend(frameon=False, fontsize=8.5, labelcolor=INK, loc="upper right")


def _draw_steps(axes: Axes, validation: Validation) -> None:
    note = "solid: order 2 expected, dashed: order 1"
    dress(axes, "Order in the time step", "dt over the largest of its scene", "relative error", note)
    axes.set_xscale("log")
    axes.set_yscale("log")
    colours = dict(zip(dict.fromkeys(steps.scene for steps in validation.steps), COLOURS, strict=False))
    for steps in validation.steps:
        x = np.array(steps.dt) / max(steps.dt)
        colour = colours.get(steps.scene, GREY)
        if steps.engine == "fused":
            how = {"pyelastica": ", as PyElastica", "symmetric": ", symmetric"}[steps.splitting] if steps.split else ""
            style = "--o" if steps.expected == 1.0 else "-o"
            label = f"{steps.scene}{how}: {steps.fitted:.2f}"
            axes.plot(x, steps.error, style, color=colour, markersize=6, markerfacecolor="white", label=label)
        else:
            axes.plot(x, steps.error, "x", color=colour, markersize=5.5, markeredgewidth=1.4)
    if validation.steps:
        _guide(axes, (0.25, 1.0), min(e for steps in validation.steps for e in steps.error) * 0.5, 2.0)
        axes.set_xticks([0.25, 0.5, 1.0], ["1/4", "1/2", "1"])
        axes.minorticks_off()
        axes.set_xlim(0.22, 1.15)
        axes.legend(frameon=False, fontsize=8.5, labelcolor=INK, loc="center left", bbox_to_anchor=(1.0, 0.5))


def _guide(axes: Axes, x: tuple[float, float], start: float, order: float) -> None:
    """Draw a grey line of the given slope from (x[0], start) to x[1]."""
    y = [start, start * (x[1] / x[0]) ** order]
    axes.plot(x, y, color=GREY, linewidth=1.0, linestyle=":")
    axes.text(np.sqrt(x[0] * x[1]), 0.5 * np.sqrt(y[0] * y[1]), "order 2", fontsize=8, color=GREY)
