"""Tables of the vessel file for what turns: a rudder behind a thruster, a servo that steers a thruster.

An angle is commanded as a pulse width: (pwm - trim - 1500) / 400 times `full_angle_deg`, `mirrored` with the other
sign; 1500 us is the centred servo. Equations of the forces: `companion.core.model.actuators`.
"""

from __future__ import annotations

from typing import Annotated

import msgspec

from companion.core.configuration.sensors import Arm
from companion.core.configuration.tables import SourcedTable

Pulse = Annotated[int, msgspec.Meta(ge=1100, le=1900)]
DeadTime = Annotated[float, msgspec.Meta(ge=0, le=2.0)]
Lag = Annotated[float, msgspec.Meta(ge=0.001, le=5.0)]
RcChannel = Annotated[int, msgspec.Meta(ge=1, le=16)]
Trim = Annotated[int, msgspec.Meta(ge=-200, le=200)]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]


class Servo(SourcedTable, frozen=True, kw_only=True):
    """Position servo: first-order lag with a limit on its rate, after a dead time.

    `full_angle_deg`: angle at 1900 us; `angle_max_deg`: the most that is asked for; `rate_deg_s`: the fastest it turns.
    """

    name: str
    channel: RcChannel
    full_angle_deg: Annotated[float, msgspec.Meta(ge=1, le=180)]
    angle_max_deg: Annotated[float, msgspec.Meta(ge=1, le=180)]
    rate_deg_s: Annotated[float, msgspec.Meta(ge=1, le=2000)]
    lag_s: Lag
    dead_time_s: DeadTime
    trim_us: Trim = 0
    mirrored: bool = False
    pwm_min_us: Pulse = 1100
    pwm_max_us: Pulse = 1900


class Steering(Servo, frozen=True, kw_only=True):
    """The servo that turns a thruster: a positive angle turns its thrust from x towards y, beyond `azimuth_deg`."""


class Rudder(Servo, frozen=True, kw_only=True):
    """A rudder in the race of a thruster: a positive angle turns a boat that goes ahead to starboard.

    `race_share`: share of the rudder's area in the race; `race_gain`: how much of the race's final speed is reached at
    the rudder (1: all); `straightening`: share of the stern's sideways speed that the rudder meets.
    """

    x_m: Arm
    area_m2: Annotated[float, msgspec.Meta(ge=1e-5, le=20)]
    aspect_ratio: Annotated[float, msgspec.Meta(ge=0.2, le=6)]
    propeller_diameter_m: Annotated[float, msgspec.Meta(ge=0.01, le=5)]
    race_share: Share = 1.0
    race_gain: Share = 0.7
    straightening: Share = 0.7
