"""IMU and attitude of the autopilot. Their equations in the filter: `estimation.inertial`.

Specific force and rates are older than their stamp by the delay of the autopilot's low-pass filters
(`configuration.imu_filters`), as `aritra provision` sets them; heading has not passed them.
"""

from __future__ import annotations

import math

from msgspec.structs import replace

from companion.core.configuration.imu_filters import PROVISIONED_HZ, low_pass_delay_s
from companion.core.configuration.sensors import Imu
from companion.core.geometry.frames import ssa
from companion.core.messages import Attitude, ImuSample
from companion.core.model.sensor_errors import correct_heading, correct_imu, correct_yaw_rate, knows_imu_errors
from companion.core.sensors.sensor import Sensor, verdict, within

MAX_ACCEL_M_S2 = 320.0
"""Twice the largest full scale of an autopilot's IMU (16 g)."""
MAX_RATE_RAD_S = 70.0
"""Twice the largest full scale (2000 deg/s)."""
MAX_ANGLE_RAD = 7.0
"""Beyond a full turn; angles come as -pi..pi or 0..2 pi."""


class OfTheImu(Sensor):
    """What has its place and its known errors in the table `imu`."""

    key, aids = "imu", False
    latency_s = low_pass_delay_s(PROVISIONED_HZ)

    def __init__(self, imu: Imu):
        self._imu, self._exact, self.rate_Hz = imu, not knows_imu_errors(imu), imu.rate_Hz


class InertialSensor(OfTheImu):
    """Accelerometer and gyro."""

    label, messages = "IMU", (ImuSample,)

    @staticmethod
    def screen(m: ImuSample) -> tuple[ImuSample | None, str]:
        """Finite, and within twice the largest full scale."""
        rates = within(MAX_RATE_RAD_S, m.p_rad_s, m.q_rad_s, m.r_rad_s)
        return verdict(m, rates and within(MAX_ACCEL_M_S2, m.ax_m_s2, m.ay_m_s2, m.az_m_s2), "imu")

    def correct(self, m: ImuSample) -> ImuSample:
        """Without the known biases, scale and misalignment."""
        if self._exact:
            return m
        a_x, a_y, r = correct_imu(self._imu, m.ax_m_s2, m.ay_m_s2, m.r_rad_s)
        return replace(m, ax_m_s2=float(a_x), ay_m_s2=float(a_y), r_rad_s=float(r))

    @staticmethod
    def repeatable(m: ImuSample) -> tuple[str, tuple[float, ...]]:
        """All six axes."""
        rates = m.p_rad_s, m.q_rad_s, m.r_rad_s
        return f"IMU ({m.source})", (m.ax_m_s2, m.ay_m_s2, m.az_m_s2, *rates)


class AttitudeSensor(OfTheImu):
    """The autopilot's own attitude; headings in site axes."""

    label, messages = "heading", (Attitude,)

    @staticmethod
    def screen(m: Attitude) -> tuple[Attitude | None, str]:
        """Finite angles and rates; a heading that was left out (NaN) is none."""
        angles = within(MAX_ANGLE_RAD, m.phi_rad, m.theta_rad, 0.0 if math.isnan(m.psi_rad) else m.psi_rad)
        return verdict(m, angles and within(MAX_RATE_RAD_S, m.p_rad_s, m.q_rad_s, m.r_rad_s), "heading")

    def correct(self, m: Attitude) -> Attitude:
        """Without the compass' known errors and the gyro's."""
        if self._exact:
            return m
        psi, r = correct_heading(self._imu, m.psi_rad), correct_yaw_rate(self._imu, m.r_rad_s)
        return replace(m, psi_rad=ssa(float(psi)), r_rad_s=float(r))

    @staticmethod
    def repeatable(m: Attitude) -> tuple[str, tuple[float, ...]]:
        """Angles and rates."""
        return "attitude", (m.phi_rad, m.theta_rad, m.psi_rad, m.p_rad_s, m.q_rad_s, m.r_rad_s)
