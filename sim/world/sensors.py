"""Simulated measurements of a motion: noise, bias, wander, outliers, dropouts, all from a seed.

IMU       a = nu_dot + omega x nu at the IMU's place, minus gravity, tilted by roll and pitch; white noise per
          sample, a bias drawn at start that walks
attitude  true heading + slow Gauss-Markov wander (compass and autopilot filter) + white noise
UWB       |tag - anchor| + bias per anchor + white noise; at random an anchor is silent or reads far (NLOS)

Errors that the vessel file knows of (`companion.core.model.sensor_errors`) come first, noise and drawn biases on top.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from msgspec import Meta

from companion.core.configuration.sensors import Imu, Uwb
from companion.core.configuration.site_file import Anchor
from companion.core.constants import GRAVITY_M_S2
from companion.core.geometry.frames import point_acceleration, point_position, wrapped
from companion.core.model.sensor_errors import (
    apply_heading_errors,
    apply_imu_errors,
    apply_uwb_scale,
    arrival_time_ns,
    out_of_sight,
)
from sim.world.environment import Moment
from sim.world.plant import Motion
from sim.world_limits import FAR_READING_M

TILT_SIGMA_RAD = 0.002  # noise of the autopilot's roll and pitch; assumed


@dataclass(frozen=True)
class UwbFaults:
    """Chances per range: silent, or non-line-of-sight with an extra path of up to `nlos_m`."""

    dropout: Annotated[float, Meta(ge=0, le=1)] = 0.0
    nlos: Annotated[float, Meta(ge=0, le=1)] = 0.0
    nlos_m: Annotated[float, Meta(ge=0, le=FAR_READING_M)] = 3.0


@dataclass(frozen=True)
class ImuReading:
    """Specific force [m/s^2], rates [rad/s] and attitude [rad] as the autopilot holds them."""

    accel_m_s2: tuple[float, float, float]
    gyro_rad_s: tuple[float, float, float]
    phi_rad: float
    theta_rad: float
    psi_rad: float


def body_rates(psi_dot_rad_s: float, moment: Moment) -> tuple[float, float, float]:
    """p, q, r [rad/s] of a hull that yaws while waves roll and pitch it (Fossen 2021, eq. 2.39 inverted)."""
    phi, theta = moment.phi_rad, moment.theta_rad
    phi_dot, theta_dot = moment.tilt_rate_rad_s
    across, down = psi_dot_rad_s * math.cos(theta) * math.sin(phi), psi_dot_rad_s * math.cos(theta) * math.cos(phi)
    return (
        phi_dot - psi_dot_rad_s * math.sin(theta),
        theta_dot * math.cos(phi) + across,
        down - theta_dot * math.sin(phi),
    )


def specific_force(imu: Imu, motion: Motion, moment: Moment) -> np.ndarray:
    """What a perfect accelerometer at the IMU's place measures [m/s^2], body axes, shape (3,)."""
    a_x, a_y = point_acceleration(motion.x[3:6], motion.nu_dot, (imu.x_m, imu.y_m))
    phi, theta = moment.phi_rad, moment.theta_rad
    roll, pitch = moment.tilt_rate_rad_s2  # what roll and pitch do at the IMU's height above the waterline
    a_x, a_y = a_x + pitch * imu.z_m, a_y - roll * imu.z_m
    down = -GRAVITY_M_S2 * np.cos(theta)
    return np.array([a_x + GRAVITY_M_S2 * np.sin(theta), a_y + down * np.sin(phi), down * np.cos(phi)])


class ImuSensor:
    """IMU and attitude of the autopilot, sampled at the file's rate."""

    def __init__(self, imu: Imu, rng: np.random.Generator):
        self._imu, self._rng = imu, rng
        self.period_ns = round(1e9 / imu.rate_Hz)
        self._accel_bias = rng.normal(0, imu.accel_bias_sigma_m_s2, 3)
        self._gyro_bias = rng.normal(0, imu.gyro_bias_sigma_rad_s, 3)
        self._wander = rng.normal(0, imu.heading_wander_sigma_rad)

    def measure(self, motion: Motion, moment: Moment, period_ns: int | None = None) -> ImuReading:
        """One sample, `period_ns` after the last; noise has the density that the file's has at the file's rate."""
        imu, rng, dt = self._imu, self._rng, (period_ns or self.period_ns) * 1e-9
        white = math.sqrt(self.period_ns * 1e-9 / dt)
        self._accel_bias += rng.normal(0, imu.accel_bias_walk_m_s2_sqrt_s * np.sqrt(dt), 3)
        self._gyro_bias += rng.normal(0, imu.gyro_bias_walk_rad_s_sqrt_s * np.sqrt(dt), 3)
        decay = np.exp(-dt / imu.heading_wander_time_s)
        self._wander = decay * self._wander + imu.heading_wander_sigma_rad * np.sqrt(1 - decay**2) * rng.normal()
        phi, theta = moment.phi_rad, moment.theta_rad
        p, q, r = body_rates(float(motion.x[5]), moment)
        force = specific_force(imu, motion, moment)
        force[0], force[1], rate = apply_imu_errors(imu, force[0], force[1], r)
        accel = force + self._accel_bias + rng.normal(0, imu.accel_sigma_m_s2 * white, 3)
        gyro = np.array([p, q, rate]) + self._gyro_bias + rng.normal(0, imu.gyro_sigma_rad_s * white, 3)
        tilt = rng.normal(0, TILT_SIGMA_RAD, 2)
        psi = apply_heading_errors(imu, motion.x[2]) + self._wander + rng.normal(0, imu.heading_sigma_rad)
        return ImuReading(
            (float(accel[0]), float(accel[1]), float(accel[2])),
            (float(gyro[0]), float(gyro[1]), float(gyro[2])),
            float(phi + tilt[0]),
            float(theta + tilt[1]),
            float(wrapped(psi)),
        )


class UwbSensor:
    """Ranges from one tag to the site's anchors."""

    def __init__(self, uwb: Uwb, anchors: Sequence[Anchor], faults: UwbFaults, rng: np.random.Generator):
        self._uwb, self._anchors, self.faults, self._rng = uwb, anchors, faults, rng
        self._zero_ns: int | None = None
        self._hidden = hidden_anchor(uwb, anchors)
        self._bias = rng.normal(0, uwb.range_bias_sigma_m, len(anchors))

    def tag_position(self, x: np.ndarray) -> np.ndarray:
        """Where the tag appears to be in NED [m], (3,): its place, but for the file's `scale`."""
        uwb = self._uwb
        return np.array([*apply_uwb_scale(uwb, *point_position(x, (uwb.x_m, uwb.y_m))), uwb.z_m])

    def arrival_ns(self, t_ns: int) -> int:
        """When the bytes of what is measured at `t_ns` arrive; the first call sets the start of a drift."""
        self._zero_ns = t_ns if self._zero_ns is None else self._zero_ns
        return arrival_time_ns(self._uwb, t_ns, self._zero_ns)

    def measure(self, motion: Motion) -> dict[str, float | None]:
        """Range [m] by anchor; None where the anchor stayed silent."""
        tag, rng, faults = self.tag_position(motion.x), self._rng, self.faults
        if self._hidden and rng.uniform() < self._uwb.nlos_share:
            anchor, extra_m = (self._hidden.north_m, self._hidden.east_m), rng.exponential(self._uwb.nlos_extra_m)
            tag[:2] = out_of_sight(anchor, tag[0], tag[1], extra_m)
        noise = rng.normal(0, self._uwb.range_sigma_m, len(self._anchors))
        silent = rng.uniform(size=len(self._anchors)) < faults.dropout
        far = rng.uniform(size=len(self._anchors)) < faults.nlos
        extra = rng.uniform(0.3, 1.0, len(self._anchors)) * faults.nlos_m
        ranges: dict[str, float | None] = {}
        for i, a in enumerate(self._anchors):
            distance = float(np.linalg.norm(tag - (a.north_m, a.east_m, a.down_m)))
            reading = distance + self._bias[i] + noise[i] + far[i] * extra[i]
            ranges[a.id] = None if silent[i] else max(0.0, float(reading))
        return ranges

    def fix(self, ranges: dict[str, float | None]) -> tuple[float, float, float] | None:
        """The tag's own position from what it measured, in the ENU frame of its anchors [m].

        Horizontal Gauss-Newton at the tag's known height, from the anchors' middle; None with fewer than 3.
        """
        measured_by = [(a, r) for a in self._anchors if (r := ranges[a.id]) is not None]
        if len(measured_by) < 3:
            return None
        places = np.array([(a.north_m, a.east_m) for a, _ in measured_by])
        height2 = np.array([(a.down_m - self._uwb.z_m) ** 2 for a, _ in measured_by])
        measured = np.array([r for _, r in measured_by])
        p = places.mean(axis=0)
        for _ in range(8):
            away = p - places
            distance = np.sqrt((away**2).sum(axis=1) + height2)
            p = p + np.linalg.lstsq(away / distance[:, None], measured - distance, rcond=None)[0]
        return float(p[1]), float(p[0]), -self._uwb.z_m


def hidden_anchor(uwb: Uwb, anchors: Sequence[Anchor]) -> Anchor | None:
    """The anchor out of sight: by its id, with or without leading zeros, else by its number among them.

    None where the file or the site has none.
    """
    if not uwb.nlos_share:
        return None
    named = {str(i): a for i, a in enumerate(anchors)}
    named |= {a.id.lstrip("0"): a for a in anchors} | {a.id: a for a in anchors}
    return named.get(uwb.nlos_anchor)
