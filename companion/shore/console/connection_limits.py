"""Connections to the console's web server: those that ask for nothing end, and cannot use up its sockets.

A connection is a stranger's until one of its requests has passed `request_auth`. A stranger has `REQUEST_S` to send a
whole head, and only so many of them are there at a time: of one address, and in all. Beyond that the oldest goes, not
the newest, so that a page that wants to order a stop always comes in.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

REQUEST_S = 5.0
"""How long a stranger may take to ask for something (assumed)."""
OF_ADDRESS, STRANGERS = 32, 128
"""Connections of strangers from one address, and in all (assumed; a browser opens six)."""


class ConnectionLimits:
    """Wraps the protocols that `make` makes, one for each connection. `ended`: how many were ended."""

    def __init__(self, make: Callable[[], asyncio.Protocol]) -> None:
        self.ended = 0
        self._make = make
        self._strangers: dict[asyncio.BaseTransport, tuple[str, asyncio.TimerHandle]] = {}

    def __call__(self) -> asyncio.Protocol:
        """The protocol of a new connection."""
        return _Watched(self._make(), self)

    def prove(self, transport: asyncio.BaseTransport | None) -> None:
        """A request on this connection has passed: it is no stranger's any more."""
        if transport is not None and (known := self._strangers.pop(transport, None)):
            known[1].cancel()

    def come(self, transport: asyncio.BaseTransport) -> None:
        """A new connection."""
        peer = transport.get_extra_info("peername")
        address = str(peer[0]) if isinstance(peer, tuple) else ""
        timer = asyncio.get_running_loop().call_later(REQUEST_S, self._end, transport)
        self._strangers[transport] = address, timer
        same = [t for t, (other, _) in self._strangers.items() if other == address]
        if len(same) > OF_ADDRESS:
            self._end(same[0])
        elif len(self._strangers) > STRANGERS:
            self._end(next(iter(self._strangers)))

    def _end(self, transport: asyncio.BaseTransport) -> None:
        self.prove(transport)
        self.ended += 1
        with contextlib.suppress(AttributeError):
            transport.abort()  # pyright: ignore[reportAttributeAccessIssue]  (every transport of a socket has it)


class _Watched(asyncio.Protocol):
    """A protocol as it is; `limits` hears of its connection."""

    def __init__(self, inner: asyncio.Protocol, limits: ConnectionLimits) -> None:
        self._inner, self._limits = inner, limits
        self._transport: asyncio.BaseTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport
        self._inner.connection_made(transport)
        self._limits.come(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        self._limits.prove(self._transport)
        self._inner.connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        self._inner.data_received(data)

    def eof_received(self) -> bool | None:
        return self._inner.eof_received()

    def pause_writing(self) -> None:
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        self._inner.resume_writing()
