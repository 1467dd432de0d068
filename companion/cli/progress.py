"""State of a run on one line of a terminal; without a terminal, a new line every few seconds."""

from __future__ import annotations

import contextlib
from typing import TextIO

from companion.core.messages import (
    Alert,
    ExcitationStatus,
    GuidanceReference,
    LoopTiming,
    Message,
    NewMission,
    OverrideLease,
    StateEstimate,
)

TERMINAL_NS = 250_000_000
PLAIN_NS = 5_000_000_000


class Progress:
    """Feed it every message; it prints at its own pace. `waypoints`: how many there are to pass."""

    def __init__(self, waypoints: int, out: TextIO):
        self._waypoints, self._out = waypoints, out
        self._live = out.isatty()
        self._period_ns = TERMINAL_NS if self._live else PLAIN_NS
        self._next_ns = self._start_ns = 0
        self._estimate: StateEstimate | None = None
        self._reference: GuidanceReference | None = None
        self._excitation: ExcitationStatus | None = None
        self._lease: OverrideLease | None = None
        self._lateness_ms = 0.0

    def see(self, message: Message) -> None:
        """Note one message; alerts are printed at once."""
        if isinstance(message, Alert):
            self._print(f"{message.level}: {message.text}")
        elif isinstance(message, StateEstimate):
            self._estimate = message
        elif isinstance(message, GuidanceReference):
            self._reference = message
        elif isinstance(message, ExcitationStatus):
            self._excitation = message
        elif isinstance(message, NewMission):
            self._waypoints = len(message.waypoints)
        elif isinstance(message, LoopTiming):
            self._lateness_ms = max(self._lateness_ms, message.lateness_ms)
        elif isinstance(message, OverrideLease):
            self._lease = message
            self._start_ns = self._start_ns or message.t_ns
            if message.t_ns >= self._next_ns:
                self._next_ns = message.t_ns + self._period_ns
                self._show(message)

    def close(self) -> None:
        """End the live line."""
        if self._live:
            self._write("\n")

    def _show(self, lease: OverrideLease) -> None:
        seconds = (lease.t_ns - self._start_ns) * 1e-9
        e, g = self._estimate, self._reference
        where = f"N {e.north_m:6.2f} E {e.east_m:6.2f} m  u {e.u_m_s:5.2f} m/s" if e else "no estimate"
        what = lease.reason if lease.source == "neutral" else ""
        if lease.source == "excitation" and (x := self._excitation):
            what = f"{x.phase}  segment {min(x.segment + 1, x.segments)}/{x.segments} {x.name} {x.elapsed_s:.1f} s"
        elif lease.source == "manual":
            what = f"by hand: {lease.reason}"
        elif not what and g:
            what = f"{g.phase}  waypoint {g.waypoints_passed}/{self._waypoints}  y_e {g.y_e_m:+.2f} m"
        text = f"{seconds:6.1f} s  {where}  {what}  [{lease.source}, late <= {self._lateness_ms:.1f} ms]"
        if self._live:
            self._write("\r\x1b[2K" + text)
        else:
            self._print(text)

    def _print(self, text: str) -> None:
        self._write(("\r\x1b[2K" if self._live else "") + text + "\n")

    def _write(self, text: str) -> None:
        """Write `text`; a closed terminal must not stop the boat."""
        with contextlib.suppress(OSError):
            self._out.write(text)
            self._out.flush()
