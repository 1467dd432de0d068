"""Somebody else under this boat's name: told loudly, for what is shown on shore may be another boat than the one meant.

Heard directly where zenoh brings it (boats that are clients of a router, or connected to each other), or told of by a
sender on shore, who hears both: peers of one router do not hear each other.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from companion.core.messages import Alert
from companion.core.telemetry import structs as shore

AGAIN_NS = 30_000_000_000
"""Between alerts while it lasts (assumed)."""


class NameCollisions:
    """`meet` and `hear` may be called on any thread; so is `tell`."""

    def __init__(self, boat: str, run: str, now_ns: Callable[[], int], tell: Callable[[Alert], None]) -> None:
        self._boat, self._run, self._now_ns, self._tell = boat, run, now_ns, tell
        self._lock = threading.Lock()
        self._told_ns: int | None = None

    def hear(self, data: bytes) -> None:
        """A sample of topic `mode` under this boat's name that came from elsewhere."""
        try:
            run = shore.decode("mode", data).run
        except (ValueError, RecursionError):
            return
        self.meet(run, "by this boat")

    def meet(self, run: str, where: str) -> None:
        """Another run was heard under this name. `where`: by whom, in words."""
        now = self._now_ns()
        with self._lock:
            if run == self._run or (self._told_ns is not None and now - self._told_ns < AGAIN_NS):
                return
            self._told_ns = now
        text = (
            f"another boat or program calls itself {self._boat}, too (run {run[:12]}, heard {where}): STOP reaches "
            "both, and the console refuses other orders; end it, or give one of them another name (telemetry.boat)"
        )
        self._tell(Alert(t_ns=now, level="error", text=text))
