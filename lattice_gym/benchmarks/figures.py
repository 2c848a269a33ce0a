"""The look that the reports' figures share."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lattice_gym.rendering import figures

INK, GREY, PALE = "#22303c", "#7c8894", "#d5dde4"
COLOURS = (
    *("#0b7fab", "#e4572e", "#2a9d5c", "#8e5bb5", "#d19a00", "#6b7a88"),
    *("#1f3b73", "#b5446e", "#4aa3a2", "#8c6d31", "#3d9a3d"),
)
"""One after another for what is shown side by side."""
ENGINE_COLOUR = {"fused": COLOURS[0], "pyelastica": COLOURS[1]}


def new_figure(width: float, height: float) -> Figure:
    """Empty figure of a size [inch], drawn with no display."""
    return Figure(figsize=(width, height), facecolor="white", layout="constrained")


def dress(axes: Axes, title: str = "", x: str = "", y: str = "", note: str = "") -> None:
    """Give a panel its title, a note below it, the labels of its axes, and the grid that all panels have."""
    axes.set_title(title, loc="left", fontsize=10.5, fontweight="bold", color=INK, pad=17 if note else 6)
    axes.text(0.0, 1.02, note, transform=axes.transAxes, fontsize=8, color=GREY, va="bottom")
    axes.set_xlabel(x, fontsize=9, color=INK, labelpad=1)
    axes.set_ylabel(y, fontsize=9, color=INK, labelpad=2)
    axes.tick_params(labelsize=8, colors=GREY, length=3)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(PALE)
    axes.grid(color=PALE, linewidth=0.5, alpha=0.7)
    axes.set_axisbelow(True)


def save(figure: Figure, path: Path) -> None:
    """Write the PNG."""
    figures.save(figure, path, dpi=130)
