"""State of a run on one line of a terminal; without a terminal, a new line every few seconds."""

from __future__ import annotations

import contextlib
import shutil
from typing import TextIO

from companion.cli.boat.terminal_writer import TerminalWriter
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
PLAIN_NS = 10_000_000_000
COLUMNS = 79
"""Of the live line, where the terminal is not narrower: one less than all, so that none wraps."""


class Progress:
    """Feed it every message; it prints at its own pace. `waypoints`: how many there are to pass."""

    def __init__(self, waypoints: int, out: TextIO | TerminalWriter):
        self._waypoints, self._out = waypoints, out
        self._live = out.isatty()
        self._period_ns = TERMINAL_NS if self._live else PLAIN_NS
        self._next_ns = self._start_ns = 0
        self._estimate: StateEstimate | None = None
        self._reference: GuidanceReference | None = None
        self._excitation: ExcitationStatus | None = None
        self._lease: OverrideLease | None = None
        self._lateness_ms = 0.0
        self._ending = False

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

    def ends(self) -> None:
        """From now on the boat is neutral because the run ends, not because anybody stopped it."""
        self._ending = True

    def close(self) -> None:
        """End the live line."""
        if self._live:
            self._write("\n")

    def _show(self, lease: OverrideLease) -> None:
        """One line: what comes first matters most, and what does not fit is left out."""
        e, g = self._estimate, self._reference
        where = f"N {e.north_m:6.2f} E {e.east_m:6.2f} m  {e.u_m_s:5.2f} m/s" if e else "no estimate"
        doing = " ".join(self._doing(lease).split())  # a reason may hold line ends
        parts = [f"{(lease.t_ns - self._start_ns) * 1e-9:6.1f} s", where, doing]
        if lease.source not in ("plan", "neutral", "manual", "excitation"):
            parts.append(f"by {lease.source.replace('_', ' ')}")
        if g and lease.source != "neutral" and not self._excitation:
            parts.append(f"y_e {g.y_e_m:+.2f} m")
        parts.append(f"late {self._lateness_ms:.0f} ms")
        text = parts[0]
        for part in parts[1:]:
            text += f"  {part}" if len(text) + len(part) + 2 <= self._columns() or part is where else ""
        self._write("\r\x1b[2K" + text[: self._columns()]) if self._live else self._print(text)

    def _doing(self, lease: OverrideLease) -> str:
        if self._ending:
            return "the run ends"
        if lease.source == "neutral":
            return lease.reason
        if lease.source == "manual":
            return f"by hand: {lease.reason}"
        if lease.source == "excitation" and (x := self._excitation):
            return f"{x.phase} {min(x.segment + 1, x.segments)}/{x.segments} {x.name} {x.elapsed_s:.0f} s"
        g = self._reference
        return f"{'waypoint' if g.phase == 'leg' else g.phase} {g.waypoints_passed}/{self._waypoints}" if g else ""

    def _columns(self) -> int:
        """How long a line may be."""
        return min(COLUMNS, shutil.get_terminal_size((COLUMNS + 1, 24)).columns - 1) if self._live else COLUMNS

    def _print(self, text: str) -> None:
        self._write(("\r\x1b[2K" if self._live else "") + text + "\n")

    def _write(self, text: str) -> None:
        """Write `text`; a closed terminal must not stop the boat."""
        with contextlib.suppress(OSError):
            self._out.write(text)
            self._out.flush()
