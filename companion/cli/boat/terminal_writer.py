"""Text for a terminal that is written by a thread of its own.

For a terminal may stop taking characters (Ctrl-S, a radio link that stalls, a pager): then the text stands still, and
the control loop does not.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from typing import TextIO

WAITING = 200
"""Texts that wait at most; older ones are left out. Assumed: the last minute of a run, its alerts included."""
CLOSE_S = 0.5
"""What is left is waited for so long at the end; assumed."""


class TerminalWriter:
    """Takes text as `out` would, never waits, never raises. `close` it."""

    def __init__(self, out: TextIO):
        self._out = out
        self._texts: deque[str] = deque(maxlen=WAITING)
        self._due, self._closed = threading.Event(), False
        self._thread = threading.Thread(target=self._run, name="terminal", daemon=True)
        self._thread.start()

    def isatty(self) -> bool:
        """Whether people look at it."""
        return self._out.isatty()

    def write(self, text: str) -> int:
        """Have it written; how long it is."""
        self._texts.append(text)
        self._due.set()
        return len(text)

    def flush(self) -> None:
        """What is written is flushed."""

    def close(self) -> None:
        """Wait for what is left, a little."""
        self._closed = True
        self._due.set()
        self._thread.join(CLOSE_S)

    def _run(self) -> None:
        while not self._closed or self._texts:
            self._due.wait()
            self._due.clear()
            while self._texts:
                with contextlib.suppress(OSError, ValueError):  # a closed terminal must not stop the boat
                    self._out.write(self._texts.popleft())
                    self._out.flush()
