"""The one shape of every transport: bytes in, bytes out, and a stream that may end.

    open()     connect, or raise OSError with the reason
    receive()  wait for bytes; b"" means that the other end is gone
    send()     hand bytes over without waiting; raises OSError where the port is not open
    close()    idempotent

A port knows nothing of messages; a codec knows nothing of ports; `drivers.link` joins the two.
"""

from __future__ import annotations

from typing import Protocol


class Port(Protocol):
    """A byte transport. One `open` may follow a `close`: reconnecting re-uses the object."""

    @property
    def name(self) -> str:
        """For people: `udp://127.0.0.1:14550`, `serial:///dev/ttyACM0:115200`."""
        ...

    async def open(self) -> None:
        """Connect. Raises OSError with the reason."""
        ...

    async def receive(self) -> bytes:
        """Next bytes as they come; b"" once the other end is gone."""
        ...

    def send(self, data: bytes) -> None:
        """Queue bytes without blocking. Raises OSError where the port is not open."""
        ...

    async def close(self) -> None:
        """Release the device. May be called twice."""
        ...
