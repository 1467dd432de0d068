"""Frames that the companion sends: every method returns the bytes of one MAVLink 2 frame.

The override rules are those of ArduPilot as observed: on channels 1-8 a value of 65535 leaves the channel
alone and 0 releases it to the receiver, while 65534 IS A PULSE WIDTH there; on channels 9-16 a value of 0
leaves it alone and 65534 releases it; 17 and 18 are ignored. Without a receiver a release changes nothing:
send neutral first. Source: https://mavlink.io/en/messages/common.html and the firmware's behaviour.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.core.constants import NEUTRAL_US
from companion.core.messages import OverrideLease
from drivers.mavlink.signing import Signing
from drivers.mavlink.statustext import chunks
from drivers.mavlink.vision import VisionPose

PWM_MIN_US, PWM_MAX_US = 1100, 1900
"""Pulse widths of the thrusters' speed controllers [us] (Blue Robotics Basic ESC)."""
CHANNELS = 16
"""Channels that an override reaches; ArduPilot ignores 17 and 18."""
_LOW_CHANNELS = 8
_LOW_IGNORE, _LOW_RELEASE = 65535, 0
_HIGH_IGNORE, _HIGH_RELEASE = 0, 65534
_PARAM_ID_LEN = 16
MESSAGE_IDS: dict[str, int] = {kind.msgname: ident for ident, kind in dialect.mavlink_map.items()}


class MavlinkEncoder:
    """Encodes as `system`/`component` for `target_system`/`target_component` (0: everyone).

    `system` must equal the autopilot's SYSID_MYGCS (4.7: MAV_GCS_SYSID), which drops other overrides
    silently. `signing`: signs every frame.
    """

    def __init__(
        self,
        system: int,
        component: int,
        target_system: int,
        target_component: int,
        signing: Signing | None = None,
    ) -> None:
        self.target_system = target_system
        self.target_component = target_component
        self._mav = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        self._signing = signing
        self._text_id = 0
        if signing:
            signing.equip(self._mav)

    def heartbeat(self) -> bytes:
        """HEARTBEAT of an onboard controller."""
        kind, invalid = dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID
        return self._pack(self._mav.heartbeat_encode(kind, invalid, 0, 0, dialect.MAV_STATE_ACTIVE))

    def override(self, lease: OverrideLease) -> bytes:
        """RC_CHANNELS_OVERRIDE with the lease's pulse widths; ValueError names the channel that is wrong."""
        if len(lease.channels) != len(lease.pwm_us):
            raise ValueError(f"override: {len(lease.channels)} channels, {len(lease.pwm_us)} pulse widths")
        for channel, pwm_us in zip(lease.channels, lease.pwm_us, strict=True):
            if type(pwm_us) is not int or not PWM_MIN_US <= pwm_us <= PWM_MAX_US:
                raise ValueError(
                    f"override: channel {channel}: {pwm_us!r} is not a whole number of us "
                    f"from {PWM_MIN_US} to {PWM_MAX_US}"
                )
        _check_channels(lease.channels)
        return self._override(dict(zip(lease.channels, lease.pwm_us, strict=True)))

    def neutral(self, channels: Iterable[int]) -> bytes:
        """Override of `channels` with 1500 us."""
        return self._override(dict.fromkeys(_check_channels(channels), NEUTRAL_US))

    def release(self, channels: Iterable[int]) -> bytes:
        """Hand `channels` back to the receiver."""
        return self._override(
            {c: _LOW_RELEASE if c <= _LOW_CHANNELS else _HIGH_RELEASE for c in _check_channels(channels)}
        )

    def command_long(self, command: int, *params: float) -> bytes:
        """COMMAND_LONG with up to 7 parameters, the rest 0."""
        filled = [*params, *[0.0] * (7 - len(params))]
        return self._pack(self._mav.command_long_encode(self.target_system, self.target_component, command, 0, *filled))

    def set_message_interval(self, name: str, rate_hz: float) -> bytes:
        """Ask for messages of type `name` ("ATTITUDE") at `rate_hz`; KeyError for an unknown type."""
        return self.command_long(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, MESSAGE_IDS[name], 1e6 / rate_hz)

    def request_message(self, name: str) -> bytes:
        """Ask for one message of type `name`."""
        return self.command_long(dialect.MAV_CMD_REQUEST_MESSAGE, MESSAGE_IDS[name])

    def set_mode(self, custom_mode: int) -> bytes:
        """MAV_CMD_DO_SET_MODE with the custom-mode flag, without which ArduPilot denies it."""
        flag = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        return self.command_long(dialect.MAV_CMD_DO_SET_MODE, flag, custom_mode)

    def arm(self) -> bytes:
        """Arm the autopilot."""
        return self.command_long(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def disarm(self) -> bytes:
        """Disarm the autopilot."""
        return self.command_long(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0)

    def param_request_read(self, name: str) -> bytes:
        """Ask for the parameter `name`."""
        return self._pack(
            self._mav.param_request_read_encode(self.target_system, self.target_component, _param_id(name), -1)
        )

    def timesync(self, tc1_ns: int, ts1_ns: int) -> bytes:
        """TIMESYNC: a question has tc1 = 0 and our time in ts1; an answer our time in tc1 and echoes ts1."""
        return self._pack(self._mav.timesync_encode(tc1_ns, ts1_ns))

    def vision_position(self, fix: VisionPose) -> bytes:
        """VISION_POSITION_ESTIMATE: our pose, for the autopilot's filter."""
        pose = fix.north_m, fix.east_m, 0.0, 0.0, 0.0, fix.yaw_rad
        return self._pack(
            self._mav.vision_position_estimate_encode(fix.usec, *pose, list(fix.covariance), fix.reset_counter)
        )

    def global_origin(self, lat_deg: float, lon_deg: float) -> bytes:
        """SET_GPS_GLOBAL_ORIGIN at sea level (the boat's height is not known), for the target's system."""
        lat, lon = round(lat_deg * 1e7), round(lon_deg * 1e7)
        return self._pack(self._mav.set_gps_global_origin_encode(self.target_system, lat, lon, 0))

    def statustext(self, text: str) -> list[bytes]:
        """STATUSTEXT of severity warning: as many frames as `text` needs."""
        self._text_id = self._text_id % 65535 + 1
        return [
            self._pack(self._mav.statustext_encode(dialect.MAV_SEVERITY_WARNING, chunk, self._text_id, number))
            for number, chunk in enumerate(chunks(text))
        ]

    def _override(self, pwm_us: Mapping[int, int]) -> bytes:
        ignore = [_LOW_IGNORE] * _LOW_CHANNELS + [_HIGH_IGNORE] * (18 - _LOW_CHANNELS)
        raw = [pwm_us.get(i, untouched) for i, untouched in enumerate(ignore, start=1)]
        return self._pack(self._mav.rc_channels_override_encode(self.target_system, self.target_component, *raw))

    def _pack(self, message: Any) -> bytes:
        if self._signing:
            self._signing.stamp(self._mav)
        data = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return data


def _check_channels(channels: Iterable[int]) -> tuple[int, ...]:
    """The channels, each once and within 1..16, or ValueError."""
    checked = tuple(channels)
    for channel in checked:
        if type(channel) is not int or not 1 <= channel <= CHANNELS:
            raise ValueError(f"override: channel {channel!r} is not one of 1 to {CHANNELS}")
        if checked.count(channel) > 1:
            raise ValueError(f"override: channel {channel} is given twice")
    return checked


def _param_id(name: str) -> bytes:
    raw = name.encode("ascii", errors="replace")
    if not raw or len(raw) > _PARAM_ID_LEN or not name.isascii():
        raise ValueError(f"parameter name {name!r} is not 1 to {_PARAM_ID_LEN} ASCII characters")
    return raw
