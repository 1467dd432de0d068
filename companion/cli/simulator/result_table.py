"""What `aritra demo` shows at its end: figures in groups, what each means, and a verdict in one sentence."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from rich.text import Text

Figures = Mapping[str, float | int]
GROUPS: Mapping[str, Sequence[tuple[str, str, str, str]]] = {
    "the boat, against the truth": (
        ("cross_track_rms_m", "off the path", "m", "rms, on straight legs"),
        ("surge_rms_error_m_s", "off the speed", "m/s", "rms, true surge, there"),
        ("overshoot_m", "overshoot", "m", "beyond the worst corner"),
        ("station_error_m", "off the station", "m", "largest in the last 3 s"),
        ("station_error_deg", "off its heading", "deg", "the same"),
    ),
    "its estimate, against the truth": (
        ("position_rmse_m", "position", "m", "rms"),
        ("u_rmse_m_s", "surge", "m/s", "rms"),
        ("v_rmse_m_s", "sway", "m/s", "rms"),
        ("heading_rmse_deg", "heading", "deg", "rms"),
        ("nees", "NEES", "", "6: as good as it says; much more: too sure"),
    ),
    "its control loop, 10 times a second": (
        ("ticks", "ticks", "", "one in 0.1 s"),
        ("leases", "commands", "", "one for every tick"),
        ("leases_from_plan", "of fresh plans", "", "the first seconds are neutral"),
        ("lateness_p99_ms", "late by", "ms", "99 % are better"),
        ("latency_p99_ms", "IMU to command", "ms", "99 % are better"),
        ("nmpc_p50_ms", "time to solve", "ms", "median"),
        ("nmpc_p99_ms", "time to solve", "ms", "99 % are better"),
        ("cpu_percent", "processor", "%", "of one core"),
        ("rss_mb", "memory", "MB", "at most"),
    ),
}
GOALS_MS = {"lateness_p99_ms": 10.0, "latency_p99_ms": 30.0, "nmpc_p99_ms": 5.0}
LATE_MS, STALL_MS = 50.0, 500.0
"""A computer is too busy whose ticks (p99) are late by half a period, or whose simulator stands still for so long;
assumed."""
BUSY = "this computer is too busy: {}; close other programs, and run it again"


def busy(figures: Figures) -> str:
    """What shows that the computer could not keep up, in a sentence; empty: nothing does."""
    found = []
    if (late_ms := figures.get("lateness_p99_ms", math.nan)) > LATE_MS:
        found.append(f"1 tick in 100 was over {late_ms:.0f} ms late")
    if (stall_ms := figures.get("simulator_stall_ms", math.nan)) > STALL_MS:
        found.append(f"the simulator stood still for {stall_ms / 1e3:.1f} s")
    return BUSY.format(" and ".join(found)) if found else ""


def passed(figures: Figures, stopped: str) -> bool:
    """Whether every waypoint was passed, and driving was not stopped."""
    return figures["waypoints_passed"] == figures["waypoints_total"] and not stopped


def verdict(figures: Figures, stopped: str) -> Text:
    """How it went, in a sentence; others where driving was stopped, and where the computer is to blame for it."""
    done, total = figures["waypoints_passed"], figures["waypoints_total"]
    way = f"{done} of {total} waypoints"
    if "cross_track_rms_m" in figures:
        way += f", {figures['cross_track_rms_m']:.2f} m rms off the path"
        way += f", position known to {figures['position_rmse_m']:.2f} m rms"
    fine = passed(figures, stopped)
    out = Text.assemble(("PASSED" if fine else "NOT PASSED", "bold green" if fine else "bold red"), f": {way}.")
    if stopped:
        out.append(f"\nBut {stopped}.", style="bold red")
    if why := busy(figures):
        out.append(f"\n{'But ' if fine else ''}{why}.", style="yellow")
    return out


def lines(figures: Figures, stopped: str) -> Iterator[Text]:
    """The figures by group, then the verdict; no line of a figure is longer than 78 characters."""
    for head, rows in GROUPS.items():
        yield Text(head, style="bold")
        for key, name, unit, meaning in rows:
            if math.isfinite(value := figures.get(key, math.nan)):
                shown = str(value) if isinstance(value, int) else f"{value:.3f}"
                missed = value > GOALS_MS.get(key, math.inf)
                goal = f"; goal {GOALS_MS[key]:g}{': missed' * missed}" if key in GOALS_MS else ""
                yield Text(f"  {name:<16}{shown:>9} {unit:<4} {meaning}{goal}", style="yellow" if missed else "")
    yield verdict(figures, stopped)
