"""The desk of `aritra teleop` without a boat: keys to commands, a terminal that goes, a table that holds everything."""

import asyncio
import io
import itertools
import os
import pty
import threading
import tty

import pytest
from rich.console import Console

from companion.cli.boat.teleop import TeleopConsole
from companion.cli.boat.teleop_view import ALERTS, TeleopState, TeleopView, picture
from companion.core.messages import (
    Alert,
    ExcitationStatus,
    LoopTiming,
    ManualInput,
    ModeStatus,
    OverrideLease,
    StateEstimate,
)
from tests.support.drive_fixture import setup
from tests.support.stand_ins.sim_clock import SimClock

S = 1_000_000_000


@pytest.fixture
def terminal():
    """(master, slave) of a pty whose slave gives each key at once."""
    master, slave = pty.openpty()
    tty.setcbreak(slave)
    ends = [master, slave]
    yield ends
    for end in ends:
        if end is not None:
            os.close(end)


class Boat:
    """Stands for the App: remembers what it was told; raises where asked to."""

    def __init__(self):
        self.commands, self.sticks, self.fails = [], [], False

    def command(self, command):
        self.commands.append(command.command)

    def manual(self, sticks):
        if self.fails:
            raise ZeroDivisionError("a bug")
        self.sticks.append(sticks)


def serve(terminal, story):
    """`story(boat, clock, master)` beside a desk; what the desk raised, alerts, whether it ended the run."""
    boat, told, ended = Boat(), [], []

    async def scene():
        clock = SimClock(S)
        desk = TeleopConsole(terminal[1], None, io.StringIO())
        task = asyncio.create_task(desk.run(boat, setup(), clock, told.append, lambda: ended.append(True)))
        await story(boat, clock)
        await clock.advance(S // 10)
        if not task.done():
            task.cancel()
        (result,) = await asyncio.gather(task, return_exceptions=True)
        desk.close()
        return result

    return asyncio.run(scene()), [a.text for a in told], bool(ended), boat


def test_keys_become_commands_and_sticks(terminal):
    async def story(boat, clock):
        for keys in (b"r", b"4w", b"m", b" ", b"g", b"h", b"p", b"m"):
            os.write(terminal[0], keys)
            await clock.advance(S // 10)

    result, told, ended, boat = serve(terminal, story)
    assert isinstance(result, asyncio.CancelledError) and ended
    assert boat.commands == ["manual", "stop", "start", "hold", "excite"]
    assert told == ["mark 1 begins", "mark 1 ends"]
    surges = [s.surge for s in boat.sticks]
    assert surges[0] == 0 and 0.4 in surges and surges[-1] == 0
    times = [s.t_ns for s in boat.sticks]
    assert {b - a for a, b in itertools.pairwise(times)} == {S // 20}
    assert {s.source for s in boat.sticks} == {"keyboard"}


def test_control_d_ends_the_run(terminal):
    async def story(boat, clock):
        os.write(terminal[0], b"\x04")
        await clock.advance(S // 10)

    result, _, ended, _ = serve(terminal, story)
    assert result is None and ended


def test_a_terminal_that_goes_ends_the_run(terminal):
    async def story(boat, clock):
        os.write(terminal[0], b"w")
        await clock.advance(S // 10)
        assert boat.sticks[-1].surge > 0
        os.close(terminal[0])
        terminal[0] = None
        await clock.advance(S // 10)

    result, _, ended, _ = serve(terminal, story)
    assert result is None and ended


def test_a_fault_at_the_desk_ends_the_run_and_is_raised(terminal):
    async def story(boat, clock):
        boat.fails = True
        await clock.advance(S // 10)

    result, _, ended, _ = serve(terminal, story)
    assert isinstance(result, ZeroDivisionError) and ended


def drawn(seen):
    console = Console(file=io.StringIO(), width=160)
    console.print(picture(seen))
    return console.file.getvalue()


def test_the_table_before_anything_is_known():
    assert "starting" in drawn(TeleopState(()))


def test_the_table_shows_what_there_is():
    seen = TeleopState(("fp", "fs"))
    seen.level, seen.log = 0.3, "logs/aritra-1.mcap"
    for message in (
        ModeStatus(t_ns=0, mode="manual", why="all is ready", driving=True),
        StateEstimate(
            t_ns=0, north_m=1.25, east_m=-2.5, psi_rad=-0.5, u_m_s=0.4, v_m_s=0.0, r_rad_s=0.1,
            covariance=(0.0,) * 36, accel_bias_m_s2=(0.0, 0.0), gyro_bias_rad_s=0.0, anchor_bias_m={},
            disturbance_n=(0.0,) * 3, health="healthy", reason="",
        ),
        ManualInput(t_ns=0, surge=0.3, sway=0.0, yaw=-0.15, source="keyboard"),
        OverrideLease(t_ns=0, index=0, channels=(9, 10, 1), pwm_us=(1620, 1480, 1500), valid_for_s=0.3,
                      source="excitation", reason="", f_command_n=(1.0, 1.0)),
        ExcitationStatus(t_ns=0, phase="fly", segment=1, segments=8, name="steps", elapsed_s=3.2),
        LoopTiming(t_ns=0, index=0, lateness_ms=2.5, imu_to_override_ms=None),
        *(Alert(t_ns=0, level="info", text=f"number {i}") for i in range(20)),
    ):  # fmt: skip
        seen.see(message)
    text = drawn(seen)
    for part in ("MANUAL", "all is ready", "N 1.25  E -2.50", "heading 331 deg", "ahead +30%", "clockwise -15%",
                 "fp 1620 us", "fs 1480 us  [excitation]", "2/8 steps", "late by 2.5 ms",
                 "logs/aritra-1.mcap", "number 19", "SPACE stop"):  # fmt: skip
        assert part in text, part
    assert "number 13" not in text and len(seen.alerts) == ALERTS


def test_brackets_in_what_is_shown_are_shown():
    """A mission of this name that was loaded from shore ended the drawing: the table stood still."""
    seen = TeleopState(())
    seen.log = "logs/[bold]/1.mcap"
    seen.see(ModeStatus(t_ns=0, mode="auto", why="out [/back]", driving=True))
    seen.see(Alert(t_ns=0, level="info", text="the mission out [/back] is loaded"))
    assert all(part in drawn(seen) for part in ("AUTO  out [/back]", "[bold]/1.mcap", "mission out [/back] is"))


def test_a_terminal_that_takes_nothing_is_not_waited_for():
    """Drawing happens elsewhere: `close` returns though the other end never reads."""
    reading, writing = os.pipe()
    os.set_blocking(writing, True)
    filler = b"x" * 65536
    os.set_blocking(writing, False)
    try:
        while True:
            os.write(writing, filler)
    except BlockingIOError:
        os.set_blocking(writing, True)
    with os.fdopen(writing, "w") as out:
        view = TeleopView(TeleopState(()), out)
        view.start()
        view.close()
        (drawing,) = [thread for thread in threading.enumerate() if thread.name == "view"]
        os.read(reading, 1 << 20)
        drawing.join(5)
        os.close(reading)
    assert not drawing.is_alive()
