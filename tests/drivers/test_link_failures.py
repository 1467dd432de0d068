"""A device link whose port ends, breaks or raises; random lives."""

import asyncio
import itertools
import random
import socket
from collections.abc import Callable, Sequence

import pytest

from companion.boat.clock import BoatClock
from companion.core.messages import LinkStatus, Message, StatusText
from drivers.link import DeviceLink
from drivers.ports.pseudo_terminal import PtyPort
from drivers.ports.serial_line import SerialPort
from drivers.ports.udp import UdpServerPort
from tests.drivers.link_bench import CYCLE, SECOND, Bench, Lines, live
from tests.drivers.ports.port_pairs import HOST, free_port, run
from tests.support.stand_ins.memory_port import memory_pair
from tests.support.stand_ins.sim_clock import SimClock


@pytest.mark.parametrize("how", ["end", "error"])
def test_a_port_that_ends_or_breaks_is_opened_again(how):
    async def story(bench: Bench) -> None:
        for _ in range(3):
            bench.device.send(b"$ alive\n")
            await bench.seconds(0)
            assert bench.link.state == "online"
            bench.port.breaks = how == "error"
            await bench.device.close()
            await bench.seconds(0)
            assert bench.link.state == "lost"
            assert not bench.link.is_open
            assert not bench.link.send(b"to nobody"), "nothing is queued for the time after the reconnect"
            await bench.device.open()
            await bench.seconds(0.2)
            assert bench.link.is_open
            assert bench.link.send(b"to the device")
            assert await bench.device.receive() == b"to the device"

    bench = live(story)
    assert bench.states() == ["searching", "online", "lost"] * 3 + ["searching"]
    words = "imu broke: Input/output error" if how == "error" else "the other end of imu is gone"
    assert sum(reason == words for _, _, reason in bench.told) == 3
    assert bench.link.refused_sends >= 3


def test_a_port_that_ends_at_once_is_not_hammered():
    """Opens, ends, opens, ...: without one message the pauses grow to 2 s."""

    async def story(bench: Bench) -> None:
        async def end() -> bytes:
            return b""

        bench.port.receive = end
        await bench.device.close()
        await bench.seconds(60)

    bench = live(story)
    assert 30 <= bench.port.opened <= 45
    assert bench.states() == ["searching"]


@pytest.mark.parametrize("where", ["codec", "on_bytes", "on_messages"])
def test_a_bug_in_codec_or_callback_is_not_hidden_and_the_port_is_closed(where):
    def fail(*_: object) -> list[Message]:
        raise ZeroDivisionError("bug")

    async def main() -> None:
        clock, (port, device) = SimClock(), memory_pair()
        codec = Lines()
        if where == "codec":
            codec.feed = fail
        told: list[Message] = []

        def on_messages(messages: Sequence[Message], t_ns: int) -> None:
            told.extend(messages)
            if where == "on_messages" and any(isinstance(message, StatusText) for message in messages):
                fail()

        link = DeviceLink(
            "uwb", port, codec, now_ns=clock.now_ns, sleep_until=clock.sleep_until, rng=random.Random(1),
            on_messages=on_messages, on_bytes=fail if where == "on_bytes" else None,
        )  # fmt: skip
        await device.open()
        running = asyncio.create_task(link.run())
        await clock.advance(0)
        device.send(b"$\n")
        with pytest.raises(ZeroDivisionError, match="bug"):
            await running
        assert await device.receive() == b""

    asyncio.run(main())


@pytest.mark.parametrize("seed", range(5))
def test_random_lives_keep_to_the_cycle_and_lose_no_message_while_open(seed):
    """Any order of boots, unplugs, garbage and silence: only legal changes, one reason for each."""
    rng = random.Random(seed)
    sent: list[str] = []

    async def story(bench: Bench) -> None:
        for index in range(400):
            action = rng.choice(["speak", "speak", "speak", "garbage", "unplug", "plug", "wait"])
            bench.port.plugged = bench.device.is_open
            if action == "unplug":
                await bench.device.close()
            elif action == "plug" and not bench.device.is_open:
                await bench.device.open()
                bench.port.plugged = True
            elif action in ("speak", "garbage") and bench.device.is_open and not bench.device.has_ended:
                text = f"$ {index}" if action == "speak" else f"{index}"
                heard = bench.link.is_open
                bench.device.send(f"{text}\n".encode())
                if action == "speak" and heard:
                    sent.append(text)
            await bench.seconds(rng.choice([0.0, 0.05, 0.5, 1.3, 5.0]))
            if bench.device.has_ended:
                await bench.device.close()

    bench = live(story)
    told = [state for _, state, _ in bench.told]
    assert all(change in CYCLE for change in itertools.pairwise(told))
    assert [text for _, text in bench.texts] == sent
    assert {"searching", "online", "stale", "lost"} <= set(told)


def test_on_a_real_pty_and_the_boat_clock_in_any_boot_order(tmp_path):
    """The link starts before its device exists; the device is unplugged and comes back."""
    path = str(tmp_path / "ttyUWB")
    clock, told, texts = BoatClock(), [], []

    def on_messages(messages: Sequence[Message], t_ns: int) -> None:
        for message in messages:
            (told if isinstance(message, LinkStatus) else texts).append(message)

    async def until(condition: Callable[[], bool]) -> None:
        while not condition():
            await asyncio.sleep(0.01)

    async def main() -> None:
        link = DeviceLink(
            "uwb", SerialPort(path, 115200), Lines(), now_ns=clock.now_ns, sleep_until=clock.sleep_until,
            rng=random.Random(2), on_messages=on_messages,
        )  # fmt: skip
        device = PtyPort(path)
        async with asyncio.timeout(10):
            running = asyncio.create_task(link.run())
            await until(lambda: len(told) >= 2)
            for _ in range(2):
                await device.open()
                await until(lambda: link.is_open)
                device.send(b"$ range\n")
                await until(lambda: link.state == "online")
                assert link.send(b"lec\r")
                assert await device.receive() == b"lec\r"
                await device.close()
                await until(lambda: link.state == "searching")
            running.cancel()
            with pytest.raises(asyncio.CancelledError):
                await running

    asyncio.run(main())
    assert told[1].reason == f"cannot open serial:{path}:115200: No such file or directory"
    assert [text.text for text in texts] == ["$ range", "$ range"]
    assert [status.state for status in told].count("lost") == 2


@pytest.mark.parametrize(("name", "option"), [("mavlink", "--mavlink"), ("uwb", "--uwb"), ("dvl", "--device dvl=URL")])
def test_a_port_that_another_program_holds_is_told_with_what_to_do_and_opens_once_it_is_free(name, option):
    told: list[LinkStatus] = []

    async def main() -> None:
        clock, number = SimClock(), free_port(socket.SOCK_DGRAM)
        other, port = UdpServerPort(HOST, number), UdpServerPort(HOST, number)
        link = DeviceLink(
            name, port, Lines(), now_ns=clock.now_ns, sleep_until=clock.sleep_until, rng=random.Random(1),
            on_messages=lambda messages, t_ns: told.extend(m for m in messages if isinstance(m, LinkStatus)),
        )  # fmt: skip
        await other.open()
        running = asyncio.create_task(link.run())
        for _ in range(20):
            await clock.advance(SECOND)
            await asyncio.sleep(0.01)  # the name of the host is looked up in a thread
        assert told[-1].reason == (
            f"udpin:{HOST}:{number} is held by another program (another aritra run?): end it, or give {option}"
        )
        assert len(told) == 2, "once, however often it is tried"
        await other.close()
        while not link.is_open:
            await clock.advance(SECOND)
            await asyncio.sleep(0.01)
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running

    run(main)
