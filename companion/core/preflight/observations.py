"""Observations of a pre-flight check while it listened: values only, so that rows can be made and tested anywhere."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from companion.core.messages import (
    AutopilotInfo,
    Battery,
    Heartbeat,
    Innovation,
    LinkStatus,
    Measured,
    RcChannels,
    ServoOutput,
    StateEstimate,
    StatusText,
    UwbPosition,
    UwbRanges,
)


class RoundTrip(NamedTuple):
    """One TIMESYNC answer: how long it took, and the offset of the autopilot's clock that it shows [s]."""

    took_s: float
    offset_s: float


@dataclass(frozen=True)
class Disk:
    """The log folder. `problem`: why nothing can be written there; `quota_bytes`: what logs may take, of which
    `used_bytes` are taken; `newest_s`: when the newest log was written (wall clock).
    """

    folder: str
    free_bytes: int
    problem: str | None = None
    quota_bytes: float | None = None
    used_bytes: int = 0
    newest_s: float | None = None


@dataclass(frozen=True)
class Observations:
    """Everything. `rates_hz`, `wanted_hz`: by MAVLink message type; `lost`: frames missing of `received`.

    `estimate`, `innovations`: what the boat's own filter made of it; `notes`: warnings of the configuration;
    `arming_told`: the autopilot has answered when it was asked for its arming checks;
    `deaf`: the autopilot signs what it says and answers nothing of ours, who have no key; `uwb_hz`: cycles of the tag;
    `autopilot`: system of the autopilot that the run file names, `strangers`: those of other autopilots;
    `wall_s`: the boat's date [s since 1970]; `mavlink`, `uwb`: the last word on each link; `heard`,
    `sensor_hz`: messages of the sensors that are not inertial by their keys, and how often they measured (`cycles_of`).
    """

    listened_s: float
    disk: Disk
    wall_s: float
    mavlink: LinkStatus | None = None
    uwb: LinkStatus | None = None
    heartbeat: Heartbeat | None = None
    info: AutopilotInfo | None = None
    rates_hz: Mapping[str, float] = field(default_factory=dict)
    wanted_hz: Mapping[str, float] = field(default_factory=dict)
    deaf: bool = False
    autopilot: int | None = None
    strangers: tuple[int, ...] = ()
    received: int = 0
    lost: int = 0
    round_trips: tuple[RoundTrip, ...] = ()
    battery: Battery | None = None
    servo: ServoOutput | None = None
    rc: RcChannels | None = None
    texts: tuple[StatusText, ...] = ()
    arming_told: bool = False
    estimate: StateEstimate | None = None
    innovations: tuple[Innovation, ...] = ()
    heard: Mapping[str, tuple[Measured, ...]] = field(default_factory=dict)
    sensor_hz: Mapping[str, float] = field(default_factory=dict)
    ranges: tuple[UwbRanges, ...] = ()
    positions: tuple[UwbPosition, ...] = ()
    uwb_hz: float = 0.0
    notes: tuple[str, ...] = ()


def cycles_of(messages: Iterable[Measured]) -> int:
    """How often a sensor has measured: its messages of the kind that came most, as ranges and position of one cycle of
    a tag are two messages.
    """
    return max(Counter(type(m) for m in messages).values(), default=0)
