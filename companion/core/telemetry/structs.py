"""What the boat tells the shore: one struct a topic, as JSON under `aritra/<boat>/telemetry/<topic>`.

Every struct begins with `v`, `run` and `t_ns`. `v`: version of the struct; a new optional field does not raise it, a
changed or removed one does, and readers ignore fields that they do not know. `run`: names this run of the boat's
program; `t_ns`: the boat's monotonic clock [ns], the instant it speaks of. Units are in the names, frames those of
`messages`. A missing number is null. JSON because a browser, a notebook and `jq` read it as it is; numbers are rounded
to what a person or a plot can use, which makes it as short as msgpack with its eight bytes for every number.
Reference for people: docs/telemetry.md.
"""

from __future__ import annotations

from typing import Literal

import msgspec

from companion.core.messages import Health, MissionPoint
from companion.core.telemetry.shore_message import VERSION, ShoreMessage
from companion.core.telemetry.status import (
    AlertTold,
    BatteryNow,
    ChecksNow,
    LinksNow,
    ModeNow,
    TimingNow,
)

KEYSPACE = "aritra"

Place = tuple[float, float]
"""(north, east) [m], site axes."""
Pose = tuple[float, float, float]
"""(north [m], east [m], heading [rad])."""


class ThrusterAbout(msgspec.Struct, frozen=True, kw_only=True):
    """One thruster: name, RC channel, place (forward, starboard), direction of positive thrust, forces it can give."""

    name: str
    channel: int
    x_m: float
    y_m: float
    azimuth_deg: float
    force_min_n: float
    force_max_n: float


class AnchorAbout(msgspec.Struct, frozen=True, kw_only=True):
    """A UWB anchor."""

    id: str
    north_m: float
    east_m: float


class GuidanceAbout(msgspec.Struct, frozen=True, kw_only=True):
    """How the boat rounds corners and how fast it goes: see `PathLimits`. `end`: after the last waypoint."""

    cruise_m_s: float
    acceleration_m_s2: float
    deceleration_m_s2: float
    lateral_m_s2: float
    yaw_rate_rad_s: float
    crawl_m_s: float
    corner_reach_m: float
    corner_cut_m: float
    acceptance_m: float
    turning_radius_m: float
    end: Literal["station", "drift"] = "station"


class About(ShoreMessage, frozen=True, kw_only=True):
    """Topic `about`, once a run: what does not change.

    `unix_minus_t_ns`: added to a `t_ns` gives the boat's idea of Unix time, which may be wrong. `within`: polygons the
    boat must stay inside of; `without`: outside of. `configuration`: name of run, vessel, site and mission texts.
    `length_m`, `beam_m`: of the hull, about the origin of the body axes, and `guidance`: null from boats that do
    not send them.
    """

    vessel: str
    site: str
    configuration: str
    software: str
    unix_minus_t_ns: int
    period_s: float
    lat_deg: float
    lon_deg: float
    rotation_deg: float
    thrusters: tuple[ThrusterAbout, ...]
    anchors: tuple[AnchorAbout, ...]
    within: tuple[tuple[Place, ...], ...]
    without: tuple[tuple[Place, ...], ...]
    commands: bool
    length_m: float | None = None
    beam_m: float | None = None
    guidance: GuidanceAbout | None = None


class StateNow(ShoreMessage, frozen=True, kw_only=True):
    """Topic `state`, at the full rate: the estimate. Pose, body velocities over ground, disturbance [N, N, N m].

    `covariance`: upper triangle, row by row, of the 6 x 6 of [x y psi u v r]: 21 numbers (`square` unfolds them).
    """

    north_m: float
    east_m: float
    psi_rad: float
    u_m_s: float
    v_m_s: float
    r_rad_s: float
    covariance: tuple[float, ...]
    disturbance_n: tuple[float, ...]
    health: Health
    reason: str


class AttitudeNow(ShoreMessage, frozen=True, kw_only=True):
    """Topic `attitude`, twice a second: the autopilot's. Heading from true north; null where it was left out."""

    roll_rad: float
    pitch_rad: float
    heading_rad: float | None


class ThrustersNow(ShoreMessage, frozen=True, kw_only=True):
    """Topic `thrusters`, at the full rate: the lease. In the order of `About.thrusters`.

    `source`: rung of the fallback ladder, or excitation, or manual; `reason`: why no higher one. `output_us`: pulse
    widths at the outputs that carry them, as the autopilot reports them, null where its report is older than 1 s.
    `sent`: whether the pulses went to an open port; null from boats that do not say so.
    """

    pwm_us: tuple[int, ...]
    force_n: tuple[float, ...]
    source: str
    reason: str
    output_us: tuple[int, ...] | None
    sent: bool | None = None


class ReferenceNow(ShoreMessage, frozen=True, kw_only=True):
    """Topic `reference`, at half the rate while guidance steers: leg, errors to it, and what is asked for now."""

    phase: str
    leg: int
    waypoints_passed: int
    x_e_m: float
    y_e_m: float
    psi_ref_rad: float
    u_ref_m_s: float
    north_ref_m: float
    east_ref_m: float


class PathNow(ShoreMessage, frozen=True, kw_only=True):
    """Topic `path`, at the start and when another mission was loaded: the reference path, in straight legs.

    `end_heading_rad`: null: that of the last leg. `origin`: source of the mission.
    """

    name: str
    waypoints: tuple[MissionPoint, ...]
    end_heading_rad: float | None
    origin: Literal["run file", "shore"]


class HorizonNow(ShoreMessage, frozen=True, kw_only=True):
    """Topic `horizon`, at half the rate: what the NMPC expects, from where a command sent at `t_ns` begins to act.

    `poses`: predicted, `step_s` apart; `reference`: places of the path that belong to them. `status`: the solver's.
    """

    status: str
    step_s: float
    poses: tuple[Pose, ...]
    reference: tuple[Place, ...]


class RangeNow(msgspec.Struct, frozen=True, kw_only=True):
    """Newest range to one anchor; `residual_m`: measured minus expected, null while nothing is expected.

    `accepted`: whether the filter used it.
    """

    anchor: str
    range_m: float
    residual_m: float | None
    accepted: bool | None


class RangesNow(ShoreMessage, frozen=True, kw_only=True):
    """Topic `ranges`, each tag cycle, twice a second at most: its UWB ranges."""

    ranges: tuple[RangeNow, ...]


class ExcitationNow(ShoreMessage, frozen=True, kw_only=True):
    """Topic `excitation`, twice a second while one is flown."""

    phase: str
    segment: int
    segments: int
    name: str
    elapsed_s: float


TOPICS: dict[str, type[ShoreMessage]] = {
    "about": About,
    "state": StateNow,
    "attitude": AttitudeNow,
    "thrusters": ThrustersNow,
    "reference": ReferenceNow,
    "path": PathNow,
    "horizon": HorizonNow,
    "ranges": RangesNow,
    "mode": ModeNow,
    "alert": AlertTold,
    "checks": ChecksNow,
    "excitation": ExcitationNow,
    "timing": TimingNow,
    "links": LinksNow,
    "battery": BatteryNow,
}
_NAMES = {kind: name for name, kind in TOPICS.items()}
_DECODERS = {name: msgspec.json.Decoder(kind) for name, kind in TOPICS.items()}
_ENCODER = msgspec.json.Encoder()


def topic_of(message: ShoreMessage) -> str:
    """Name of a struct's topic."""
    return _NAMES[type(message)]


def telemetry_key(boat: str, topic: str) -> str:
    """Zenoh key of a topic. `*` for boat or topic stands for all."""
    return f"{KEYSPACE}/{boat}/telemetry/{topic}"


def command_key(boat: str) -> str:
    """Zenoh key under which the boat answers orders (`orders`)."""
    return f"{KEYSPACE}/{boat}/command"


def sticks_key(boat: str) -> str:
    """Zenoh key on which the boat hears who steers it by hand (`sticks`)."""
    return f"{KEYSPACE}/{boat}/sticks"


def alive_key(boat: str) -> str:
    """Zenoh key of the liveliness token: there while the boat's program runs and can be reached."""
    return f"{KEYSPACE}/{boat}/alive"


def encode(message: ShoreMessage) -> bytes:
    """Struct -> JSON."""
    return _ENCODER.encode(message)


def decode(topic: str, data: bytes) -> ShoreMessage:
    """JSON of a topic -> struct. Raises ValueError: unknown topic, newer version, or not what the topic promises."""
    if topic not in _DECODERS:
        raise ValueError(f"unknown telemetry topic {topic!r}: this program is older than the boat's")
    try:
        message = _DECODERS[topic].decode(data)
    except msgspec.MsgspecError as error:
        raise ValueError(f"{topic}: {error}") from None
    if message.v > VERSION:
        raise ValueError(f"{topic}: version {message.v}, this program knows {VERSION}: update it")
    return message


def square(triangle: tuple[float, ...], n: int = 6) -> tuple[tuple[float, ...], ...]:
    """Upper triangle, row by row -> the symmetric n x n matrix. Raises ValueError for another length."""
    if len(triangle) != n * (n + 1) // 2:
        raise ValueError(f"expected {n * (n + 1) // 2} numbers, got {len(triangle)}")
    rows = [[0.0] * n for _ in range(n)]
    values = iter(triangle)
    for i in range(n):
        for j in range(i, n):
            rows[i][j] = rows[j][i] = next(values)
    return tuple(map(tuple, rows))
