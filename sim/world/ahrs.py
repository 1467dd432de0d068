"""What an autopilot makes of its inertial sensors: low-pass filters, and roll and pitch by ArduPilot's DCM.

    phi, theta    carried on by the gyro, levelled on the apparent vertical of the last 0.2 s:
                  e = b x (0 0 -1), b the mean specific force, normed;    omega = gyro + K_P e + integral of K_I e
    sensors       second-order low-pass filters at INS_GYRO_FILTER and INS_ACCEL_FILTER

Without GPS this is the AHRS of a Rover that is armed: nothing tells it the boat's own acceleration, so that tilt
follows it with a time constant of 1 / K_P = 5 s. Disarmed, and with GPS, the real one uses EKF3, which errs less;
this one is the worst kind, always.

Source: ArduPilot 4.6, AP_AHRS_DCM.cpp (drift_correction) and LowPassFilter2p.cpp; gains are its defaults.
"""

from __future__ import annotations

import math

from companion.core.geometry.frames import ssa
from sim.world.autopilot import SensorFrame

Vec3 = tuple[float, float, float]

KP, KI = 0.2, 0.0087
CORRECTION_S, INTEGRAL_S = 0.2, 5.0
DRIFT_RAD_S2 = math.radians(0.5 / 60)
"""Fastest change of the integral, 0.5 deg/s a minute: what AP_AHRS_DCM allows a gyro to drift."""
SPIN_RAD_S = math.radians(20)
"""Above this spin rate the integral waits."""


class LowPass:
    """A second-order Butterworth filter of three axes, sampled at `rate_hz`; a cut-off of 0 lets all through.

    By the bilinear transform without prewarping: its delay, sqrt(2) / (2 pi f), is that of the firmware's, which runs
    at 1 kHz or more. Prewarped at 100 Hz, a filter of 20 Hz would be 9.7 ms late instead of 11.3.
    """

    def __init__(self, rate_hz: float):
        self._rate_hz = rate_hz
        self._cutoff_hz = -1.0
        self._b0 = self._a1 = self._a2 = 0.0
        self._memory: list[tuple[float, float]] | None = None

    def __call__(self, value: Vec3, cutoff_hz: float) -> Vec3:
        """The next sample, filtered; the first one settles it."""
        if cutoff_hz <= 0:
            return value
        if cutoff_hz != self._cutoff_hz:
            self._tune(cutoff_hz)
        if self._memory is None:
            rest = [v / (1.0 + self._a1 + self._a2) for v in value]
            self._memory = [(d, d) for d in rest]
        out = []
        for axis, (v, (d1, d2)) in enumerate(zip(value, self._memory, strict=True)):
            d0 = v - self._a1 * d1 - self._a2 * d2
            out.append(self._b0 * (d0 + 2.0 * d1 + d2))
            self._memory[axis] = d0, d1
        return out[0], out[1], out[2]

    def _tune(self, cutoff_hz: float) -> None:
        self._cutoff_hz, self._memory = cutoff_hz, None
        w = math.pi * cutoff_hz / self._rate_hz
        c = 1.0 + 2.0 * math.cos(math.pi / 4) * w + w * w
        self._b0, self._a1 = w * w / c, 2.0 * (w * w - 1.0) / c
        self._a2 = (1.0 - 2.0 * math.cos(math.pi / 4) * w + w * w) / c


class Ahrs:
    """State of filters and attitude; one `advance` every `period_s`. `tilt_rad`: roll and pitch, once there are any."""

    def __init__(self, period_s: float):
        self._period_s = period_s
        self._gyro, self._accel = LowPass(1.0 / period_s), LowPass(1.0 / period_s)
        self.tilt_rad: tuple[float, float] | None = None
        self._sum, self._sum_s = [0.0, 0.0, 0.0], 0.0
        self._P, self._I = [0.0, 0.0], [0.0, 0.0]
        self._waiting, self._waiting_s = [0.0, 0.0], 0.0

    def advance(self, raw: SensorFrame, gyro_filter_hz: float, accel_filter_hz: float) -> SensorFrame:
        """What the autopilot says of the sensors' next sample; of `raw`, roll and pitch are not used."""
        phi, theta = self._carry_on(raw.accel_m_s2, raw.gyro_rad_s)
        p, q, r = self._gyro(raw.gyro_rad_s, gyro_filter_hz)
        accel = self._accel(raw.accel_m_s2, accel_filter_hz)
        return SensorFrame(
            accel_m_s2=accel, gyro_rad_s=(p, q, r), phi_rad=phi, theta_rad=theta, psi_rad=ssa(raw.psi_rad),
            p_rad_s=p + self._I[0], q_rad_s=q + self._I[1], r_rad_s=r, gyro_drift_rad_s=(self._I[0], self._I[1], 0.0),
            voltage_v=raw.voltage_v, current_a=raw.current_a, receiver_us=raw.receiver_us, gnss=raw.gnss,
        )  # fmt: skip

    def _carry_on(self, accel: Vec3, gyro: Vec3) -> tuple[float, float]:
        """Roll and pitch one sample later."""
        if self.tilt_rad is None:  # a boat that is switched on levels at once
            self.tilt_rad = math.atan2(-accel[1], -accel[2]), math.atan2(accel[0], math.hypot(accel[1], accel[2]))
        phi, theta = self.tilt_rad
        p, q, r = gyro[0] + self._P[0] + self._I[0], gyro[1] + self._P[1] + self._I[1], gyro[2]
        cp, sp, ct, st = math.cos(phi), math.sin(phi), math.cos(theta), math.sin(theta)
        about_down = q * sp + r * cp
        self.tilt_rad = phi + self._period_s * (p + about_down * st / ct), theta + self._period_s * (q * cp - r * sp)
        down = sp * accel[1] + cp * accel[2]
        level = ct * accel[0] + st * down, cp * accel[1] - sp * accel[2], ct * down - st * accel[0]
        self._sum = [s + a for s, a in zip(self._sum, level, strict=True)]
        self._sum_s += self._period_s
        if self._sum_s >= CORRECTION_S - 1e-9:
            self._correct(math.sqrt(p * p + q * q + r * r))
        return self.tilt_rad

    def _correct(self, spin_rad_s: float) -> None:
        """Gains from the mean specific force since the last correction."""
        size = math.sqrt(sum(s * s for s in self._sum))
        error = [-self._sum[1] / size, self._sum[0] / size] if size else [0.0, 0.0]
        self._P = [KP * e for e in error]
        if spin_rad_s < SPIN_RAD_S:
            self._waiting = [w + KI * e * self._sum_s for w, e in zip(self._waiting, error, strict=True)]
            self._waiting_s += self._sum_s
        if self._waiting_s >= INTEGRAL_S:
            limit = DRIFT_RAD_S2 * self._waiting_s
            self._I = [i + max(-limit, min(limit, w)) for i, w in zip(self._I, self._waiting, strict=True)]
            self._waiting, self._waiting_s = [0.0, 0.0], 0.0
        self._sum, self._sum_s = [0.0, 0.0, 0.0], 0.0
