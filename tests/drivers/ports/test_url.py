"""Port URLs: what they mean, and what the errors of the others say."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.ports.pseudo_terminal import PtyPort
from drivers.ports.serial_line import SerialPort
from drivers.ports.tcp import TcpClientPort, TcpServerPort
from drivers.ports.udp import UdpClientPort, UdpServerPort
from drivers.ports.url import open_port_from_url

BY_PATH = "/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0-port0"


@pytest.mark.parametrize(
    ("url", "kind", "name"),
    [
        ("udpin:0.0.0.0:14550", UdpServerPort, None),
        ("udpout:127.0.0.1:14551", UdpClientPort, None),
        ("udpout:[::1]:14551", UdpClientPort, None),
        ("tcp:autopilot.local:5760", TcpClientPort, None),
        ("tcpin:0.0.0.0:5760", TcpServerPort, None),
        ("serial:/dev/ttyACM0:57600", SerialPort, None),
        ("serial:/dev/ttyACM0", SerialPort, "serial:/dev/ttyACM0:115200"),
        (f"serial:{BY_PATH}", SerialPort, f"serial:{BY_PATH}:115200"),
        (f"serial:{BY_PATH}:921600", SerialPort, None),
        ("pty:/tmp/uwb", PtyPort, None),
    ],
)
def test_urls_that_mean_something(url, kind, name):
    port = open_port_from_url(url)
    assert type(port) is kind
    assert port.name == (name or url)


@pytest.mark.parametrize(
    ("url", "hint"),
    [
        ("", "expected one of udpin:HOST:PORT"),
        ("udp:127.0.0.1:14550", "expected one of"),
        ("/dev/ttyACM0", "did you mean 'serial:/dev/ttyACM0:115200'"),
        ("udpin", "expected one of"),
        ("udpin:14550", "expected HOST:PORT"),
        ("udpin::14550", "is not a host"),
        ("udpout://127.0.0.1:14550", "is not a host"),
        ("udpout:::1:14550", "in brackets"),
        ("udpout:192.168.1..20:14550", "'192.168.1..20' is not a host"),
        ("tcp:localhost:port", "port number 'port'"),
        ("tcp:localhost:0", "between 1 and 65535"),
        ("tcp:localhost:65536", "between 1 and 65535"),
        ("tcp:localhost:٣", "between 1 and 65535"),
        ("serial:ttyACM0:115200", "not an absolute path"),
        ("serial:/dev/ttyACM0:fast", "baud rate 'fast'"),
        ("serial:/dev/ttyACM0:9", "between 1200 and 4000000"),
        ("pty:relative", "not an absolute path"),
    ],
)
def test_urls_that_do_not(url, hint):
    with pytest.raises(ValueError) as caught:
        open_port_from_url(url)
    assert hint in str(caught.value)
    assert repr(url) in str(caught.value)


@given(st.text(max_size=40))
def test_any_text_is_a_port_or_a_clear_error(text):
    try:
        assert open_port_from_url(text).name
    except ValueError as error:
        assert repr(text) in str(error)
