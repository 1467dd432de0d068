"""`aritra teleop`: drive by hand, with the keyboard or a gamepad, on real or simulated wires."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal, TextIO

from companion.boat.app import App
from companion.boat.clock import Clock
from companion.boat.load_run import RunSetup
from companion.cli.boat import run
from companion.cli.boat.teleop_view import TeleopState, TeleopView
from companion.cli.boat.wires import add_config, add_wires
from companion.cli.options.outputs import output
from companion.core.configuration.tables import ConfigError
from companion.core.messages import Alert, ManualInput, Message, OperatorCommand
from drivers.sticks.device import GamepadDevice
from drivers.sticks.keyboard import Command, Keyboard

PERIOD_NS = 50_000_000
"""Sticks are read 20 times a second: twice a tick, so that a late reading does no harm."""
_OPERATOR: dict[Command, Literal["stop", "manual", "start", "hold", "excite"]] = {
    "stop": "stop",
    "drive": "manual",
    "start": "start",
    "hold": "hold",
    "excite": "excite",
}


def add_parser(commands) -> None:
    """Add `teleop` to the command line."""
    p = commands.add_parser(
        "teleop",
        help="drive by hand: keyboard or gamepad",
        description="Like `aritra run`, with a person at the sticks. Thrusters are neutral until R is pressed, which "
        "arms; a key let go of, a silent gamepad and SPACE end in neutral; Ctrl-C ends in neutral, disarmed. "
        "Exit code 0: an orderly end; 1: a failure; 2: bad input.",
        example="aritra teleop --gamepad /dev/input/js0",
    )
    add_config(p)
    add_wires(p)
    p.add_argument(
        "--log", type=output, metavar="LOG", help="MCAP log to write (default: aritra-DATE.mcap in log.folder)"
    )
    p.add_argument(
        "--gamepad",
        nargs="?",
        const="/dev/input/js0",
        metavar="DEVICE",
        help="move by a gamepad (default /dev/input/js0); the keyboard keeps its commands",
    )
    p.set_defaults(function=teleop, mission=None, excite=None, start=False, end_after=None, unchecked=False)


def teleop(args: argparse.Namespace) -> int:
    """Drive until interrupted; the exit code. Raises ConfigError without a terminal."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise ConfigError(
            "needs a terminal for keyboard and table: not a pipe, not a service; or drive from the console, By hand"
        )
    with _keys_as_they_come(sys.stdin.fileno()):
        return run.run(args, TeleopConsole(sys.stdin.fileno(), args.gamepad))


class TeleopConsole:
    """Keys and sticks to the App, messages to the view. `gamepad`: its device, or None.

    `out`: where the view is drawn, the terminal where it is None.
    """

    def __init__(self, descriptor: int, gamepad: str | None, out: TextIO | None = None) -> None:
        self._descriptor, self._gamepad = descriptor, gamepad
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN)
        self._keyboard = Keyboard()
        self._seen = TeleopState(())
        self._view = TeleopView(self._seen, out or sys.stdout)
        self._marks = 0

    def begins(self, log: Path) -> None:
        """Show where the log goes."""
        self._seen.log = str(log)

    def see(self, message: Message) -> None:
        """Note a message for the view."""
        self._seen.see(message)

    def ends(self) -> None:
        """Nothing to show: the mode says it."""

    def close(self) -> None:
        """Stop drawing."""
        self._view.close()

    async def run(
        self, app: App, setup: RunSetup, clock: Clock, tell: Callable[[Alert], None], end: Callable[[], None]
    ) -> None:
        """Read keys and sticks until cancelled. Whatever ends it ends the run, in neutral."""
        self._seen.thrusters = tuple(c.name for c in setup.pilot.vessel.controls)
        self._view.start()
        pad, reading = None, None
        if self._gamepad:
            pad = GamepadDevice(
                self._gamepad,
                now_ns=clock.now_ns,
                sleep_until=clock.sleep_until,
                tell=lambda text: tell(Alert(t_ns=clock.now_ns(), level="info", text=text)),
            )
            reading = asyncio.create_task(pad.run())
        try:
            await self._serve(app, clock, tell, pad)
        finally:
            end()
            if reading:
                reading.cancel()

    async def _serve(self, app: App, clock: Clock, tell: Callable[[Alert], None], pad: GamepadDevice | None) -> None:
        """Twenty times a second the keys, then the sticks, until the terminal is closed or Ctrl-D."""
        due_ns, stops = clock.now_ns(), 0
        while True:
            now = clock.now_ns()
            data = self._read()
            commands = self._keyboard.feed(data or b"", now)
            if pad and pad.stops > stops:
                stops = pad.stops
                commands.append("stop")
            if data is None or "quit" in commands:
                return
            for command in commands:
                self._do(command, app, now, tell)
            shares = pad.shares(now) if pad else self._keyboard.shares(now)
            self._seen.level = self._keyboard.level
            app.manual(ManualInput(t_ns=now, **shares._asdict(), source="gamepad" if pad else "keyboard"))
            due_ns = max(due_ns + PERIOD_NS, now)
            await clock.sleep_until(due_ns)

    def _read(self) -> bytes | None:
        """Keys typed since the last call, b"" for none; None: the terminal was closed."""
        happened = [events for _, events in self._poll.poll(0)]
        if not happened:
            return b""
        if happened[0] & select.POLLIN:
            with contextlib.suppress(OSError):
                return os.read(self._descriptor, 256) or None
        return None

    def _do(self, command: Command, app: App, t_ns: int, tell: Callable[[Alert], None]) -> None:
        if command == "mark":
            self._marks += 1
            number, begins = (self._marks + 1) // 2, self._marks % 2
            self._seen.note = f"mark {number} {'runs' if begins else 'ended'}"
            tell(Alert(t_ns=t_ns, level="info", text=f"mark {number} {'begins' if begins else 'ends'}"))
        elif command != "quit":
            app.command(OperatorCommand(t_ns=t_ns, command=_OPERATOR[command]))


@contextlib.contextmanager
def _keys_as_they_come(descriptor: int) -> Iterator[None]:
    """Set the terminal to give each key at once, without echo; restore it afterwards."""
    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    try:
        yield
    finally:
        with contextlib.suppress(termios.error):
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
