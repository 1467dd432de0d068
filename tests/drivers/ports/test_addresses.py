"""Names that mean an IPv6 address as well, as `localhost` does on Debian: the IPv4 one is tried first."""

import asyncio
import socket

import pytest

from drivers.ports.tcp import TcpClientPort, TcpServerPort
from drivers.ports.udp import UdpClientPort, UdpServerPort
from tests.drivers.ports.port_pairs import HOST, free_port, run


@pytest.mark.parametrize("make", [UdpClientPort, UdpServerPort, TcpServerPort, TcpClientPort])
def test_of_a_name_that_has_both_ipv4_goes_first(monkeypatch, make):
    tried: list[socket.AddressFamily] = []
    real = socket.socket

    def noted(family: socket.AddressFamily, *args) -> socket.socket:
        tried.append(family)
        return real(socket.AF_INET, *args)

    async def main():
        port = free_port(socket.SOCK_STREAM if "Tcp" in make.__name__ else socket.SOCK_DGRAM)
        near, far = (HOST, port), ("::1", port, 0, 0)

        async def both(*_: object, **how: int):
            v6, v4 = (socket.AF_INET6, far), (socket.AF_INET, near)
            return [(family, how["type"], 0, "", address) for family, address in (v6, v4)]

        listener = TcpServerPort(HOST, port)
        if make is TcpClientPort:
            await listener.open()
        monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", both)
        monkeypatch.setattr(socket, "socket", noted)
        made = make("boat.local", port)
        await made.open()
        await made.close()
        await listener.close()

    run(main)
    assert tried[0] == socket.AF_INET
