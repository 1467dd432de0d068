"""The display of teleop: one table, redrawn four times a second in a thread of its own.

Of its own, because a terminal may stop taking characters (Ctrl-S, a radio link that stalls): then the picture stands
still, and the control loop does not.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections import deque
from typing import TextIO

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from companion.core.messages import (
    Alert,
    ExcitationStatus,
    LoopTiming,
    ManualInput,
    Message,
    ModeStatus,
    OverrideLease,
    StateEstimate,
)

PERIOD_S = 0.25
ALERTS = 6
KEYS = (
    "r take the sticks (arms)   w a s d q e z c or arrows move   1..9, 0 force   SPACE stop   "
    "g mission   h hold   p excitation   m mark   Ctrl-C end"
)


class TeleopState:
    """The newest of everything that is shown."""

    def __init__(self, thrusters: tuple[str, ...]) -> None:
        self.thrusters = thrusters
        self.mode: ModeStatus | None = None
        self.estimate: StateEstimate | None = None
        self.lease: OverrideLease | None = None
        self.sticks: ManualInput | None = None
        self.excitation: ExcitationStatus | None = None
        self.late_ms = 0.0
        self.level = 0.0
        self.note = self.log = ""
        self.alerts: deque[str] = deque(maxlen=ALERTS)

    def see(self, message: Message) -> None:
        """Note one message."""
        match message:
            case Alert():
                self.alerts.append(f"{message.level}: {message.text}")
            case ModeStatus():
                self.mode = message
            case StateEstimate():
                self.estimate = message
            case OverrideLease():
                self.lease = message
            case ManualInput():
                self.sticks = message
            case ExcitationStatus():
                self.excitation = message
            case LoopTiming():
                self.late_ms = max(self.late_ms, message.lateness_ms)


def picture(seen: TeleopState) -> Table:
    """The table."""
    table = Table(show_header=False, title="aritra teleop", caption=KEYS, expand=True)
    table.add_column(width=10, no_wrap=True)
    table.add_column(ratio=1)

    def row(name: str, text: str) -> None:
        table.add_row(name, Text(text))  # as it is: names of missions and logs may hold brackets

    mode, e, lease, sticks = seen.mode, seen.estimate, seen.lease, seen.sticks
    row("mode", f"{mode.mode.upper()}  {mode.why}" if mode else "starting")
    if e and e.health != "initialising":
        heading = math.degrees(e.psi_rad) % 360.0
        speeds = f"u {e.u_m_s:+.2f}  v {e.v_m_s:+.2f} m/s  r {math.degrees(e.r_rad_s):+.0f} deg/s"
        row("state", f"N {e.north_m:.2f}  E {e.east_m:.2f} m  heading {heading:.0f} deg  {speeds}  {e.health}")
    else:
        row("state", f"no position: {e.reason}" if e else "")
    if sticks:
        shares = f"ahead {sticks.surge:+.0%}  starboard {sticks.sway:+.0%}  clockwise {sticks.yaw:+.0%}"
        row("sticks", f"{shares}  ({sticks.source}, keys give {seen.level:.0%})")
    if lease:
        pulses = "  ".join(f"{name} {us} us" for name, us in zip(seen.thrusters, lease.pwm_us, strict=False))
        row("thrusters", f"{pulses}  [{lease.source}]")
    if seen.excitation and lease and lease.source == "excitation":
        x = seen.excitation
        row("excitation", f"{x.phase}  {min(x.segment + 1, x.segments)}/{x.segments} {x.name} {x.elapsed_s:.0f} s")
    row("log", f"{seen.log}  {seen.note}")
    row("ticks", f"late by {seen.late_ms:.1f} ms at most")
    row("alerts", "\n".join(seen.alerts))
    return table


class TeleopView:
    """Draws `seen` on `out` until `close`."""

    def __init__(self, seen: TeleopState, out: TextIO) -> None:
        self._seen, self._out = seen, out
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._draw, name="view", daemon=True)

    def start(self) -> None:
        """Begin to draw."""
        self._thread.start()

    def close(self) -> None:
        """Draw a last time, without waiting for a terminal that is blocked."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join(timeout=2 * PERIOD_S)

    def _draw(self) -> None:
        with contextlib.suppress(OSError), Live(console=Console(file=self._out), auto_refresh=False) as live:
            while not self._ended.is_set():
                live.update(picture(self._seen), refresh=True)
                self._ended.wait(PERIOD_S)
            live.update(picture(self._seen), refresh=True)
