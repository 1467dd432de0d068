"""Two ports joined by memory: a cable for tests.

A cable: an end may be plugged_in in any order, what is sent while the other end is closed is dropped and
counted, and closing one end ends the stream at the other.
"""

from __future__ import annotations

import asyncio
import errno

from drivers.ports.port import PortCounters, SendBuffer

LIMIT_BYTES = 65536


def memory_pair(name: str = "memory", *, limit_bytes: int = LIMIT_BYTES) -> tuple[MemoryPort, MemoryPort]:
    """Two ends of one cable. `limit_bytes`: what may wait for a slow receiver."""
    near, far = MemoryPort(f"{name}:a", limit_bytes), MemoryPort(f"{name}:b", limit_bytes)
    near.other, far.other = far, near
    return near, far


class MemoryPort:
    """One end; made by `memory_pair`."""

    other: MemoryPort

    def __init__(self, name: str, limit_bytes: int = LIMIT_BYTES) -> None:
        self.name = name
        self.counters = PortCounters()
        self.inbox = SendBuffer(limit_bytes)
        self.plugged_in = False
        self.ended = False
        self._waiter: asyncio.Future[None] | None = None

    @property
    def is_open(self) -> bool:
        """Whether this end is plugged in."""
        return self.plugged_in

    @property
    def has_ended(self) -> bool:
        """Whether the other end has left since."""
        return self.ended

    @property
    def waiting_bytes(self) -> int:
        """What has come and was not received yet."""
        return len(self.inbox)

    async def open(self) -> None:
        """Plug in."""
        if self.plugged_in:
            raise OSError(errno.EISCONN, "already open")
        self.plugged_in, self.ended = True, False

    async def receive(self) -> bytes:
        """The next chunk as it was sent; b"" once the other end has closed."""
        while self.plugged_in:
            if self.inbox:
                data = bytes(self.inbox.head())
                self.inbox.consume(len(data))
                self.counters.received_bytes += len(data)
                return data
            if self.ended:
                break
            await self._arrival()
        return b""

    def send(self, data: bytes) -> None:
        """Put a chunk into the other end's hands. Raises OSError where the port is not open."""
        if not self.plugged_in or self.ended:
            raise OSError(errno.ENOTCONN, f"{self.name} is not open")
        if not self.other.plugged_in:
            self.counters.dropped_bytes += len(data)
            return
        dropped = self.other.inbox.push(data)
        self.counters.dropped_bytes += dropped
        self.counters.sent_bytes += len(data) - dropped
        self.other.wake()

    async def close(self) -> None:
        """Unplug, which ends the other end's stream unless that one ended ours. May be called twice."""
        if self.plugged_in:
            self.plugged_in = False
            self.inbox.clear()
            self.wake()
            if not self.ended:
                self.other.ended = True
                self.other.wake()

    async def _arrival(self) -> None:
        if self._waiter is not None:
            raise RuntimeError(f"{self.name}: only one receiver at a time")
        self._waiter = asyncio.get_running_loop().create_future()
        try:
            await self._waiter
        finally:
            self._waiter = None

    def wake(self) -> None:
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)
