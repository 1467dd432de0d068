"""The board of ArduPilot's own simulator, for runs beside a real firmware: gyros that warm up, a compass without error.

    gyro     + c t on each axis
    nu       = psi_c - m - psi          psi_c: the compass, `COMPASS_LATE_S` late
    psi'     = r + b + k_psi nu,        b' = k_b nu,        m' = k_m nu once under way

psi is the heading that the autopilot says, b its correction of the gyro, m what it takes for an error of the compass.
Elsewhere the vessel file says how a heading errs, compass and autopilot in one.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import NamedTuple

from companion.core.geometry.frames import ssa
from sim.world.sensors import ImuReading

GYRO_DRIFT_RAD_S2 = math.radians(0.05) / 60
"""c: SIM_DRIFT_SPEED, 0.05 deg/s a minute; it turns after five minutes, which no mission lasts."""
COMPASS_LATE_S = 0.04
"""Fitted with the gains of DCM: 0.036 s."""
UNDER_WAY_M_S = 0.3
"""Assumed: the firmware's heading begins to slip as its boat sets off."""


class HeadingGains(NamedTuple):
    """k_psi, k_b [1/s^2], k_m, both others [1/s]."""

    heading: float
    gyro: float
    compass: float


DCM = HeadingGains(0.2, 0.005, 0.0)
EKF3_WITH_GPS = HeadingGains(1.45, 0.082, 1.42)
"""Fitted to the headings of 4.6 in three missions each (seeds 11 to 13), which they follow within 0.085 and 0.076
degrees rms. AP_AHRS_DCM.cpp has 0.2 and 0.01; its integral waits while the boat spins."""


class SitlBoard:
    """State of heading and correction; one `sense` every `period_s`."""

    def __init__(self, gains: HeadingGains, period_s: float):
        self._gains, self._period_s = gains, period_s
        self._compass_rad: deque[float] = deque(maxlen=1 + round(COMPASS_LATE_S / period_s))
        self._psi_rad = math.nan
        self._gyro_rad_s = self._offset_rad = self._t_s = 0.0
        self._under_way = False

    def sense(self, reading: ImuReading, compass_rad: float, speed_m_s: float) -> ImuReading:
        """The reading with this board's gyros and heading."""
        self._t_s += self._period_s
        self._compass_rad.append(compass_rad)
        self._under_way |= speed_m_s > UNDER_WAY_M_S
        if math.isnan(self._psi_rad):
            self._psi_rad = self._compass_rad[0]
        drift = GYRO_DRIFT_RAD_S2 * self._t_s
        p, q, r = (rate + drift for rate in reading.gyro_rad_s)
        self._psi_rad += self._period_s * (r + self._gyro_rad_s)
        nu = ssa(self._compass_rad[0] - self._offset_rad - self._psi_rad)
        self._psi_rad += self._period_s * self._gains.heading * nu
        self._gyro_rad_s += self._period_s * self._gains.gyro * nu
        self._offset_rad += self._period_s * self._gains.compass * nu * self._under_way
        return replace(reading, gyro_rad_s=(p, q, r), psi_rad=self._psi_rad)
