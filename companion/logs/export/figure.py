"""A figure for print of one log: path, heading, speeds, yaw rate, cross-track error, thrusters; as wide as its column.

The panels are those of `plot`, set for paper: 8 pt in Times-like letters (STIX, which come with matplotlib), thin
lines, no titles (a caption says what it is), fonts embedded as TrueType. Two columns of panels from `WIDE_MM` on.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from companion.core.messages import GroundTruth, StateEstimate
from companion.logs.export.plot import (
    BLUE,
    STYLE,
    VERMILION,
    cross_track,
    heading,
    nothing_in,
    pwm,
    save,
    speeds,
    track,
)
from companion.logs.log_file import LogFile
from companion.logs.series import Series, collect

WIDE_MM = 130.0
MM_PER_INCH = 25.4
DPI = 300
PANEL_MM, WIDE_PANEL_MM = 27.0, 31.0
"""Height of a panel [mm], narrow and wide figure; assumed."""
MARGIN_MM, LEGEND_MM = 16.0, 18.0
"""Space beside a map in one column, and above and below it [mm]; assumed."""
Draw = Callable[[Axes, Series], None]

PRINT: dict[Any, Any] = STYLE | {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.markerscale": 1.0,
    "legend.columnspacing": 0.9,
    "legend.borderaxespad": 0.1,
    "lines.linewidth": 0.9,
    "lines.markersize": 3,
    "axes.linewidth": 0.5,
    "grid.linewidth": 0.4,
    "xtick.major.width": 0.5,
    "ytick.major.width": 0.5,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
}
SYMBOLS = {
    "surge u, estimate": r"$\hat u$", "surge u, truth": "$u$", "u reference": "$u_{ref}$",
    "sway v, estimate": r"$\hat v$", "sway v, truth": "$v$",
}  # fmt: skip


def figure(log: LogFile, out: Path, width_mm: float, *, truth: LogFile | None = None) -> None:
    """Draw `log` into `out` (.pdf, .png or .svg by its name). `truth`: the simulator's log of the same run.

    Raises LogError: nothing to draw; ConfigError: `out` cannot be written.
    """
    series = collect(log, truth)
    nothing_in(log, series)
    drawn = printed(series, width_mm)
    config = log.metadata.get("config_sha256", "unknown")[:12]
    about: dict[str, Any] = {"Title": f"{log.path.name}, configuration {config}"}
    if out.suffix == ".pdf":
        about["CreationDate"] = None  # the same log gives the same bytes
    with mpl.rc_context(PRINT):
        save(drawn, out, dpi=DPI, metadata=about)


def printed(series: Series, width_mm: float) -> Figure:
    """The figure, `width_mm` wide; as high as it needs."""
    with mpl.rc_context(PRINT):
        drawn = _wide(series, width_mm) if width_mm >= WIDE_MM else _narrow(series, width_mm)
        timed = drawn.axes[1:]
        for axes in timed:
            axes.set_xlim(0.0, max(series.duration_s, 1e-3))
        drawn.align_ylabels(timed)
        _keep_legends_inside(drawn)
    return drawn


def _narrow(series: Series, width_mm: float) -> Figure:
    """One under the other."""
    track_mm = (width_mm - MARGIN_MM) * _aspect(series) + LEGEND_MM
    drawn = _sheet(width_mm, track_mm + len(PANELS) * PANEL_MM)
    grid = drawn.add_gridspec(len(PANELS) + 1, 1, height_ratios=(track_mm, *(PANEL_MM for _ in PANELS)))
    _path(drawn.add_subplot(grid[0]), series)
    for row, (draw, label) in enumerate(PANELS, 1):
        _panel(drawn.add_subplot(grid[row]), series, draw, label, last=row == len(PANELS))
    return drawn


def _wide(series: Series, width_mm: float) -> Figure:
    """Path and the error to it on the left, the rest on the right."""
    left, right = PANELS[:1], PANELS[1:]
    drawn = _sheet(width_mm, len(right) * WIDE_PANEL_MM)
    grid = drawn.add_gridspec(len(right), 2)
    _path(drawn.add_subplot(grid[:-1, 0]), series)
    for draw, label in left:
        _panel(drawn.add_subplot(grid[-1, 0]), series, draw, label, last=True)
    for row, (draw, label) in enumerate(right):
        _panel(drawn.add_subplot(grid[row, 1]), series, draw, label, last=row == len(right) - 1)
    return drawn


def _sheet(width_mm: float, height_mm: float) -> Figure:
    drawn = Figure(figsize=(width_mm / MM_PER_INCH, height_mm / MM_PER_INCH), layout="constrained")
    FigureCanvasAgg(drawn)
    return drawn


def _aspect(series: Series) -> float:
    """Height over width of what the map shows, within limits."""
    places = [np.column_stack([series[StateEstimate][k] for k in ("north_m", "east_m")])]
    if series.site:
        places += [np.array(series.site.fence)]
    both = np.vstack(places)
    both = both[np.isfinite(both).all(axis=1)]
    if not len(both):
        return 1.0
    north_m, east_m = np.ptp(both, axis=0)
    return float(np.clip(north_m / max(east_m, 1e-3), 0.4, 1.3))


def _panel(axes: Axes, series: Series, draw: Draw, label: str, *, last: bool) -> None:
    draw(axes, series)
    axes.set_ylabel(label)
    _thin(axes)
    _legend(axes, columns=8)
    axes.tick_params(labelbottom=last)
    if last:
        axes.set_xlabel("time [s]")


def _path(axes: Axes, series: Series) -> None:
    track(axes, series)
    _thin(axes)
    axes.set_aspect("equal", adjustable="box")
    _legend(axes, columns=3)


def _thin(axes: Axes) -> None:
    for line in axes.get_lines():
        line.set_markersize(min(line.get_markersize(), 4.0))
        line.set_linewidth(min(line.get_linewidth(), 1.6))


def _yaw_rate(axes: Axes, series: Series) -> None:
    estimate, truth = series[StateEstimate], series[GroundTruth]
    if len(estimate):
        axes.plot(estimate.t_s, np.degrees(estimate.line("r_rad_s")), color=BLUE, label=r"$\hat r$")
    if len(truth):
        axes.plot(truth.t_s, np.degrees(truth.line("r_rad_s")), color=VERMILION, lw=0.7, label="$r$")


def _keep_legends_inside(drawn: Figure) -> None:
    """Give fewer columns to every legend that reaches over the figure's edge."""
    for axes in drawn.axes:
        for columns in range(len(axes.get_legend_handles_labels()[0]) - 1, 0, -1):
            drawn.draw_without_rendering()
            legend = axes.get_legend()
            if not legend or legend.get_window_extent().x1 <= drawn.bbox.x1:
                break
            _legend(axes, columns)


def _legend(axes: Axes, columns: int) -> None:
    """Legend above the axes, with symbols where there are any; an empty title keeps its space."""
    if old := axes.get_legend():
        old.remove()
    handles, labels = axes.get_legend_handles_labels()
    if not handles:
        axes.set_title("")
        return
    short_labels = [SYMBOLS.get(str(label), _short(str(label))) for label in labels]
    columns = min(columns, len(handles))
    axes.set_title("\n".join([" "] * -(-len(handles) // columns)), fontsize=7, pad=3)
    legend = axes.legend(handles, short_labels, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns)
    legend.set_in_layout(False)


def _short(label: str) -> str:
    """Label of a thruster or of a level of degradation, without count."""
    return label.removeprefix("fallback ").split(": ")[0]


PANELS: tuple[tuple[Draw, str], ...] = (
    (cross_track, r"$y_e$ [m]"),
    (heading, r"$\psi$ [deg]"),
    (speeds, r"$u, v$ [m s$^{-1}$]"),
    (_yaw_rate, r"$r$ [deg s$^{-1}$]"),
    (pwm, r"pulse width [$\mu$s]"),
)
"""What is drawn under the path, and the axis of each."""
