"""What water, air, shore and the outside effects do to the hull at each step: force, velocity of the water, damping."""

from __future__ import annotations

import math
from math import atan2, cos, exp, hypot, radians, sin

import numpy as np

from tests.hidden.plant.world import BASIN_M, MIDDLE_M, STEP_S, G, World

RHO_AIR = 1.225
AMBIENT_TIME_S = 3.0
WAVE_SHAPE = (1.0, 1.5, 0.25)  # surge, sway, yaw [m] per newton of wave force
WAVE_TILT = (0.012, 0.008)  # roll, pitch [rad per N]
EDGE_M = 0.5
WALL_REACH_M = 4.0


def markov(n: int, tau_s: float, rng: np.random.Generator) -> np.ndarray:
    """Gauss-Markov noise of unit size at every step, shape (n,)."""
    decay = math.exp(-STEP_S / tau_s)
    noise = rng.standard_normal(n) * math.sqrt(1 - decay * decay)
    noise[0] = rng.standard_normal()
    out, value = np.empty(n), 0.0
    for i, e in enumerate(noise.tolist()):
        value = decay * value + e if i else e
        out[i] = value
    return out


class Surroundings:
    """Tables over time for one log of n steps that begins at `t0` on the common clock."""

    def __init__(self, world: World, n: int, t0: float, rng: np.random.Generator):
        self.world = world
        w = world.water
        t = t0 + np.arange(n) * STEP_S
        self.water = self._current(t)
        speed = np.full(n, w.V_w)
        if w.gustiness and w.gust_square:
            speed = w.V_w * (1 + w.gustiness * np.sign(markov(n, w.gust_square, rng)))
        elif w.gustiness:
            speed = np.maximum(0.0, w.V_w * (1 + w.gustiness * markov(n, w.gust_time, rng)))
        to = math.radians(w.beta_w_deg + 180)
        north = speed * math.cos(to) + w.ambient_V_w[0]
        east = speed * math.sin(to) + w.ambient_V_w[1]
        self.air = list(zip(north.tolist(), east.tolist(), strict=True)) if (north**2 + east**2).any() else []
        self.ambient = np.array([a * markov(n, AMBIENT_TIME_S, rng) for a in w.ambient_N]).T.tolist()
        self.wave, self.quadrature = _waves(world, t, rng) if w.wave_N else (np.zeros(n), np.zeros(n))
        self.wave_list = self.wave.tolist() if w.wave_N else []
        self.still = not (self.air or self.wave_list or w.tether_N_m or w.tether_form[0] or world.odd.wall
                          or world.odd.lift or world.odd.heading_drag[0] or any(w.ambient_N))  # fmt: skip

    def _current(self, t: np.ndarray) -> list[tuple[float, float]]:
        w = self.world.water
        beta = np.radians(w.beta_c_deg + w.turn_deg_s * t + w.swing[0] * np.sin(2 * np.pi * t / w.swing[1]))
        north, east = w.V_c * np.cos(beta) + w.ambient_V_c[0], w.V_c * np.sin(beta) + w.ambient_V_c[1]
        return list(zip(north.tolist(), east.tolist(), strict=True))

    def water_at(self, k: int, north: float, east: float) -> tuple[float, float]:
        """Velocity of the water (north, east) [m/s] where the boat is."""
        c = self.water[k]
        shear, gyre = self.world.water.shear, self.world.odd.gyre
        if shear:
            share = 1 + shear * (north - MIDDLE_M)
            c = (c[0] * share, c[1] * share)
        return (c[0] - gyre * (east - MIDDLE_M), c[1] + gyre * (north - MIDDLE_M)) if gyre else c

    def damping_at(self, north: float, east: float) -> float:
        """Factor on the damping: more over a shallow."""
        w = self.world.water
        if not w.shallow:
            return 1.0
        n0, e0, radius = w.shallow_at
        inside = n0 - north if w.shallow_strip else radius - hypot(north - n0, east - e0)
        return 1 + w.shallow / (1 + exp(-max(min(inside / EDGE_M, 50.0), -50.0)))

    def force(self, k: int, s: tuple, v_c: tuple[float, float]) -> tuple[float, float, float]:
        """Body force [N, N, N m] on a boat in state s = (north, east, psi, u, v, r) in water moving with v_c."""
        if self.still:
            return 0.0, 0.0, 0.0
        north, east, psi, u, v, _ = s
        c, sn = cos(psi), sin(psi)
        X, Y, N = self.ambient[k]
        if self.air:
            x, y, n = self._wind(self.air[k], c, sn, u, v)
            X, Y, N = X + x, Y + y, N + n
        if self.wave_list:
            a, rel = self.wave_list[k], radians(self.world.water.wave_from_deg + 180) - psi
            X += WAVE_SHAPE[0] * a * cos(rel)
            Y += WAVE_SHAPE[1] * a * sin(rel)
            N += WAVE_SHAPE[2] * a * sin(2 * rel)
        fn, fe, arm = self._pull(north, east, c, sn)
        x, y = c * fn + sn * fe, c * fe - sn * fn
        X, Y, N = X + x, Y + y, N + arm * y
        odd = self.world.odd
        if odd.lift or odd.heading_drag[0]:
            ur = u - c * v_c[0] - sn * v_c[1]
            Y += odd.lift * ur * abs(ur)
            N += 0.3 * odd.lift * ur * abs(ur)
            share, at = odd.heading_drag
            X += self.world.hull.X_uu * share * (1 + cos(psi - radians(at))) * ur * abs(ur)
        return X, Y, N

    def _wind(self, air: tuple, c: float, sn: float, u: float, v: float) -> tuple[float, float, float]:
        h, (c_x, c_y, c_n) = self.world.hull, self.world.water.c_wind
        u_rw, v_rw = u - c * air[0] - sn * air[1], v - c * air[1] + sn * air[0]
        speed2 = u_rw * u_rw + v_rw * v_rw
        gamma = -atan2(v_rw, u_rw)
        q = 0.5 * RHO_AIR * speed2
        return (
            -c_x * cos(gamma) * q * h.frontal,
            c_y * sin(gamma) * q * h.lateral,
            c_n * sin(2 * gamma) * q * h.lateral * h.length,
        )

    def _pull(self, north: float, east: float, c: float, sn: float) -> tuple[float, float, float]:
        """Tether and wall: force north, east [N] at body x = arm."""
        w = self.world.water
        fn = fe = arm = 0.0
        tension, slack = w.tether_form
        if w.tether_N_m or tension:
            n0, e0, arm = w.tether_at
            dn, de = n0 - north - c * arm, e0 - east - sn * arm
            away = max(hypot(dn, de), 1e-6)
            pull = (tension + w.tether_N_m * max(away - slack, 0.0)) / away
            fn, fe = pull * dn, pull * de
        if self.world.odd.wall:
            fe += self.world.odd.wall * exp(-max(BASIN_M - east, 0.0) / WALL_REACH_M)
        return fn, fe, arm


def _waves(world: World, t: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Wave force [N] of rms `wave_N` and its quadrature at times t: 40 sinusoids about the peak, random phases."""
    w = world.water
    lines = rng.normal(1.0, w.wave_band, 40)
    weight = rng.rayleigh(1.0, 40)
    if w.wave_second:
        second = rng.uniform(size=40) < w.wave_second
        lines = np.where(second, lines / 0.6, lines)
    omega = 2 * np.pi / w.wave_T * np.clip(lines, 0.4, 2.5)
    phase = omega[:, None] * t + rng.uniform(0, 2 * np.pi, 40)[:, None]
    size = w.wave_N / np.sqrt((weight**2).sum() / 2)
    return size * (weight @ np.sin(phase)), size * (weight @ np.cos(phase))


def tilt(world: World, surroundings: Surroundings, step: np.ndarray, psi: np.ndarray, accel: np.ndarray) -> tuple:
    """Roll and pitch [rad] at the given steps: waves, and heeling by acceleration (n, 2)."""
    rel = np.radians(world.water.wave_from_deg + 180) - psi
    q = surroundings.quadrature[step]
    phi = WAVE_TILT[0] * q * np.sin(rel) - 0.15 * accel[:, 1] / G
    theta = -WAVE_TILT[1] * q * np.cos(rel) + 0.10 * accel[:, 0] / G
    return phi, theta
