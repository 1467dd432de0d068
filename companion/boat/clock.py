"""The one source of time: a clock that is passed in, never asked behind anyone's back.

`now_ns` is monotonic [ns]; `sleep_until` waits for an instant on that clock. `BoatClock` is the machine's own.
"""

from __future__ import annotations

import asyncio
import time
from typing import Protocol


class Clock(Protocol):
    """Monotonic time in nanoseconds; its zero means nothing."""

    def now_ns(self) -> int:
        """The present instant [ns]; never goes back."""
        ...

    async def sleep_until(self, t_ns: int) -> None:
        """Return at `t_ns` or after, never before. An instant in the past lets others run once."""
        ...


class BoatClock:
    """The machine's monotonic clock: unmoved by NTP steps and by the date."""

    def now_ns(self) -> int:
        """CLOCK_MONOTONIC [ns]."""
        return time.monotonic_ns()

    async def sleep_until(self, t_ns: int) -> None:
        """Sleep on the event loop's timer, again if it fires a little early."""
        await asyncio.sleep(max(0.0, (t_ns - time.monotonic_ns()) * 1e-9))
        while (left_ns := t_ns - time.monotonic_ns()) > 0:
            await asyncio.sleep(left_ns * 1e-9)
