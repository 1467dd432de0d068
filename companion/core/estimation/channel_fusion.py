"""Measurement updates by a sensor that states its equation as channels (`core.sensors.sensor`), component by component.

    z = h(motion, e) + w        H = dh/d[x y psi u v r phi theta e], exact, by CasADi

Each component has a gate of its own. One that re-opens says that something jumped: first the sensor's own slow error,
where it has one that is within four sigma of zero after the jump too; else what the channel is about. A slow error that
drifts beyond four sigma is none: the position is taken anew from the fix, and the error begins at zero again.
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
from companion.core.estimation.gates import Gate, all_accepted_ns, judge
from companion.core.estimation.kalman import KalmanEquations
from companion.core.estimation.ranging.ranges import PLACE_SIGMA_M, VELOCITY_SIGMA_M_S, decorrelate, inflate
from companion.core.messages import Measured
from companion.core.model.integrate import BufferedStep
from companion.core.sensors.sensor import BodyMotion, Sensor, SensorChannel

MOVING = (0, 1, 2, 3, 4, 5, TILT.start, TILT.start + 1)
"""States that h depends on, beside the sensor's own errors."""
ERROR_SIGMAS = 4.0
"""A slow error that is stationary is within so many sigma of zero; assumed."""


class ChannelFusion:
    """Constant parts for one sensor, whose error states begin at `first` of the filter's."""

    def __init__(self, sensor: Sensor, first: int, algebra: KalmanEquations):
        self._sensor, self._algebra = sensor, algebra
        self._errors = tuple(range(first, first + len(sensor.error_states)))
        self._states = np.array([*MOVING, *self._errors])
        self._channels = {c.name: (c, BufferedStep(channel_function(c, len(self._errors)))) for c in sensor.channels}

    def fuse(self, belief: FilterState, m: Measured) -> Result:
        """All channels that a message speaks of."""
        gates, innovations = dict(belief.gates), []
        for reading in self._sensor.readings(m):
            channel, _ = self._channels[reading.channel]
            for axis, (name, z) in enumerate(zip(channel.axes, reading.z, strict=True)):
                nu, H = self._innovation(channel, axis, z, belief)
                S = H @ belief.P @ H.T + channel.sigma**2
                key = f"{self._sensor.key} {channel.name} {name}"
                verdict, gates[key] = judge(
                    gates.get(key, Gate()), channel.rule, belief.t_ns, float(nu[0]), math.sqrt(S[0, 0])
                )
                sensor = f"{channel.name} {name}"
                innovations.append(innovation_message(belief.t_ns, sensor, nu, S, verdict != "rejected"))
                if verdict != "rejected":
                    belief = self._update(channel, axis, z, belief, jumped=verdict == "reopened")
            if channel.about == "position":
                mine = [gates[f"{self._sensor.key} {channel.name} {name}"] for name in channel.axes]
                belief = replace(belief, position_ns=all_accepted_ns(mine, belief.position_ns))
        return replace(belief, gates=gates), tuple(innovations)

    def _innovation(
        self, channel: SensorChannel, axis: int, z: float, belief: FilterState
    ) -> tuple[np.ndarray, np.ndarray]:
        """z - h of one component, and its row of the Jacobian."""
        rates = np.array(belief.rates_rad_s[:2]) - belief.x[B_TILT]
        packed, rows = self._channels[channel.name][1](belief.x[self._states], rates), len(channel.axes)
        H = np.zeros((1, len(belief.x)))
        H[0, self._states] = packed[rows:].reshape((rows, len(self._states)), order="F")[axis]
        return np.array([z - float(packed[axis])]), H

    def _update(self, channel: SensorChannel, axis: int, z: float, belief: FilterState, *, jumped: bool) -> FilterState:
        """Belief after a component that passed its gate; `jumped`: by a lasting innovation."""
        (nu, H), R = self._innovation(channel, axis, z, belief), np.array([[channel.sigma**2]])
        own = self._errors[axis : axis + 1] if channel.about == "position" else ()
        limit = ERROR_SIGMAS * (self._sensor.error_states[axis].stationary or math.inf) if own else 0.0
        x, P = belief.x, belief.P
        moved = jumped and channel.about == "position" and not (own and abs(x[own[0]] + nu[0]) <= limit)
        if not moved:
            P = inflate(P, own or LAYOUT.velocity, abs(float(nu[0]))) if jumped else P
            x, P = self._algebra.update(x, P, nu, H, R)
            moved = bool(own) and abs(x[own[0]]) > limit
        if moved:
            belief = self._anew(axis, belief, abs(float(nu[0])))
            nu, H = self._innovation(channel, axis, z, belief)
            x, P = self._algebra.update(belief.x, belief.P, nu, H, R)
        return replace(belief, x=x, P=P)

    def _anew(self, axis: int, belief: FilterState, jump: float) -> FilterState:
        """Belief with one coordinate unknown, speed in doubt, and the sensor's slow error as at the start."""
        own, x = self._errors[axis : axis + 1], belief.x.copy()
        jump = max(PLACE_SIGMA_M, jump + sum(abs(x[i]) for i in own))
        P = inflate(decorrelate(belief.P, (axis, *own)), (axis,), jump)
        for i in own:
            x[i], P[i, i] = 0.0, self._sensor.error_states[axis].sigma ** 2
        P = inflate(P, LAYOUT.velocity, VELOCITY_SIGMA_M_S)
        return replace(belief, x=x, P=P, displaced_ns=belief.t_ns)


def channel_function(channel: SensorChannel, errors: int) -> ca.Function:
    """CasADi function ([x y psi u v r phi theta e], [p q]) -> vec[h, Jacobian]."""
    s, rates = ca.SX.sym("s", len(MOVING) + errors), ca.SX.sym("rates", 2)
    e = [s[len(MOVING) + i] for i in range(errors)]
    h = ca.vertcat(*channel.expected(BodyMotion(s[:3], s[3:6], (s[6], s[7]), (rates[0], rates[1])), e))
    packed = ca.densify(ca.vec(ca.horzcat(h, ca.jacobian(h, s))))
    return ca.Function("channel", [s, rates], [packed])
