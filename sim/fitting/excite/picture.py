"""One flight on one page: the track in the basin by segment, and speeds and thruster commands over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from companion.core.excitation.file import Excitation
from companion.core.excitation.pen import Pen
from companion.core.messages import ExcitationStatus, GroundTruth
from sim.fitting.validate.figures import COLOURS

FAINT, HOME = "#999999", "#bbbbbb"
MAP = "tab20"


@dataclass(frozen=True)
class FlightTrace:
    """Data of the picture.

    t_s      (k,) since the first status
    x        (k, 6) [north, east, psi, u, v, r]
    segment  (k,) index of the segment; -1: on the way back
    f_n      (k, n) thruster forces
    """

    t_s: np.ndarray
    x: np.ndarray
    segment: np.ndarray
    f_n: np.ndarray


def flight_trace(truths: Sequence[GroundTruth], statuses: Sequence[ExcitationStatus]) -> FlightTrace:
    """The true motion from the first status to the last."""
    first, last = statuses[0].t_ns, statuses[-1].t_ns
    kept = [m for m in truths if first <= m.t_ns <= last]
    t_ns = np.array([m.t_ns for m in kept])
    stamps = np.array([s.t_ns for s in statuses])
    which = np.array([s.segment if s.phase == "fly" else -1 for s in statuses])
    x = np.array([(m.north_m, m.east_m, m.psi_rad, m.u_m_s, m.v_m_s, m.r_rad_s) for m in kept])
    at = np.maximum(np.searchsorted(stamps, t_ns, side="right") - 1, 0)
    return FlightTrace((t_ns - first) * 1e-9, x, which[at], np.array([m.f_n for m in kept]))


def draw_flight(
    flight: FlightTrace, excitation: Excitation, pen: Pen, thrusters: Sequence[str], title: str, path: Path
) -> None:
    """Write the picture as PNG. Raises OSError."""
    colours = mpl.colormaps[MAP]
    names = list(dict.fromkeys(s.name for s in excitation.segments))
    colour = [colours(names.index(s.name) % 20) for s in excitation.segments]
    with mpl.rc_context({"font.size": 8, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(13, 7.5), layout="constrained")
        grid = figure.add_gridspec(3, 2, width_ratios=(1.1, 1))
        _track(figure.add_subplot(grid[:, 0]), flight, excitation, pen, colour)
        axes = [figure.add_subplot(grid[row, 1]) for row in range(3)]
        for column, (label, tint) in enumerate(zip(("u [m/s]", "v [m/s]"), COLOURS, strict=False)):
            axes[0].plot(flight.t_s, flight.x[:, 3 + column], color=tint, lw=0.9, label=label)
        axes[1].plot(flight.t_s, flight.x[:, 5], color=COLOURS[2], lw=0.9, label="r [rad/s]")
        for i, name in enumerate(thrusters):
            tint = COLOURS[i % len(COLOURS)]
            axes[2].plot(flight.t_s, flight.f_n[:, i], lw=0.7, color=tint, label=f"{name} [N]")
        for ax in axes:
            _bands(ax, flight, colour)
            ax.legend(fontsize=7, ncols=4, loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False)
            ax.set_xlim(0, flight.t_s[-1])
        axes[-1].set_xlabel("time [s]")
        figure.suptitle(title, x=0.01, ha="left", fontsize=10)
        figure.savefig(path, dpi=110)


def _track(ax: Any, flight: FlightTrace, excitation: Excitation, pen: Pen, colour: Sequence[Any]) -> None:
    for i, fence in enumerate((pen.site.fence, *pen.others.within, *pen.others.without)):
        corners = np.array([*fence, fence[0]])
        ax.plot(corners[:, 1], corners[:, 0], color="#222222", lw=1.0, ls=":", label=None if i else "fence")
    north, east = pen.middle
    ax.add_patch(Circle((east, north), excitation.return_m, fill=False, ec=FAINT, lw=0.6, label="the middle"))
    labelled = set()
    for a, b in _stretches(flight.segment):
        which = flight.segment[a]
        name = "on the way home" if which < 0 else excitation.segments[which].name
        tint, width = (HOME, 0.8) if which < 0 else (colour[which], 1.5)
        label = None if name in labelled else name
        labelled.add(name)
        ax.plot(flight.x[a : b + 1, 1], flight.x[a : b + 1, 0], color=tint, lw=width, label=label)
    ax.set_aspect("equal")
    ax.set_xlabel("east [m]")
    ax.set_ylabel("north [m]")
    ax.figure.legend(*ax.get_legend_handles_labels(), fontsize=7, loc="outside lower left", ncols=6, frameon=False)


def _bands(ax: Any, flight: FlightTrace, colour: Sequence[Any]) -> None:
    for a, b in _stretches(flight.segment):
        if flight.segment[a] >= 0:
            end = flight.t_s[min(b, len(flight.t_s) - 1)]
            ax.axvspan(flight.t_s[a], end, color=colour[flight.segment[a]], alpha=0.18, lw=0)


def _stretches(segment: np.ndarray) -> list[tuple[int, int]]:
    """First index and the one after the last of each stretch of the same segment."""
    edges = [int(i) for i in np.flatnonzero(np.diff(segment)) + 1]
    return list(zip([0, *edges], [*edges, len(segment)], strict=True))
