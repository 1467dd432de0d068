"""A gamepad's device, read as it comes: opened again for ever where it is unplugged; the last pad is forgotten then."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Awaitable, Callable

from drivers.sticks.gamepad import EVENT, Gamepad, axis_codes
from drivers.sticks.mapping import NEUTRAL, Shares

READ_EVENTS = 64
RETRY_NS = 1_000_000_000
"""Between attempts to open the device (assumed)."""


class GamepadDevice:
    """`path`: /dev/input/js0 and the like. `tell` gets a sentence at each change.

    Public: `shares(t_ns)`, neutral while there is no pad; `stops`: presses of the stop button so far.
    """

    def __init__(
        self,
        path: str,
        *,
        now_ns: Callable[[], int],
        sleep_until: Callable[[int], Awaitable[None]],
        tell: Callable[[str], None],
        codes_of: Callable[[int], tuple[int, ...]] = axis_codes,
    ) -> None:
        self.path, self.stops = path, 0
        self._now_ns, self._sleep_until, self._tell, self._codes_of = now_ns, sleep_until, tell, codes_of
        self._pad: Gamepad | None = None
        self._told = ""

    def shares(self, t_ns: int) -> Shares:
        """Where the sticks stand at `t_ns`; neutral without a pad."""
        return self._pad.shares(t_ns) if self._pad else NEUTRAL

    async def run(self) -> None:
        """For ever; cancelling closes the device."""
        while True:
            try:
                trouble = await self._use()
            except OSError as error:
                trouble = error.strerror or str(error)
            self._say(f"gamepad {self.path}: {trouble}; waiting for it")
            await self._sleep_until(self._now_ns() + RETRY_NS)

    async def _use(self) -> str:
        """Open and read until it ends; why it did."""
        descriptor = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK)
        try:
            pad = Gamepad(self._codes_of(descriptor))
            if pad.missing:
                return f"has no axis with code {', '.join(map(str, pad.missing))} of linux/input-event-codes.h"
            self._pad = pad
            self._say(f"gamepad {self.path}: there; it counts once its sticks have been at rest")
            while data := await _readable(descriptor):
                self.stops += len(pad.feed(data, self._now_ns()))
            return "is gone"
        finally:
            self._pad = None
            os.close(descriptor)

    def _say(self, text: str) -> None:
        if text != self._told:
            self._told = text
            self._tell(text)


async def _readable(descriptor: int) -> bytes:
    """The next bytes of a non-blocking descriptor; b"" at its end. Raises OSError."""
    loop, ready = asyncio.get_running_loop(), asyncio.Event()
    loop.add_reader(descriptor, ready.set)
    try:
        while True:
            with contextlib.suppress(BlockingIOError):
                return os.read(descriptor, READ_EVENTS * EVENT.size)
            ready.clear()
            await ready.wait()
    finally:
        loop.remove_reader(descriptor)
