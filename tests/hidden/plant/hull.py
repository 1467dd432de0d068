"""Motion of the hull, written from Fossen's vector form, component by component.

    M nu_r_dot + C(nu_r) nu_r + D(nu_r) nu_r = tau,   nu_r = nu - R(psi)^T v_c,   eta_dot = R(psi) nu

The water's velocity v_c is held over a step; its rate of change is neglected.
"""

from __future__ import annotations

from math import cos, sin, sqrt

from tests.hidden.plant.world import World

RHO = 1000.0
_GAUSS = ((0.8611363116, 0.3478548451), (0.3399810436, 0.6521451549))
HULLS_SEEN = 1.5  # two hulls, half shielded


class HullMotion:
    """Rates of (north, east, psi, u, v, r) for one world."""

    def __init__(self, world: World):
        h = world.hull
        self.h = h
        self.m11, self.m22 = h.m - h.X_udot, h.m - h.Y_vdot
        self.m13, self.m23 = -h.m * h.y_g, h.m * h.x_g - h.Y_rdot
        self.m33 = h.I_z + h.m * (h.x_g**2 + h.y_g**2) - h.N_rdot
        a, b, c, d, e = self.m11, self.m22, self.m33, self.m13, self.m23
        det = a * (b * c - e * e) - d * d * b
        self.inverse = ((b * c - e * e) / det, d * e / det, -d * b / det,
                        (a * c - d * d) / det, -a * e / det, a * b / det)  # fmt: skip
        self.plain = h.cross_flow == 0 and h.munk == 0 and h.extra[0] == 0
        half = h.length / 2
        nodes = [(s * x * half, w * half) for x, w in _GAUSS for s in (1, -1)]
        share = 0.5 * RHO * h.cross_flow * h.draft * HULLS_SEEN
        self.strips = [(x, share * w * (h.cross_flow_aft if x < 0 else 1.0)) for x, w in nodes]

    def begin(self, start: tuple) -> tuple:
        """The state in which a log begins."""
        return start

    def at_imu(self, s: tuple, rate: tuple) -> tuple:
        """Rates that an IMU sees."""
        return rate

    def under_tag(self, s: tuple) -> tuple:
        """State from which the tag's place follows."""
        return s

    def energy(self, u: float, v: float, r: float) -> float:
        """Kinetic energy [J] of hull and added mass in still water."""
        return 0.5 * (self.m11 * u * u + self.m22 * v * v + self.m33 * r * r) + (self.m13 * u + self.m23 * v) * r

    def rate(self, s: tuple, tau: tuple, v_c: tuple, d: float) -> tuple:
        """d/dt of s = (north, east, psi, u, v, r); tau [N, N, N m], water (north, east) [m/s], damping times d."""
        _, _, psi, u, v, r = s
        c, sn = cos(psi), sin(psi)
        uc, vc = c * v_c[0] + sn * v_c[1], c * v_c[1] - sn * v_c[0]
        ur, vr = u - uc, v - vc
        p1, p2 = self.m11 * ur + self.m13 * r, self.m22 * vr + self.m23 * r
        dx, dy, dn = self.damping(ur, vr, r, d)
        fx, fy, fn = tau[0] + p2 * r + dx, tau[1] - p1 * r + dy, tau[2] + p1 * vr - p2 * ur + dn
        i11, i12, i13, i22, i23, i33 = self.inverse
        return (
            c * u - sn * v,
            sn * u + c * v,
            r,
            i11 * fx + i12 * fy + i13 * fn + r * vc,
            i12 * fx + i22 * fy + i23 * fn - r * uc,
            i13 * fx + i23 * fy + i33 * fn,
        )

    def damping(self, u: float, v: float, r: float, d: float) -> tuple[float, float, float]:
        """Force and moment [N, N, N m] of the water at u, v, r through it; the file's damping times d."""
        h = self.h
        x = d * (h.X_u + h.X_uu * abs(u)) * u
        y = d * ((h.Y_v + h.Y_vv * abs(v)) * v + h.Y_r * r)
        n = d * ((h.N_r + h.N_rr * abs(r)) * r + h.N_v * v)
        if self.plain:
            return x, y, n
        more = self._extra(u, v, r)
        return x + more[0], y + more[1], n + more[2]

    def _extra(self, u: float, v: float, r: float) -> tuple[float, float, float]:
        """Cross-flow strips, Munk moment, the hull-fouling variant."""
        h = self.h
        x_force = y_force = 0.0
        moment = h.munk * u * v / (1 + h.munk_fade * sqrt(u * u + v * v))
        if h.cross_flow:
            for x, k in self.strips:
                w = v + x * r
                f = -k * abs(w) * w
                y_force += f
                moment += x * f
        share, power = h.extra
        if share:
            x_force += share * h.X_uu * abs(u) ** (power - 1) * u
            y_force += share * h.Y_vv * abs(v) ** (power - 1) * v
            moment += share * h.N_rr * abs(r) ** (power - 1) * r
        return x_force, y_force, moment

    def step(self, s: tuple, taus: tuple, v_c: tuple, d: float, h: float) -> tuple:
        """Runge-Kutta 4 over h seconds; `taus` at its begin, middle and end."""
        k1 = self.rate(s, taus[0], v_c, d)
        k2 = self.rate(_along(s, k1, h / 2), taus[1], v_c, d)
        k3 = self.rate(_along(s, k2, h / 2), taus[1], v_c, d)
        k4 = self.rate(_along(s, k3, h), taus[2], v_c, d)
        g = h / 6
        return (
            s[0] + g * (k1[0] + 2 * (k2[0] + k3[0]) + k4[0]),
            s[1] + g * (k1[1] + 2 * (k2[1] + k3[1]) + k4[1]),
            s[2] + g * (k1[2] + 2 * (k2[2] + k3[2]) + k4[2]),
            s[3] + g * (k1[3] + 2 * (k2[3] + k3[3]) + k4[3]),
            s[4] + g * (k1[4] + 2 * (k2[4] + k3[4]) + k4[4]),
            s[5] + g * (k1[5] + 2 * (k2[5] + k3[5]) + k4[5]),
        )


def _along(s: tuple, k: tuple, h: float) -> tuple:
    return (s[0] + h * k[0], s[1] + h * k[1], s[2] + h * k[2], s[3] + h * k[3], s[4] + h * k[4], s[5] + h * k[5])
