"""The simulated autopilot on real sockets: one UDP endpoint and one TCP server, any number of peers.

    server = MavlinkServer(rover, clock)
    await server.open_udp(("127.0.0.1", 0), target=("127.0.0.1", 14550))
    await server.open_tcp(("127.0.0.1", 5760))
    server.send(rover.step(t_ns, sensors))     # whoever drives the plant drives this
    await server.close()

UDP sends to its target from the start and answers whoever speaks to it; such a peer is forgotten after 30 s
of silence. A TCP peer is served from when it connects until it leaves; what it does not read beyond 64 kB is
lost to it, as on a full serial line. `clock` gives the simulation's time [ns].
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable, Iterable

from sim.world.autopilot import Rover

Address = tuple[str, int]
_FORGET_NS = 30_000_000_000
_FULL_BYTES = 65_536


class MavlinkServer:
    """Carries bytes between sockets and a Rover. `open_udp`, `open_tcp` return where it listens."""

    def __init__(self, rover: Rover, clock: Callable[[], int]):
        self._rover, self._clock = rover, clock
        self._udp: asyncio.DatagramTransport | None = None
        self._target: Address | None = None
        self._udp_heard_ns: dict[Address, int] = {}
        self._tcp: asyncio.Server | None = None
        self._writers: dict[Hashable, asyncio.StreamWriter] = {}

    @property
    def waiting_bytes(self) -> int:
        """What TCP peers have not taken yet."""
        return sum(writer.transport.get_write_buffer_size() for writer in self._writers.values())

    async def open_udp(self, bind: Address, target: Address | None = None) -> Address:
        """Listen on `bind` (port 0: any free one) and talk to `target`. OSError with the reason."""
        loop = asyncio.get_running_loop()
        self._udp, _ = await loop.create_datagram_endpoint(lambda: _Datagrams(self._datagram), local_addr=bind)
        if target is not None:
            self._target = target
            self._rover.add_link(("udp", target))
        return self._udp.get_extra_info("sockname")[:2]

    async def open_tcp(self, bind: Address) -> Address:
        """Listen on `bind` (port 0: any free one). OSError with the reason."""
        self._tcp = await asyncio.start_server(self._client, *bind)
        return self._tcp.sockets[0].getsockname()[:2]

    def send(self, outgoing: Iterable[tuple[Hashable, bytes]]) -> None:
        """Hand what `Rover.step` returned to its peers; forget UDP peers long silent."""
        for peer, data in outgoing:
            self._send(peer, data)
        horizon_ns = self._clock() - _FORGET_NS
        for address in [a for a, heard_ns in self._udp_heard_ns.items() if heard_ns < horizon_ns]:
            del self._udp_heard_ns[address]
            self._rover.remove_link(("udp", address))

    async def close(self) -> None:
        """Close every socket. May be called twice."""
        if self._udp is not None:
            self._udp.close()
            self._udp = None
        if self._tcp is not None:
            self._tcp.close()
            self._tcp = None
        for writer in list(self._writers.values()):
            writer.close()
        await asyncio.sleep(0)

    def _send(self, peer: Hashable, data: bytes) -> None:
        writer = self._writers.get(peer)
        if writer is not None:
            if writer.transport.get_write_buffer_size() < _FULL_BYTES:
                writer.write(data)
        elif self._udp is not None and isinstance(peer, tuple) and peer[0] == "udp":
            self._udp.sendto(data, peer[1])

    def _datagram(self, data: bytes, address: Address) -> None:
        now_ns = self._clock()
        if address != self._target:
            self._udp_heard_ns[address] = now_ns
        peer = ("udp", address)
        self._send(peer, self._rover.receive(data, peer, now_ns))

    async def _client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peer = ("tcp", writer.get_extra_info("peername")[:2])
        self._writers[peer] = writer
        self._rover.add_link(peer)
        try:
            while data := await reader.read(4096):
                self._send(peer, self._rover.receive(data, peer, self._clock()))
        except OSError:
            pass  # the client vanished: the same as leaving
        finally:
            del self._writers[peer]
            self._rover.remove_link(peer)
            writer.close()


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, received: Callable[[bytes, Address], None]):
        self._received = received

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self._received(data, addr[:2])

    def error_received(self, exc: Exception) -> None:
        """ICMP says that nobody listens there (yet): UDP goes on."""
