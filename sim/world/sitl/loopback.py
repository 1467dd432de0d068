"""The simulated boat for a real ArduPilot in software: servo packets and states over UDP, UWB bytes over a pty.

The firmware sets the pace. `speed` holds it back where it would run faster than that many seconds per second;
after a stall the lost time is not made up.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

from msgspec.structs import replace

from companion.core.messages import GroundTruth
from drivers.ports.pseudo_terminal import PtyPort
from sim.world.loopback import TRUTH_NS, plug_in
from sim.world.mavlink_server import Address
from sim.world.sitl.backend import Answer, JsonBackend
from sim.world.sitl.physics import SitlPhysics
from sim.world.sitl.protocol import PORT
from sim.world.world import WorldSetup

WATCH_S = 0.5
BEHIND_NS = 200_000_000
"""Further behind than this is a stall, not jitter; assumed."""


@dataclass(frozen=True)
class JsonWires:
    """Where the firmware sends, where the tag appears. `speed`: simulated per real seconds at most, None: no limit."""

    bind: Address = ("127.0.0.1", PORT)
    uwb_path: str = "/tmp/aritra-uwb"
    speed: float | None = None


class Pace:
    """How long to wait with the answer so that simulated time runs at most `speed` times as fast as real time."""

    def __init__(self, speed: float | None):
        self._speed = speed
        self._zero_ns: int | None = None

    def wait_ns(self, world_ns: int, now_ns: int) -> int:
        """From `now_ns` until the world may be at `world_ns`."""
        if self._speed is None:
            return 0
        at_ns = round(world_ns / self._speed)
        if self._zero_ns is None or self._zero_ns + at_ns < now_ns - BEHIND_NS:
            self._zero_ns = now_ns - at_ns
        return max(0, self._zero_ns + at_ns - now_ns)


async def serve_firmware(
    setup: WorldSetup,
    seed: int,
    wires: JsonWires,
    on_truth: Callable[[GroundTruth], None],
    say: Callable[[str], None],
) -> None:
    """Run until cancelled. `say` is told where the devices are, and what happens. Raises OSError for a taken port."""
    pty = PtyPort(wires.uwb_path)
    server = _Server(SitlPhysics(setup, seed), pty, wires.speed, on_truth, say)
    try:
        udp = await _listen(server, wires.bind)
        await plug_in(pty, "--ardupilot-json")
        host, port = udp.get_extra_info("sockname")[:2]
        say(f"waiting for ArduPilot (--model JSON:{host}) on udp {host}:{port}, UWB tag on {wires.uwb_path}")
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(server.answer_tag())
                group.create_task(server.watch())
        finally:
            say(server.summary())
    finally:
        server.close()
        await pty.close()


async def _listen(server: _Server, bind: Address) -> asyncio.DatagramTransport:
    """The server's socket. Raises OSError that names the address."""
    loop = asyncio.get_running_loop()
    try:
        return (await loop.create_datagram_endpoint(lambda: server, local_addr=bind))[0]
    except OSError as error:
        host, port = bind
        hint = f"a second boat takes --ardupilot-json {host}:{port + 10} and a firmware started with -I1"
        raise OSError(f"udp {host}:{port}: {error.strerror or error}; {hint}") from None


class _Server(asyncio.DatagramProtocol):
    """Datagrams to the backend and back; the tag's bytes to the pty; the truth, stamped with this machine's clock."""

    def __init__(
        self,
        physics: SitlPhysics,
        pty: PtyPort,
        speed: float | None,
        on_truth: Callable[[GroundTruth], None],
        say: Callable[[str], None],
    ):
        self._physics, self._pty, self._pace = physics, pty, Pace(speed)
        self._backend = JsonBackend(physics)
        self._on_truth, self._say = on_truth, say
        self._truth_due_ns = 0
        self._udp: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._udp = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: Address) -> None:
        now_ns = time.monotonic_ns()
        sender = f"{addr[0]}:{addr[1]}"
        answer = self._backend.receive(data, sender, now_ns)
        self._tell()
        if answer is None:
            return
        if answer.uwb:
            self._pty.send(answer.uwb)
        self._record(answer, now_ns)
        wait_ns = self._pace.wait_ns(self._physics.world.t_ns, now_ns)
        if wait_ns:
            asyncio.get_running_loop().call_later(wait_ns * 1e-9, self._send, answer.data, addr)
        else:
            self._send(answer.data, addr)

    def error_received(self, exc: Exception) -> None:
        """ICMP says that the firmware is gone: it may come back."""

    async def answer_tag(self) -> None:
        """What the companion says to the tag; while nobody has the device open this waits."""
        while data := await self._pty.receive():
            if answer := self._physics.world.uwb(data):
                self._pty.send(answer)

    async def watch(self) -> None:
        """A look at the clock now and then."""
        while True:
            await asyncio.sleep(WATCH_S)
            self._backend.watch(time.monotonic_ns())
            self._tell()

    def close(self) -> None:
        """Close the socket. May be called twice, and before it is open."""
        if self._udp is not None:
            self._udp.close()

    def summary(self) -> str:
        """What went over the wire."""
        c = self._backend.counters
        frames = f"{c.steps} frames, {c.repeated} asked for again, {c.missed} missed"
        return f"{frames}, firmware started again {c.restarts} times, {c.strangers + c.garbage} datagrams ignored"

    def _send(self, data: bytes, address: Address) -> None:
        if self._udp is not None and not self._udp.is_closing():
            self._udp.sendto(data, address)

    def _record(self, answer: Answer, now_ns: int) -> None:
        if answer.stepped and self._physics.world.t_ns >= self._truth_due_ns:
            self._truth_due_ns = self._physics.world.t_ns + TRUTH_NS
            self._on_truth(replace(self._physics.world.truth(), t_ns=now_ns))

    def _tell(self) -> None:
        for text in self._backend.take_news():
            self._say(text)
