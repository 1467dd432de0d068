"""What a pre-flight check may have heard, all in order, for the tests beside it."""

from companion.cli.simulator.autopilot_options import wirings
from companion.core.messages import (
    AutopilotInfo,
    Heartbeat,
)
from companion.core.preflight.observations import Disk, Observations, RoundTrip
from companion.core.preflight.parameter_file import parse_parameters
from companion.core.preflight.rows import ParameterSet
from companion.core.preflight.wiring import Companion
from tests.support.drive_fixture import setup

COMPANION = Companion((("fl", 9), ("fr", 10), ("rl", 11), ("rr", 12)), (1, 2, 3, 4), 1, 0.3, 0.015)
SITE, VESSEL = setup().pilot.site, setup().pilot.vessel
DISK = Disk("logs", 10**11)
BEAT = Heartbeat(
    t_ns=0,
    system=1,
    component=1,
    vehicle_type=11,
    autopilot=3,
    base_mode=65,
    custom_mode=4,
    system_status=3,
    armed=False,
)
INFO = AutopilotInfo(t_ns=0, flight_sw_version=4 << 24 | 6 << 16, board_version=0, capabilities=0)
WANTED = {"ATTITUDE": 50.0, "RAW_IMU": 50.0, "RC_CHANNELS": 5.0}
TRIPS = tuple(RoundTrip(0.003 + 0.0001 * k, 12.0 + 0.0001 * k) for k in range(10))


def heard(**changed):
    given = {
        "listened_s": 5.0, "disk": DISK, "wall_s": 1.8e9, "heartbeat": BEAT, "info": INFO, "received": 1000,
        "arming_told": True, "wanted_hz": WANTED, "rates_hz": dict(WANTED), "round_trips": TRIPS,
    }  # fmt: skip
    return Observations(**{**given, **changed})


def by_name(rows):
    rows = list(rows)
    assert all(row.why and row.needed and row.found for row in rows)
    assert all(bool(row.fix) == (row.level != "ok") for row in rows), "what is not in order says what to do"
    return {row.name: row for row in rows}


def told(wiring_name, **changed):
    """A whole set as an autopilot would tell it: the file's, over what the firmware has by default."""
    defaults = {
        "RC_OPTIONS": 32.0, "MODE_CH": 8.0, "RCMAP_ROLL": 1.0, "RCMAP_PITCH": 2.0, "RCMAP_THROTTLE": 3.0,
        "RCMAP_YAW": 4.0,
        "ARMING_REQUIRE": 1.0, "ARMING_CHECK": 1.0, "BRD_SAFETY_DEFLT": 0.0, "SERVO_RC_FS_MSK": 0.0, "SCR_ENABLE": 0.0,
        "FS_THR_ENABLE": 1.0, "FS_THR_VALUE": 910.0, "FS_ACTION": 2.0, "FS_GCS_ENABLE": 0.0, "RC_OVERRIDE_TIME": 3.0,
        "ARMING_RUDDER": 2.0, "FRAME_TYPE": 0.0, **{f"SERVO{n}_FUNCTION": 0.0 for n in range(1, 17)},
    }  # fmt: skip
    file = parse_parameters(wirings()[wiring_name], name=wiring_name)
    return ParameterSet({**defaults, **file, **changed})
