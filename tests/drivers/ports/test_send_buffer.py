"""What is sent and not read: the oldest bytes are dropped and counted, nothing survives `close`."""

import errno
import socket
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.ports.descriptor import DescriptorPort
from drivers.ports.port import SendBuffer
from drivers.ports.udp import UdpClientPort
from tests.drivers.ports.port_pairs import HOST, Pair, free_port, run, take


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
