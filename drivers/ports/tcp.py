"""TCP: a client, and a server that talks to one peer at a time.

The server stops listening while it has a peer, so a second client is refused instead of being half heard;
when the peer goes, `receive` returns b"" and the next `open` listens again. Keep-alive finds a peer whose
machine lost power; small writes leave at once.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket

from drivers.ports.descriptor import READ_BYTES, DescriptorPort
from drivers.ports.udp import addresses, bracketed

SEND_LIMIT_BYTES = 65536
CONNECT_TIMEOUT_S = 3.0
OPTIONS = (
    (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1),
    (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1),
    (socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 2),
    (socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 1),
    (socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3),
    (socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 5000),
)
"""Assumed: a dead peer is noticed after 2 s + 3 * 1 s of silence, or 5000 ms of unacknowledged data."""


class _TcpPort(DescriptorPort):
    """What client and server share: one connected stream."""

    def __init__(self, scheme: str, host: str, port: int, send_limit_bytes: int) -> None:
        super().__init__(f"{scheme}:{bracketed(host)}:{port}", send_limit_bytes)
        self.host = host
        self.port = port

    def _use(self, connected: socket.socket) -> None:
        for level, option, value in OPTIONS:
            connected.setsockopt(level, option, value)
        self._socket = connected
        self._adopt(connected)

    def _read(self) -> bytes | None:
        return self._socket.recv(READ_BYTES)

    def _write(self, data: memoryview) -> int:
        return self._socket.send(data)


class TcpClientPort(_TcpPort):
    """`tcp:127.0.0.1:5760`."""

    def __init__(self, host: str, port: int, *, send_limit_bytes: int = SEND_LIMIT_BYTES) -> None:
        super().__init__("tcp", host, port, send_limit_bytes)

    async def open(self) -> None:
        """Connect. Raises OSError: refused, unknown host, no answer within 3 s."""
        self._require_closed()
        try:
            async with asyncio.timeout(CONNECT_TIMEOUT_S):
                connected = await self._connect()
        except TimeoutError as error:
            raise OSError(errno.ETIMEDOUT, f"no answer within {CONNECT_TIMEOUT_S:g} s") from error
        self._begin()
        self._use(connected)

    async def _connect(self) -> socket.socket:
        """The first of the host's addresses that answers; the last one's error where none does."""
        loop = asyncio.get_running_loop()
        failure = OSError(errno.EADDRNOTAVAIL, "the host has no address")
        for family, kind, protocol, _, address in await addresses(self.host, self.port, socket.SOCK_STREAM):
            made = socket.socket(family, kind, protocol)
            made.setblocking(False)
            try:
                await loop.sock_connect(made, address)
            except OSError as error:
                made.close()
                failure = error
            except BaseException:
                made.close()
                raise
            else:
                return made
        raise failure


class TcpServerPort(_TcpPort):
    """`tcpin:0.0.0.0:5760`: `open` listens, the first client becomes the peer."""

    def __init__(self, host: str, port: int, *, send_limit_bytes: int = SEND_LIMIT_BYTES) -> None:
        super().__init__("tcpin", host, port, send_limit_bytes)
        self._listener: socket.socket | None = None

    async def open(self) -> None:
        """Listen. Raises OSError (address in use, not an address of this machine)."""
        self._require_closed()
        loop = asyncio.get_running_loop()
        family, kind, protocol, _, address = (await addresses(self.host, self.port, socket.SOCK_STREAM))[0]
        listener = socket.socket(family, kind, protocol)
        try:
            listener.setblocking(False)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
            listener.listen(1)
        except BaseException:
            listener.close()
            raise
        self._listener = listener
        self._begin()
        loop.add_reader(listener, self._accept, listener)

    async def close(self) -> None:
        """Stop listening and hang up."""
        self._stop_listening()
        await super().close()

    def _accept(self, listener: socket.socket) -> None:
        """Take the first client; one that hung up before we looked is forgotten."""
        with contextlib.suppress(OSError):
            connected, _ = listener.accept()
            connected.setblocking(False)
            self._stop_listening()
            self._use(connected)

    def _stop_listening(self) -> None:
        if self._listener is not None:
            asyncio.get_running_loop().remove_reader(self._listener)
            self._listener.close()
            self._listener = None
