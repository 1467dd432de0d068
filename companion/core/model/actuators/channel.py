"""One channel: from a pulse width to what it commands, a thrust [N] or an angle [rad], and how fast that follows.

    f_dot = (f_cmd - f) / lag,  |f_dot| <= slew         after the channel's own dead time

f is the channel's state and has the unit of its command; so have its limits and rates. Thrust: `thrusters`. Angle:

    angle = full_angle (pwm - trim - 1500) / 400        `mirrored`: with the other sign
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import casadi as ca
import numpy as np

from companion.core.configuration.servos import Servo
from companion.core.configuration.vessel_file import ForceMap, Propulsion, Thruster
from companion.core.constants import NEUTRAL_US
from companion.core.model.thrusters import SPAN_US, force_from_pwm, force_reach, pwm_from_force, steady_force

EQUAL_CHANGE: dict[str, float] = {"N": 10.0, "rad": 1.0}
"""Changes of a command that count alike, by unit; assumed: 1 m, 1 rad, 1 m/s or 1 rad/s of the boat is as much. Of
thrusters up to `EQUAL_UP_TO_N`; of stronger ones the same share of full thrust."""
EQUAL_UP_TO_N = 38.0
"""Full thrust of the example boats' T200, for which `EQUAL_CHANGE` and the weights of the NMPC were chosen."""


@dataclass(frozen=True)
class Channel:
    """What one RC channel commands, in its `unit`.

    `lower`, `upper`: limits of what may be asked for; `rate`: what control asks for per second at most; `slew`: what
    the hardware does per second at most, None: as the lag lets it. `value(pwm_us, voltage_v)`: the steady state;
    `expression`: the same in CasADi; `pulse(value, voltage_v)`: pulse width [us] within its limits, neutral for 0.
    """

    name: str
    unit: Literal["N", "rad"]
    lower: float
    upper: float
    lag_s: float
    dead_time_s: float
    rate: float
    slew: float | None
    value: Callable[[float, float], float]
    expression: Callable[[Any, Any], Any]
    pulse: Callable[[float, float], int]


def thrust_channel(t: Thruster, fmap: ForceMap, p: Propulsion) -> Channel:
    """Thrust of one thruster; `p` has what is common to those without their own."""
    lower, upper = force_reach(t)
    return Channel(
        t.name, "N", lower, upper,
        p.lag_s if t.lag_s is None else t.lag_s,
        p.dead_time_s if t.dead_time_s is None else t.dead_time_s,
        p.rate_limit_N_s, p.slew_N_s,
        partial(force_from_pwm, t, fmap), partial(steady_force, t, fmap), partial(pwm_from_force, t, fmap),
    )  # fmt: skip


def angle_channel(s: Servo) -> Channel:
    """Angle of one servo; voltage plays no part."""
    most, rate = math.radians(s.angle_max_deg), math.radians(s.rate_deg_s)
    full = math.radians(s.full_angle_deg) * (-1 if s.mirrored else 1)
    middle = NEUTRAL_US + s.trim_us

    def value(pwm_us: float, _: float) -> float:
        return full * min(max((pwm_us - middle) / SPAN_US, -1.0), 1.0)

    def expression(pwm_us: Any, _: Any) -> Any:
        return full * ca.fmax(ca.fmin((pwm_us - middle) / SPAN_US, 1.0), -1.0)

    def pulse(angle_rad: float, _: float) -> int:
        return int(np.clip(round(middle + SPAN_US * angle_rad / full), s.pwm_min_us, s.pwm_max_us))

    return Channel(s.name, "rad", -most, most, s.lag_s, s.dead_time_s, rate, rate, value, expression, pulse)
