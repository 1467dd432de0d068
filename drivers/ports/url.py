"""From text to transport: `udpin:0.0.0.0:14550` becomes a Port. Errors name the text and what would do.

    udpin:HOST:PORT      listen; locks on to the first peer        udpout:HOST:PORT   talk to this address
    tcpin:HOST:PORT      listen; one peer                          tcp:HOST:PORT      connect
    serial:PATH[:BAUD]   serial device, 115200 where not said      pty:PATH           simulated device

An IPv6 address stands in brackets: `udpout:[::1]:14550`. Of a name that has both, IPv4 goes first.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.ports.port import Port
from drivers.ports.pseudo_terminal import PtyPort
from drivers.ports.serial_line import SerialPort
from drivers.ports.tcp import TcpClientPort, TcpServerPort
from drivers.ports.udp import UdpClientPort, UdpServerPort

DEFAULT_BAUD = 115200
BY_PATH = "/dev/serial/by-path/"
NETWORK: dict[str, Callable[[str, int], Port]] = {
    "udpin": UdpServerPort,
    "udpout": UdpClientPort,
    "tcp": TcpClientPort,
    "tcpin": TcpServerPort,
}
FORMS = "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT, serial:PATH:BAUD, pty:PATH"


class PortUrlError(ValueError):
    """The text is not the URL of a port."""

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(f"port {url!r}: {reason}")


def open_port_from_url(url: str) -> Port:
    """The port that `url` names, not opened yet. Raises PortUrlError (a ValueError)."""
    scheme, colon, rest = url.partition(":")
    if scheme in NETWORK and colon:
        return NETWORK[scheme](*_host_and_port(url, rest))
    if scheme == "serial" and colon:
        return SerialPort(*_path_and_baud(url, rest))
    if scheme == "pty" and colon:
        return PtyPort(_path(url, rest))
    hint = f" (did you mean 'serial:{url}:{DEFAULT_BAUD}'?)" if url.startswith("/") else ""
    raise PortUrlError(url, f"expected one of {FORMS}{hint}")


def _host_and_port(url: str, rest: str) -> tuple[str, int]:
    host, colon, number = rest.rpartition(":")
    if not colon:
        raise PortUrlError(url, "expected HOST:PORT after the scheme")
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    elif ":" in host:
        raise PortUrlError(url, "an IPv6 address stands in brackets, as in [::1]")
    if not host or "/" in host or not _is_name(host):
        raise PortUrlError(url, f"{host!r} is not a host")
    if not _is_number(number) or not 1 <= int(number) <= 65535:
        raise PortUrlError(url, f"port number {number!r} is not between 1 and 65535")
    return host, int(number)


def _path_and_baud(url: str, rest: str) -> tuple[str, int]:
    """The baud rate is the last part if that is a number; by-path names end in colons of their own."""
    head, colon, number = rest.rpartition(":")
    if not colon or (rest.startswith(BY_PATH) and not _is_number(number)):
        return _path(url, rest), DEFAULT_BAUD
    if not _is_number(number):
        raise PortUrlError(url, f"baud rate {number!r} is not a number, such as {DEFAULT_BAUD}")
    if not 1200 <= int(number) <= 4_000_000:
        raise PortUrlError(url, f"baud rate {number} is not between 1200 and 4000000")
    return _path(url, head), int(number)


def _path(url: str, path: str) -> str:
    if not path.startswith("/"):
        raise PortUrlError(url, f"{path!r} is not an absolute path")
    return path


def _is_name(host: str) -> bool:
    """Whether the network's names can spell it: looked up, another one is a UnicodeError, not an OSError."""
    try:
        host.encode("idna")
    except UnicodeError:
        return False
    return True


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit()
