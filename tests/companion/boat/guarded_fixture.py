"""The App's bench with the start interlock, and what others write to its autopilot or say on its wire."""

from __future__ import annotations

from companion.boat.start_interlock import StartInterlock, companion_of
from companion.cli.simulator.autopilot_options import wirings
from companion.core.messages import OperatorCommand
from companion.core.preflight.parameter_file import parse_parameters
from sim.world.autopilot.parameter_table import BOARD_PARAMETERS
from tests.companion.boat.app_fixture import Bench
from tests.drivers.mavlink.mavlink_autopilot import Sender
from tests.support.drive_fixture import setup

PLAIN = {f"SERVO{n}_FUNCTION": 58.0 + n for n in range(1, 5)}
"""Plain pass-through of the thrusters' channels: the last pulse stays for ever."""


def written(bench, values):
    """A ground station sets parameters; the autopilot broadcasts them."""
    station = Sender(255, 190)
    for name, value in values.items():
        frame = station.param_set(1, 1, name.encode(), value, 9)
        bench.far.send(bench.world.mavlink(frame, "boat"))


def silently_written(bench, values):
    """As a script does, or with the broadcast lost."""
    for name, value in values.items():
        bench.world.rover.vehicle.parameters.set(name, value)


class Guarded(Bench):
    """The App's bench with a guard, on a wiring's parameters."""

    def __init__(self, path, wiring="gate", changes=None, **world):
        files = parse_parameters(wirings()[wiring], name=wiring)
        parameters = {**BOARD_PARAMETERS, **files, **(changes or {})}
        super().__init__(path, parameters=parameters, guard=self._guarding, **world)

    def _guarding(self, codec):
        self.guard = StartInterlock(codec, companion_of(setup()))
        return self.guard

    def order(self, command):
        self.app.command(OperatorCommand(t_ns=self.clock.now_ns(), command=command))

    async def drive_off(self):
        """The operator starts the mission, and it begins."""
        self.order("start")
        assert await self.run(20.0, until=lambda: self.mode == "auto"), self.alerts()


def told(bench, words):
    return sum(words in text for text in bench.alerts())


def strange(bench, system=7):
    bench.far.send(Sender(system, 1).beat())
