"""The picture of the divergence report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.lines import Line2D

from lattice_gym.benchmarks.divergence.judge import OK, REFINEMENT, RIGHT, WRONG, Run
from lattice_gym.benchmarks.figures import GREY, dress, new_figure, save
from lattice_gym.engines.step_doubling import STEP_TOLERANCE
from lattice_gym.physics.energy import ENERGY_TOLERANCE

COLOUR = {
    OK: "#9aa5b1",
    "non_finite": "#1b1b1b",
    "overstretched": "#c1443c",
    "inverted": "#e39b3b",
    "torn": "#3b78b5",
    "energy": "#6a3d9a",
    "inaccurate": "#2f8f5b",
}
"""Of each end of a run."""
MARKER = {"right": "o", "between": "o", "wrong": "o", "collapsed": "s"}
TOP, LEAST = 10.0, 1e-7
"""What is beyond is drawn at the edge."""


def _clipped(value: float) -> float:
    return min(max(value, LEAST), TOP)


def draw(runs: Sequence[Run], path: Path) -> None:
    """Draw what was compared: deviation over step, and what two checks see over deviation; a colour for each end."""
    figure = new_figure(14.0, 4.6)
    left, middle, right = panels = figure.subplots(1, 3)
    distance = f"largest distance from the run at dt/{REFINEMENT} [height]"
    dress(left, "", "time step over the predicted critical one", f"{distance}\n(top: 10 and more, or not finite)")
    dress(middle, "", distance, "energy check: spurious energy in a control step\nover the energy at stake")
    dress(right, "", distance, "step check: largest distance from the run at dt/2\n[longest side]")
    for run in (run for run in runs if run.verdict in MARKER):
        x = _clipped(run.deviation)
        style: dict[str, Any] = {"marker": MARKER[run.verdict], "ms": 4.5, "mec": "white", "mew": 0.4}
        style["color"] = COLOUR[run.status]
        left.plot(run.share, x, **style)
        middle.plot(x, min(max(run.residual, 1e-6), 1.0), **style)
        right.plot(x, _clipped(run.step_error), **style)
    for level, text in ((RIGHT, "right below"), (WRONG, "wrong above")):
        left.axhline(level, color=GREY, lw=0.8, ls="--")
        edge = left.get_yaxis_transform()
        left.annotate(text, (1.0, level), xycoords=edge, fontsize=8, va="bottom", ha="right", color=GREY)
        for axes in (middle, right):
            axes.axvline(level, color=GREY, lw=0.8, ls="--")
    for axes, name, level in ((middle, "energy", ENERGY_TOLERANCE), (right, "inaccurate", STEP_TOLERANCE)):
        axes.axhline(level, color=COLOUR[name], lw=0.8, ls="--")
        axes.annotate("flagged above", (LEAST, level), fontsize=8, va="bottom", color=COLOUR[name])
        axes.set(xscale="log", xlim=(LEAST / 2, 2.0 * TOP))
    for axes in panels:
        axes.set(yscale="log", ylim=(LEAST / 2, 2.0 * TOP))
    middle.set_ylim(5e-7, 2.0)
    ends = [status for status in COLOUR if any(run.status == status for run in runs)]
    handles = [Line2D([], [], ls="", marker="o", color=COLOUR[end], label=end.replace("_", " ")) for end in ends]
    handles.append(Line2D([], [], ls="", marker="s", color=GREY, label=f"dt/{REFINEMENT} flagged, too"))
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), fontsize=9, frameon=False)
    save(figure, path)
