"""A simulated sensor that states its equation as channels: the very same equation, at the true motion, with noise.

z = h(motion, e) + w        e: drawn at the start, then as its `ErrorState`s say; w: white
"""

from __future__ import annotations

import math

import numpy as np

from companion.core.messages import Measured
from companion.core.sensors.sensor import BodyMotion, Sensor
from sim.world.environment import Moment
from sim.world.plant import Motion
from sim.world.sensors import body_rates


class ChannelSensor:
    """One sensor, sampled at its rate from `begin_ns` on. `errors`: its slow errors now."""

    def __init__(self, sensor: Sensor, rng: np.random.Generator, begin_ns: int):
        self.sensor, self._rng = sensor, rng
        self.errors = [float(rng.normal(0.0, e.sigma)) for e in sensor.error_states]
        self._due_ns, self._period_ns = begin_ns, round(1e9 / sensor.rate_Hz)
        self._under_way: list[tuple[int, Measured]] = []

    def step(self, motion: Motion, moment: Moment, t_ns: int) -> list[Measured]:
        """Measure when due; the messages that arrive now, `latency_s` after they were measured."""
        if t_ns >= self._due_ns:
            self._due_ns += self._period_ns
            arrives_ns = t_ns + round(self.sensor.latency_s * 1e9)
            self._under_way.append((arrives_ns, self.measure(motion, moment, arrives_ns)))
        ready = [m for ready_ns, m in self._under_way if ready_ns <= t_ns]
        self._under_way = [each for each in self._under_way if each[0] > t_ns]
        return ready

    def measure(self, motion: Motion, moment: Moment, stamp_ns: int) -> Measured:
        """One message, a period after the last."""
        dt_s, rng = self._period_ns * 1e-9, self._rng
        for i, e in enumerate(self.sensor.error_states):
            decay = math.exp(-dt_s / e.time_s)
            sigma = math.hypot(e.stationary * math.sqrt(1 - decay**2), e.walk * math.sqrt(dt_s))
            self.errors[i] = decay * self.errors[i] + sigma * float(rng.normal())
        x = motion.x
        p, q, _ = body_rates(float(x[5]), moment)
        at = BodyMotion(x[:3], x[3:6], (moment.phi_rad, moment.theta_rad), (p, q))
        values = {
            c.name: tuple(float(h) + float(rng.normal(0.0, c.sigma)) for h in c.expected(at, self.errors))
            for c in self.sensor.channels
        }
        return self.sensor.message(values, stamp_ns)
