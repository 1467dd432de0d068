"""Telemetry on how the boat's program is: mode, alerts, checks, timing, links, battery. Conventions: `structs`."""

from __future__ import annotations

from typing import Literal

import msgspec

from companion.core.messages import LinkState, Mode
from companion.core.preflight.rows import Level, Row
from companion.core.telemetry.shore_message import ShoreMessage


class ModeNow(ShoreMessage, frozen=True, kw_only=True):
    """Topic `mode`, at every change and once a second. `driving`: the thrusters may turn.

    `armed`, `autopilot_mode`: of the last heartbeat (Rover: 0 MANUAL, 4 HOLD), null while the autopilot is silent.
    `ended`: the boat's program ends, in order; nothing comes after it.
    """

    mode: Mode
    why: str
    driving: bool
    armed: bool | None
    autopilot_mode: int | None
    ended: bool = False


class AlertTold(ShoreMessage, frozen=True, kw_only=True):
    """Topic `alert`, each: something a person should know."""

    level: Literal["info", "warning", "error"]
    text: str


class ChecksNow(ShoreMessage, frozen=True, kw_only=True):
    """Topic `checks`, once the autopilot's parameters were judged: the rows of `aritra check` known on the boat."""

    level: Level
    rows: tuple[Row, ...]


class Spread(msgspec.Struct, frozen=True, kw_only=True):
    """Median and largest value of the last second; null where there was none."""

    median_ms: float | None
    max_ms: float | None


class TimingNow(ShoreMessage, frozen=True, kw_only=True):
    """Topic `timing`, once a second: loop, solver, process, and this telemetry itself.

    `leases`: how many by source; `solves`: by status. `cpu_percent` of one core, `rss_mb` in 1e6 bytes, null before
    the first. `dropped`: messages, since the start, that telemetry had no room for; `refused`: orders from shore.
    """

    lateness: Spread
    imu_to_override: Spread
    solve: Spread
    solves: dict[str, int]
    leases: dict[str, int]
    cpu_percent: float | None
    rss_mb: float | None
    dropped: int
    refused: int


class LinkNow(msgspec.Struct, frozen=True, kw_only=True):
    """One device link and the reason for its state."""

    link: str
    state: LinkState
    reason: str


class LinksNow(ShoreMessage, frozen=True, kw_only=True):
    """Topic `links`, once a second. `ages_s`: since the last heartbeat, imu, attitude and word of each other sensor by
    its key; null: never. `figures`: what a sensor says of its own quality, by its name.
    """

    links: tuple[LinkNow, ...]
    ages_s: dict[str, float | None]
    figures: dict[str, str] = msgspec.field(default_factory=dict)


class BatteryNow(ShoreMessage, frozen=True, kw_only=True):
    """Topic `battery`, once a second. `age_s`: of the autopilot's last message about it."""

    voltage_v: float
    current_a: float | None
    remaining_percent: int | None
    age_s: float
