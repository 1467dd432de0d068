"""The shore of one run: telemetry out, orders in, both only where the run file has a `[telemetry]` table."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

from companion.boat.app import App
from companion.boat.clock import Clock
from companion.boat.load_run import RunSetup
from companion.boat.signing_key import load_secret
from companion.boat.start_interlock import StartInterlock
from companion.boat.uplink.name_collision import NameCollisions
from companion.boat.uplink.order_receiver import ShoreCommands
from companion.boat.uplink.stick_receiver import ShoreSticks
from companion.boat.uplink.telemetry import Telemetry, boat_name, config_of
from companion.core.messages import Alert, Message
from companion.core.pilot.state import PilotSettings
from companion.core.telemetry.order_gate import OrderGate
from companion.core.telemetry.sticks import StickGate
from companion.core.telemetry.view import TelemetryView, Who

RUN_BYTES = 6
UNSIGNED = "orders from shore need no key: whoever the router lets in may drive the boat (telemetry.command_key)"


def shore_of(setup: RunSetup, path: Path) -> Shore:
    """The shore that the run file at `path` asks for. Raises ConfigError."""
    link = setup.run.telemetry
    if link is None:
        return Shore(setup.pilot, None)
    key = None
    if link.command_key:
        key = load_secret(path.parent / link.command_key, where=f"{path}: telemetry.command_key")
    boat, run = boat_name(link, setup.pilot.vessel.name), secrets.token_hex(RUN_BYTES)
    offset_ns = time.time_ns() - time.monotonic_ns()
    who = Who(run, setup.digest, f"aritra {version('aritra')}", offset_ns, link.commands)
    config = config_of(link, path.parent, where=str(path))
    telemetry = Telemetry(boat, link, config, TelemetryView(setup.pilot, who, link.rate_Hz))
    gates = (OrderGate(boat, run, key), StickGate(boat, run, key)) if link.commands else None
    return Shore(setup.pilot, telemetry, gates, name=(boat, run))


class Shore:
    """Feed it every message. Orders are obeyed between `open` and `end`. Without telemetry nothing happens.

    `name`: the boat's, and its run's.
    """

    def __init__(
        self,
        settings: PilotSettings,
        telemetry: Telemetry | None,
        gates: tuple[OrderGate, StickGate] | None = None,
        name: tuple[str, str] = ("", ""),
    ) -> None:
        self.telemetry, self.commands = telemetry, None
        self.sticks: ShoreSticks | None = None
        self._settings, self._gates, self._name = settings, gates, name

    def open(self, app: App, guard: StartInterlock | None, clock: Clock, tell: Callable[[Alert], None]) -> None:
        """Begin, on the loop's thread; `tell` is called on it."""
        if self.telemetry is None:
            return
        loop = asyncio.get_running_loop()

        def tell_loop(alert: Alert) -> None:
            with contextlib.suppress(RuntimeError):  # the loop is closed: the run is over
                loop.call_soon_threadsafe(tell, alert)

        namesakes = NameCollisions(*self._name, clock.now_ns, tell_loop)
        if self._gates:
            gate, sticks = self._gates
            self.sticks = ShoreSticks(app, sticks, clock, tell)
            self.commands = ShoreCommands(app, self._settings, gate, clock, tell, namesakes.meet, self.sticks.take)
            self.telemetry.refused = self.commands.refused.total
            if not gate.signed:
                tell(Alert(t_ns=clock.now_ns(), level="warning", text=UNSIGNED))
        self.telemetry.start(tell_loop, lambda: guard.rows if guard else (), self.commands, namesakes.hear, self.sticks)

    def see(self, message: Message) -> None:
        """Note one message; never waits."""
        if self.telemetry:
            self.telemetry.see(message)

    def end(self) -> None:
        """The run begins to end: no order is obeyed any more."""
        if self.commands:
            self.commands.end()
        if self.sticks:
            self.sticks.end()

    def close(self) -> None:
        """Publish what is left, and end; waits for 3 s at most."""
        if self.telemetry:
            self.telemetry.close()
        if self.commands:
            self.commands.close()
