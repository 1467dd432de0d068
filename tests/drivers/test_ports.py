"""One conformance suite for every port, then what is special to each."""

import asyncio
import errno
import os
import random
import socket
import termios
import threading
import time
from collections.abc import Awaitable, Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.ports.descriptor import DescriptorPort
from drivers.ports.memory import memory_pair
from drivers.ports.port import Port, SendBuffer
from drivers.ports.pseudo_terminal import PtyPort
from drivers.ports.serial_line import SerialPort
from drivers.ports.tcp import TcpClientPort, TcpServerPort
from drivers.ports.udp import DATAGRAM_BYTES, UdpClientPort, UdpServerPort
from drivers.ports.url import open_port_from_url

BIG = 1 << 20
HOST = "127.0.0.1"
HELLO = b"hello"
BY_PATH = "/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0-port0"


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


KINDS = ["memory", "serial", "pty", "udpout", "udpin", "tcp", "tcpin"]


@pytest.fixture(params=KINDS)
def pair(request, tmp_path) -> Pair:
    return Pair(request.param, tmp_path, BIG)


# --- the suite ---------------------------------------------------------------------------------------


def test_bytes_pass_both_ways_in_order(pair):
    async def main():
        await pair.join()
        every_byte = bytes(range(256))
        for sender, receiver in ((pair.near, pair.far), (pair.far, pair.near)):
            for start in range(0, 256, 8):
                sender.send(every_byte[start : start + 8])
            assert await take(receiver, 256) == every_byte
        await pair.close()

    run(main)


def test_big_payloads_arrive_whole_and_in_order(pair):
    payload = random.Random(1).randbytes(100_000)

    async def main():
        await pair.join()
        for sender, receiver in ((pair.near, pair.far), (pair.far, pair.near)):
            sender.send(payload)
            assert await take(receiver, len(payload)) == payload
            assert sender.counters.dropped_bytes == 0
        assert pair.far.counters.received_bytes >= len(payload)
        assert pair.near.counters.sent_bytes >= len(payload)
        await pair.close()

    run(main)


def test_both_directions_at_once(pair):
    rng = random.Random(2)
    there, back = rng.randbytes(40_000), rng.randbytes(40_000)

    async def main():
        await pair.join()
        pair.near.send(there)
        pair.far.send(back)
        assert await asyncio.gather(take(pair.far, 40_000), take(pair.near, 40_000)) == [there, back]
        await pair.close()

    run(main)


def test_close_is_idempotent_and_send_on_closed_raises(pair):
    async def main():
        await pair.near.close()
        with pytest.raises(OSError):
            pair.near.send(b"never opened")
        assert await pair.near.receive() == b""
        await pair.join()
        for _ in range(2):
            await pair.close()
        for port in (pair.near, pair.far):
            with pytest.raises(OSError):
                port.send(b"closed")
            assert await port.receive() == b""

    run(main)


def test_receive_tells_when_the_other_end_goes_or_waits_where_it_cannot_know(pair):
    async def main():
        await pair.join()
        waiting = asyncio.create_task(pair.near.receive())
        await asyncio.sleep(0.01)
        await pair.far.close()
        if pair.sees_end:
            assert await waiting == b""
            assert await pair.near.receive() == b""
            with pytest.raises(OSError):
                pair.near.send(b"nobody there")
        else:
            pair.near.send(b"nobody there")
            pair.near.send(b"still nobody")
            await asyncio.sleep(0.02)
            assert not waiting.done()
            await pair.far.open()
            pair.far.send(b"x" if pair.kind == "udpout" else HELLO)
        await pair.close()
        await waiting

    run(main)


def test_send_alone_notices_a_broken_line_too(pair):
    if not pair.sees_end:
        pytest.skip("no end to be seen")

    async def main():
        await pair.join()
        await pair.far.close()
        with pytest.raises(OSError):
            while True:
                pair.near.send(b"anybody?")
                await asyncio.sleep(0.001)
        assert await pair.near.receive() == b""
        await pair.close()

    run(main)


def test_bytes_sent_before_the_end_are_still_received(pair):
    if not pair.sees_end or pair.kind == "serial":
        pytest.skip("no end to be seen, or a cable that loses what was on it when unplugged")

    async def main():
        await pair.join()
        pair.far.send(b"last words")
        await pair.far.close()
        assert await take(pair.near, 10) == b"last words"
        assert await pair.near.receive() == b""
        await pair.close()

    run(main)


def test_closing_wakes_a_waiting_receiver(pair):
    async def main():
        await pair.join()
        waiting = [asyncio.create_task(port.receive()) for port in (pair.near, pair.far)]
        await asyncio.sleep(0.01)
        await pair.close()
        assert await asyncio.gather(*waiting) == [b"", b""]

    run(main)


def test_reopens_after_close_and_again(pair):
    async def main():
        for _ in range(3):
            await pair.join()
            pair.far.send(b"again")
            assert await take(pair.near, 5) == b"again"
            await pair.close()

    run(main)


def test_opening_twice_is_refused(pair):
    async def main():
        await pair.join()
        for port in (pair.near, pair.far):
            with pytest.raises(OSError, match="already open"):
                await port.open()
        pair.near.send(b"unharmed")
        assert await take(pair.far, 8) == b"unharmed"
        await pair.close()

    run(main)


def test_the_name_is_the_url(pair):
    if pair.kind == "memory":
        assert [pair.near.name, pair.far.name] == ["memory:a", "memory:b"]
    else:
        for port in (pair.near, pair.far):
            again = open_port_from_url(port.name)
            assert (type(again), again.name) == (type(port), port.name)


def test_cancelling_receive_loses_nothing(pair):
    payload = random.Random(3).randbytes(2000)

    async def main():
        await pair.join()
        got = bytearray()

        async def collect() -> None:
            while len(got) < len(payload):
                got.extend(await pair.near.receive())

        for start in range(0, len(payload), 50):
            receiver = asyncio.create_task(collect())
            await asyncio.sleep(0)
            pair.far.send(payload[start : start + 50])
            for _ in range(start // 50 % 4):
                await asyncio.sleep(0)
            receiver.cancel()
            await asyncio.gather(receiver, return_exceptions=True)
        await collect()
        assert bytes(got) == payload
        await pair.close()

    run(main)


def test_one_receiver_at_a_time(pair):
    async def main():
        await pair.join()
        first = asyncio.create_task(pair.near.receive())
        await asyncio.sleep(0.12)
        if pair.kind != "pty":
            with pytest.raises(RuntimeError, match="one receiver"):
                await pair.near.receive()
        pair.far.send(b"y")
        assert await first == b"y"
        await pair.close()

    run(main)


@pytest.mark.parametrize("kind", ["memory", "serial", "pty", "tcp", "tcpin"])
def test_nobody_reads_so_old_bytes_are_dropped_and_counted(kind, tmp_path):
    """Sending 200 frames of 100 kB into a stuck line: little memory, no waiting, and the last frame comes."""
    pair = Pair(kind, tmp_path, 200_000)
    frames = [bytes([index]) * 100_000 for index in range(200)]

    async def main():
        await pair.join()
        began = time.perf_counter()
        for offered, frame in enumerate(frames, 1):
            pair.near.send(frame)
            if isinstance(pair.near, DescriptorPort):
                gone = pair.near.counters.sent_bytes + pair.near.counters.dropped_bytes
                assert offered * 100_000 - gone <= 200_000
        assert time.perf_counter() - began < 2.0
        counters = pair.near.counters
        assert counters.dropped_bytes > 5_000_000
        lost = counters.dropped_bytes
        got = await take(pair.far, 200 * 100_000 - lost)
        assert got.endswith(frames[-1])
        assert counters.dropped_bytes == lost
        whole = [got[start : start + 100_000] for start in range(0, len(got), 100_000)]
        assert all(frame in frames for frame in whole), "a frame was cut"
        await pair.close()

    run(main)


@pytest.mark.parametrize("kind", ["serial", "pty", "tcp"])
def test_nothing_queued_survives_close(kind, tmp_path):
    """An override queued before an unplug must not be played back after the reconnect."""
    pair = Pair(kind, tmp_path, 1 << 26)

    async def main():
        await pair.join()
        pair.near.send(b"o" * 16_000_000)
        assert pair.near.counters.sent_bytes < 16_000_000
        await pair.close()
        assert pair.near.counters.sent_bytes + pair.near.counters.dropped_bytes >= 16_000_000
        await pair.join()
        pair.near.send(b"new")
        assert await take(pair.far, 3) == b"new"
        await pair.close()

    run(main)


def test_the_very_send_that_breaks_the_line_raises():
    class Snapped(UdpClientPort):
        def _write(self, data: memoryview) -> int:
            raise OSError(errno.EIO, "snapped")

    async def main():
        port = Snapped(HOST, free_port(socket.SOCK_DGRAM))
        await port.open()
        with pytest.raises(BrokenPipeError, match="gone"):
            port.send(b"lost")
        assert port.counters.dropped_bytes == 4
        assert await port.receive() == b""
        await port.close()

    run(main)


# --- send buffer -------------------------------------------------------------------------------------


@settings(deadline=None)
@given(
    st.integers(1, 30),
    st.lists(st.one_of(st.binary(min_size=1, max_size=12), st.integers(1, 12)), max_size=60),
)
def test_send_buffer_keeps_order_whole_chunks_and_its_limit(limit, actions):
    """Bytes = push a chunk, number = the wire takes that many. Every chunk leaves whole or not at all."""
    buffer, wire, pushed, dropped = SendBuffer(limit), bytearray(), [], 0
    for action in actions:
        if isinstance(action, bytes):
            tagged = bytes([len(pushed) % 256]) * len(action)
            pushed.append(tagged)
            dropped += buffer.push(tagged)
        else:
            head = buffer.head()[:action]
            wire += head
            buffer.consume(len(head))
        assert len(buffer) <= limit
    while buffer:
        wire += buffer.head()
        buffer.consume(len(buffer.head()))
    assert len(wire) + dropped == sum(map(len, pushed))
    rest = bytes(wire)
    for chunk in pushed:
        rest = rest.removeprefix(chunk)
    assert rest == b""


def test_send_buffer_prefers_the_newest():
    buffer = SendBuffer(10)
    assert [buffer.push(chunk) for chunk in (b"aaaa", b"bbbb", b"cccc")] == [0, 0, 4]
    buffer.consume(1)
    assert buffer.push(b"dddddd") == 4, "the chunk on the wire stays, the next one goes"
    assert bytes(buffer.head()) == b"bbb"
    assert buffer.push(b"e" * 11) == 17
    assert buffer.clear() == 3
    with pytest.raises(ValueError, match="positive"):
        SendBuffer(0)


# --- UDP ---------------------------------------------------------------------------------------------


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


# --- TCP ---------------------------------------------------------------------------------------------


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


# --- serial ------------------------------------------------------------------------------------------


def test_serial_is_raw_exclusive_and_says_what_is_wrong(tmp_path):
    async def main():
        device = PtyPort()
        await device.open()
        port, rival = SerialPort(device.path, 115200), SerialPort(device.path, 115200)
        await port.open()
        with pytest.raises(OSError, match="another program"):
            await rival.open()
        device.send(b"\r\n\x03\x04\x11\x13\x00\xff")
        assert await take(port, 8) == b"\r\n\x03\x04\x11\x13\x00\xff"
        await port.close()
        await rival.open()
        await rival.close()
        await device.close()
        with pytest.raises(FileNotFoundError, match="No such file"):
            await SerialPort(str(tmp_path / "ttyNONE"), 115200).open()
        (tmp_path / "plain").write_bytes(b"")
        with pytest.raises(OSError):
            await SerialPort(str(tmp_path / "plain"), 115200).open()

    run(main)


def test_serial_unplugged_while_sending_is_an_end_and_plugging_in_again_works(tmp_path):
    link = str(tmp_path / "tty")

    async def main():
        device, port = PtyPort(link), SerialPort(link, 115200)
        for _ in range(2):
            await device.open()
            await port.open()
            waiting = asyncio.create_task(port.receive())
            port.send(b"z" * 4000)
            await device.close()
            assert not os.path.lexists(link)
            assert await waiting == b""
            with pytest.raises(OSError):
                for _ in range(100):
                    port.send(b"z" * 4000)
            await port.close()
            with pytest.raises(FileNotFoundError):
                await port.open()

    run(main)


def test_a_device_that_opens_after_its_opener_was_cancelled_is_closed(monkeypatch):
    class Device:
        closed = 0

        def reset_output_buffer(self) -> None:
            raise termios.error(errno.EIO, "gone")

        def close(self) -> None:
            self.closed += 1

    slow, device = threading.Event(), Device()

    def open_slowly(*_: object, **__: object) -> Device:
        assert slow.wait(5.0)
        return device

    monkeypatch.setattr("serial.Serial", open_slowly)

    async def main():
        port = SerialPort("/dev/slow", 115200)
        opening = asyncio.create_task(port.open())
        await asyncio.sleep(0.02)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening
        slow.set()
        while not device.closed:
            await asyncio.sleep(0.001)
        with pytest.raises(OSError):
            port.send(b"not open")

    run(main)


def test_the_pty_is_raw_for_any_program():
    async def main():
        device = PtyPort()
        await device.open()
        terminal = os.open(device.path, os.O_RDWR | os.O_NOCTTY)
        os.write(terminal, b"\n\x03\x11")
        assert await take(device, 3) == b"\n\x03\x11"
        device.send(b"\r\x04")
        assert os.read(terminal, 10) == b"\r\x04"
        os.close(terminal)
        await device.close()

    run(main)


def test_pty_device_speaks_to_nobody_without_piling_up_and_keeps_its_link_honest(tmp_path):
    link = tmp_path / "tty"

    async def main():
        device = PtyPort(str(link))
        await device.open()
        for _ in range(100):
            device.send(b"old line\r\n")
        assert device.counters.dropped_bytes == 1000
        listener = SerialPort(str(link), 115200)
        await listener.open()
        device.send(b"new line\r\n")
        assert await take(listener, 10) == b"new line\r\n"
        await listener.close()
        link.unlink()
        link.write_text("somebody's file")
        await device.close()
        assert link.read_text() == "somebody's file"
        with pytest.raises(FileExistsError, match="not a symbolic link"):
            await device.open()

    run(main)


# --- URLs --------------------------------------------------------------------------------------------


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
