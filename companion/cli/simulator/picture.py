"""The demo's picture: track, speeds, forces and timing of one run on one page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from companion.cli.simulator.summary import DemoScore
from companion.core.messages import LoopTiming, OverrideLease, PlanResult
from companion.core.pilot.pilot import PilotSettings

TRUE, ESTIMATE, PATH, FAINT = "#222222", "#0072b2", "#d55e00", "#999999"
THRUSTERS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00")
HULL_M = np.array([(0.75, 0.0), (0.45, 0.35), (-0.7, 0.35), (-0.7, -0.35), (0.45, -0.35)])


def draw(score: DemoScore, settings: PilotSettings, path: Path) -> None:
    """Write the picture as PNG."""
    with mpl.rc_context({"font.size": 8, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(12, 7.5), layout="constrained")
        grid = figure.add_gridspec(4, 2, width_ratios=(1.15, 1))
        _track(figure.add_subplot(grid[:, 0]), score, settings)
        axes = [figure.add_subplot(grid[row, 1]) for row in range(4)]
        _surge(axes[0], score)
        _sway_yaw(axes[1], score)
        _forces(axes[2], score, settings)
        _timing(axes[3], score)
        for ax in axes:
            ax.set_xlim(0, score.track.t_s[-1] - score.track.t_s[0])
        axes[-1].set_xlabel("time since driving began [s]")
        figure.suptitle(headline(score.figures), x=0.01, ha="left", fontsize=10)
        figure.savefig(path, dpi=110)


def headline(figures: Mapping[str, float]) -> str:
    """The run in one line; what was not measured (NaN) is left out."""
    said = {
        "cross_track_rms_m": "cross-track {:.2f} m rms",
        "position_rmse_m": "position estimate {:.2f} m rms",
        "nmpc_p50_ms": "NMPC {:.1f} ms median",
    }
    known = (text.format(figures[name]) for name, text in said.items() if math.isfinite(figures[name]))
    return ", ".join([f"{figures['waypoints_passed']} of {figures['waypoints_total']} waypoints", *known])


def _track(ax: Any, score: DemoScore, settings: PilotSettings) -> None:
    track = score.track
    points = np.array(settings.mission.path.points)
    fence = np.array([*settings.site.fence, settings.site.fence[0]])
    ax.plot(fence[:, 1], fence[:, 0], color=FAINT, lw=0.8, ls=":", label="fence")
    ax.plot(points[:, 1], points[:, 0], color=PATH, lw=1.2, marker="o", ms=4, label="mission")
    ax.plot(track.truth[:, 1], track.truth[:, 0], color=TRUE, lw=1.4, label="true track")
    ax.plot(track.estimate[:, 1], track.estimate[:, 0], color=ESTIMATE, lw=0.9, label="estimate")
    for i in range(0, len(track.t_s), 80):
        x, y, psi = track.truth[i, :3]
        c, s = np.cos(psi), np.sin(psi)
        hull = HULL_M @ np.array([[s, c], [c, -s]])
        ax.add_patch(Polygon(hull + (y, x), closed=True, fill=False, ec=FAINT, lw=0.6))
    for anchor in settings.site.anchors:
        ax.plot(anchor.east_m, anchor.north_m, marker="^", color="#009e73", ms=7, clip_on=False)
    if settings.site.anchors:
        ax.plot([], [], marker="^", ls="", color="#009e73", label="UWB anchor")
    ax.set_aspect("equal")
    ax.set_xlabel("east [m]")
    ax.set_ylabel("north [m]")
    ax.set_title("Track", loc="left")
    ax.legend(loc="upper center", ncols=5, frameon=False, bbox_to_anchor=(0.5, -0.06))


def _surge(ax: Any, score: DemoScore) -> None:
    t = score.track.t_s - score.track.t_s[0]
    ax.plot(t, score.track.u_ref, color=PATH, lw=1.0, label="asked for")
    ax.plot(t, score.track.truth[:, 3], color=TRUE, lw=1.2, label="true")
    ax.plot(t, score.track.estimate[:, 3], color=ESTIMATE, lw=0.8, label="estimate")
    _label(ax, "surge u [m/s]", 3)


def _sway_yaw(ax: Any, score: DemoScore) -> None:
    t = score.track.t_s - score.track.t_s[0]
    for column, colour, name in ((4, ESTIMATE, "v [m/s]"), (5, PATH, "r [rad/s]")):
        ax.plot(t, score.track.truth[:, column], color=colour, lw=1.2, label=f"{name} true")
        ax.plot(t, score.track.estimate[:, column], color=colour, lw=0.6, alpha=0.6, label="estimate")
    _label(ax, "sway v, yaw rate r", 4)


def _forces(ax: Any, score: DemoScore, settings: PilotSettings) -> None:
    leases = score.messages[OverrideLease]
    t = np.array([m.t_ns for m in leases]) * 1e-9 - score.track.t_s[0]
    forces = np.array([m.f_command_n for m in leases])
    for i, thruster in enumerate(settings.vessel.thrusters):
        ax.plot(t, forces[:, i], lw=0.8, color=THRUSTERS[i % len(THRUSTERS)], label=thruster.name)
    _label(ax, "force command [N]", 5)


def _timing(ax: Any, score: DemoScore) -> None:
    start = score.track.t_s[0]
    plans, loops = score.messages[PlanResult], score.messages[LoopTiming]
    ax.plot([m.t_ns * 1e-9 - start for m in plans], [m.solve_time_s * 1e3 for m in plans],
            ".", ms=2, color=ESTIMATE, label="NMPC solve")  # fmt: skip
    ax.plot([m.t_ns * 1e-9 - start for m in loops], [m.lateness_ms for m in loops],
            ".", ms=2, color=PATH, label="tick lateness")  # fmt: skip
    ax.set_yscale("log")
    _label(ax, "timing [ms]", 2)


def _label(ax: Any, name: str, columns: int) -> None:
    """Axis name at the left, legend in one line above."""
    ax.set_ylabel(name)
    ax.legend(loc="lower left", ncols=columns, frameon=False, bbox_to_anchor=(0.0, 0.97), markerscale=2)
