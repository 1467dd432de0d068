"""The run file: which boat, which site, which mission, over which wires. Reference: docs/run-file.md.

Paths in it are relative to the file itself. `aritra run --config FILE`; deploy/aritra.toml is the example.
"""

from __future__ import annotations

from typing import Annotated

import msgspec

from companion.core.config import Table, parse_toml

Positive = Annotated[float, msgspec.Meta(gt=0)]


class MavlinkLink(Table, frozen=True, kw_only=True):
    """Wire to the autopilot. Our system id must equal the autopilot's SYSID_MYGCS (4.7: MAV_GCS_SYSID)."""

    url: str
    system_id: Annotated[int, msgspec.Meta(ge=1, le=255)] = 1
    component_id: Annotated[int, msgspec.Meta(ge=1, le=255)] = 191


class UwbLink(Table, frozen=True, kw_only=True):
    """Wire to the UWB tag. `tag`: its name in logs. The wire format stands in the vessel file."""

    url: str
    tag: str = "tag"


class Control(Table, frozen=True, kw_only=True):
    """Timing of the control loop [s].

    A plan that is not there `plan_deadline_s` after its tick is replaced by the next step of the fallback
    ladder. `lease_s`: how long a lease is meant to hold. `latency_s`: from an override to the autopilot's output.
    `blind_s`: how long the boat goes on with a degraded estimate (no UWB, no IMU) before it stops; assumed.
    `neutral_channels` are held at 1500 us beside the thrusters': without a receiver the autopilot takes a
    channel 3 that says nothing for a radio failure, and its gate stays shut.
    """

    period_s: Annotated[float, msgspec.Meta(ge=0.02, le=1.0)] = 0.1
    plan_deadline_s: Positive = 0.05
    lease_s: Annotated[float, msgspec.Meta(gt=0, le=5.0)] = 0.3
    latency_s: Annotated[float, msgspec.Meta(ge=0, le=1.0)] = 0.03
    blind_s: Annotated[float, msgspec.Meta(gt=0, le=600.0)] = 15.0
    neutral_channels: tuple[Annotated[int, msgspec.Meta(ge=1, le=16)], ...] = (1, 2, 3, 4)


class LogFolder(Table, frozen=True, kw_only=True):
    """Where logs go, and how many megabytes (1e6 bytes) of them are kept; None: the current folder, all of them."""

    folder: str | None = None
    quota_MB: Positive | None = None


class RunFile(Table, frozen=True, kw_only=True):
    """One run. `excitation`: what `aritra run --excite` flies instead of the mission."""

    vessel: str
    site: str
    mission: str
    excitation: str | None = None
    mavlink: MavlinkLink
    uwb: UwbLink
    control: Control = Control()
    log: LogFolder = LogFolder()


def load_run(text: str, *, name: str) -> RunFile:
    """Run file text -> RunFile. Raises ConfigError naming file and key."""
    return parse_toml(text, RunFile, name=name)
