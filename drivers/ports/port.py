"""The one shape of every transport: bytes in, bytes out, and a stream that may end.

    open()     connect, or raise OSError with the reason
    receive()  wait for bytes; b"" means that the other end is gone, or that the port was closed
    send()     hand bytes over without waiting; raises OSError where the port is not open
    close()    idempotent

A port knows nothing of messages; a codec knows nothing of ports; `drivers.link` joins the two.

Sending never blocks and never grows: each port holds a `SendBuffer`, drops its oldest chunks when that is
full, and counts them. Nothing queued survives `close`, so a reconnect never plays back an old command.
Ports without a connection (UDP, the master side of a pty) cannot see the other end go: they wait, and the
silence is the link's business. A port with no peer yet accepts `send` and counts the bytes as dropped.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Protocol


@dataclass(slots=True)
class PortCounters:
    """What a port did since it was made; reconnects do not reset it."""

    received_bytes: int = 0
    sent_bytes: int = 0
    dropped_bytes: int = 0
    """Given to `send` but never sent: buffer full, no peer, refused, or still queued at `close`."""
    rejected_datagrams: int = 0
    """Heard from an address that is not the peer (UDP only)."""
    refused_datagrams: int = 0
    """Errors that the network reported for datagrams: nobody listens there, no route (UDP only)."""


class Port(Protocol):
    """A byte transport. One `open` may follow a `close`: reconnecting re-uses the object."""

    @property
    def name(self) -> str:
        """For people, and accepted by `url`: `udpin:0.0.0.0:14550`, `serial:/dev/ttyACM0:115200`."""
        ...

    @property
    def counters(self) -> PortCounters:
        """Bytes received, sent and dropped so far."""
        ...

    async def open(self) -> None:
        """Connect. Raises OSError with the reason."""
        ...

    async def receive(self) -> bytes:
        """Next bytes as they come; b"" once the other end is gone. Cancelling it loses no byte."""
        ...

    def send(self, data: bytes) -> None:
        """Queue bytes without blocking. Raises OSError where the port is not open."""
        ...

    async def close(self) -> None:
        """Release the device. May be called twice. A `receive` that waits returns b""."""
        ...


class SendBuffer:
    """Chunks waiting to be sent, at most `limit_bytes` of them; pure.

    A chunk is what one `send` was given: a whole frame. When full, the oldest whole chunks go first, so
    that what arrives is fresh and never cut in the middle. A chunk of which a part is already on the wire
    stays; a new chunk that cannot fit even then is dropped itself.
    """

    def __init__(self, limit_bytes: int) -> None:
        if limit_bytes <= 0:
            raise ValueError(f"limit_bytes must be positive, got {limit_bytes}")
        self.limit_bytes = limit_bytes
        self._chunks: deque[bytes] = deque()
        self._size = 0
        self._head_sent = 0

    def __len__(self) -> int:
        """Bytes waiting."""
        return self._size - self._head_sent

    def push(self, chunk: bytes) -> int:
        """Append a chunk; returns how many bytes were dropped to make room (or of the chunk itself)."""
        dropped = 0
        keep = 1 if self._head_sent else 0
        while len(self) + len(chunk) > self.limit_bytes and len(self._chunks) > keep:
            old = self._chunks[keep]
            del self._chunks[keep]
            self._size -= len(old)
            dropped += len(old)
        if len(self) + len(chunk) > self.limit_bytes:
            return dropped + len(chunk)
        if chunk:
            self._chunks.append(bytes(chunk))
            self._size += len(chunk)
        return dropped

    def head(self) -> memoryview:
        """The unsent rest of the oldest chunk; empty when nothing waits."""
        return memoryview(self._chunks[0])[self._head_sent :] if self._chunks else memoryview(b"")

    def consume(self, count: int) -> None:
        """`count` bytes of `head` are on their way."""
        self._head_sent += count
        if self._chunks and self._head_sent >= len(self._chunks[0]):
            self._size -= len(self._chunks.popleft())
            self._head_sent = 0

    def clear(self) -> int:
        """Forget everything; returns how many bytes that were."""
        dropped = len(self)
        self._chunks.clear()
        self._size = self._head_sent = 0
        return dropped
