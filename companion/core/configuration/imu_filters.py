"""The autopilot's low-pass filters of its inertial sensors, and how late they make what it tells.

    delay = sqrt(2) / (2 pi f)       of a second-order Butterworth filter at motions well below its cut-off f

ArduPilot filters gyros and accelerometers at INS_GYRO_FILTER and INS_ACCEL_FILTER [Hz], at its sensors' own rate of
1 kHz or more, and tells nothing else: RAW_IMU, ATTITUDE's rates and IMU of a .BIN have passed them. Heading has not.
Source: AP_InertialSensor (4.6): _publish_gyro, _publish_accel, LowPassFilter2p; 0 lets all through.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

PROVISIONED_HZ = 20.0
"""Both filters as the files of deploy/ardupilot set them."""
FilteredColumn = Literal["r_rad_s", "ax_m_s2", "ay_m_s2"]
FILTERS: Mapping[FilteredColumn, str] = {
    "r_rad_s": "INS_GYRO_FILTER",
    "ax_m_s2": "INS_ACCEL_FILTER",
    "ay_m_s2": "INS_ACCEL_FILTER",
}
"""Column of a run -> parameter of the autopilot."""
FILTER_PARAMETERS = tuple(dict.fromkeys(FILTERS.values()))


def low_pass_delay_s(cutoff_hz: float) -> float:
    """Delay [s] of a second-order Butterworth low-pass at a cut-off [Hz]; 0 where there is no filter (0 Hz)."""
    return math.sqrt(2.0) / (2.0 * math.pi * cutoff_hz) if cutoff_hz > 0 else 0.0


def late_by_filters(parameters: Mapping[str, float]) -> dict[FilteredColumn, float]:
    """By how much inertial columns are late [s], by the autopilot's parameters; without those of unknown filters."""
    known: dict[FilteredColumn, float] = {c: parameters[name] for c, name in FILTERS.items() if name in parameters}
    return {column: low_pass_delay_s(hz) for column, hz in known.items() if math.isfinite(hz)}
