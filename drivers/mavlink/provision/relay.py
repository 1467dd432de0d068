"""Between a program on this computer and the autopilot: the program talks to a UDP port, and we to the autopilot.

    MAVSDK  <- unsigned, udp 127.0.0.1 ->  relay  <- signed, with a key ->  port of the autopilot

With a key the program's frames are signed, in its own name, and of what the autopilot says only what is believed passes
(see `signing`): while the relay is open, programs of this computer can have frames signed. It is for setting up, not
for driving. Without a key all frames pass, and the relay notes whether the autopilot signs.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from drivers.mavlink.framing import Framer
from drivers.mavlink.signing import Signing, is_signed
from drivers.ports.port import Port

HOST = "127.0.0.1"
UNREADABLE = frozenset({"STATUSTEXT"})
"""MAVSDK writes a text that is not UTF-8 into the terminal; the chip's number is one in Rover 4.6 (observed)."""
REOPEN_S = 0.5
"""Between attempts to open a port again that ended; assumed."""


class Relay(asyncio.DatagramProtocol):
    """The first program that speaks is the one that is answered. `number`: UDP port on this computer, once it is open;
    `signed`: the autopilot signs what it says.
    """

    def __init__(self, port: Port, signing: Signing | None) -> None:
        self.number = 0
        self.signed = False
        self._port, self._signing = port, signing
        self._peer: Any = None
        self._transport: Any = None
        self._from_program, self._from_autopilot = Framer(), Framer()
        self._mav = dialect.MAVLink(None)
        if signing:
            signing.equip(self._mav)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The UDP port is open."""
        self._transport = transport
        self.number = transport.get_extra_info("sockname")[1]

    def datagram_received(self, data: bytes, addr: Any) -> None:
        """Frames of the program."""
        self._peer = self._peer or addr
        if addr != self._peer:
            return
        for message in self._from_program.feed(data, time.monotonic_ns()):
            with contextlib.suppress(OSError):  # gone: MAVSDK will miss its answers, and say so
                self._port.send(self._frame(message))

    async def pump(self) -> None:
        """What the autopilot says, until cancelled; a port that ends is opened again."""
        while True:
            with contextlib.suppress(OSError):
                while data := await self._port.receive():
                    self._pass_on(data)
            await self._port.close()
            await asyncio.sleep(REOPEN_S)
            with contextlib.suppress(OSError):
                await self._port.open()

    def _pass_on(self, data: bytes) -> None:
        for message in self._from_autopilot.feed(data, time.monotonic_ns()):
            self.signed = self.signed or is_signed(message)
            if message.get_type() in UNREADABLE:
                continue
            if self._peer and (self._signing is None or self._signing.accepts(message)):
                self._transport.sendto(bytes(message.get_msgbuf()), self._peer)

    def _frame(self, message: Any) -> bytes:
        """The same frame in its sender's name, with a signature if there is a key."""
        if self._signing is None:
            return bytes(message.get_msgbuf())
        self._mav.srcSystem, self._mav.srcComponent = message.get_srcSystem(), message.get_srcComponent()
        self._mav.seq = message.get_seq()
        self._signing.stamp(self._mav)
        return bytes(message.pack(self._mav))


@contextlib.asynccontextmanager
async def open_relay(port: Port, signing: Signing | None) -> AsyncIterator[Relay]:
    """A relay to `port`. Raises OSError where that cannot be opened at first."""
    await port.open()
    transport = None
    try:
        loop = asyncio.get_running_loop()
        transport, relay = await loop.create_datagram_endpoint(lambda: Relay(port, signing), local_addr=(HOST, 0))
        pump = asyncio.create_task(relay.pump())
        try:
            yield relay
        finally:
            pump.cancel()
            await asyncio.gather(pump, return_exceptions=True)
    finally:
        if transport:
            transport.close()
        await port.close()
