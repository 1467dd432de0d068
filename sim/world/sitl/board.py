"""The board of ArduPilot's own simulator, for runs beside a real firmware: gyros that warm up, a compass without error,
readings that are older than their stamps, a battery that is always full.

    gyro     + c t on each axis
    psi_c    = psi + tan(I) (cos(psi_m) d_phi - sin(psi_m) d_theta)     a compass that is levelled wrongly
    psi'     = r + b + k_psi 0.97^n nu,        b' = k_b nu unless it spins,        nu = psi_c - psi

psi is the heading that the autopilot says, b its correction of the gyro, nu from the mean of the compass since it was
read last, n loops ago. I is the inclination of the earth's magnetic field at the site and psi_m the heading from
magnetic north; d_phi and d_theta are the errors of the autopilot's own roll and pitch, by which it levels the compass.
Elsewhere the vessel file says how a heading errs, compass and autopilot in one.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from companion.core.configuration.site_file import Site
from companion.core.geometry.frames import ssa
from sim.world.ahrs import SPIN_RAD_S, Vec3
from sim.world.sensors import ImuReading

GYRO_DRIFT_RAD_S2 = math.radians(0.05) / 60
"""c: SIM_DRIFT_SPEED, 0.05 deg/s a minute; it turns after five minutes, which no mission lasts."""
VOLTAGE_V = 16.0
"""SIM_BATT_VOLTAGE that the rig sets: what SITL tells of its battery, however much thrust is given."""
READING_AGE_S, HEADING_AGE_S = 0.005, 0.0075
"""How old specific force and rates, and the heading, are at their stamps. By the lag of 4.6 behind the true motion in
three missions (seeds 16 to 18): yaw rate 15.5 to 16.5 ms, of which its low-pass filter is 11.3; heading 10 to 11.5 ms,
against 3 to 3.5 of this board without it."""
COMPASS_PERIOD_S = 0.1
"""Rover::update_compass, 10 Hz; AP_Compass averages what has come since."""
LOOP_HZ, FADES = 200.0, 0.97
"""SCHED_LOOP_RATE of gate.param; `_omega_yaw_P *= 0.97f` in each loop without a new compass value."""
UNDER_WAY_M_S = 0.3
"""Assumed. On 4.6 the drift that it knows is that of 33 to 42 s, in missions that begin at 30 s (seeds 9, 11 to 13)."""


class HeadingGains(NamedTuple):
    """k_psi [1/s] and k_b [1/s^2]. `gps`: with a position roll and pitch are right, and b is -c t until the boat is
    under way, and stays so: an EKF knows of a boat at rest that it does not turn."""

    heading: float
    gyro: float
    gps: bool


DCM = HeadingGains(0.18, 0.01, gps=False)
"""AP_AHRS_DCM.cpp, 4.6: AHRS_YAW_P 0.2 times 0.9, which `_yaw_gain` is at rest; `_ki_yaw`. Not fitted: these equations
follow the headings of 4.6 in 15 missions (seeds 16 to 30), of which two had been looked at, within 0.05 degrees rms."""
EKF3_WITH_GPS = HeadingGains(0.075, 0.0, gps=True)
"""Fitted to the headings of 4.6 in three missions (seeds 11 to 13), which it follows within 0.09 degrees rms, taken
10 ms earlier; a fourth (seed 9) within 0.08 about a mean of 0.09."""


class SitlBoard:
    """State of heading and correction; one `sense` every `period_s`."""

    def __init__(self, gains: HeadingGains, site: Site, period_s: float):
        self._gains, self._period_s = gains, period_s
        self._tan_inclination, self._north_rad = _magnetic_field(site)
        self._compass: list[float] = []
        self._psi_rad = math.nan
        self._gyro_rad_s = self._nu_rad = self._t_s = 0.0
        self._under_way = False
        self._before: ImuReading | None = None

    def sense(
        self, reading: ImuReading, compass_rad: float, speed_m_s: float, tilt_error_rad: tuple[float, float]
    ) -> ImuReading:
        """The reading with this board's gyros and heading; `tilt_error_rad`: of the autopilot's roll and pitch."""
        self._t_s += self._period_s
        self._under_way |= speed_m_s > UNDER_WAY_M_S
        drift = GYRO_DRIFT_RAD_S2 * self._t_s
        p, q, r = (rate + drift for rate in reading.gyro_rad_s)
        if self._gains.gps and not self._under_way:
            self._gyro_rad_s = -drift
        if abs(r) < SPIN_RAD_S:
            self._gyro_rad_s += self._period_s * self._gains.gyro * self._nu_rad
        faded = FADES ** (LOOP_HZ * self._period_s * len(self._compass))
        self._psi_rad += self._period_s * (r + self._gyro_rad_s + self._gains.heading * faded * self._nu_rad)
        self._read(compass_rad, tilt_error_rad)
        now = replace(reading, gyro_rad_s=(p, q, r), psi_rad=self._psi_rad)
        before, self._before = self._before or now, now
        return self._aged(before, now)

    def _aged(self, before: ImuReading, now: ImuReading) -> ImuReading:
        """What is read now: a straight line between the last two samples."""
        age, heading_age = READING_AGE_S / self._period_s, HEADING_AGE_S / self._period_s

        def between(old: Vec3, new: Vec3) -> Vec3:
            x, y, z = (n + age * (o - n) for o, n in zip(old, new, strict=True))
            return x, y, z

        return replace(
            now,
            accel_m_s2=between(before.accel_m_s2, now.accel_m_s2),
            gyro_rad_s=between(before.gyro_rad_s, now.gyro_rad_s),
            psi_rad=now.psi_rad + heading_age * (before.psi_rad - now.psi_rad),
        )

    def _read(self, compass_rad: float, tilt_error_rad: tuple[float, float]) -> None:
        """One sample of the compass; nu where it is time."""
        if math.isnan(self._psi_rad):
            self._psi_rad = compass_rad
        if self._gains.gps:  # an EKF levels rightly, and compares each sample with the heading of its time
            self._nu_rad = ssa(compass_rad - self._psi_rad)
            return
        phi, theta = tilt_error_rad
        north_rad = compass_rad - self._north_rad
        error = self._tan_inclination * (math.cos(north_rad) * phi - math.sin(north_rad) * theta)
        self._compass.append(compass_rad + error)
        if len(self._compass) * self._period_s >= COMPASS_PERIOD_S - 1e-9:
            self._nu_rad = sum(ssa(each - self._psi_rad) for each in self._compass) / len(self._compass)
            self._compass.clear()


def _magnetic_field(site: Site) -> tuple[float, float]:
    """Tangent of the inclination, and the direction of magnetic north from the site's [rad]: ArduPilot's own table."""
    from pymavlink.mavextra import get_mag_field_ef  # noqa: PLC0415 - 0.2 s, and few worlds have this board

    field = get_mag_field_ef(site.lat_deg, site.lon_deg)
    if field is None:
        raise ValueError(f"ArduPilot's table of the earth's magnetic field has no entry for {site.lat_deg:g} N")
    declination_deg, inclination_deg, _ = field
    return math.tan(math.radians(inclination_deg)), math.radians(declination_deg - site.rotation_deg)
