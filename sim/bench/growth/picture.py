"""Growth as a picture: cost over size, both logarithmic, a panel for each size that is varied."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FormatStrFormatter, LogLocator, NullFormatter, NullLocator

from sim.bench.result import Bench, Growth

WIDTH_IN, HEIGHT_IN = 4.2, 3.4
MARKERS = "osD^v"
FEW = 100.0
"""Range of values below which powers of ten alone are too few ticks."""


def draw(bench: Bench, path: Path) -> None:
    """Write the picture; the suffix says its kind. ValueError where nothing grew."""
    panels: dict[str, list[Growth]] = {}
    for g in bench.growth:
        panels.setdefault(g.by, []).append(g)
    if not panels:
        raise ValueError("no growth was measured: --growth")
    across = min(len(panels), 2)
    down = -(-len(panels) // across)
    figure = Figure(figsize=(WIDTH_IN * across, HEIGHT_IN * down), layout="constrained")
    axes = np.atleast_1d(figure.subplots(down, across)).ravel()
    for ax, (by, curves) in zip(axes, panels.items(), strict=False):
        _panel(ax, by, curves)
    for ax in axes[len(panels) :]:
        ax.set_axis_off()
    figure.savefig(path, dpi=150)


def _panel(ax: Axes, by: str, curves: list[Growth]) -> None:
    sizes = sorted({p.size for g in curves for p in g.points})
    for g, marker in zip(curves, MARKERS, strict=False):
        label = f"{g.what}: {g.first_exponent:.1f} to {g.last_exponent:.1f}"
        ax.plot([p.size for p in g.points], [p.value for p in g.points], marker=marker, ms=4, lw=1.2, label=label)
    ax.set(xscale="log", yscale="log", xlabel=by, ylabel=curves[0].unit)
    ax.xaxis.set_major_locator(FixedLocator(sizes))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_xticklabels([f"{s:g}" for s in sizes])
    low, high = ax.get_ylim()
    ax.set_ylim(low, high * (high / low) ** 0.3)
    ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high / low < FEW else (1,)))
    ax.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.grid(True, which="major", alpha=0.3)
    ax.legend(fontsize=7, title="power, first and last pair", title_fontsize=7, loc="upper left")
