"""Pictures of a boat's history: each parameter over the missions with its interval, and gains."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from companion.core.configuration.vessel_file import VesselFile
from sim.commission.watch.course import Z95, BoatCourse, threshold_nats
from sim.fitting.engine.parameters import HULL, file_values
from sim.fitting.validate.figures import COLOURS, INK

SPEED_M_S = 0.5
"""Speed at which drag is shown; that of the missions of the paper."""
Line = tuple[str, np.ndarray]


def courses(course: BoatCourse, vessel: VesselFile) -> Figure:
    """Thrusters, drag, inertia, and times of thrust over the missions, 95 % bands; dashed: changes that were told."""
    panels = {
        "thrust [% of the file]": [(n.partition(":")[2], _unit(course, n)) for n in _named(course, "thruster_gain")],
        f"drag at {SPEED_M_S:g} m/s [% of the file]": _drag(course, vessel),
        "inertia [% of the file]": _inertia(course, vessel),
        "dead time and lag [ms more]": [(n.replace("_", " "), 10 * _unit(course, n)) for n in ("dead_time", "lag")],
    }
    figure = Figure(figsize=(10, 2.6 * len(panels)), layout="constrained")
    for ax, (title, lines) in zip(figure.subplots(len(panels), 1, sharex=True), panels.items(), strict=True):
        _panel(ax, course, lines, 0.0 if title.startswith("dead") else 100.0)
        ax.set_ylabel(title)
    figure.axes[-1].set_xlabel("mission")
    figure.axes[-1].xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    return figure


def gains(course: BoatCourse) -> Figure:
    """Gain of the belief over the file in force, and evidence of the best change, mission by mission."""
    figure = Figure(figsize=(10, 2.8), layout="constrained")
    ax, at = figure.add_subplot(), np.arange(1, len(course.missions) + 1)
    gain = [m.gain_nats for m in course.missions]
    ax.bar(at, gain, color=COLOURS[0], label="predicted better than by the file in force")
    ax.plot(at, [m.best[0] for m in course.missions], "o-", color=COLOURS[1], ms=4, label="evidence of a change")
    told = threshold_nats(len(course.watched.causes))
    ax.axhline(told, color=COLOURS[1], ls="--", lw=1, label=f"told from {told:.1f} nats on")
    ax.axhline(0, color=INK, lw=0.8)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    ax.set(xlabel="mission", ylabel="nats", yscale="symlog", xlim=(0.4, len(at) + 0.6))
    ax.legend(fontsize=8)
    return figure


def _panel(ax: Axes, course: BoatCourse, lines: Sequence[Line], zero: float) -> None:
    at = np.arange(1, len(course.missions) + 1)
    for (name, d), colour in zip(lines, (*COLOURS, *COLOURS), strict=False):
        mean = np.array([zero + 100 * d @ m.belief.mean for m in course.missions])
        se = np.array([100 * np.sqrt(d @ m.belief.covariance @ d) for m in course.missions])
        ax.plot(at, mean, "o-", ms=3, color=colour, label=name)
        ax.fill_between(at, mean - Z95 * se, mean + Z95 * se, color=colour, alpha=0.15, lw=0)
    ax.axhline(zero, color=INK, lw=0.8)
    for change in course.changes:
        ax.axvline(change.onset + 1 - 0.5, color=INK, ls="--", lw=1)
    ax.set_xlim(0.4, len(at) + 0.6)
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8, ncols=4)


def _named(course: BoatCourse, family: str) -> list[str]:
    return [n for n in course.watched.names if n.startswith(f"{family}:")]


def _unit(course: BoatCourse, name: str) -> np.ndarray:
    return np.array([1.0 if n == name else 0.0 for n in course.watched.names])


def _drag(course: BoatCourse, vessel: VesselFile) -> list[Line]:
    """Shares of drag ahead, across and in yaw by their linear and quadratic terms, at `SPEED_M_S` or as many rad/s."""
    out = []
    for name, linear, quadratic in (
        ("ahead", "X_u_N_s_m", "X_uu_N_s2_m2"), ("across", "Y_v_N_s_m", "Y_vv_N_s2_m2"),
        ("in yaw", "N_r_N_m_s", "N_rr_N_m_s2"),
    ):  # fmt: skip
        one, two = abs(getattr(vessel.damping, linear)), SPEED_M_S * abs(getattr(vessel.damping, quadratic))
        share = one / (one + two) if one + two else 0.5
        d = share * _unit(course, f"base:{linear}") + (1 - share) * _unit(course, f"base:{quadratic}")
        out.append((name, d + _unit(course, "hull_fouling")))
    return out


def _inertia(course: BoatCourse, vessel: VesselFile) -> list[Line]:
    values = dict(zip(HULL, file_values(vessel)[: len(HULL)].tolist(), strict=True))
    load = _unit(course, "payload")
    ahead = _unit(course, "base:M11_kg") + load / values["M11_kg"]
    across = _unit(course, "base:M22_kg") + load / values["M22_kg"]
    return [("ahead", ahead), ("across", across), ("in yaw", _unit(course, "base:M33_kg_m2"))]
