"""A signature for a program that cannot sign: it talks to a UDP port on this computer, and we to the autopilot.

    MAVSDK  <- unsigned, udp 127.0.0.1 ->  relay  <- signed ->  port of the autopilot

Frames of the program are signed with our key, in its own name; of what the autopilot says only what is believed
passes (see `signing`). While it is open, programs of this computer can have frames signed: it is for setting up, not
for driving.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from drivers.mavlink.framing import Framer
from drivers.mavlink.signing import Signing
from drivers.ports.port import Port

HOST = "127.0.0.1"


@contextlib.asynccontextmanager
async def signing_relay(port: Port, signing: Signing) -> AsyncIterator[int]:
    """Yields the UDP port on this computer; silent once `port` ends. Raises OSError where that cannot be opened."""
    await port.open()
    transport = None
    try:
        loop = asyncio.get_running_loop()
        transport, program = await loop.create_datagram_endpoint(lambda: _Program(port, signing), local_addr=(HOST, 0))
        pump = asyncio.create_task(program.pump())
        try:
            yield transport.get_extra_info("sockname")[1]
        finally:
            pump.cancel()
            await asyncio.gather(pump, return_exceptions=True)
    finally:
        if transport:
            transport.close()
        await port.close()


class _Program(asyncio.DatagramProtocol):
    """The first program that speaks is the one that is answered."""

    def __init__(self, port: Port, signing: Signing) -> None:
        self._port, self._signing = port, signing
        self._peer: Any = None
        self._transport: Any = None
        self._from_program, self._from_autopilot = Framer(), Framer()
        self._mav = dialect.MAVLink(None)
        signing.equip(self._mav)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._peer = self._peer or addr
        if addr != self._peer:
            return
        for message in self._from_program.feed(data, time.monotonic_ns()):
            with contextlib.suppress(OSError):  # gone: MAVSDK will miss its answers, and say so
                self._port.send(self._signed(message))

    async def pump(self) -> None:
        """What the autopilot says, until its port ends."""
        with contextlib.suppress(OSError):
            while data := await self._port.receive():
                for message in self._from_autopilot.feed(data, time.monotonic_ns()):
                    if self._signing.accepts(message) and self._peer:
                        self._transport.sendto(bytes(message.get_msgbuf()), self._peer)

    def _signed(self, message: Any) -> bytes:
        """The same frame in its sender's name, with a signature."""
        self._mav.srcSystem, self._mav.srcComponent = message.get_srcSystem(), message.get_srcComponent()
        self._mav.seq = message.get_seq()
        self._signing.stamp(self._mav)
        return bytes(message.pack(self._mav))
