"""The picture of the throughput report: batches above, below what a scene, a finer mesh, muscles and rods cost."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from lattice_gym.benchmarks.figures import COLOURS, GREY, INK, dress, new_figure, save
from lattice_gym.benchmarks.throughput.growth import Growth
from lattice_gym.benchmarks.throughput.study import N_SUBSTEPS, Batches, thread_counts
from lattice_gym.benchmarks.timing import median

US = 1e6


def draw(
    worms: Batches, features: dict[str, list[float]], grown: dict[str, Growth], cache: int | None, path: Path
) -> None:
    """Write the PNG."""
    figure = new_figure(13.5, 7.6)
    rows = figure.subplots(2, 3)
    _draw_batches(rows[0, 0], worms)
    _draw_cost(rows[0, 1], worms)
    _draw_features(rows[0, 2], features)
    _draw_elements(rows[1, 0], grown["elements"], cache)
    for axes, name in zip(rows[1, 1:], ("muscles", "rods"), strict=True):
        _draw_growth(axes, grown[name], name)
    save(figure, path)


def _colour(index: int) -> str:
    return COLOURS[index % len(COLOURS)]


def _points(axes: Axes, count: list[int], times: list[list[float]], scale: float, **style: Any) -> None:
    """Medians, with bars from the least to the greatest."""
    middle = [scale * median(own) for own in times]
    low = [m - scale * min(own) for m, own in zip(middle, times, strict=True)]
    high = [scale * max(own) - m for m, own in zip(middle, times, strict=True)]
    axes.errorbar(count, middle, yerr=[low, high], elinewidth=0.8, capsize=2, markersize=5, **style)


def _by_threads(axes: Axes, keys: list[tuple[int, int]], threads: int) -> list[int]:
    axes.set_xscale("log", base=2)
    return [n_worm for n_worm, own in keys if own == threads]


def _draw_batches(axes: Axes, worms: Batches) -> None:
    for k, threads in enumerate(thread_counts()):
        count = _by_threads(axes, list(worms.physics), threads)
        steps = [1.0 / median(worms.physics[n_worm, threads]) for n_worm in count]
        axes.plot(count, steps, color=_colour(k), marker="o", markersize=5, label=f"physics, threads: {threads}")
        control = [N_SUBSTEPS / median(worms.control[n_worm, threads]) for n_worm in count]
        axes.plot(
            count, control, color=_colour(k), marker="^", markersize=5, linestyle="--",
            label=f"environment, threads: {threads}",
        )  # fmt: skip
    axes.axhline(1.0 / median(worms.plain), color=GREY, linewidth=1.2, label="plain PyElastica, one worm")
    axes.set_yscale("log")
    dress(axes, "Batches", "worms", "worm-steps / s")
    axes.legend(fontsize=8, frameon=False)


def _draw_cost(axes: Axes, worms: Batches) -> None:
    for k, threads in enumerate(thread_counts()):
        count = _by_threads(axes, list(worms.physics), threads)
        times = [worms.physics[n_worm, threads] for n_worm in count]
        _points(axes, count, times, US, color=_colour(k), marker="o", label=f"threads: {threads}")
    axes.set_ylim(bottom=0.0)
    dress(axes, "Cost of a worm in a batch", "worms", "us per worm and step")
    axes.legend(fontsize=8, frameon=False)


def _draw_features(axes: Axes, features: dict[str, list[float]]) -> None:
    names = list(features)[::-1]
    costs = [US * median(features[name]) for name in names]
    axes.barh(names, costs, color=[_colour(1) if name == "bare" else _colour(0) for name in names], height=0.65)
    for row, cost in enumerate(costs):
        axes.annotate(f"{cost:.3g}", (cost, row), xytext=(3, 0), textcoords="offset points", va="center", fontsize=8)
    axes.set_xscale("log")
    axes.set_xlim(left=1.0, right=2.0 * max(costs))
    dress(axes, "What a feature costs", "us per step")


def _draw_growth(axes: Axes, growth: Growth, name: str) -> None:
    _points(axes, growth.count, growth.times, US, color=_colour(0), marker="o", linestyle="none")
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(left=0.0)
    dress(axes, f"Cost against {name}", name, "us per step")


def _draw_elements(axes: Axes, growth: Growth, cache: int | None) -> None:
    _draw_growth(axes, growth, "elements")
    held = growth.within(cache)
    if (line := held.line()) is not None:
        ends = [0, growth.count[-1]]
        label = f"{US * line.start:.2g} us + {1e3 * US * line.slope:.3g} ns per element"
        axes.plot(ends, [US * (line.start + line.slope * n) for n in ends], color=INK, linewidth=1.0, label=label)
    if len(held.count) < len(growth.count):
        edge = 0.5 * (held.count[-1] + growth.count[len(held.count)]) if held.count else 0.0
        axes.axvline(edge, color=GREY, linewidth=1.0, linestyle=(0, (4, 3)), label="beyond the second-level cache")
    axes.legend(fontsize=8, frameon=False)
