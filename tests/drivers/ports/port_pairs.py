"""Pairs of connected ports of every kind, for the tests of ports."""

import asyncio
import socket
from collections.abc import Awaitable, Callable

from drivers.ports.port import Port
from drivers.ports.pseudo_terminal import PtyPort
from drivers.ports.serial_line import SerialPort
from drivers.ports.tcp import TcpClientPort, TcpServerPort
from drivers.ports.udp import UdpClientPort, UdpServerPort
from tests.support.stand_ins.memory_port import memory_pair

HOST = "127.0.0.1"
HELLO = b"hello"


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind((HOST, 0))
        return probe.getsockname()[1]


def run(main: Callable[[], Awaitable[None]], limit_s: float = 10.0) -> None:
    async def limited() -> None:
        async with asyncio.timeout(limit_s):
            await main()

    asyncio.run(limited())


class Pair:
    """Two ports of one kind and how to join them. `sees_end`: the near end notices that the far one goes."""

    def __init__(self, kind: str, tmp_path, limit: int):
        self.kind = kind
        self.sees_end = not kind.startswith("udp") and kind != "pty"
        self.link = str(tmp_path / "line")
        self.near, self.far = self._make(limit)

    def _make(self, limit: int) -> tuple[Port, Port]:
        if self.kind == "memory":
            return memory_pair(limit_bytes=limit)
        if self.kind in ("serial", "pty"):
            ends = (
                SerialPort(self.link, 115200, send_limit_bytes=limit),
                PtyPort(self.link, send_limit_bytes=limit),
            )
            return ends if self.kind == "serial" else ends[::-1]
        if self.kind.startswith("udp"):
            port = free_port(socket.SOCK_DGRAM)
            ends = (
                UdpClientPort(HOST, port, send_limit_bytes=limit),
                UdpServerPort(HOST, port, send_limit_bytes=limit),
            )
            return ends if self.kind == "udpout" else ends[::-1]
        port = free_port()
        ends = (
            TcpClientPort(HOST, port, send_limit_bytes=limit),
            TcpServerPort(HOST, port, send_limit_bytes=limit),
        )
        return ends if self.kind == "tcp" else ends[::-1]

    async def join(self) -> None:
        """Open both, the listening side first, and let the calling side say hello."""
        caller_is_near = self.kind in ("memory", "serial", "udpout", "tcp")
        caller, answerer = (self.near, self.far) if caller_is_near else (self.far, self.near)
        await answerer.open()
        await caller.open()
        caller.send(HELLO)
        assert await take(answerer, len(HELLO)) == HELLO

    async def close(self) -> None:
        await self.near.close()
        await self.far.close()


async def take(port: Port, count: int) -> bytes:
    got = bytearray()
    while len(got) < count:
        data = await port.receive()
        assert data, f"{port.name} ended after {len(got)} of {count} bytes"
        got += data
    return bytes(got)
