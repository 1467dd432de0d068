"""A gamepad's device: unplugged, plugged in again, lacking an axis. A named pipe stands for it, its axes as told."""

import array
import asyncio
import contextlib
import fcntl
import os
import termios

from drivers.sticks.device import GamepadDevice
from tests.drivers.test_keyboard_gamepad import CODES, MS, NEUTRAL, S, event, opened
from tests.support.stand_ins.sim_clock import SimClock


def play(path, story, codes=CODES):
    """`story(device, clock, told)` beside a device that is being read."""
    told = []

    async def scene():
        clock = SimClock(S)
        device = GamepadDevice(
            str(path), now_ns=clock.now_ns, sleep_until=clock.sleep_until, tell=told.append, codes_of=lambda _: codes
        )
        task = asyncio.create_task(device.run())
        try:
            await story(device, clock)
        finally:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

    asyncio.run(scene())
    return told


async def passes(condition):
    for _ in range(400):
        if condition():
            return
        await asyncio.sleep(0.005)
    raise AssertionError("it did not come true")


class Plug:
    """Call it with what the pad sends; `taken`: whether all of that was read."""

    def __init__(self, descriptor):
        self._descriptor = descriptor

    def __call__(self, data):
        os.write(self._descriptor, data)

    def taken(self):
        left = array.array("i", [0])
        fcntl.ioctl(self._descriptor, termios.FIONREAD, left)
        return not left[0]


@contextlib.contextmanager
def plugged_in(path):
    """The pad's end of the pipe."""
    descriptor = os.open(path, os.O_RDWR)
    try:
        yield Plug(descriptor)
    finally:
        os.close(descriptor)


def test_a_pad_that_comes_goes_and_comes_back_with_its_stick_held(tmp_path):
    path = tmp_path / "js0"

    async def story(device, clock):
        await asyncio.sleep(0.02)
        assert device.shares(clock.now_ns()) == NEUTRAL
        os.mkfifo(path)
        with plugged_in(path) as pad:
            await clock.advance(S)
            pad(opened())
            await passes(pad.taken)
            assert device.shares(clock.now_ns()) == NEUTRAL
            pad(event(1, -1.0)[:3])
            pad(event(1, -1.0)[3:] + event(0, 1 / 32767, 1))
            await passes(lambda: device.shares(clock.now_ns()).surge == 1.0)
            await passes(lambda: device.stops == 1)
        await passes(lambda: device.shares(clock.now_ns()) == NEUTRAL)
        with plugged_in(path) as pad:
            await clock.advance(S + MS)
            pad(opened(y=-1.0) + event(3, 0.5))
            await passes(pad.taken)
            assert device.shares(clock.now_ns()) == NEUTRAL, "it came back held"
            pad(event(1, 0.0) + event(3, 0.0))
            await passes(pad.taken)
            device.shares(clock.now_ns())
            pad(event(3, 1.0))
            await passes(lambda: device.shares(clock.now_ns()).yaw == 1.0)

    told = play(path, story)
    assert "No such file" in told[0] and "at rest" in told[1] and "is gone" in told[2] and "at rest" in told[3]


def test_a_pad_that_lacks_an_axis_is_named_and_does_not_drive(tmp_path):
    path = tmp_path / "js0"
    os.mkfifo(path)

    async def story(device, clock):
        with plugged_in(path) as pad:
            pad(opened())
            await asyncio.sleep(0.05)
            assert device.shares(clock.now_ns()) == NEUTRAL

    (text,) = play(path, story, codes=(0, 1, 2, 5))
    assert "no axis with code 3" in text
