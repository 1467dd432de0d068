"""Measurement updates by a sensor that states its equation as channels (`core.sensors.sensor`), component by component.

    z = h(motion, e) + w        H = dh/d[x y psi u v r phi theta e], exact, by CasADi

Each component has a gate of its own. One that re-opens says that something jumped: first the sensor's own slow error,
where it has one and the jump is within four sigma of it; else what the channel is about.
"""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
from msgspec.structs import replace

from companion.core.estimation.filter_state import (
    B_TILT,
    LAYOUT,
    TILT,
    FilterState,
    Result,
    innovation_message,
)
from companion.core.estimation.gates import Gate, judge
from companion.core.estimation.kalman import KalmanEquations
from companion.core.estimation.ranging.ranges import PLACE_SIGMA_M, VELOCITY_SIGMA_M_S, decorrelate, inflate
from companion.core.messages import Measured
from companion.core.model.integrate import BufferedStep
from companion.core.sensors.sensor import BodyMotion, Channel, Sensor

MOVING = (0, 1, 2, 3, 4, 5, TILT.start, TILT.start + 1)
"""States that h depends on, beside the sensor's own errors."""
ERROR_SIGMAS = 4.0
"""A jump within so many sigma of the sensor's slow error is one of it; assumed."""


class ChannelFusion:
    """Constant parts for one sensor, whose error states begin at `first` of the filter's."""

    def __init__(self, sensor: Sensor, first: int, algebra: KalmanEquations):
        self._sensor, self._algebra = sensor, algebra
        self._errors = tuple(range(first, first + len(sensor.error_states)))
        self._states = np.array([*MOVING, *self._errors])
        self._channels = {c.name: (c, BufferedStep(channel_function(c, len(self._errors)))) for c in sensor.channels}

    def fuse(self, belief: FilterState, m: Measured) -> Result:
        """All channels that a message speaks of."""
        x, P, gates, innovations, position_ns = belief.x, belief.P, dict(belief.gates), [], belief.position_ns
        for reading in self._sensor.readings(m):
            channel, function = self._channels[reading.channel]
            R = np.array([[channel.sigma**2]])
            for axis, (name, z) in enumerate(zip(channel.axes, reading.z, strict=True)):
                h, H = self._predict(function, len(channel.axes), axis, x, belief)
                nu = np.array([z - h])
                S = H @ P @ H.T + R
                key = f"{self._sensor.key} {channel.name} {name}"
                verdict, gates[key] = judge(
                    gates.get(key, Gate()), channel.rule, belief.t_ns, float(nu[0]), math.sqrt(S[0, 0])
                )
                sensor = f"{channel.name} {name}"
                innovations.append(innovation_message(belief.t_ns, sensor, nu, S, verdict != "rejected"))
                if verdict == "rejected":
                    continue
                if verdict == "reopened":
                    P = self._reopen(channel, axis, P, abs(float(nu[0])))
                x, P = self._algebra.update(x, P, nu, H, R)
                position_ns = belief.t_ns if channel.about == "position" else position_ns
        return replace(belief, x=x, P=P, gates=gates, position_ns=position_ns), tuple(innovations)

    def _predict(
        self, function: BufferedStep, rows: int, axis: int, x: np.ndarray, belief: FilterState
    ) -> tuple[float, np.ndarray]:
        """h and its row of the Jacobian for one component."""
        rates = np.array(belief.rates_rad_s[:2]) - x[B_TILT]
        packed = function(x[self._states], rates)
        H = np.zeros((1, len(x)))
        H[0, self._states] = packed[rows:].reshape((rows, len(self._states)), order="F")[axis]
        return float(packed[axis]), H

    def _reopen(self, channel: Channel, axis: int, P: np.ndarray, jump: float) -> np.ndarray:
        """P once a lasting innovation of `jump` has opened a gate."""
        if channel.about == "velocity":
            return inflate(P, LAYOUT.velocity, jump)
        own = self._errors[axis : axis + 1]
        if own and jump <= ERROR_SIGMAS * self._sensor.error_states[axis].stationary:
            return inflate(P, own, jump)
        P = inflate(decorrelate(P, (axis,)), (axis,), max(PLACE_SIGMA_M, jump))
        return inflate(P, LAYOUT.velocity, VELOCITY_SIGMA_M_S)


def channel_function(channel: Channel, errors: int) -> ca.Function:
    """CasADi function ([x y psi u v r phi theta e], [p q]) -> vec[h, Jacobian]."""
    s, rates = ca.SX.sym("s", len(MOVING) + errors), ca.SX.sym("rates", 2)
    e = [s[len(MOVING) + i] for i in range(errors)]
    h = ca.vertcat(*channel.expected(BodyMotion(s[:3], s[3:6], (s[6], s[7]), (rates[0], rates[1])), e))
    packed = ca.densify(ca.vec(ca.horzcat(h, ca.jacobian(h, s))))
    return ca.Function("channel", [s, rates], [packed])
