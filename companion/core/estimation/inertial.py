"""Measurement updates by the autopilot's sensors: IMU and heading.

IMU      [a_x a_y r] at the lever arm, in level axes, plus biases  (process.imu)
heading  psi + b_psi, where b_psi is the slow wander of the autopilot's own estimate
"""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import Imu
from companion.core.constants import GRAVITY_M_S2
from companion.core.estimation.filter_state import (
    B_PSI,
    DYNAMIC,
    IMU_BIAS,
    FilterState,
    Result,
    Tilt,
    innovation_message,
)
from companion.core.estimation.gates import judge
from companion.core.estimation.kalman import KalmanEquations
from companion.core.estimation.process import Process
from companion.core.estimation.ranging.ranges import inflate
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.geometry.frames import ssa
from companion.core.messages import Attitude, ImuSample


def to_level_axes(tilt: Tilt, x: float, y: float, z: float) -> tuple[float, float, float]:
    """R_y(theta) R_x(phi) [x y z]: body components to level axes that keep the heading."""
    cp, sp = math.cos(tilt.phi_rad), math.sin(tilt.phi_rad)
    ct, st = math.cos(tilt.theta_rad), math.sin(tilt.theta_rad)
    down = sp * y + cp * z
    return ct * x + st * down, cp * y - sp * z, ct * down - st * x


class Inertial:
    """Constant parts of the IMU and heading equations; the methods are pure."""

    def __init__(self, process: Process, imu: Imu, tuning: EstimatorTuning, algebra: KalmanEquations):
        self._process, self._algebra, self._tuning = process, algebra, tuning
        accel = math.hypot(imu.accel_sigma_m_s2, GRAVITY_M_S2 * tuning.tilt_sigma_rad)
        self._imu_R = np.square([accel, accel, imu.gyro_sigma_rad_s])
        self._heading_R = np.array([[imu.heading_sigma_rad**2]])

    def fuse_imu(self, belief: FilterState, m: ImuSample) -> Result:
        """One update by a_x, a_y, r. R of an axis whose innovation exceeds the limit grows with nu^2."""
        expected, J = self._process.imu(belief.x[DYNAMIC], self._process.drive(belief.f_n))
        a_x, a_y, _ = to_level_axes(belief.tilt, m.ax_m_s2, m.ay_m_s2, m.az_m_s2)
        nu = np.array([a_x, a_y, m.r_rad_s]) - expected
        nu -= belief.x[IMU_BIAS]
        H = np.zeros((3, len(belief.x)))
        H[:, DYNAMIC] = J
        H[:, IMU_BIAS] = np.eye(3)
        HPH = H @ belief.P @ H.T
        surprise = nu**2 / (np.diag(HPH) + self._imu_R) / self._tuning.imu_limit**2
        S = HPH + np.diag(self._imu_R)
        x, P = self._algebra.update(belief.x, belief.P, nu, H, np.diag(self._imu_R * np.maximum(surprise, 1.0)))
        innovation = innovation_message(belief.t_ns, "imu", nu, S, bool((surprise <= 1.0).all()))
        return replace(belief, x=x, P=P, imu_ns=belief.t_ns), (innovation,)

    def fuse_heading(self, belief: FilterState, m: Attitude) -> Result:
        """One update by the autopilot's heading; roll and pitch are taken as exact."""
        belief = replace(belief, tilt=Tilt(m.phi_rad, m.theta_rad))
        nu = np.array([ssa(m.psi_rad - belief.x[2] - belief.x[B_PSI])])
        H = np.zeros((1, len(belief.x)))
        H[0, 2] = H[0, B_PSI] = 1.0
        S = H @ belief.P @ H.T + self._heading_R
        verdict, gate = judge(
            belief.heading_gate, self._tuning.heading_gate, belief.t_ns, float(nu[0]), math.sqrt(S[0, 0])
        )
        belief = replace(belief, heading_gate=gate)
        innovations = (innovation_message(belief.t_ns, "heading", nu, S, verdict != "rejected"),)
        if verdict == "rejected":
            return belief, innovations
        P = inflate(belief.P, (2,), abs(float(nu[0]))) if verdict == "reopened" else belief.P
        x, P = self._algebra.update(belief.x, P, nu, H, self._heading_R)
        return replace(belief, x=x, P=P), innovations
