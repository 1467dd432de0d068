"""Links: the state machine over all its inputs, and whole lives of a link on a stepped clock."""

import asyncio
import errno
import itertools
import random
from collections.abc import Awaitable, Callable, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.boat.clock import BoatClock, SimClock
from companion.core.messages import LinkStatus, Message, StatusText
from drivers.link import DeviceLink, LinkTiming, link_state
from drivers.link_state import LinkObservations, backoff_s
from drivers.ports.memory import MemoryPort, memory_pair
from drivers.ports.pseudo_terminal import PtyPort
from drivers.ports.serial_line import SerialPort

SECOND = 10**9
TIMING = LinkTiming(stale_after_s=1.2, lost_after_s=4.0)
STATES = ("searching", "online", "stale", "lost")
CYCLE = {
    ("searching", "online"), ("online", "stale"), ("online", "lost"), ("stale", "online"), ("stale", "lost"),
    ("lost", "searching"), *((state, state) for state in ("searching", "online", "stale")),
}  # fmt: skip


class Lines:
    """A codec of text lines that begin with '$'; everything else is garbage."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes, t_ns: int) -> list[Message]:
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [StatusText(t_ns=t_ns, severity=6, text=x.decode()) for x in lines if x.startswith(b"$")]


class Deaf(MemoryPort):
    """A port whose device is not plugged in until `plugged`, or breaks when told to."""

    plugged = True
    breaks = False
    opened = 0

    async def open(self) -> None:
        self.opened += 1
        if not self.plugged:
            raise FileNotFoundError(errno.ENOENT, "No such file or directory", "/dev/ttyACM0")
        await super().open()

    async def receive(self) -> bytes:
        data = await super().receive()
        if self.breaks:
            self.breaks = False
            raise OSError(errno.EIO, "Input/output error")
        return data

    async def close(self) -> None:
        await super().close()
        raise OSError(errno.EIO, "a dead device cannot even be closed well")


class Bench:
    """A link on a stepped clock, its device at the other end of a cable, and all that it told."""

    def __init__(self, timing: LinkTiming = TIMING) -> None:
        self.clock = SimClock(5 * SECOND)
        self.port, self.device = Deaf("imu"), MemoryPort("device")
        self.port.other, self.device.other = self.device, self.port
        self.told: list[tuple[float, str, str]] = []
        self.texts: list[tuple[float, str]] = []
        self.raw = b""
        self.link = DeviceLink(
            "imu",
            self.port,
            Lines(),
            now_ns=self.clock.now_ns,
            sleep_until=self.clock.sleep_until,
            rng=random.Random(4),
            on_messages=self.on_messages,
            on_bytes=self.on_bytes,
            timing=timing,
        )

    def on_bytes(self, data: bytes, t_ns: int) -> None:
        assert t_ns == self.clock.now_ns()
        self.raw += data

    def on_messages(self, messages: Sequence[Message], t_ns: int) -> None:
        for message in messages:
            assert message.t_ns == t_ns
            t_s = t_ns / SECOND - 5.0
            if isinstance(message, LinkStatus):
                assert message.link == "imu"
                assert message.state == self.link.state
                self.told.append((t_s, message.state, message.reason))
            elif isinstance(message, StatusText):
                self.texts.append((t_s, message.text))

    async def seconds(self, s: float) -> None:
        await self.clock.advance(round(s * SECOND))

    async def revive(self) -> None:
        """The cable's other end was unplugged by the link's own reconnecting: plug it in again."""
        await self.device.close()
        await self.device.open()

    def states(self) -> list[str]:
        return [state for state, _ in itertools.groupby(state for _, state, _ in self.told)]


def live(story: Callable[[Bench], Awaitable[None]], timing: LinkTiming = TIMING) -> Bench:
    """Run a link through `story`, then cancel it; afterwards its port must be closed."""
    bench = Bench(timing)

    async def main() -> None:
        async with asyncio.timeout(10):
            await bench.device.open()
            running = asyncio.create_task(bench.link.run())
            await bench.seconds(0)
            await story(bench)
            assert not running.done() or running.result() is None
            running.cancel()
            with pytest.raises(asyncio.CancelledError):
                await running
            assert asyncio.all_tasks() == {asyncio.current_task()}
            assert not bench.link.is_open
            assert not bench.link.send(b"late")
            with pytest.raises(OSError):
                bench.port.send(b"closed by cancellation")

    asyncio.run(main())
    return bench


# --- the table ---------------------------------------------------------------------------------------


def whole_ns() -> st.SearchStrategy[int]:
    edges = [TIMING.stale_after_ns, TIMING.lost_after_ns]
    return st.one_of(st.integers(0, 10 * SECOND), st.sampled_from([e + d for e in edges for d in (-1, 0, 1)]))


SEEN = st.builds(
    LinkObservations, fault=st.sampled_from(["", "cannot open"]), framed=st.booleans(), silent_ns=whole_ns(),
    frameless_ns=whole_ns(), babble_ns=st.one_of(st.just(0), whole_ns()),
)  # fmt: skip


@given(st.sampled_from(STATES), SEEN)
def test_every_state_under_every_observation(before, seen):
    state, cause, reason, reopen = link_state(before, seen, TIMING)
    assert (before, state) in CYCLE
    assert reason
    assert cause
    if state == "online":
        assert seen.framed
        assert seen.frameless_ns < TIMING.stale_after_ns
    if seen.fault:
        assert state in ("lost", "searching")
        assert reason == seen.fault
    if state == "lost":
        assert reopen
        assert link_state("lost", seen, TIMING).state == "searching"
    if state == "stale":
        assert not reopen
        assert TIMING.stale_after_ns <= seen.frameless_ns < TIMING.lost_after_ns


@pytest.mark.parametrize(
    ("before", "seen", "state", "reason"),
    [
        ("searching", LinkObservations("", False, 0, 0, 0), "searching", "port open, waiting for a message"),
        ("searching", LinkObservations("", True, 0, 0, 0), "online", "messages arrive"),
        ("searching", LinkObservations("", False, 2 * SECOND, 2 * SECOND, 0), "searching", "no bytes for 2.0 s"),
        ("online", LinkObservations("", True, 1_199_999_999, 1_199_999_999, 0), "online", "messages arrive"),
        ("online", LinkObservations("", True, 1_200_000_000, 1_200_000_000, 0), "stale", "no bytes for 1.2 s"),
        ("stale", LinkObservations("", True, 100, 100, 0), "online", "messages arrive"),
        ("stale", LinkObservations("", True, 4 * SECOND, 4 * SECOND, 0), "lost", "no bytes for 4.0 s"),
        ("online", LinkObservations("unplugged", True, 0, 0, 0), "lost", "unplugged"),
        ("lost", LinkObservations("unplugged", True, 0, 0, 0), "searching", "unplugged"),
        (
            "online", LinkObservations("", True, 1000, 2 * SECOND, 1_900_000_000), "stale",
            "bytes but no valid frame for 1.9 s: wrong baud rate?",
        ),
        (
            "searching", LinkObservations("", False, 1000, 3 * SECOND, 3 * SECOND), "searching",
            "bytes but no valid frame for 3.0 s: wrong baud rate?",
        ),
    ],
)  # fmt: skip
def test_rows_of_the_table(before, seen, state, reason):
    verdict = link_state(before, seen, TIMING)
    assert (verdict.state, verdict.reason) == (state, reason)


def test_silence_before_the_first_message_does_not_reopen_but_lasting_garbage_does():
    hour = 3600 * SECOND
    assert not link_state("searching", LinkObservations("", False, hour, hour, 0), TIMING).reopen
    assert not link_state("searching", LinkObservations("", False, 0, hour, 3 * SECOND), TIMING).reopen
    assert link_state("searching", LinkObservations("", False, 0, hour, 4 * SECOND), TIMING).reopen


def test_backoff_grows_from_a_tenth_to_two_seconds_with_jitter():
    rng = random.Random(0)
    for attempt in range(40):
        whole = min(0.1 * 2**attempt, 2.0)
        pauses = [backoff_s(attempt, rng, TIMING) for _ in range(200)]
        assert max(0.1, 0.75 * whole) <= min(pauses) <= max(pauses) <= min(2.0, 1.25 * whole)
        assert max(pauses) - min(pauses) > 0.15 * whole


@pytest.mark.parametrize(
    "wrong",
    [
        {"stale_after_s": 0.0},
        {"stale_after_s": 5.0},
        {"backoff_min_s": 0.0},
        {"backoff_min_s": 3.0},
        {"lost_after_s": float("nan")},
    ],
)
def test_timing_that_makes_no_sense_is_refused(wrong):
    with pytest.raises(ValueError, match="need 0 <"):
        LinkTiming(**wrong)


# --- lives -------------------------------------------------------------------------------------------


def test_a_life_from_searching_to_online_stale_lost_and_back():
    async def story(bench: Bench) -> None:
        assert bench.link.state == "searching"
        await bench.seconds(0.5)
        for index in range(20):
            bench.device.send(f"$ {index}\n".encode())
            await bench.seconds(0.1)
        await bench.seconds(6.0)
        await bench.revive()
        await bench.seconds(0.5)
        bench.device.send(b"$ back\n")
        await bench.seconds(0.1)

    bench = live(story)
    assert bench.states() == ["searching", "online", "stale", "lost", "searching", "online"]
    assert [text for _, text in bench.texts] == [f"$ {index}" for index in range(20)] + ["$ back"]
    assert bench.raw == b"".join(f"$ {index}\n".encode() for index in range(20)) + b"$ back\n"
    last_s = 0.5 + 19 * 0.1
    when = {state: (t_s, reason) for t_s, state, reason in reversed(bench.told)}
    assert when["online"] == (pytest.approx(0.5), "messages arrive")
    assert when["stale"] == (pytest.approx(last_s + 1.2), "no bytes for 1.2 s")
    assert when["lost"] == (pytest.approx(last_s + 4.0), "no bytes for 4.0 s")
    again_s = next(t_s for t_s, state, _ in bench.told if state == "searching" and t_s > last_s)
    assert last_s + 4.1 <= again_s <= last_s + 4.125, "lost is told until the port opens again"


def test_a_pause_shorter_than_stale_is_not_told():
    async def story(bench: Bench) -> None:
        for _ in range(5):
            bench.device.send(b"$\n")
            await bench.seconds(1.19)

    bench = live(story)
    assert bench.states() == ["searching", "online"]
    assert sum(state == "online" for _, state, _ in bench.told) == 1


def test_an_hour_of_a_device_that_is_not_there_and_then_comes():
    async def story(bench: Bench) -> None:
        await bench.port.other.close()
        bench.port.plugged = False
        await bench.device.close()
        await bench.seconds(3600)
        assert 3600 / 2.0 * 0.9 < bench.port.opened < 3600 / 1.5 * 1.1 + 10
        bench.port.plugged = True
        await bench.device.open()
        await bench.seconds(2.0)
        bench.device.send(b"$ here\n")
        await bench.seconds(0)

    bench = live(story)
    reasons = [reason for _, _, reason in bench.told]
    assert "cannot open imu: No such file or directory" in reasons
    assert len(bench.told) < 10, "an hour of the same reason is one piece of news"
    assert bench.told[-1][1] == "online"


def test_garbage_never_counts_as_online_and_says_why():
    rng = random.Random(6)

    async def story(bench: Bench) -> None:
        for _ in range(35):
            bench.device.send(rng.randbytes(30).replace(b"$", b"#"))
            await bench.seconds(0.1)

    bench = live(story)
    assert bench.told[-1][1:] == ("searching", "bytes but no valid frame for 1.2 s: wrong baud rate?")
    assert bench.states() == ["searching"]
    assert not bench.texts


def test_lasting_garbage_reopens_the_port_so_that_a_udp_lock_is_given_up():
    async def story(bench: Bench) -> None:
        for opened in (1, 2, 3):
            assert bench.port.opened == opened
            for _ in range(40):
                bench.device.send(b"garbage\n")
                await bench.seconds(0.1)
            while not bench.device.has_ended:
                bench.device.send(b"garbage\n")
                await bench.seconds(0.1)
            await bench.revive()
            await bench.seconds(0.6)

    bench = live(story)
    assert bench.states() == ["searching"]


def test_a_device_that_starts_after_a_minute_of_silence_is_not_reopened_for_its_boot_text():
    async def story(bench: Bench) -> None:
        bench.device.send(b"boot\n")
        await bench.seconds(60.0)
        for _ in range(30):
            bench.device.send(b"ESP-ROM:esp32\n")
            await bench.seconds(0.1)
        bench.device.send(b"$ 1.00 m\n")
        await bench.seconds(0)
        assert bench.port.opened == 1

    assert live(story).states() == ["searching", "online"]


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
