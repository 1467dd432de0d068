"""Roll and pitch as states of the filter: carried on by the gyro, levelled by the specific force that the model leaves.

    phi_dot   = p + (q sin phi + r cos phi) tan theta            p, q: rates less their bias (Fossen 2021, eq. 2.39)
    theta_dot = q cos phi - r sin phi                             r: the filter's own
    R_y(theta) R_x(phi) f = [a_x a_y -g]                          f: specific force less its bias

The autopilot's own roll and pitch follow the boat's acceleration (without GPS it levels on the apparent vertical, with
a time constant of 5 s); here the model's acceleration is taken out first. Only the start believes them, loosely.
"""

from __future__ import annotations

import math

import numpy as np

from companion.core.estimation.filter_state import B_TILT, TILT, R, Tilt


def level_jacobian(tilt: Tilt, x: float, y: float, z: float) -> np.ndarray:
    """Derivatives of the first two components of `frames.to_level` to phi, theta; shape (2, 2)."""
    cp, sp = math.cos(tilt.phi_rad), math.sin(tilt.phi_rad)
    ct, st = math.cos(tilt.theta_rad), math.sin(tilt.theta_rad)
    down, across = sp * y + cp * z, cp * y - sp * z
    return np.array([[st * across, ct * down - st * x], [-down, 0.0]])


def yaw_rate(tilt: Tilt, q_rad_s: float, r_rad_s: float) -> float:
    """psi_dot = (q sin phi + r cos phi) / cos theta [rad/s]."""
    return (q_rad_s * math.sin(tilt.phi_rad) + r_rad_s * math.cos(tilt.phi_rad)) / math.cos(tilt.theta_rad)


def advance_tilt(x: np.ndarray, F: np.ndarray, before: np.ndarray, pq_rad_s: tuple[float, float], dt_s: float) -> None:
    """Write roll and pitch after `dt_s` into x, and their rows into its Jacobian F; `before`: x at the beginning."""
    tilt, bias, r = Tilt(*before[TILT]), before[B_TILT], float(before[R])
    p, q = pq_rad_s[0] - bias[0], pq_rad_s[1] - bias[1]
    cp, sp, tt = math.cos(tilt.phi_rad), math.sin(tilt.phi_rad), math.tan(tilt.theta_rad)
    x[TILT] = before[TILT] + dt_s * np.array([p + (q * sp + r * cp) * tt, q * cp - r * sp])
    phi, theta = range(TILT.start, TILT.stop)
    F[phi, phi] = 1.0 + dt_s * (q * cp - r * sp) * tt
    F[phi, theta] = dt_s * (q * sp + r * cp) * (1.0 + tt**2)
    F[theta, phi] = -dt_s * (q * sp + r * cp)
    F[phi, R], F[theta, R] = dt_s * cp * tt, -dt_s * sp
    F[phi, B_TILT] = -dt_s, -dt_s * sp * tt
    F[theta, B_TILT] = 0.0, -dt_s * cp
