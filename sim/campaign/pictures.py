"""Distributions of a campaign's figures: a histogram of each, or where a grid parts the cases a curve for each part."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sim.fitting.validate.figures import COLOURS, INK

ACROSS = 3
FEW = 8
"""Fewer values than this are drawn one by one, not as a histogram."""
ROUND_OFF = 1e-9
"""Values that differ by less than this share of their size are one value; assumed."""
STYLES = ("-", "--", ":")
HATCHES = ("", "///", "...")
"""How parts beyond the number of colours are told from those of the same colour, as lines and as bars."""


def distributions(parts: Mapping[str, Mapping[str, np.ndarray]], names: Sequence[str]) -> Figure:
    """One panel for each figure of `names`. `parts`: by part of the grid, values by figure (NaN: none)."""
    down = -(-len(names) // ACROSS)
    figure = Figure(figsize=(11, 2.6 * down + 0.5), layout="constrained")
    axes = figure.subplots(down, ACROSS, squeeze=False).ravel()
    for ax, name in zip(axes, names, strict=False):
        values = {part: columns[name] for part, columns in parts.items()}
        if len(values) == 1:
            _histogram(ax, _known(next(iter(values.values()))))
        else:
            _curves(ax, values)
        ax.set_title(name, fontsize=9)
        ax.tick_params(labelsize=8)
        ax.xaxis.set_major_locator(MaxNLocator(5))
    for ax in axes[len(names) :]:
        ax.set_axis_off()
    if len(parts) > 1:
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=min(3, len(parts)), fontsize=8)
    return figure


def errors(sigmas: Mapping[str, np.ndarray]) -> Figure:
    """Errors of fitted parameters in their own standard errors: median, middle half, and 95 % of the cases."""
    figure = Figure(figsize=(11, 0.26 * len(sigmas) + 1.2), layout="constrained")
    ax = figure.add_subplot()
    at = np.arange(len(sigmas))[::-1]
    ax.axvspan(-1.96, 1.96, color="#eeeeee", label="95 % of honest errors")
    for y, values in zip(at, sigmas.values(), strict=True):
        quarter, middle, three = np.quantile(_known(values), [0.25, 0.5, 0.75])
        low, high = not_exceeded(_known(values), 0.025), not_exceeded(_known(values), 0.975)
        ax.plot([low, high], [y, y], color=COLOURS[0], lw=1, label="95 % of the cases" if y == 0 else None)
        ax.plot([quarter, three], [y, y], color=COLOURS[0], lw=4, label="half of the cases" if y == 0 else None)
        ax.plot(middle, y, "|", color=INK, ms=9, label="median" if y == 0 else None)
    ax.axvline(0.0, color=INK, lw=0.8)
    ax.set_yticks(at, list(sigmas), fontsize=8)
    ax.set(xlabel="(fitted - true) / standard error", ylim=(-0.7, len(sigmas) - 0.3))
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=8)
    return figure


def counts(parts: Mapping[str, Mapping[str, int]]) -> Figure:
    """How often each text came, a bar in each part of the grid."""
    every = sum((Counter(counts_of_part) for counts_of_part in parts.values()), Counter[str]())
    words = [word for word, _ in every.most_common()]
    figure = Figure(figsize=(11, 0.3 * len(words) + 1.2), layout="constrained")
    ax = figure.add_subplot()
    left = np.zeros(len(words))
    for i, (part, counts_of_part) in enumerate(parts.items()):
        many = np.array([counts_of_part.get(w, 0) for w in words], dtype=float)
        colour, hatch = COLOURS[i % len(COLOURS)], HATCHES[i // len(COLOURS) % len(HATCHES)]
        ax.barh(np.arange(len(words))[::-1], many, left=left, color=colour, hatch=hatch, label=part)
        left += many
    ax.set_yticks(np.arange(len(words))[::-1], [w or "(none)" for w in words], fontsize=8)
    ax.set(xlabel="cases")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    if len(parts) > 1:
        figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    return figure


def not_exceeded(values: np.ndarray, share: float) -> float:
    """The least of the values that this share of them, or more, do not exceed: for 95 % of less than 20 the largest."""
    return float(np.quantile(values, share, method="inverted_cdf"))


def _known(values: np.ndarray) -> np.ndarray:
    return np.sort(values[np.isfinite(values)])


def _histogram(ax: Axes, values: np.ndarray) -> None:
    if len(values) < FEW:
        ax.plot(values, np.zeros(len(values)), "|", color=COLOURS[0], ms=14)
        ax.set_yticks([])
        return
    size = float(np.abs(values).max())
    if np.ptp(values) <= ROUND_OFF * size:
        bins, margin = 1, 0.05 * (size or 1.0)
    else:
        bins, margin = min(40, max(8, round(len(values) ** 0.5))), 0.0
    ax.hist(values, bins, range=(values[0] - margin, values[-1] + margin), color=COLOURS[0], alpha=0.85)
    for at, style in ((float(np.median(values)), "-"), (not_exceeded(values, 0.95), "--")):
        ax.axvline(at, color=INK, ls=style, lw=1)
    ax.set_ylabel("cases", fontsize=8)
    ax.yaxis.set_major_locator(MaxNLocator(integer=True))


def _curves(ax: Axes, parts: Mapping[str, np.ndarray]) -> None:
    """Share of all cases of a part (NaN: those without the figure) that are at most so large.

    A part without any value has its name in the legend alone.
    """
    for i, (part, every) in enumerate(parts.items()):
        values = _known(every)
        at = np.concatenate([values[:1], values])
        share = np.arange(len(at)) / max(len(every), 1)
        style = STYLES[i // len(COLOURS) % len(STYLES)]
        ax.step(
            at,
            100 * share,
            style,
            where="post",
            color=COLOURS[i % len(COLOURS)],
            lw=1.4,
            label=part,
        )
    ax.set_ylabel("cases [%]", fontsize=8)
    ax.set_ylim(0, 102)
    ax.grid(alpha=0.3)
