"""The simulated autopilot as the judge of the pre-flight check: does a thruster still turn after the companion died?

judge = Judge({"FS_THR_ENABLE": 0}, wiring="gate")
judge.rows                     what the check says of it, before anything was overridden
judge.turns_after_death()      what happens
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as wire

from companion.core.constants import NEUTRAL_US
from companion.core.messages import Heartbeat, RcChannels, ServoOutput
from companion.core.preflight.autopilot import parameter_rows
from companion.core.preflight.link import rest_rows
from companion.core.preflight.observations import Disk, Observations
from companion.core.preflight.rows import ParameterSet, Row
from companion.core.preflight.wiring import BAND_US
from sim.world.autopilot.parameter_table import BOARD_PARAMETERS, TABLE
from tests.companion.core.preflight.observations_fixture import COMPANION
from tests.sim.world.autopilot.autopilot_fixture import Bench, command
from tests.sim.world.wirings.wiring_fixture import load

PATIENCE_S = 15.0
"""Longer than every fail-safe of the shipped files: 6.5 s."""
FORCE = 21196


class Judge:
    """A boat with a wiring's file and `changes` on top; `receiver_us`: pulses of an RC receiver."""

    def __init__(self, changes=None, *, wiring="gate", receiver_us=(), firmware="4.6"):
        base = {**BOARD_PARAMETERS, **load(wiring)}
        self.bench = Bench(changes, base=base, dt_s=0.02, firmware=firmware)
        if receiver_us:
            self.bench.receiver(*receiver_us)
        self.bench.run(1.2)
        self.omni = wiring == "omni"
        self.told = told(self.bench.rover.vehicle.parameters)
        self.rows = self._check()

    def refused(self) -> list[str]:
        """Names of the rows that refuse."""
        return [row.name for row in self.rows if row.level == "refuse"]

    def turns_after_death(self, us: int = 1700) -> bool:
        """Drive at `us`, stop saying anything, wait, look at the thrusters' outputs."""
        bench = self.bench
        bench.run(1.0, every=self._drive(NEUTRAL_US))
        bench.send(command(176, 1, 0))
        bench.send(command(400, 1, FORCE))
        bench.run(0.5, every=self._drive(us))
        bench.run(PATIENCE_S)
        return any(p and abs(p - NEUTRAL_US) > BAND_US for p in bench.rover.outputs_us[:4])

    def arms(self) -> bool:
        """Hold all in neutral as a run does, set MANUAL and ask it to arm."""
        self.bench.run(1.0, every=self._drive(NEUTRAL_US))
        self.bench.send(command(176, 1, 0))
        self.bench.send(command(400, 1, 0))
        self.bench.run(0.5, every=self._drive(NEUTRAL_US))
        return self.bench.rover.vehicle.modes.armed

    def _drive(self, us: int) -> wire.MAVLink_message:
        """Thrusters and, with the mixer, throttle; other neutral channels at 1500 us as in a run."""
        low = [1500, 1500, us if self.omni else 1500, 1500]
        return wire.MAVLink_rc_channels_override_message(0, 0, *low, *[65535] * 4, *[us] * 4, *[0] * 6)

    def _check(self) -> list[Row]:
        vehicle = self.bench.rover.vehicle
        beat = Heartbeat(
            t_ns=0, system=1, component=1, vehicle_type=11, autopilot=3, base_mode=65,
            custom_mode=int(vehicle.modes.mode), system_status=3, armed=vehicle.modes.armed,
        )  # fmt: skip
        heard = Observations(
            listened_s=5.0, disk=Disk("", 10**12), wall_s=2e9, heartbeat=beat, arming_told=True,
            servo=ServoOutput(t_ns=0, pwm_us=self.bench.rover.outputs_us),
            rc=RcChannels(t_ns=0, pwm_us=(*vehicle.rc.radio_in_us, 0, 0)),
        )  # fmt: skip
        p = ParameterSet(self.told)
        return [*parameter_rows(p, COMPANION), *rest_rows(heard, p, COMPANION)]


def told(parameters) -> dict[str, float]:
    """All parameters as this firmware spells them on the wire."""
    return {parameters.wire_name(i): parameters[row.name] for i, row in enumerate(TABLE)}
