"""Pictures of a diagnosis; matplotlib without a display. Blue: refitted base; orange: with the causes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from companion.core.geometry.frames import rotate
from sim.fitting.diagnose.selection.held_out import CHANNELS, HORIZONS_S, MODELS, OpenLoopError, Replay
from sim.fitting.diagnose.selection.residual_forces import ResidualForces
from sim.fitting.validate.figures import COLOURS, GREYS, INK

BASE, WITH = COLOURS[0], COLOURS[1]
LOOK = {"base": GREYS[1], "refit": BASE, "extended": WITH}
LABELS = {"base": "as given", "refit": "refitted", "extended": "with the causes"}
FORCES = ("X [N]", "Y [N]", "N [N m]")
BINS, SECTORS = 12, 16
MEAN, CHANGE = "residual force, mean and 2 sigma of it", "what the causes change, mean"
GRID = {"left": 0.08, "right": 0.99, "bottom": 0.1, "top": 0.92, "wspace": 0.1, "hspace": 0.12}
"""Fixed margins: a layout engine takes most of the time of a figure with many axes."""
LEAST_IN_BIN = 4
CELLS_M = (0.5, 1.0, 2.0)
MOST_BARS = 14
NATS_TICKS = (0, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 20000, 50000)
TICKS = (0.05, 0.1, 0.2, 0.5, 1, 2, 3, 5, 10, 20, 50, 100)


def over_time(before: ResidualForces, after: ResidualForces) -> Figure:
    """Latent force over the shared clock with 2 sigma: refitted base against the model with the causes."""
    figure = Figure(figsize=(11, 6.2))
    axes = figure.subplots(3, 1, sharex=True, gridspec_kw=GRID)
    for i, ax in enumerate(axes):
        for residual, colour, label in ((before, BASE, LABELS["refit"]), (after, WITH, LABELS["extended"])):
            for n, log in enumerate(np.unique(residual.log)):
                mine = residual.log == log
                t, f, s = residual.clock_s[mine] / 60, residual.force[mine, i], residual.sigma[mine, i]
                ax.fill_between(t, f - 2 * s, f + 2 * s, color=colour, alpha=0.2, lw=0)
                ax.plot(t, f, color=colour, lw=0.9, label=label if n == 0 else None)
        ax.axhline(0, color=INK, lw=0.6)
        ax.set_ylabel(FORCES[i])
        ends = [r.force[:, i] + side * r.sigma[:, i] for r in (before, after) for side in (-2, 2)]
        ax.set_ylim(*_axis_limits(np.concatenate(ends)))
    axes[-1].set_xlabel("t [min], all logs on one clock")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="upper center", ncols=2)
    return figure


def against(residual: ResidualForces, columns: Mapping[str, np.ndarray]) -> Figure:
    """Residual force of the refitted base over `columns` (W,) by label, with the force that the causes add."""
    figure = Figure(figsize=(11, 6.4))
    axes = figure.subplots(3, len(columns), sharex="col", sharey="row", squeeze=False, gridspec_kw=GRID)
    for i in range(3):
        for ax, (label, x) in zip(axes[i], columns.items(), strict=True):
            _binned(ax, x, residual.force[:, i], residual.cause[:, i])
            ax.locator_params(axis="x", nbins=5)
            ax.tick_params(labelsize=9)
            if i == 2:
                ax.set_xlabel(label)
        axes[i, 0].set_ylabel(FORCES[i])
        axes[i, 0].set_ylim(*_axis_limits(residual.force[:, i], 0.99))
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="upper center", ncols=2, fontsize=9)
    return figure


def over_heading(residual: ResidualForces) -> Figure:
    """Residual force over heading, polar: zero on the dark ring, positive outside it."""
    figure = Figure(figsize=(11, 4.4))
    psi = np.mod(residual.x[:, 2], 2 * np.pi)
    edges = np.linspace(0, 2 * np.pi, SECTORS + 1)
    middle = (edges[:-1] + edges[1:]) / 2
    axes = figure.subplots(
        1, 3, subplot_kw={"projection": "polar"}, gridspec_kw=GRID | {"bottom": 0.14, "top": 0.86, "wspace": 0.3}
    )
    for i, ax in enumerate(axes):
        ax.set_theta_zero_location("N")
        ax.set_theta_direction(-1)
        mean, se = means_by_bin(psi, residual.force[:, i], edges)
        cause, _ = means_by_bin(psi, residual.cause[:, i], edges)
        reach = 1.05 * float(np.nanmax(np.concatenate([np.abs(mean) + 2 * se, np.abs(cause)]), initial=1e-3))
        ring = np.linspace(0, 2 * np.pi, 200)
        ax.plot(ring, np.full(200, reach), color=INK, lw=1.4)
        ax.errorbar(middle, mean + reach, yerr=2 * se, fmt="o", ms=3, color=BASE, lw=1, label=MEAN)
        if residual.cause[:, i].any():
            closed = np.append(cause, cause[:1]) + reach
            ax.plot(np.append(middle, middle[:1]), closed, color=WITH, label=CHANGE)
        ax.set_ylim(0, 2 * reach)
        ax.spines["polar"].set_color(GREYS[1])
        ax.set_yticks([0, reach, 2 * reach], [f"{-reach:.2g}", "0", f"{reach:.2g}"], fontsize=9)
        ax.set_rlabel_position(45)
        ax.set_xticks(np.radians([0, 90, 180, 270]), ["N", "E", "S", "W"])
        ax.set_title(FORCES[i], fontsize=10)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncols=2, fontsize=9)
    return figure


def over_basin(before: ResidualForces, after: ResidualForces) -> Figure:
    """Mean residual force in cells of the basin as arrows: refitted base, and with the causes, to one scale."""
    figure = Figure(figsize=(11, 5.4))
    axes = figure.subplots(1, 2, gridspec_kw=GRID)
    size = next((m for m in CELLS_M if np.ptp(before.x[:, :2], axis=0).max() < 12 * m), CELLS_M[-1])
    cells = [_cells(residual, size) for residual in (before, after)]
    longest = max(float(np.hypot(*c[:, 2:].T).max(initial=0.0)) for c in cells) or 1.0
    for ax, c, colour, label in zip(axes, cells, (BASE, WITH), (LABELS["refit"], LABELS["extended"]), strict=True):
        arrows = ax.quiver(
            c[:, 1], c[:, 0], c[:, 3], c[:, 2], color=colour, angles="xy", scale_units="xy",
            scale=longest / (1.5 * size), width=0.004,
        )  # fmt: skip
        ax.quiverkey(arrows, 0.85, 1.04, longest / 1.5, f"{longest / 1.5:.2g} N", labelpos="E")
        tips = c[:, [1, 0]] + c[:, [3, 2]] * 1.5 * size / longest
        ax.update_datalim(tips)
        ax.set_title(label, loc="left")
        ax.set(xlabel="east [m]", aspect="equal", adjustable="datalim")
        ax.margins(0.1)
    axes[0].set_ylabel("north [m]")
    return figure


def tracks(replays: Sequence[Replay]) -> Figure:
    """Measured positions, and the models' open-loop tracks of the tag under the same commands."""
    figure = Figure(figsize=(5.4 * max(len(replays), 1), 5.2), layout="constrained")
    axes = figure.subplots(1, max(len(replays), 1), squeeze=False)[0]
    for ax, replay in zip(axes, replays, strict=False):
        ax.plot(replay.fixes_m[:, 1], replay.fixes_m[:, 0], ".", color=INK, ms=4, label="measured")
        for name in MODELS:
            track = replay.tracks[name]
            ax.plot(track[:, 1], track[:, 0], color=LOOK[name], lw=1.6, label=LABELS[name])
        ax.plot(*replay.tracks["extended"][0, ::-1], "o", color=INK, ms=6)
        low, high = replay.fixes_m.min(axis=0), replay.fixes_m.max(axis=0)
        middle, half = (low + high) / 2, 0.75 * max(float((high - low).max()), 1.0)
        ax.set(xlim=(middle[1] - half, middle[1] + half), ylim=(middle[0] - half, middle[0] + half), aspect="equal")
        ax.set(title=f"20 s from t = {replay.start_s:.0f} s", xlabel="east [m]", ylabel="north [m]")
    axes[0].legend(fontsize=8, loc="upper right")
    return figure


def held_out(errors: Sequence[OpenLoopError]) -> Figure:
    """Rms error on held-out logs by channel and horizon, with 95 % intervals where there are any."""
    shown = {channel: mine for channel in CHANNELS if (mine := [e for e in errors if e.channel == channel])}
    figure = Figure(figsize=(11, 3.4))
    axes = figure.subplots(1, max(len(shown), 1), squeeze=False, gridspec_kw=GRID | {"bottom": 0.17, "wspace": 0.35})[0]
    for ax, (channel, mine) in zip(axes, shown.items(), strict=False):
        for j, name in enumerate(MODELS):
            at = np.array([HORIZONS_S.index(e.horizon_s) for e in mine]) + 0.27 * (j - 1)
            rms = np.array([e.rms[name] for e in mine])
            ends = np.array([e.ci95[name] for e in mine]).reshape(-1, 2).T
            spread = np.where(np.isfinite(ends).all(axis=0), np.abs(ends - rms), 0.0)
            ax.bar(at, rms, 0.25, yerr=spread, color=LOOK[name], label=LABELS[name], error_kw={"lw": 0.8})
        ax.set_xticks(range(len(HORIZONS_S)), [f"{h} s" for h in HORIZONS_S])
        ax.set_xlim(-0.5, len(HORIZONS_S) - 0.5)  # room for all horizons, where short logs reach the first alone
        ax.set_title(f"{channel} [{CHANNELS[channel]}]", fontsize=10)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncols=3, fontsize=9)
    return figure


def evidence(named: Mapping[str, float], others: Mapping[str, tuple[float, float]], least: float) -> Figure:
    """Nats for every cause, and for the best that was not named at the last step, with the line of acceptance.

    `others`: nats and size over the smallest worth a name.
    """
    rest = dict(sorted(others.items(), key=lambda kv: -kv[1][0])[: max(MOST_BARS - len(named), 4)])
    bars = [(k, v, WITH, "named") for k, v in named.items()]
    bars += [(k, v, GREYS[0], f"{size:.1f}" if v >= least else "") for k, (v, size) in rest.items() if k not in named]
    figure = Figure(figsize=(9, 0.3 * len(bars) + 1.3), layout="constrained")
    ax = figure.add_subplot()
    at = np.arange(len(bars))[::-1]
    ax.barh(at, [v for _, v, _, _ in bars], color=[c for _, _, c, _ in bars])
    for y, (_, v, _, text) in zip(at, bars, strict=True):
        ax.text(max(v, 0.0), y, f" {text}", va="center", fontsize=8)
    ax.axvline(least, color=INK, lw=1.2, ls="--", label=f"{least:g} nats: named above")
    ax.set_yticks(at, [k for k, _, _, _ in bars], fontsize=8)
    ax.set_xscale("symlog", linthresh=10)
    most = max([v for _, v, _, _ in bars], default=least)
    ax.set_xlim(float(np.clip(min([v for _, v, _, _ in bars], default=0.0), -10, 0)) - 0.5, 2 * max(most, least))
    ax.set_xticks(shown := [n for n in NATS_TICKS if n < 2 * max(most, least)], [f"{n:g}" for n in shown])
    ax.minorticks_off()
    ax.set_xlabel("evidence over its absence [nats]")
    ax.legend(fontsize=8, loc="lower right")
    return figure


def whiteness(before: Mapping[str, np.ndarray], after: Mapping[str, np.ndarray], samples: Mapping[str, int]) -> Figure:
    """Correlation of one-step errors with those before them, by channel; grey: where white noise would lie."""
    known = [name for name in before if np.isfinite(before[name]).all()]
    figure = Figure(figsize=(11, 3.2))
    axes = figure.subplots(1, max(len(known), 1), sharey=True, squeeze=False, gridspec_kw=GRID | {"bottom": 0.26})[0]
    for ax, name in zip(axes, known, strict=False):
        lags = np.arange(1, len(before[name]) + 1)
        band = 2 / np.sqrt(max(samples[name], 1))
        ax.axhspan(-band, band, color=GREYS[1], alpha=0.4, lw=0)
        ax.plot(lags, before[name], color=BASE, lw=1.2, label=LABELS["refit"])
        ax.plot(lags, after[name], color=WITH, lw=1.2, label=LABELS["extended"])
        ax.set_title(name, fontsize=9)
        ax.set_xlabel("samples apart", fontsize=8)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncols=2, fontsize=9)
    return figure


def sizes(rows: Sequence[tuple[str, float, float, float]]) -> Figure:
    """Size of each cause over the smallest worth a name, with its 95 % interval: name, low, value, high."""
    figure = Figure(figsize=(9, 0.4 * len(rows) + 1.2), layout="constrained")
    ax = figure.add_subplot()
    at = np.arange(len(rows))[::-1]
    low, value, high = np.array([row[1:] for row in rows]).T
    low = np.maximum(low, 0.05)
    ax.errorbar(value, at, xerr=[value - low, high - value], fmt="o", color=WITH, capsize=4)
    ax.axvline(1.0, color=INK, ls="--", lw=1.2, label="smallest size worth a name")
    ax.set_yticks(at, [row[0] for row in rows], fontsize=9)
    ax.set(xlabel="size over the smallest worth a name, 95 % interval", ylim=(-0.7, len(rows) - 0.3), xscale="log")
    ends = min(0.5, float(low.min())), 2 * float(high.max())
    ax.set_xlim(*ends)
    ticks = [t for t in TICKS if ends[0] <= t <= ends[1]]
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
    ax.minorticks_off()
    ax.legend(fontsize=8, loc="upper right")
    return figure


def _binned(ax: Axes, x: np.ndarray, force: np.ndarray, cause: np.ndarray) -> None:
    """Force over x as points, means of equal bins with 2 standard errors, and the mean that the causes add."""
    known = np.isfinite(x)
    x, force, cause = x[known], force[known], cause[known]
    ax.plot(x, force, ".", ms=1.5, color="#bbbbbb", zorder=1)
    ax.axhline(0, color=INK, lw=0.6)
    edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))
    if len(edges) < 3:
        return
    middle = (edges[:-1] + edges[1:]) / 2
    mean, se = means_by_bin(x, force, edges)
    ax.errorbar(middle, mean, yerr=2 * se, fmt="o", ms=3, lw=1, color=BASE, zorder=3, label=MEAN)
    if cause.any():
        ax.plot(middle, means_by_bin(x, cause, edges)[0], color=WITH, lw=1.6, zorder=4, label=CHANGE)


def means_by_bin(x: np.ndarray, y: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of y in each bin and its standard error, one independent sample every 5 s; NaN in bins with few."""
    of = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    mean, se = np.full(len(edges) - 1, np.nan), np.full(len(edges) - 1, np.nan)
    for i in range(len(mean)):
        mine = y[of == i]
        if len(mine) >= LEAST_IN_BIN:
            mean[i], se[i] = mine.mean(), mine.std() / np.sqrt(max(len(mine) / 5, 1))
    return mean, se


def _cells(residual: ResidualForces, size_m: float) -> np.ndarray:
    """Rows north, east, force north, force east of each cell with enough windows."""
    force = np.column_stack(rotate(residual.x[:, 2], *residual.force[:, :2].T))
    place = residual.x[:, :2]
    cell, of = np.unique(np.floor(place / size_m).astype(int), axis=0, return_inverse=True)
    of = of.ravel()
    many = np.bincount(of) >= LEAST_IN_BIN
    mean = np.array([force[of == i].mean(axis=0) for i in np.flatnonzero(many)]).reshape(-1, 2)
    return np.hstack([(cell[many] + 0.5) * size_m, mean])


def _axis_limits(values: np.ndarray, share: float = 0.998) -> tuple[float, float]:
    """Limits of an axis: the central `share` of the values, zero, and a margin."""
    low, high = np.quantile(values, (1 - share, share))
    room = 0.15 * max(high - low, 1e-3)
    return min(low, 0.0) - room, max(high, 0.0) + room
