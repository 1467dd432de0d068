"""Pulse widths to forces: dead time, rotor map, lag, battery; and the way back for the pilot."""

from __future__ import annotations

from collections import deque
from math import cos, exp, inf, radians, sin, sqrt

import numpy as np

from tests.hidden.plant.world import STEP_S, Curve, Drive, Thruster, World

FORCE_OF_WASH_N = 30.0


def bollard(d: Drive, t: Thruster, pwm: float, V: float) -> float:
    """Steady force [N] of thruster t alone at pulse width `pwm` [us] and battery V, without what varies in time."""
    if d.quantum_us:
        pwm = round(pwm / d.quantum_us) * d.quantum_us
    c = min(max((pwm - t.trim_us - 1500.0) / 400.0, -1.0), 1.0)
    e = abs(c) - d.dead_band_us / 400.0
    if d.soft_us:
        w = d.soft_us / 400.0
        e = (e + sqrt(e * e + w * w)) / 2 - 0.5 * (sqrt((d.dead_band_us / 400.0) ** 2 + w * w) - d.dead_band_us / 400.0)
    if e <= 0.0:
        return 0.0
    e *= 1 + (d.bend[0] if c > 0 else d.bend[1]) * (1 - e)
    curve: Curve = d.ahead if c > 0 else d.astern
    n = (V / d.V_ref) ** (curve.a0 + curve.a1 * e) * (curve.c1 * e**curve.q + curve.c2 * e * e)
    gain = t.gain if t.gain_small is None else t.gain_small + (t.gain - t.gain_small) * e
    force = gain * d.common * curve.k * n * n
    if d.voltage_exponent:
        force *= (V / d.V_nominal) ** d.voltage_exponent
    return force if c > 0 else -force * (d.astern_gain - d.astern_bend * e)


class Propulsion:
    """State of ESCs, rotors and battery. `command` gives pulse widths, `advance` moves on by one step."""

    def __init__(self, world: World, rng: np.random.Generator):
        d = world.drive
        self.d, self.odd, self.rng = d, world.odd, rng
        n = len(d.thrusters)
        self.force, self.inner = [0.0] * n, [0.0] * n
        self.pwm, self.slewed, self.held = [1500.0] * n, [1500.0] * n, [1500.0] * n
        self.queue: deque[tuple[int, list[float]]] = deque()
        self.charge_Ah, self.V = 0.0, d.open_V - d.R_ohm * d.hotel_A
        self.grow, self.grow_half = 1 - exp(-STEP_S / d.lag), 1 - exp(-STEP_S / 2 / d.lag)
        self.grow_2 = 1 - exp(-STEP_S / d.lag_2) if d.lag_2 else 1.0
        angles = [radians(t.azimuth_deg) for t in d.thrusters]
        self.axis = [(cos(a), sin(a), t.x * sin(a) - t.y * cos(a), t.x, t.y)
                     for a, t in zip(angles, d.thrusters, strict=True)]  # fmt: skip
        ts = d.thrusters
        self.behind = [(i, j) for i in range(n) for j in range(n) if ts[i].y * ts[j].y > 0 and ts[i].x > ts[j].x]
        self.body = (0.0, 0.0, 0.0)
        self.couples = bool(d.advance or d.advance_square or d.wash or d.wash_root or world.odd.interaction[2])

    def command(self, k: int, pwm: list[float]) -> None:
        """Pulse widths [us] that leave at step k."""
        wait = self.d.dead_time
        if self.d.jitter:
            wait *= 1 + self.rng.uniform(-self.d.jitter, self.d.jitter)
        self.queue.append((max(k + round(wait / STEP_S), self.queue[-1][0] if self.queue else 0), pwm))

    def advance(self, k: int, t: float, nu_r: tuple, V: float | None = None) -> tuple:
        """Body forces at begin, middle and end of step k; t on the common clock, `V` where the battery is known."""
        while self.queue and self.queue[0][0] <= k:
            self.pwm = self.queue.popleft()[1]
        seen = self._at_the_esc()
        V = self.V if V is None else V
        d = self.d
        begin, middle, end = self.force, [], []
        for i, thruster in enumerate(d.thrusters):
            aim = bollard(d, thruster, seen[d.wire[i]], V) * self._share(i, t)
            f = begin[i]
            if d.lag_2:
                self.inner[i] += (aim - self.inner[i]) * self.grow_2
                aim = self.inner[i]
            if d.rate < inf:
                most = d.rate * STEP_S
                middle.append(f + min(max((aim - f) * self.grow_half, -most / 2), most / 2))
                end.append(f + min(max((aim - f) * self.grow, -most), most))
            else:
                middle.append(f + (aim - f) * self.grow_half)
                end.append(f + (aim - f) * self.grow)
        self.force = end
        self._drain(end)
        first, self.body = self.body, self._body(end, nu_r)
        return first, self._body(middle, nu_r), self.body

    def _share(self, i: int, t: float) -> float:
        share = 1.0
        foul = self.d.fouling
        if foul is not None and foul.index == i and t >= foul.t_on:
            grown = min(1.0, (t - foul.t_on) / foul.ramp) if foul.ramp else 1.0
            if foul.beat and ((t - foul.t_on) // foul.beat) % 2:
                grown = 0.0
            share *= 1 - (1 - foul.gain) * grown
        a, period = self.odd.oscillation
        if a:
            share *= 1 + a * sin(6.283185307 * t / period)
        slope, above = self.odd.throttle
        if slope:
            share *= max(0.3, 1 - slope * max(0.0, sum(map(abs, self.force)) - above) / 100.0)
        return share

    def _at_the_esc(self) -> list[float]:
        """Commands after slew limit and backlash."""
        pwm = self.pwm
        if self.d.rate_pwm < inf:
            most = self.d.rate_pwm * STEP_S
            self.slewed = [s + min(max(p - s, -most), most) for s, p in zip(self.slewed, pwm, strict=True)]
            pwm = self.slewed
        if self.odd.backlash_us:
            b = self.odd.backlash_us
            self.held = [min(max(h, p - b), p + b) for h, p in zip(self.held, pwm, strict=True)]
            pwm = self.held
        return pwm

    def _drain(self, force: list[float]) -> None:
        d = self.d
        current = d.hotel_A + d.watts_N15 * sum(abs(f) ** 1.5 for f in force) / max(self.V, 8.0)
        self.charge_Ah += current * STEP_S / 3600.0
        self.V = d.open_V - d.drop_V_Ah * self.charge_Ah - d.R_ohm * current

    def _body(self, force: list[float], nu_r: tuple) -> tuple[float, float, float]:
        if self.couples:
            force = self._coupled(force, nu_r)
        X = Y = N = 0.0
        for f, a in zip(force, self.axis, strict=True):
            X += f * a[0]
            Y += f * a[1]
            N += f * a[2]
        return X, Y, N

    def _coupled(self, force: list[float], nu_r: tuple) -> list[float]:
        """Loss with advance speed, wash on the one behind, the outside interaction."""
        d, (u, v, r) = self.d, nu_r
        linear, square = d.advance, d.advance_square
        out = []
        for f, (c, s, _, x, y) in zip(force, self.axis, strict=True):
            along = (u - r * y) * c + (v + r * x) * s
            if f < 0:
                along = -along
            share = 1 - (linear + square * (along if along > 0 else -along)) * along
            out.append(f * (0.2 if share < 0.2 else 1.5 if share > 1.5 else share))
        if d.wash or d.wash_root:
            for front, rear in self.behind:
                load = force[front] / FORCE_OF_WASH_N
                if load > 0:
                    out[rear] *= max(0.0, 1 - d.wash * load - d.wash_root * sqrt(load))
        i, j, k = self.odd.interaction
        if k:
            out[i] += k * abs(force[j]) * force[i] / FORCE_OF_WASH_N
        return out


class Commander:
    """Body force wanted to pulse widths, as somebody does who believes the base: least squares, then the map back."""

    def __init__(self, base: World):
        d = base.drive
        a = np.radians([t.azimuth_deg for t in d.thrusters])
        x, y = np.array([t.x for t in d.thrusters]), np.array([t.y for t in d.thrusters])
        self.share = np.linalg.pinv(np.array([np.cos(a), np.sin(a), x * np.sin(a) - y * np.cos(a)])).tolist()
        self.pwm = np.arange(1100.0, 1901.0, 2.0)
        plain = Thruster("", 0.0, 0.0, 0.0, 0)
        self.force = np.maximum.accumulate([bollard(d, plain, p, d.V_nominal) for p in self.pwm])

    def __call__(self, tau: tuple[float, float, float]) -> list[float]:
        """Pulse widths [us], whole numbers, 1500 for no force."""
        wanted = [a * tau[0] + b * tau[1] + c * tau[2] for a, b, c in self.share]
        pwm = np.round(np.interp(wanted, self.force, self.pwm))
        return [1500.0 if abs(f) < 0.05 else float(p) for f, p in zip(wanted, pwm, strict=True)]
