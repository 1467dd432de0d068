"""UDP: a client that talks to one address, and a server that locks on to one peer.

`udpin` answers only the peer it is locked on to: the first address heard. It moves to another address only
after that peer has been silent for `peer_timeout_s`; until then other senders are counted as rejected
(pymavlink's own udpin answers everyone that ever sent). UDP has no end: a peer that goes falls silent, and
"connection refused" is counted, since the other program may simply not have started yet.
"""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Callable
from typing import Any

from drivers.ports.descriptor import READ_BYTES, DescriptorPort

DATAGRAM_BYTES = 1472
"""Ethernet's 1500 less the IPv4 (20) and UDP (8) headers: larger chunks are split, never fragmented."""
SEND_LIMIT_BYTES = 65536
PEER_TIMEOUT_S = 3.0
"""Assumed: three heartbeats at 1 Hz missed."""


class _UdpPort(DescriptorPort):
    """What client and server share: datagrams of at most 1472 bytes, errors counted and never an end."""

    def __init__(self, scheme: str, host: str, port: int, send_limit_bytes: int) -> None:
        super().__init__(f"{scheme}:{bracketed(host)}:{port}", send_limit_bytes)
        self.host = host
        self.port = port

    async def open(self) -> None:
        """Resolve the address, connect or bind. Raises OSError (unknown host, no route, address in use, not ours)."""
        self._require_closed()
        family, _, _, _, address = (await addresses(self.host, self.port, socket.SOCK_DGRAM))[0]
        made = socket.socket(family, socket.SOCK_DGRAM)
        try:
            made.setblocking(False)
            self._attach(made, address)
        except BaseException:
            made.close()
            raise
        self._socket = made
        self._begin()
        self._adopt(made)

    def _queue(self, data: bytes) -> None:
        for start in range(0, len(data), DATAGRAM_BYTES):
            super()._queue(data[start : start + DATAGRAM_BYTES])

    def _read(self) -> bytes | None:
        """One datagram; an empty one is nothing, not an end."""
        try:
            data, address = self._socket.recvfrom(READ_BYTES)
        except BlockingIOError:
            raise
        except OSError:
            self.counters.refused_datagrams += 1
            return None
        return data if self._accepts(address) and data else None

    def _write(self, data: memoryview) -> int:
        try:
            return self._transmit(data)
        except BlockingIOError:
            raise
        except OSError:
            self.counters.refused_datagrams += 1
            return 0

    def _attach(self, made: socket.socket, address: Any) -> None:
        raise NotImplementedError

    def _accepts(self, address: Any) -> bool:
        raise NotImplementedError

    def _transmit(self, data: memoryview) -> int:
        raise NotImplementedError


class UdpClientPort(_UdpPort):
    """`udpout:127.0.0.1:14551`: sends to this address and receives from it only (the kernel filters)."""

    def __init__(self, host: str, port: int, *, send_limit_bytes: int = SEND_LIMIT_BYTES) -> None:
        super().__init__("udpout", host, port, send_limit_bytes)

    def _attach(self, made: socket.socket, address: Any) -> None:
        made.connect(address)

    def _accepts(self, address: Any) -> bool:
        return True

    def _transmit(self, data: memoryview) -> int:
        return self._socket.send(data)


class UdpServerPort(_UdpPort):
    """`udpin:0.0.0.0:14550`: waits for a peer, then talks to it alone. `now_ns`: a monotonic clock [ns]."""

    def __init__(
        self,
        host: str,
        port: int,
        *,
        peer_timeout_s: float = PEER_TIMEOUT_S,
        now_ns: Callable[[], int] = time.monotonic_ns,
        send_limit_bytes: int = SEND_LIMIT_BYTES,
    ) -> None:
        super().__init__("udpin", host, port, send_limit_bytes)
        self.peer: Any = None
        """Address locked on to, None before the first datagram."""
        self._peer_timeout_ns = round(peer_timeout_s * 1e9)
        self._now_ns = now_ns
        self._heard_ns = 0

    def _attach(self, made: socket.socket, address: Any) -> None:
        made.bind(address)
        self.peer = None

    def _accepts(self, address: Any) -> bool:
        now_ns = self._now_ns()
        if address != self.peer:
            if self.peer is not None and now_ns - self._heard_ns < self._peer_timeout_ns:
                self.counters.rejected_datagrams += 1
                return False
            self.peer = address
        self._heard_ns = now_ns
        return True

    def _transmit(self, data: memoryview) -> int:
        return self._socket.sendto(data, self.peer) if self.peer is not None else 0


async def addresses(host: str, port: int, kind: socket.SocketKind) -> list[Any]:
    """What getaddrinfo says, IPv4 first: `localhost` and names of a local network mostly mean both, IPv6 first, where
    autopilots and ground stations listen on IPv4 alone. Raises OSError (unknown host).
    """
    infos = await asyncio.get_running_loop().getaddrinfo(host, port, type=kind)
    return sorted(infos, key=lambda info: info[0] != socket.AF_INET)


def bracketed(host: str) -> str:
    """An IPv6 address in brackets, anything else as it is."""
    return f"[{host}]" if ":" in host else host
