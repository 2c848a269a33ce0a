"""The picture of the throughput report: batches above, below what a scene, a finer mesh, muscles and rods cost."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lattice_gym.benchmarks.scaling import Growth
from lattice_gym.benchmarks.throughput_study import N_SUBSTEPS, Batches, thread_counts
from lattice_gym.benchmarks.timing import median
from lattice_gym.rendering.extras import extra

TEXT, GRID, REFERENCE, FIT = "#333333", "#dddddd", "#8c6d31", "#222222"
COLOURS = ("#5b84b1", "#b5305f", "#3d8f6e", "#c98b2b", "#7b5ea7")
US = 1e6


def draw(
    worms: Batches, scenes: dict[str, list[float]], grown: dict[str, Growth], cache: int | None, path: Path
) -> None:
    """Write the PNG."""
    figure = extra("matplotlib.figure").Figure(figsize=(13.5, 7.6), layout="constrained")
    rows = figure.subplots(2, 3)
    _draw_batches(rows[0, 0], worms)
    _draw_cost(rows[0, 1], worms)
    _draw_scenes(rows[0, 2], scenes)
    _draw_elements(rows[1, 0], grown["elements"], cache)
    for axes, name in zip(rows[1, 1:], ("muscles", "rods"), strict=True):
        _draw_growth(axes, grown[name], name)
    for axes in rows.flat:
        axes.grid(which="major", color=GRID, linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=9, colors=TEXT)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


def _colour(index: int) -> str:
    return COLOURS[index % len(COLOURS)]


def _points(axes: Any, count: list[int], times: list[list[float]], scale: float, **style: Any) -> None:
    """Medians, with bars from the least to the greatest."""
    middle = [scale * median(own) for own in times]
    low = [m - scale * min(own) for m, own in zip(middle, times, strict=True)]
    high = [scale * max(own) - m for m, own in zip(middle, times, strict=True)]
    axes.errorbar(count, middle, yerr=[low, high], elinewidth=0.8, capsize=2, markersize=5, **style)


def _by_threads(axes: Any, keys: list[tuple[int, int]], threads: int) -> list[int]:
    axes.set_xlabel("worms", fontsize=10, color=TEXT)
    axes.set_xscale("log", base=2)
    return [n_worm for n_worm, own in keys if own == threads]


def _draw_batches(axes: Any, worms: Batches) -> None:
    for k, threads in enumerate(thread_counts()):
        count = _by_threads(axes, list(worms.physics), threads)
        steps = [1.0 / median(worms.physics[n_worm, threads]) for n_worm in count]
        axes.plot(count, steps, color=_colour(k), marker="o", markersize=5, label=f"physics, threads: {threads}")
        control = [N_SUBSTEPS / median(worms.control[n_worm, threads]) for n_worm in count]
        axes.plot(
            count, control, color=_colour(k), marker="^", markersize=5, linestyle="--",
            label=f"environment, threads: {threads}",
        )  # fmt: skip
    axes.axhline(1.0 / median(worms.plain), color=REFERENCE, linewidth=1.2, label="plain PyElastica, one worm")
    axes.set_yscale("log")
    axes.set_ylabel("worm-steps / s", fontsize=10, color=TEXT)
    axes.set_title("Batches", fontsize=12, color=TEXT)
    axes.legend(fontsize=8, frameon=False)


def _draw_cost(axes: Any, worms: Batches) -> None:
    for k, threads in enumerate(thread_counts()):
        count = _by_threads(axes, list(worms.physics), threads)
        times = [worms.physics[n_worm, threads] for n_worm in count]
        _points(axes, count, times, US, color=_colour(k), marker="o", label=f"threads: {threads}")
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("us per worm and step", fontsize=10, color=TEXT)
    axes.set_title("Cost of a worm in a batch", fontsize=12, color=TEXT)
    axes.legend(fontsize=8, frameon=False)


def _draw_scenes(axes: Any, scenes: dict[str, list[float]]) -> None:
    names = list(scenes)[::-1]
    costs = [US * median(scenes[name]) for name in names]
    axes.barh(names, costs, color=[_colour(1) if name == "bare" else _colour(0) for name in names], height=0.65)
    for row, cost in enumerate(costs):
        axes.annotate(f"{cost:.3g}", (cost, row), xytext=(3, 0), textcoords="offset points", va="center", fontsize=8)
    axes.set_xscale("log")
    axes.set_xlim(left=1.0, right=2.0 * max(costs))
    axes.set_xlabel("us per step", fontsize=10, color=TEXT)
    axes.set_title("What a scene has", fontsize=12, color=TEXT)


def _draw_growth(axes: Any, growth: Growth, name: str) -> None:
    _points(axes, growth.count, growth.times, US, color=_colour(0), marker="o", linestyle="none")
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(left=0.0)
    axes.set_xlabel(name, fontsize=10, color=TEXT)
    axes.set_ylabel("us per step", fontsize=10, color=TEXT)
    axes.set_title(f"Cost against {name}", fontsize=12, color=TEXT)


def _draw_elements(axes: Any, growth: Growth, cache: int | None) -> None:
    _draw_growth(axes, growth, "elements")
    held = growth.within(cache)
    if (line := held.line()) is not None:
        ends = [0, growth.count[-1]]
        label = f"{US * line.start:.2g} us + {1e3 * US * line.slope:.3g} ns per element"
        axes.plot(ends, [US * (line.start + line.slope * n) for n in ends], color=FIT, linewidth=1.0, label=label)
    if len(held.count) < len(growth.count):
        edge = 0.5 * (held.count[-1] + growth.count[len(held.count)]) if held.count else 0.0
        axes.axvline(edge, color=REFERENCE, linewidth=1.0, linestyle=(0, (4, 3)), label="beyond the second-level cache")
    axes.legend(fontsize=8, frameon=False)
