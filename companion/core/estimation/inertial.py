"""Measurement updates by the autopilot's sensors: accelerometer, gyro and heading.

IMU       [a_x a_y] at the lever arm, in level axes by the filter's own roll and pitch, plus biases
attitude  psi + b_psi, where b_psi is the slow wander of the autopilot's own estimate, and psi_dot by its rates

Specific force and yaw rate have no gate: R of a number whose innovation exceeds the limit grows with its square.

The rates are those of ATTITUDE: the ones of RAW_IMU are cut to whole mrad/s.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import Imu
from companion.core.estimation.filter_state import (
    B_ACCEL,
    B_GYRO,
    B_PSI,
    DYNAMIC,
    TILT,
    FilterState,
    R,
    Result,
    innovation_message,
)
from companion.core.estimation.gates import judge
from companion.core.estimation.kalman import KalmanEquations
from companion.core.estimation.process import Process
from companion.core.estimation.ranging.ranges import inflate
from companion.core.estimation.tilt import level_jacobian, to_level_axes, yaw_rate
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.geometry.frames import ssa
from companion.core.messages import Attitude, ImuSample


class Inertial:
    """Constant parts of the IMU and attitude equations; the methods are pure."""

    def __init__(self, process: Process, imu: Imu, tuning: EstimatorTuning, algebra: KalmanEquations):
        self._process, self._algebra, self._tuning = process, algebra, tuning
        self._accel_R = np.square([imu.accel_sigma_m_s2, imu.accel_sigma_m_s2])
        self._attitude_R = np.square([imu.heading_sigma_rad, imu.gyro_sigma_rad_s])

    def fuse_imu(self, belief: FilterState, m: ImuSample) -> Result:
        """One update by a_x, a_y."""
        expected, J = self._process.acceleration(belief.x[DYNAMIC], self._process.drive(belief.f_n))
        tilt, force = belief.tilt, (m.ax_m_s2, m.ay_m_s2, m.az_m_s2)
        nu = np.array(to_level_axes(tilt, *force)[:2]) - expected - belief.x[B_ACCEL]
        H = np.zeros((2, len(belief.x)))
        H[:, DYNAMIC] = J
        H[:, B_ACCEL] = np.eye(2)
        H[:, TILT] = -level_jacobian(tilt, *force)
        HPH = H @ belief.P @ H.T
        S = HPH + np.diag(self._accel_R)
        surprise = nu**2 / np.diag(S) / self._tuning.imu_limit**2
        x, P = self._algebra.update(belief.x, belief.P, nu, H, np.diag(self._accel_R * np.maximum(surprise, 1.0)))
        innovation = innovation_message(belief.t_ns, "imu", nu, S, bool((surprise <= 1.0).all()))
        return replace(belief, x=x, P=P, imu_ns=belief.t_ns), (innovation,)

    def fuse_attitude(self, belief: FilterState, m: Attitude) -> Result:
        """One update by heading and yaw rate. Of roll and pitch only the rates count."""
        belief = replace(belief, pq_rad_s=(m.p_rad_s, m.q_rad_s), pq_ns=belief.t_ns)
        rate = yaw_rate(belief.tilt, m.q_rad_s, m.r_rad_s)
        x = belief.x
        nu = np.array([ssa(m.psi_rad - x[2] - x[B_PSI]), rate - x[R] - x[B_GYRO]])
        H = np.zeros((2, len(x)))
        H[0, 2] = H[0, B_PSI] = H[1, R] = H[1, B_GYRO] = 1.0
        S = H @ belief.P @ H.T + np.diag(self._attitude_R)
        verdict, gate = judge(
            belief.heading_gate, self._tuning.heading_gate, belief.t_ns, float(nu[0]), math.sqrt(S[0, 0])
        )
        belief = replace(belief, heading_gate=gate)
        good = verdict != "rejected"
        surprise = nu[1] ** 2 / S[1, 1] / self._tuning.imu_limit**2
        variance = self._attitude_R * (1.0, max(surprise, 1.0))
        innovations = (
            innovation_message(belief.t_ns, "heading", nu[:1], S[:1, :1], good),
            innovation_message(belief.t_ns, "yaw rate", nu[1:], S[1:, 1:], bool(surprise <= 1.0)),
        )
        P = inflate(belief.P, (2,), abs(float(nu[0]))) if verdict == "reopened" else belief.P
        use = slice(0, 2) if good else slice(1, 2)
        x, P = self._algebra.update(x, P, nu[use], H[use], np.diag(variance[use]))
        return replace(belief, x=x, P=P), innovations
