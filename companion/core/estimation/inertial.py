"""Measurement updates by the autopilot's sensors: accelerometer, gyro and heading.

IMU       [a_x a_y] at the lever arm, in level axes by the filter's own roll and pitch, plus biases; what roll and pitch
          do at its height is + q_dot z, - p_dot z, by the slopes of the rates
attitude  psi + psi_dot T + b_psi, where b_psi is the slow wander of the autopilot's own estimate, and psi_dot by its
          rates; heading has not passed the filters that make rates and specific force late by T (`sensors.inertial`)

Specific force and yaw rate have no gate: R of a number whose innovation exceeds the limit grows in proportion to it
(Huber 1964). Accelerometers that are noisier than the vessel file says count for less. Without a model of the motion
second differences show it, in which neither thrust nor waves do (white noise of variance v: 6 v):

    v' = v + dt / T (|a_k - 2 a_k-1 + a_k-2|^2 / 12 - v),     R = sigma^2 + 2 max(0, v - sigma^2)

2: a low-pass filter of 20 Hz, as `provision` sets it, takes half of that out of white noise sampled at 50 Hz.

The rates are those of ATTITUDE: the ones of RAW_IMU are cut to whole mrad/s.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.sensors import Imu
from companion.core.estimation.filter_state import (
    B_ACCEL,
    B_GYRO,
    B_PSI,
    DYNAMIC,
    LATENT_INDICES,
    TILT,
    AccelerometerNoise,
    FilterState,
    R,
    Result,
    innovation_message,
)
from companion.core.estimation.gates import judge
from companion.core.estimation.kalman import KalmanEquations
from companion.core.estimation.latent_activity import AFTER_GAP, UNKNOWN, log_variances, update_activity
from companion.core.estimation.process import Process, at_rest
from companion.core.estimation.ranging.ranges import inflate
from companion.core.estimation.tilt import level_jacobian, yaw_rate
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.geometry.frames import ssa, to_level
from companion.core.messages import Attitude, ImuSample
from companion.core.sensors.inertial import OfTheImu

SHORTEST_S = 0.005
"""Two attitudes closer than that give no slope of the rates; assumed: a quarter of the period at 50 Hz."""
MOST_SLOPE_RAD_S2 = 15.0
"""Of roll and pitch rates, which no gate judges; more is a glitch. Assumed: a roll of 15 degrees and 1 s has 10."""
NOISE_MEAN_S, THROUGH_FILTER = 2.0, 2.0
"""T, and the filter's factor, both above. Assumed; measured: 1.4 in sigma."""


def _since_s(before_ns: int | None, t_ns: int) -> float:
    """Time since the sample before [s]; at the first one infinite."""
    return math.inf if before_ns is None else max(0.0, (t_ns - before_ns) * 1e-9)


class Inertial:
    """Constant parts of the IMU and attitude equations; the methods are pure."""

    def __init__(self, process: Process, imu: Imu, tuning: EstimatorTuning, algebra: KalmanEquations):
        self._process, self._algebra, self._tuning = process, algebra, tuning
        self._z_m = imu.z_m
        self._accel_R = np.square([imu.accel_sigma_m_s2, imu.accel_sigma_m_s2])
        self._attitude_R = np.square([imu.heading_sigma_rad, imu.gyro_sigma_rad_s])

    def fuse_imu(self, belief: FilterState, m: ImuSample) -> Result:
        """One update by a_x, a_y. At the first one, and after a gap, the latent force may be any wave's.

        Until speed is known, the slope of drag is that at rest (`process.at_rest`), as in the prediction.
        """
        since_s = _since_s(belief.imu_ns, belief.t_ns)
        if since_s > self._tuning.imu_timeout_s:
            activity = UNKNOWN if belief.imu_ns is None else AFTER_GAP
            sigma = self._tuning.lively_sigma * np.exp(np.divide(log_variances(activity), 2))
            belief = replace(belief, P=inflate(belief.P, LATENT_INDICES, sigma), activity=activity)
        drive = self._process.drive(belief.f_n)
        expected, J = self._process.acceleration(belief.x[DYNAMIC], drive)
        belief = replace(belief, accelerometers=self._noise_of(belief, m, since_s))
        noise = np.diag(self._accel_R + THROUGH_FILTER * np.maximum(0, belief.accelerometers.variance - self._accel_R))
        if belief.is_settling(self._tuning.settle_most_s):
            J = self._process.acceleration(at_rest(belief.x[DYNAMIC]), drive)[1]
        tilt, force = belief.tilt, (m.ax_m_s2, m.ay_m_s2, m.az_m_s2)
        p_dot, q_dot, _ = belief.slopes_rad_s2
        expected = expected + np.array([q_dot, -p_dot]) * self._z_m
        nu = np.array(to_level(*tilt, *force)[:2]) - expected - belief.x[B_ACCEL]
        H = np.zeros((2, len(belief.x)))
        H[:, DYNAMIC] = J
        H[:, B_ACCEL] = np.eye(2)
        H[:, TILT] = -level_jacobian(tilt, *force)
        S = H @ belief.P @ H.T + noise
        z = nu / np.sqrt(np.diag(S))
        surprise = np.abs(z) / self._tuning.imu_limit
        wider = np.sqrt(np.maximum(surprise, 1.0))
        x, P = self._algebra.update(belief.x, belief.P, nu, H, noise * np.outer(wider, wider))
        innovation = innovation_message(belief.t_ns, "imu", nu, S, bool((surprise <= 1.0).all()))
        activity = update_activity(belief.activity, (0, 1), z.tolist(), 0.0 if math.isinf(since_s) else since_s)
        return replace(belief, x=x, P=P, imu_ns=belief.t_ns, activity=activity), (innovation,)

    def _noise_of(self, belief: FilterState, m: ImuSample, dt_s: float) -> AccelerometerNoise:
        """How noisy accelerometers are with this sample, v above; over a gap differences say nothing."""
        variance, last = belief.accelerometers
        last = (*last, (m.ax_m_s2, m.ay_m_s2)) if dt_s <= self._tuning.imu_timeout_s else ()
        if len(last) == 3:
            second = np.subtract(last[2], last[1]) - np.subtract(last[1], last[0])
            variance += min(1.0, dt_s / NOISE_MEAN_S) * (float(second @ second) / 12 - variance)
        return AccelerometerNoise(variance, last[-2:])

    def _level(self, belief: FilterState, m: Attitude) -> FilterState:
        """One update by the autopilot's roll and pitch."""
        H = np.zeros((2, len(belief.x)))
        H[:, TILT] = np.eye(2)
        R = np.diag([self._tuning.ahrs_tilt_sigma_rad**2] * 2)
        nu = np.array([m.phi_rad, m.theta_rad]) - belief.x[TILT]
        x, P = self._algebra.update(belief.x, belief.P, nu, H, R)
        return replace(belief, x=x, P=P)

    def fuse_attitude(self, belief: FilterState, m: Attitude) -> Result:
        """One update by heading and yaw rate. Of roll and pitch only the rates count, but for the first after a gap."""
        dt_s, hold_s = _since_s(belief.rates_ns, belief.t_ns), self._tuning.rates_hold_s
        if dt_s > hold_s:
            belief = self._level(belief, m)
        rates, slopes = (m.p_rad_s, m.q_rad_s, m.r_rad_s), (0.0, 0.0, 0.0)
        if dt_s <= hold_s:
            last, change = np.array(belief.rates_rad_s), MOST_SLOPE_RAD_S2 * dt_s
            most = np.array([change, change, math.inf])
            rates = tuple(np.clip(rates, last - most, last + most).tolist())
            slopes = tuple((np.subtract(rates, last) / dt_s).tolist()) if dt_s >= SHORTEST_S else slopes
        belief = replace(belief, rates_rad_s=rates, rates_ns=belief.t_ns, slopes_rad_s2=slopes)
        rate, late_s = yaw_rate(belief.tilt, rates[1], m.r_rad_s), OfTheImu.latency_s
        x, has_heading = belief.x, not math.isnan(m.psi_rad)  # a heading that was left out is none
        heading = ssa(m.psi_rad - x[2] - late_s * x[R] - x[B_PSI]) if has_heading else 0.0
        nu = np.array([heading, rate - x[R] - x[B_GYRO]])
        H = np.zeros((2, len(x)))
        H[0, 2] = H[0, B_PSI] = H[1, R] = H[1, B_GYRO] = 1.0
        H[0, R] = late_s
        S = H @ belief.P @ H.T + np.diag(self._attitude_R)
        verdict, gate = "rejected", belief.heading_gate
        if has_heading:
            verdict, gate = judge(gate, self._tuning.heading_gate, belief.t_ns, float(nu[0]), math.sqrt(S[0, 0]))
        good, z = verdict != "rejected", float(nu[1]) / math.sqrt(S[1, 1])
        belief = replace(belief, heading_gate=gate, activity=update_activity(belief.activity, (2,), (z,), dt_s))
        surprise = abs(z) / self._tuning.imu_limit
        variance = self._attitude_R * (1.0, max(surprise, 1.0))
        innovations = (
            innovation_message(belief.t_ns, "heading", nu[:1], S[:1, :1], good),
            innovation_message(belief.t_ns, "yaw rate", nu[1:], S[1:, 1:], surprise <= 1.0),
        )
        P = inflate(belief.P, (2,), abs(float(nu[0]))) if verdict == "reopened" else belief.P
        use = slice(0, 2) if good else slice(1, 2)
        x, P = self._algebra.update(x, P, nu[use], H[use], np.diag(variance[use]))
        return replace(belief, x=x, P=P), innovations
