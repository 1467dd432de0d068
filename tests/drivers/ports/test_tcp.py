"""TCP ports: one peer, named errors, reset connections."""

import asyncio
import errno
import socket

import pytest

from drivers.ports.tcp import TcpClientPort, TcpServerPort
from tests.drivers.ports.port_pairs import HOST, free_port, run


def test_tcpin_has_one_peer_and_refuses_the_second():
    async def main():
        port = free_port()
        server, first, second = (
            TcpServerPort(HOST, port),
            TcpClientPort(HOST, port),
            TcpClientPort(HOST, port),
        )
        await server.open()
        server.send(b"early")
        assert server.counters.dropped_bytes == 5
        await first.open()
        first.send(b"1")
        assert await server.receive() == b"1"
        with pytest.raises(ConnectionRefusedError):
            await second.open()
        await first.close()
        assert await server.receive() == b""
        await server.close()
        await server.open()
        await second.open()
        second.send(b"2")
        assert await server.receive() == b"2"
        await second.close()
        await server.close()

    run(main)


def test_tcp_errors_name_the_reason(monkeypatch):
    async def main():
        port = free_port()
        with pytest.raises(ConnectionRefusedError):
            await TcpClientPort(HOST, port).open()
        server, rival = TcpServerPort(HOST, port), TcpServerPort(HOST, port)
        await server.open()
        with pytest.raises(OSError) as caught:
            await rival.open()
        assert caught.value.errno == errno.EADDRINUSE
        await server.close()

        async def never(*_: object) -> None:
            await asyncio.sleep(60)

        monkeypatch.setattr("drivers.ports.tcp.CONNECT_TIMEOUT_S", 0.02)
        monkeypatch.setattr(asyncio.get_running_loop(), "sock_connect", never)
        with pytest.raises(OSError, match=r"no answer within 0\.02 s"):
            await TcpClientPort(HOST, port).open()

    run(main)


def test_a_reset_connection_is_an_end():
    async def main():
        port = free_port()
        client = TcpClientPort(HOST, port)
        with socket.create_server((HOST, port)) as listener:
            await client.open()
            peer, _ = listener.accept()
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            peer.close()
            assert await client.receive() == b""
            with pytest.raises(OSError):
                client.send(b"x")
        await client.close()

    run(main)
