"""One picture of one log: track, cross-track error, speeds, heading, thruster PWM, innovations, timing.

Colours: Okabe and Ito's palette, which colour-blind readers can distinguish (https://jfly.uni-koeln.de/color).
matplotlib is an optional dependency (extra `analysis`): nothing on the boat imports this module.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from companion.cli.options.outputs import making
from companion.core.constants import NEUTRAL_US
from companion.core.messages import (
    GroundTruth,
    GuidanceReference,
    LoopTiming,
    PlanResult,
    StateEstimate,
    Tick,
)
from companion.logs.log_file import LogError, LogFile
from companion.logs.series import Series, broken, collect

BLUE, ORANGE, GREEN, VERMILION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
SKY, PURPLE, BLACK, GREY = "#56B4E9", "#CC79A7", "#000000", "#8C8C8C"
CYCLE = (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILION, "#B8A800", BLACK)
SOURCES = {"shifted_plan": SKY, "pd": ORANGE, "neutral": GREY}
MOST_ROWS = 4
GATE_SIGMA = 3.0  # line to guide the eye; the filter's own gate decides what is accepted

STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.grid": True,
    "grid.color": "#E4E4E4",
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "legend.markerscale": 1.5,
    "legend.handlelength": 1.4,
    "legend.handletextpad": 0.4,
    "legend.columnspacing": 1.0,
    "lines.linewidth": 1.3,
}


def plot(log: LogFile, out: Path, *, truth: LogFile | None = None, title: str | None = None) -> None:
    """Draw `log` into the PNG `out`. `truth`: the simulator's log of the same run, where there is one.

    Raises LogError: nothing to draw; ConfigError: `out` cannot be written.
    """
    series = collect(log, truth)
    nothing_in(log, series)
    figure = Figure(figsize=(15, 10), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    draw(figure, series, title or _title(log, series))
    save(figure, out)


def nothing_in(log: LogFile, series: Series) -> None:
    """Raise LogError where there is nothing to draw."""
    if not any(len(columns) for columns in series.columns.values()) and not len(series.lease_t_s):
        raise LogError(f"{log.path}: nothing to plot: no estimates, references, leases or ticks in it")


def save(figure: Figure, out: Path, **options: Any) -> None:
    """Write the picture, in the format of its name. Raises ConfigError with the path."""
    with making(out, ValueError):
        figure.savefig(out, **options)


def draw(figure: Figure, series: Series, title: str) -> None:
    """All panels of `series` into an empty `figure`."""
    with mpl.rc_context(STYLE):
        grid = figure.add_gridspec(6, 2, width_ratios=(1.0, 1.15))
        track(figure.add_subplot(grid[0:4, 0]), series)
        left = figure.add_subplot(grid[4, 0])
        for panel, place in (
            (heading, grid[5, 0]),
            (speeds, grid[0:2, 1]),
            (pwm, grid[2, 1]),
            (_innovations, grid[3:5, 1]),
            (_timing, grid[5, 1]),
        ):
            axes = figure.add_subplot(place, sharex=left)
            panel(axes, series)
            if place.is_last_row():
                axes.set_xlabel("time since start of log [s]")
        cross_track(left, series)
        left.set_xlim(0.0, max(series.duration_s, 1e-3))
        figure.suptitle(title, fontsize=12, fontweight="bold", x=0.01, ha="left", parse_math=False)
        _part_legends_from_titles(figure)


def _title(log: LogFile, series: Series) -> str:
    vessel = log.metadata.get("vessel", "vessel not stated")
    config = log.metadata.get("config_sha256", "unknown")[:12]
    damage = "  (damaged log)" if log.damage else ""
    return f"{log.path.name}: {vessel}, {series.duration_s:.0f} s, configuration {config}{damage}"


def track(axes: Axes, series: Series) -> None:
    """North over east: fence, anchors, tag by UWB or antenna by GNSS, reference, truth, estimate with some headings."""
    axes.set(title="Track", xlabel="east [m]", ylabel="north [m]")
    reference, estimate, truth = series[GuidanceReference], series[StateEstimate], series[GroundTruth]
    if series.site:
        fence = np.array([*series.site.fence, series.site.fence[0]])
        axes.plot(fence[:, 1], fence[:, 0], color=GREY, lw=1.0, label="fence")
        anchors = np.array([(a.north_m, a.east_m) for a in series.site.anchors]).reshape(-1, 2)
        if len(anchors):
            axes.plot(anchors[:, 1], anchors[:, 0], "^", color=PURPLE, ms=7, label="UWB anchor")
    if len(series.gnss_ne_m):
        north, east = series.gnss_ne_m.T
        axes.plot(east, north, "o", ms=2.5, color=ORANGE, alpha=0.6, mew=0, label="antenna, by GNSS alone")
    if len(series.uwb_ne_m):
        north, east = series.uwb_ne_m.T
        axes.plot(east, north, "o", ms=2.5, color=ORANGE, alpha=0.6, mew=0, label="tag, by UWB alone")
    if len(reference):
        driven = np.array([phase != "idle" for phase in series.phases])
        axes.plot(
            np.where(driven, reference.line("east_ref_m"), np.nan),
            np.where(driven, reference.line("north_ref_m"), np.nan),
            "--", color=BLACK, lw=1.0, label="path reference",
        )  # fmt: skip
    if len(truth):
        axes.plot(
            truth.line("east_m"), truth.line("north_m"), color=VERMILION, lw=2.6, alpha=0.55, label="ground truth"
        )
    known = np.flatnonzero(np.isfinite(estimate["north_m"]))
    if len(known):
        east, north, psi = estimate["east_m"], estimate["north_m"], estimate["psi_rad"]
        axes.plot(estimate.line("east_m"), estimate.line("north_m"), color=BLUE, label="estimate")
        axes.plot(east[known[0]], north[known[0]], "o", color=GREEN, ms=8, label="start")
        axes.plot(east[known[-1]], north[known[-1]], "s", color=BLUE, ms=7, label="end")
        some = known[:: max(len(known) // 20, 1)]
        axes.quiver(
            east[some], north[some], np.sin(psi[some]), np.cos(psi[some]),
            color=BLUE, angles="xy", scale=25, width=0.004, headwidth=5,
        )  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    _legend(axes, rows=2)


def cross_track(axes: Axes, series: Series) -> None:
    """y_e on legs."""
    reference = series[GuidanceReference]
    axes.set(title="Cross-track error", ylabel="y_e [m]")
    if len(reference):
        on_leg = np.array([phase == "leg" for phase in series.phases])
        error = np.where(on_leg, reference["y_e_m"], np.nan)
        rms = f"RMS {np.sqrt(np.nanmean(error**2)):.3f} m" if on_leg.any() else "no leg driven"
        axes.axhline(0.0, color=BLACK, lw=0.7)
        axes.plot(reference.t_s, broken(reference.t_s, error), color=BLUE, label=f"on legs, by estimate: {rms}")
    _legend(axes)


def heading(axes: Axes, series: Series) -> None:
    """psi, wrapped."""
    axes.set(title="Heading", ylabel="psi [deg]")
    reference, estimate, truth = series[GuidanceReference], series[StateEstimate], series[GroundTruth]
    if len(truth):
        axes.plot(truth.t_s, _degrees(truth.line("psi_rad")), color=VERMILION, lw=2.6, alpha=0.55, label="truth")
    if len(estimate):
        axes.plot(estimate.t_s, _degrees(estimate.line("psi_rad")), color=BLUE, label="estimate")
    if len(reference):
        axes.plot(reference.t_s, _degrees(reference.line("psi_ref_rad")), "--", color=BLACK, lw=1, label="reference")
    axes.set_yticks((-180, -90, 0, 90, 180))
    _legend(axes)


def speeds(axes: Axes, series: Series) -> None:
    """u, v and the reference u."""
    axes.set(title="Speeds over ground", ylabel="[m/s]")
    reference, estimate, truth = series[GuidanceReference], series[StateEstimate], series[GroundTruth]
    for name, light, dark, say in (("u_m_s", SKY, BLUE, "surge u"), ("v_m_s", ORANGE, VERMILION, "sway v")):
        if len(estimate):
            axes.plot(estimate.t_s, estimate.line(name), color=light, label=f"{say}, estimate")
        if len(truth):
            axes.plot(truth.t_s, truth.line(name), color=dark, lw=1.0, label=f"{say}, truth")
    if len(reference):
        axes.step(
            reference.t_s,
            reference.line("u_ref_m_s"),
            "--",
            where="post",
            color=BLACK,
            lw=1.0,
            label="u reference",
        )
    _legend(axes)


def pwm(axes: Axes, series: Series) -> None:
    """Pulse widths of the thrusters; shaded where a rung below the plan made them."""
    axes.set(title="Thruster PWM", ylabel="[us]")
    axes.axhline(NEUTRAL_US, color=BLACK, lw=0.7)
    for column, pwm_us in enumerate(broken(series.lease_t_s, series.pwm_us).T):
        label = series.thrusters[column] if column < len(series.thrusters) else f"thruster {column + 1}"
        colour = CYCLE[column % len(CYCLE)]
        axes.step(series.lease_t_s, pwm_us, where="post", color=colour, lw=1.0, label=label)
    sources = np.array(series.sources)
    lasts = np.isfinite(broken(series.lease_t_s, np.zeros(len(sources))))
    for source, colour in SOURCES.items():
        made = sources == source
        if count := int(made.sum()):
            edges = axes.get_xaxis_transform()
            axes.fill_between(
                series.lease_t_s, 0, 1, where=(made & lasts).tolist(), step="post",
                transform=edges, color=colour, alpha=0.45, lw=0, label=f"fallback {source}: {count}",
            )  # fmt: skip
    _legend(axes)


def _innovations(axes: Axes, series: Series) -> None:
    axes.set(title="Innovations, normalised", ylabel="sqrt(d2) [sigma]")
    rejected = 0
    for number, (sensor, (t_s, sigma, accepted)) in enumerate(series.innovations.items()):
        colour = CYCLE[number % len(CYCLE)]
        axes.plot(t_s[accepted], sigma[accepted], ".", ms=3, color=colour, label=sensor, rasterized=True)
        axes.plot(t_s[~accepted], sigma[~accepted], "x", ms=5, color=colour)
        rejected += int((~accepted).sum())
    if series.innovations:
        axes.set_yscale("log")
        axes.set_ylim(0.01, 1.5 * max(sigma.max() for _, sigma, _ in series.innovations.values()))
        axes.axhline(GATE_SIGMA, color=BLACK, lw=0.7, ls=":", label="3 sigma")
        axes.plot([], [], "x", color=BLACK, ms=5, label=f"rejected: {rejected}")
    _legend(axes)


def _timing(axes: Axes, series: Series) -> None:
    axes.set(title="Loop timing", ylabel="[ms]")
    ticks, plans, loop = series[Tick], series[PlanResult], series[LoopTiming]
    known = ~np.isnan(loop["imu_to_override_ms"])
    drawn = False
    for t_s, values, colour, say in (
        (loop.t_s[known], loop["imu_to_override_ms"][known], ORANGE, "IMU to PWM"),
        (plans.t_s, plans["solve_time_s"] * 1e3, VERMILION, "solve time"),
        (ticks.t_s, ticks["lateness_ns"] / 1e6, BLUE, "tick lateness"),
    ):
        if len(values):
            label = f"{say}: p99 {_two_digits(np.percentile(values, 99))}, max {_two_digits(values.max())}"
            axes.plot(t_s, values, ".", ms=3, color=colour, label=label)
            drawn = True
    if drawn:
        axes.set_yscale("symlog", linthresh=0.1)
        axes.set_ylim(bottom=0.0)
    _legend(axes)


def _two_digits(value: float) -> str:
    """Two significant digits, without an exponent: 0.42, 12, 250."""
    return f"{float(f'{value:.2g}'):g}"


def _part_legends_from_titles(figure: Figure) -> None:
    """Give more rows to every legend that reaches over the title at its left."""
    for axes in figure.axes:
        name = axes.get_title("left")
        (title,) = axes.findobj(lambda a, name=name: isinstance(a, Text) and bool(name) and a.get_text() == name)
        for rows in range(2, MOST_ROWS + 1):
            figure.draw_without_rendering()
            legend = axes.get_legend()
            if not legend or not legend.get_window_extent().overlaps(title.get_window_extent()):
                break
            _legend(axes, rows)


def _legend(axes: Axes, rows: int = 1) -> None:
    """Legend above the axes, right of the title; or a grey word where there was nothing to draw."""
    entries = len(axes.get_legend_handles_labels()[0])
    rows = max(rows, -(-entries // 8))
    if entries:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.985), ncols=-(-entries // rows))
    else:
        axes.text(0.5, 0.5, "not in this log", transform=axes.transAxes, ha="center", color=GREY)


def _degrees(angle_rad: np.ndarray) -> np.ndarray:
    """Angles [deg] in [-180, 180), broken (NaN) where they jump round, so that no line crosses the panel."""
    wrapped = (np.degrees(angle_rad) + 180.0) % 360.0 - 180.0
    return np.where(np.abs(np.diff(wrapped, prepend=wrapped[0])) > 180.0, np.nan, wrapped)
