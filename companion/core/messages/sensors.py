"""Messages from the wires: what sensors, autopilot and links say. Conventions: `messages`, which has all of them."""

from __future__ import annotations

from typing import Literal

import msgspec

Vec = tuple[float, ...]


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """Base of all messages. `t_ns`: instant it speaks of, companion monotonic clock [ns]."""

    t_ns: int


# --- inputs: sensors -------------------------------------------------------------------------------


class Measured(Message, frozen=True, kw_only=True):
    """Base of sensor messages. `t_rx_ns`: when the bytes arrived; `t_ns`: when it was measured."""

    t_rx_ns: int


class ImuSample(Measured, frozen=True, kw_only=True):
    """Specific force [m/s^2] and angular rate [rad/s], body FRD (at rest az = -9.81)."""

    ax_m_s2: float
    ay_m_s2: float
    az_m_s2: float
    p_rad_s: float
    q_rad_s: float
    r_rad_s: float
    source: str


class Attitude(Measured, frozen=True, kw_only=True):
    """The autopilot's attitude estimate: roll, pitch, heading from north [rad], rates [rad/s].

    A heading that is NaN was left out (`pilot.trust.sensors.heading_check`); the rest of the message counts.
    """

    phi_rad: float
    theta_rad: float
    psi_rad: float
    p_rad_s: float
    q_rad_s: float
    r_rad_s: float


class AnchorRange(msgspec.Struct, frozen=True, kw_only=True):
    """One range [m] to one anchor; `rssi_dbm` and `quality` (0-100) where the tag gives them."""

    anchor: str
    range_m: float
    rssi_dbm: float | None = None
    quality: int | None = None


class UwbRanges(Measured, frozen=True, kw_only=True):
    """Ranges of one tag cycle."""

    tag: str
    ranges: tuple[AnchorRange, ...]


class UwbPosition(Measured, frozen=True, kw_only=True):
    """A position computed by the tag, in the frame in which its anchors were set up [m], quality 0-100."""

    tag: str
    x_m: float
    y_m: float
    z_m: float
    quality: int | None = None


class GnssFix(Measured, frozen=True, kw_only=True):
    """What a GNSS receiver says of its antenna: latitude and longitude (WGS84), velocity over ground, north and east.

    `fix_type` as MAVLink's GPS_FIX_TYPE: below 3 no position; 3 alone, 4 with corrections, 5 RTK float, 6 RTK fixed.
    `h_acc_m`, `v_acc_m_s`: the receiver's own word on its errors.
    """

    fix_type: int
    lat_deg: float
    lon_deg: float
    v_north_m_s: float | None = None
    v_east_m_s: float | None = None
    satellites: int | None = None
    h_acc_m: float | None = None
    v_acc_m_s: float | None = None


class DvlVelocity(Measured, frozen=True, kw_only=True):
    """Velocity over ground of a Doppler velocity log, in its own axes: x ahead, y to starboard [m/s].

    `valid`: it sees the bottom; `altitude_m`: above it; `fom_m_s`: its own word on the error.
    """

    x_m_s: float
    y_m_s: float
    valid: bool
    altitude_m: float | None = None
    fom_m_s: float | None = None


MEASUREMENTS: tuple[type[Measured], ...] = (ImuSample, Attitude, UwbRanges, UwbPosition, GnssFix, DvlVelocity)
"""Every message of a sensor; all of them are `INPUTS`."""


# --- inputs: autopilot and links -------------------------------------------------------------------


class Heartbeat(Message, frozen=True, kw_only=True):
    """HEARTBEAT of the autopilot. `custom_mode`: Rover 0 MANUAL, 4 HOLD, 5 LOITER, 15 GUIDED."""

    system: int
    component: int
    vehicle_type: int
    autopilot: int
    base_mode: int
    custom_mode: int
    system_status: int
    armed: bool


class Battery(Message, frozen=True, kw_only=True):
    """Battery voltage [V], current [A] and what remains [%], where known."""

    voltage_v: float
    current_a: float | None = None
    remaining_percent: int | None = None


class ServoOutput(Message, frozen=True, kw_only=True):
    """SERVO_OUTPUT_RAW: pulse widths [us] that leave the autopilot, output 1 first."""

    pwm_us: tuple[int, ...]


class MotorOutputs(Message, frozen=True, kw_only=True):
    """SYS_STATUS: whether pulses may leave the autopilot, which its safety switch decides (bit MOTOR_OUTPUTS)."""

    enabled: bool


class RcChannels(Message, frozen=True, kw_only=True):
    """RC_CHANNELS: pulse widths [us] that the autopilot believes to receive, channel 1 first."""

    pwm_us: tuple[int, ...]
    rssi: int | None = None


class CommandAck(Message, frozen=True, kw_only=True):
    """Answer to a command: MAV_CMD number and MAV_RESULT (0 accepted, 4 failed)."""

    command: int
    result: int


class ParamValue(Message, frozen=True, kw_only=True):
    """One autopilot parameter; `index` is None where the autopilot echoes a PARAM_SET."""

    name: str
    value: float
    index: int | None
    count: int


class TimeSync(Message, frozen=True, kw_only=True):
    """TIMESYNC: `tc1_ns` answers with the peer's clock, `ts1_ns` echoes ours (tc1 = 0 is a question)."""

    tc1_ns: int
    ts1_ns: int


class StatusText(Message, frozen=True, kw_only=True):
    """A text from the autopilot, its chunks joined. Severity 0 (emergency) to 7 (debug)."""

    severity: int
    text: str


class AutopilotInfo(Message, frozen=True, kw_only=True):
    """AUTOPILOT_VERSION: firmware version number and board."""

    flight_sw_version: int
    board_version: int
    capabilities: int


LinkState = Literal["searching", "online", "stale", "lost"]
HELD_PORT = "is held by another program"
"""Words of the reason why a port of this machine cannot be opened, where waiting will not help."""


class LinkStatus(Message, frozen=True, kw_only=True):
    """State of one device link and the reason for it, in words."""

    link: str
    state: LinkState
    reason: str
