"""A log as telemetry for the page, and simulated ghosts: the data of the page (`web/log.js`).

Samples are made by the code of the telemetry (`core.telemetry`), at a rate that keeps the page small.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from companion.core.telemetry import structs as shore
from companion.core.telemetry.view import TelemetryView, Who
from companion.logs.configuration import setup_in, zero_ns_of
from companion.logs.log_file import LogError, LogFile
from companion.logs.series import KNOWN

if TYPE_CHECKING:
    from sim.fitting.validate.ghost import Ghost, Overlay

FULL_HZ, LEAST_HZ = 10.0, 1.0
STATES = 12_000
"""States in a page at most, by default: 20 minutes at 10 Hz, an hour at 3.3 Hz."""
RUN = "log"
SHOWN = {"position": (1.0, "m", 3), "heading": (57.29578, "deg", 1), "u": (1.0, "m/s", 3), "v": (1.0, "m/s", 3),
         "r": (57.29578, "deg/s", 2)}  # fmt: skip


def rate_of(duration_s: float) -> float:
    """Samples a second of the fastest topics."""
    return float(np.clip(STATES / max(duration_s, 1e-3), LEAST_HZ, FULL_HZ))


def samples(log: LogFile, rate_hz: float) -> list[shore.ShoreMessage]:
    """The telemetry samples of the log. Raises LogError, ConfigError: the log does not hold its configuration."""
    setup, zero_ns = setup_in(log), zero_ns_of(log)
    software = f"aritra {log.metadata.get('version', 'unknown')}"
    view = TelemetryView(setup.pilot, Who(RUN, setup.digest, software, log.wall_offset_ns, False), rate_hz)
    samples = view.begin(zero_ns)
    for message in log.messages():
        samples += view.see(message)
    return samples


def page_data(log: LogFile, samples: Sequence[shore.ShoreMessage], overlay: Overlay | None, zero_ns: int) -> bytes:
    """JSON for the page. `overlay`: ghosts on the run's clock, whose t_s = 0 is `zero_ns`."""
    first = next((t for t in samples if isinstance(t, shore.StateNow)), None)
    if first is None:
        needed = "/state_estimate, and /loop_timing at the end of a tick"
        reason = f"{log.path}: no estimate in it that could be shown: that takes {needed}"
        raise LogError("; ".join([reason, *log.damage]))
    known = next((t for t in samples if isinstance(t, shore.StateNow) and t.health in KNOWN), first)
    about, begin_ns, end_ns = samples[0], zero_ns_of(log), max(t.t_ns for t in samples)
    assert isinstance(about, shore.About)
    length_s = (end_ns - begin_ns) * 1e-9
    states = sum(isinstance(t, shore.StateNow) for t in samples)
    step = max(round(length_s * FULL_HZ / states), 1)
    data = {
        "title": log.path.name,
        "about": _about(log, about, begin_ns, length_s),
        "boat": about.vessel,
        "unix_minus_t_ns": log.wall_offset_ns,
        "zero_s": begin_ns * 1e-9,
        "length_s": length_s,
        "start_s": max((known.t_ns - begin_ns) * 1e-9, 0.0),
        "samples": [(shore.topic_of(t), msgspec.Raw(shore.encode(t))) for t in samples],
        "ghosts": [_ghost(g, overlay, zero_ns, step) for g in overlay.ghosts] if overlay else [],
        "errors": _errors(overlay) if overlay else None,
    }
    return msgspec.json.encode(data)


def _about(log: LogFile, about: shore.About, begin_ns: int, length_s: float) -> str:
    title = f"{about.vessel} at {about.site}, {length_s:.0f} s"
    if log.wall_offset_ns:
        begin = datetime.fromtimestamp((begin_ns + log.wall_offset_ns) * 1e-9, UTC)
        title += f" from {begin:%Y-%m-%d %H:%M:%S} UTC"
    damage = ", damaged log" if log.damage else ""
    return f"{title}, configuration {about.configuration[:12]}, {about.software}{damage}"


def _ghost(ghost: Ghost, overlay: Overlay, zero_ns: int, step: int) -> dict[str, Any]:
    """Pieces as far as they are known; every `step`th instant."""
    pieces = []
    for t_s, x, off_m in zip(overlay.t_s, ghost.x, ghost.error[..., 0], strict=True):
        known = int(np.isfinite(x).all(axis=1).argmin()) or len(x)
        shown = slice(0, known - 1 if known == len(x) else known, step)  # the last instant is the next piece's first
        rows = [[round(float(v), 4) for v in row] for row in x[shown]]
        start_s = zero_ns * 1e-9 + float(t_s[0])
        pieces.append({"t_s": start_s, "x": rows, "off_m": [round(float(v), 3) for v in off_m[shown]]})
    return {"name": ghost.name, "step_s": step / FULL_HZ, "pieces": pieces}


def _errors(overlay: Overlay) -> dict[str, Any]:
    how = (
        f"Open loop under the logged commands from {overlay.source}, put back every {overlay.every_s:g} s; "
        f"rms errors over {len(overlay.t_s)} pieces."
    )
    rows = []
    for age_s in overlay.ages_s:
        for ghost in overlay.ghosts:
            found = ghost.rms(age_s)
            cells = [_figure(found[name] * factor, digits) for name, (factor, _, digits) in SHOWN.items()]
            rows.append([f"{age_s:g} s", ghost.name, *cells])
    return {"how": how, "channels": [f"{name} [{unit}]" for name, (_, unit, _) in SHOWN.items()], "rows": rows}


def _figure(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "none" if np.isnan(value) else "gone"
