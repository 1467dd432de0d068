"""A device link on a stepped clock, its device at the other end of a memory port."""

import asyncio
import errno
import itertools
import random
from collections.abc import Awaitable, Callable, Sequence

import pytest

from companion.core.messages import LinkStatus, Message, StatusText
from drivers.link import DeviceLink, LinkTiming
from tests.support.stand_ins.memory_port import MemoryPort
from tests.support.stand_ins.sim_clock import SimClock

SECOND = 10**9
TIMING = LinkTiming(stale_after_s=1.2, lost_after_s=4.0)
CYCLE = {
    ("searching", "online"), ("online", "stale"), ("online", "lost"), ("stale", "online"), ("stale", "lost"),
    ("lost", "searching"), *((state, state) for state in ("searching", "online", "stale")),
}  # fmt: skip


class Lines:
    """A codec of text lines that begin with '$'; those that begin with '%' tell nothing; all else is garbage."""

    def __init__(self) -> None:
        self._rest = b""
        self.understood = 0

    def feed(self, data: bytes, t_ns: int) -> list[Message]:
        *lines, self._rest = (self._rest + data).split(b"\n")
        self.understood += sum(x.startswith((b"$", b"%")) for x in lines)
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
