"""What every kind of port does: order, close, the end of a line, opening again, cancelled receivers."""

import asyncio
import random

import pytest

from drivers.ports.url import open_port_from_url
from tests.drivers.ports.port_pairs import HELLO, Pair, run, take

BIG = 1 << 20

KINDS = ["memory", "serial", "pty", "udpout", "udpin", "tcp", "tcpin"]


@pytest.fixture(params=KINDS)
def pair(request, tmp_path) -> Pair:
    return Pair(request.param, tmp_path, BIG)


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
