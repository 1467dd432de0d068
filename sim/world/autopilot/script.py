"""The Lua machine with the gate's script: stopped and started again by MAV_CMD_SCRIPTING.

What the script wrote last stays at the outputs for 0.2 s (`LASTS_MS` of gate.lua), then they fall to SERVOn_TRIM. A new
machine starts a second after the old one ended at the earliest (source: AP_Scripting.cpp, the loop of its thread).
"""

from __future__ import annotations

from collections.abc import Callable

LASTS_NS = 200_000_000
RESTART_NS = 1_000_000_000
_CRITICAL, _INFO = 2, 6


class GateScript:
    """`exists`: a script is on the card, and SCR_ENABLE was set at boot."""

    def __init__(self, exists: bool, say: Callable[[int, str], None]):
        self.exists, self._say = exists, say
        self._ended_ns: int | None = None
        self._restart_ns: int | None = None

    def stop(self, t_ns: int, *, restart: bool) -> None:
        """End the machine at t; `restart`: and start it again."""
        if not self.exists:
            return
        if self._ended_ns is None:
            self._ended_ns = t_ns
            self._say(_CRITICAL, "Scripting: stopped")
        self._restart_ns = max(t_ns, self._ended_ns + RESTART_NS) if restart else None

    def advance(self, t_ns: int) -> None:
        """Start again where it is due."""
        if self._restart_ns is not None and t_ns >= self._restart_ns:
            self._ended_ns = self._restart_ns = None
            self._say(_CRITICAL, "Scripting: restarted")
            self._say(_INFO, "gate: thrusters on channels 9 10 11 12")

    def writes(self, t_ns: int) -> bool:
        """Whether what it wrote last is still at the outputs at t."""
        return self._ended_ns is None or t_ns - self._ended_ns < LASTS_NS

    @property
    def ended(self) -> bool:
        """Whether it writes nothing new."""
        return self._ended_ns is not None
