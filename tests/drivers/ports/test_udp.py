"""UDP ports: one peer at a time, refusals, empty datagrams."""

import asyncio
import socket

from drivers.ports.udp import DATAGRAM_BYTES, UdpClientPort, UdpServerPort
from tests.drivers.ports.port_pairs import HOST, free_port, run


def test_udpin_locks_on_to_one_peer_and_moves_only_after_its_silence():
    now_ns = 0

    async def main():
        nonlocal now_ns
        port = free_port(socket.SOCK_DGRAM)
        server = UdpServerPort(HOST, port, peer_timeout_s=3.0, now_ns=lambda: now_ns)
        first, second = UdpClientPort(HOST, port), UdpClientPort(HOST, port)
        for opened in (server, first, second):
            await opened.open()
        server.send(b"to nobody")
        assert server.counters.dropped_bytes == 9
        first.send(b"a1")
        assert await server.receive() == b"a1"
        second.send(b"b1")
        first.send(b"a2")
        assert await server.receive() == b"a2"
        assert server.counters.rejected_datagrams == 1
        server.send(b"for a")
        assert await first.receive() == b"for a"
        now_ns = 2_999_999_999
        second.send(b"b2")
        await asyncio.sleep(0.01)
        waiting = asyncio.create_task(server.receive())
        await asyncio.sleep(0.01)
        assert server.counters.rejected_datagrams == 2
        now_ns = 3_000_000_000
        second.send(b"b3")
        assert await waiting == b"b3"
        server.send(b"for b")
        assert await second.receive() == b"for b"
        first.send(b"a3")
        await asyncio.sleep(0.01)
        other = asyncio.create_task(first.receive())
        await asyncio.sleep(0.01)
        assert not other.done(), "the old peer must not be answered any more"
        for opened in (server, first, second):
            await opened.close()
        assert await other == b""

    run(main)


def test_udpin_re_opened_forgets_its_peer():
    async def main():
        port = free_port(socket.SOCK_DGRAM)
        server, first, second = (
            UdpServerPort(HOST, port),
            UdpClientPort(HOST, port),
            UdpClientPort(HOST, port),
        )
        for opened in (server, first, second):
            await opened.open()
        first.send(b"a")
        assert await server.receive() == b"a"
        await server.close()
        await server.open()
        second.send(b"b")
        assert await server.receive() == b"b"
        for opened in (server, first, second):
            await opened.close()

    run(main)


def test_udpout_started_first_is_not_ended_by_refusals():
    async def main():
        port = free_port(socket.SOCK_DGRAM)
        client, server = UdpClientPort(HOST, port), UdpServerPort(HOST, port)
        await client.open()
        waiting = asyncio.create_task(client.receive())
        for _ in range(5):
            client.send(b"anybody?")
            await asyncio.sleep(0.01)
        assert not waiting.done()
        assert client.counters.refused_datagrams >= 2
        await server.open()
        client.send(b"now?")
        assert await server.receive() == b"now?"
        server.send(b"yes")
        assert await waiting == b"yes"
        await client.close()
        await server.close()

    run(main)


def test_udpout_hears_its_address_only_and_an_empty_datagram_is_no_end():
    async def main():
        port = free_port(socket.SOCK_DGRAM)
        client = UdpClientPort(HOST, port)
        await client.open()
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as real,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
        ):
            real.bind((HOST, port))
            client.send(b"x" * (2 * DATAGRAM_BYTES + 1))
            sizes = [len(real.recvfrom(65536)[0]) for _ in range(3)]
            assert sizes == [DATAGRAM_BYTES, DATAGRAM_BYTES, 1]
            client.send(b"hi")
            _, address = real.recvfrom(100)
            stranger.sendto(b"evil", address)
            real.sendto(b"", address)
            real.sendto(b"good", address)
            assert await client.receive() == b"good"
        await client.close()

    run(main)
