"""Motion in six degrees of freedom, by Kirchhoff's equations of linear and angular momentum (Fossen 2021, chapter 3).

    P = dT/dv, Q = dT/d omega, T = 1/2 nu_r^T M nu_r
    P_dot + omega x P = F,    Q_dot + omega x Q + v_r x P = K,    eta_dot = J(eta) nu

State: (north, east, psi, u, v, r, down, phi, theta, w, p, q), the first six as in the plane. Hull damping of the plane
acts at `drag_z`, all else at `thrust_z`; heave, roll and pitch have a spring and a damper each.
"""

from __future__ import annotations

from math import cos, sin, sqrt

import numpy as np

from tests.hidden.plant.hull import HullMotion
from tests.hidden.plant.world import G, World

PLANE = 6


class SixDof:
    """Rates of the twelve states for one world with `afloat`."""

    def __init__(self, world: World):
        h, a = world.hull, world.afloat
        assert a is not None
        self.a, self.sense, self.plane = a, world.sense, HullMotion(world)
        m, plane = h.m, self.plane
        I_x, I_y, m_w = m * a.k_x**2, m * a.k_y**2, 2.0 * m
        M = np.diag([plane.m11, plane.m22, m_w, I_x + m * a.z_g**2, I_y + m * a.z_g**2, plane.m33])
        for i, j, value in ((0, 4, m * a.z_g), (0, 5, plane.m13), (1, 3, -m * a.z_g), (1, 5, plane.m23),
                            (2, 3, m * h.y_g), (2, 4, -m * h.x_g)):  # fmt: skip
            M[i, j] = M[j, i] = value
        self.M, self.inverse = M.tolist(), np.linalg.inv(M).tolist()
        self.springs = (a.heave_N_m, m * G * a.GM_T, m * G * a.GM_L)
        self.dampers = [2 * a.zeta * sqrt(k * i) for k, i in zip(self.springs, (m_w, M[3, 3], M[4, 4]), strict=True)]

    def begin(self, start: tuple) -> tuple:
        """Twelve states, upright, from six."""
        return (*start, *(0.0,) * 6)

    def rate(self, s: tuple, tau: tuple, v_c: tuple, d: float) -> tuple:
        """d/dt of s; arguments as of HullMotion.rate."""
        _, _, psi, u, v, r, z, phi, theta, w, p, q = s
        c, sn = cos(psi), sin(psi)
        uc, vc = c * v_c[0] + sn * v_c[1], c * v_c[1] - sn * v_c[0]
        ur, vr = u - uc, v - vc
        nu = (ur, vr, w, p, q, r)
        P1, P2, P3, Q1, Q2, Q3 = (sum(a * b for a, b in zip(row, nu, strict=True) if a) for row in self.M)
        dx, dy, dn = self.plane.damping(ur, vr, r, d)
        kz, kp, kq = self.springs
        bz, bp, bq = self.dampers
        zt, zd = self.a.thrust_z, self.a.drag_z
        load = (
            tau[0] + dx - q * P3 + r * P2,
            tau[1] + dy - r * P1 + p * P3,
            -kz * z - bz * w - p * P2 + q * P1,
            -zt * tau[1] - zd * dy - kp * sin(phi) - bp * p - q * Q3 + r * Q2 - vr * P3 + w * P2,
            zt * tau[0] + zd * dx - kq * sin(theta) - bq * q - r * Q1 + p * Q3 - w * P1 + ur * P3,
            tau[2] + dn - p * Q2 + q * Q1 - ur * P2 + vr * P1,
        )
        u_dot, v_dot, w_dot, p_dot, q_dot, r_dot = (
            sum(a * b for a, b in zip(row, load, strict=True) if a) for row in self.inverse
        )
        cf, sf, ct, st = cos(phi), sin(phi), cos(theta), sin(theta)
        turn = q * sf + r * cf
        ahead, across = ct * u + st * (sf * v + cf * w), cf * v - sf * w
        return (
            c * ahead - sn * across, sn * ahead + c * across, turn / ct, u_dot + r * vc, v_dot - r * uc, r_dot,
            -st * u + ct * (sf * v + cf * w), p + turn * st / ct, q * cf - r * sf, w_dot, p_dot, q_dot,
        )  # fmt: skip

    def step(self, s: tuple, taus: tuple, v_c: tuple, d: float, h: float) -> tuple:
        """Midpoint rule over h seconds."""
        half = self.rate(s, taus[0], v_c, d)
        middle = tuple(a + h / 2 * b for a, b in zip(s, half, strict=True))
        rate = self.rate(middle, taus[1], v_c, d)
        return tuple(a + h * b for a, b in zip(s, rate, strict=True))

    def at_imu(self, s: tuple, rate: tuple) -> tuple:
        """Rates of the first six states, those of u and v as an IMU at its height takes them for the plane's."""
        (w, p, q), r, z = s[9:], s[5], self.a.sensor_z[0]
        x, y = self.sense.imu_x, self.sense.imu_y
        surge = rate[3] + q * w + z * (rate[11] + p * r) + q * (p * y - q * x)
        sway = rate[4] - p * w + z * (q * r - rate[10]) + p * (q * x - p * y)
        return (*rate[:3], surge, sway, rate[5])

    def under_tag(self, s: tuple) -> tuple:
        """The first six states, moved by what roll and pitch move the tag."""
        z, (phi, theta), c, sn = self.a.sensor_z[1], s[7:9], cos(s[2]), sin(s[2])
        ahead, across = z * sin(theta) * cos(phi), -z * sin(phi)
        return (s[0] + c * ahead - sn * across, s[1] + sn * ahead + c * across, *s[2:PLANE])
