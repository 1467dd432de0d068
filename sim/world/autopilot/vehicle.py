"""The simulated autopilot behind its wires: sensors, battery, RC, modes, outputs, advanced in time."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from companion.core.constants import GRAVITY_M_S2
from companion.core.messages.sensors import GnssFix
from sim.world.autopilot.arming import PreArmReport, in_full, pre_arm_faults, stick_faults
from sim.world.autopilot.failsafe import Failsafe
from sim.world.autopilot.firmware import Firmware
from sim.world.autopilot.modes import ModeControl
from sim.world.autopilot.outputs import Outputs
from sim.world.autopilot.parameters import ParameterStore
from sim.world.autopilot.pilot_inputs import PilotInputs
from sim.world.autopilot.rc import RcInput
from sim.world.autopilot.script import GateScript

Vec3 = tuple[float, float, float]
_INITIALISING_NS = 1_000_000_000  # assumed: a second of start-up before the first real mode
_CRITICAL = 2
_NS_PER_HOUR = 3_600_000_000_000


class SensorFrame(msgspec.Struct, frozen=True, kw_only=True):
    """What the autopilot's own sensors and estimator say now, noise and bias included.

    `accel_m_s2`: specific force, body FRD (at rest z = -9.81); `gyro_rad_s`: body rates as the gyro gives
    them; phi, theta, psi: the attitude it reports, p, q, r: the rates it reports with it; `gyro_drift_rad_s`: its own
    correction that they contain; `receiver_us`: pulse widths of an RC receiver, empty without one; `gnss`: the latest
    fix, stamped as it came, None: no receiver.
    """

    accel_m_s2: Vec3
    gyro_rad_s: Vec3
    phi_rad: float
    theta_rad: float
    psi_rad: float
    p_rad_s: float
    q_rad_s: float
    r_rad_s: float
    voltage_v: float
    current_a: float
    gyro_drift_rad_s: Vec3 = (0.0, 0.0, 0.0)
    receiver_us: tuple[int, ...] = ()
    gnss: GnssFix | None = None


AT_REST = SensorFrame(
    accel_m_s2=(0.0, 0.0, -GRAVITY_M_S2),
    gyro_rad_s=(0.0, 0.0, 0.0),
    phi_rad=0.0,
    theta_rad=0.0,
    psi_rad=0.0,
    p_rad_s=0.0,
    q_rad_s=0.0,
    r_rad_s=0.0,
    voltage_v=16.0,
    current_a=0.0,
)
"""A level boat, heading north, 16 V."""


class SimulatedVehicle:
    """State at `t_ns` (simulation time). `drift_ppm`: how fast the autopilot's own clock runs ahead.

    `home`: latitude and longitude [1e-7 deg] once a command has set it. `reboot_asked`: a command has asked for it;
    whoever holds the vehicle makes a new one.
    """

    def __init__(
        self,
        boot_ns: int,
        parameters: Mapping[str, float],
        drift_ppm: float,
        gate_channels: tuple[int, ...],
        firmware: Firmware,
    ):
        self.parameters = ParameterStore(parameters, firmware)
        self.reboot_asked = False
        self.system_id = int(self.parameters["SYSID_THISMAV"])
        self.loop_rate_hz = self.parameters["SCHED_LOOP_RATE"]
        self.sensors = AT_REST
        self.t_ns = boot_ns
        self.consumed_mah = 0.0
        self.home: tuple[int, int] | None = None
        self.texts: list[tuple[int, str]] = []
        self.rc = RcInput(self.parameters)
        self.modes = ModeControl(self.parameters, self.say, self._arming_faults)
        self.failsafe = Failsafe(self.parameters, self.rc, self.modes, self.say)
        self.pilot_inputs = PilotInputs(self.parameters, self.rc, self.modes)
        self.script = GateScript(bool(gate_channels) and bool(self.parameters["SCR_ENABLE"]), self.say)
        self.outputs = Outputs(self.parameters, self.rc, self.modes, self.failsafe, gate_channels, self.script)
        self._boot_ns = boot_ns
        self._report = PreArmReport(boot_ns)
        self._rate = 1.0 + drift_ppm * 1e-6

    @property
    def clock_us(self) -> int:
        """The autopilot's own clock: microseconds since its boot."""
        return self.clock_us_at(self.t_ns)

    def clock_us_at(self, t_ns: int) -> int:
        """The same at another instant."""
        return int((t_ns - self._boot_ns) * self._rate) // 1000

    @property
    def clock_ms(self) -> int:
        """time_boot_ms."""
        return self.clock_us // 1000

    def say(self, severity: int, text: str) -> None:
        """Queue a STATUSTEXT for every link (severity 0 emergency to 7 debug)."""
        self.texts.append((severity, text))

    def pre_arm_faults(self) -> list[str]:
        """What the checks before arming find now."""
        return pre_arm_faults(self.parameters, self.modes, self.failsafe)

    def _arming_faults(self, by_stick: bool) -> list[str]:
        faults = self.pre_arm_faults() or stick_faults(self.parameters, self.rc, self.failsafe, by_stick)
        return [in_full(fault, asked=True) for fault in faults]

    def sense(self, sensors: SensorFrame, t_ns: int) -> None:
        """New sensor values at t; then everything that depends on time."""
        elapsed_ns = max(0, t_ns - self.t_ns)
        self.consumed_mah += sensors.current_a * 1000.0 * elapsed_ns / _NS_PER_HOUR
        self.sensors = sensors
        self.rc.receiver(sensors.receiver_us, t_ns)
        self.advance(t_ns)

    def advance(self, t_ns: int) -> None:
        """Bring modes, fail-safes and outputs to t (an earlier t counts as now)."""
        self.t_ns = max(t_ns, self.t_ns)
        if not self.modes.started and self.t_ns - self._boot_ns >= _INITIALISING_NS:
            self.modes.initialised()
        self.failsafe.advance(self.t_ns)
        self.pilot_inputs.advance(self.t_ns)
        if not self.modes.armed:
            for fault in self._report.due(self.pre_arm_faults, self.t_ns):
                self.say(_CRITICAL, in_full(fault, asked=False))
        self.outputs.advance(self.t_ns)
