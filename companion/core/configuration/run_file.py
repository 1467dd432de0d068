"""The run file: which boat, which site, which mission, over which wires. Reference: docs/run-file.md.

Paths in it are relative to the file itself. `aritra run --config FILE`; deploy/aritra.toml is the example.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import msgspec

from companion.core.configuration import file_kinds
from companion.core.configuration.tables import Table, parse_toml

Voltage = Annotated[float, msgspec.Meta(ge=1, le=1000)]
Percent = Annotated[float, msgspec.Meta(gt=0, lt=100)]


class MavlinkLink(Table, frozen=True, kw_only=True):
    """Wire to the autopilot. Our system id must equal the autopilot's SYSID_MYGCS (4.7: MAV_GCS_SYSID).

    `autopilot_system_id`: the autopilot's, its SYSID_THISMAV (4.7: MAV_SYSID); None: the first that is heard is ours.
    `signing_key`: file of the MAVLink 2 signing key; None: nothing is signed or checked.
    """

    url: str
    system_id: Annotated[int, msgspec.Meta(ge=1, le=255)] = 1
    component_id: Annotated[int, msgspec.Meta(ge=1, le=255)] = 191
    autopilot_system_id: Annotated[int, msgspec.Meta(ge=1, le=255)] | None = None
    signing_key: str | None = None


class ForwardLink(Table, frozen=True, kw_only=True):
    """Wire to a ground station. `writable`: it may also speak to the autopilot, within `gcs_firewall`."""

    url: str
    writable: bool = False


class VisionTable(Table, frozen=True, kw_only=True):
    """Our position for the autopilot's own filter, at `rate_Hz` at most; see docs/ground-station.md."""

    rate_Hz: Annotated[float, msgspec.Meta(ge=1, le=50)] = 10.0


class TelemetryLink(Table, frozen=True, kw_only=True):
    """Telemetry over zenoh, and orders from shore; see docs/telemetry.md.

    `connect`, `listen`: zenoh endpoints; `boat`: its name in keys (None: from the vessel's); `config`: zenoh's own
    file, for certificates and passwords. `history_s`: how much is kept for whoever joins late or was away.
    `commands`: orders from shore are obeyed; `command_key`: file of the key that they must be signed with.
    """

    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    mode: Literal["peer", "client"] = "peer"
    boat: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_.-]{1,40}\Z")] | None = None
    config: str | None = None
    rate_Hz: Annotated[float, msgspec.Meta(ge=1, le=20)] = 10.0
    history_s: Annotated[float, msgspec.Meta(ge=0, le=600)] = 60.0
    commands: bool = False
    command_key: str | None = None

    def __post_init__(self) -> None:
        if not (self.connect or self.listen):
            raise ValueError('connect: expected a zenoh endpoint, for example ["tcp/192.168.1.20:7447"]')
        if self.mode == "client" and not self.connect:
            raise ValueError("connect: a client needs a router to connect to")
        if self.command_key and not self.commands:
            raise ValueError("command_key: without commands = true nothing is obeyed: set it, or leave out the key")


class UwbLink(Table, frozen=True, kw_only=True):
    """Wire to the UWB tag. `tag`: its name in logs. The wire format stands in the vessel file."""

    url: str
    tag: str = "tag"


class SensorWire(Table, frozen=True, kw_only=True):
    """Wire to another sensor that has one of its own; the table's name is that of the vessel file's `[sensors.*]`."""

    url: str


class Control(Table, frozen=True, kw_only=True):
    """Timing of the control loop [s].

    One override a tick: after 0.5 s without one the autopilot sees a lost radio (FS_THR_ENABLE) and refuses to arm.
    `period_s`: of a tick; the tests of trust count ticks, and waves look like faults to them at 50 a second.
    A plan that is not there `plan_deadline_s` after its tick is replaced by the next step of the fallback
    ladder. `lease_s`: how long a lease is meant to hold. `latency_s`: from an override to the autopilot's output.
    `blind_s`: how long the boat goes on with a degraded estimate (no UWB, no IMU) before it stops; assumed.
    `manual_timeout_s`: sticks that are silent for so long are let go of; assumed.
    `neutral_channels` are held at 1500 us beside the thrusters': without a receiver the autopilot takes a
    channel 3 that says nothing for a radio failure, and its gate stays shut.
    """

    period_s: Annotated[float, msgspec.Meta(ge=0.05, le=0.4)] = 0.1
    plan_deadline_s: Annotated[float, msgspec.Meta(ge=0.001, le=1.0)] = 0.05
    lease_s: Annotated[float, msgspec.Meta(gt=0, le=5.0)] = 0.3
    latency_s: Annotated[float, msgspec.Meta(ge=0, le=1.0)] = 0.015
    blind_s: Annotated[float, msgspec.Meta(gt=0, le=600.0)] = 15.0
    manual_timeout_s: Annotated[float, msgspec.Meta(gt=0, le=5.0)] = 0.5
    neutral_channels: tuple[Annotated[int, msgspec.Meta(ge=1, le=16)], ...] = (1, 2, 3, 4)


class BatteryLimits(Table, frozen=True, kw_only=True):
    """Below which voltage [V] or charge [%] the battery is low (a warning) and critical (neutral); None: never."""

    low_V: Voltage | None = None
    critical_V: Voltage | None = None
    low_percent: Percent | None = None
    critical_percent: Percent | None = None

    def __post_init__(self) -> None:
        pairs = (("V", self.low_V, self.critical_V), ("percent", self.low_percent, self.critical_percent))
        for unit, low, critical in pairs:
            if low is not None and critical is not None and critical >= low:
                raise ValueError(f"critical_{unit}: expected less than low_{unit} = {low:g}")


class LogFolder(Table, frozen=True, kw_only=True):
    """Where logs go, and how many megabytes (1e6 bytes) of them are kept; None: the current folder, all of them."""

    folder: str | None = None
    quota_MB: Annotated[float, msgspec.Meta(ge=0.001, le=1e9)] | None = None

    def __post_init__(self) -> None:
        if self.folder == "":
            raise ValueError("folder: expected a path, found nothing; leave it out for the current folder")


class RunFile(Table, frozen=True, kw_only=True):
    """One run. `excitation`: what `aritra run --excite` flies instead of the mission.

    `uwb`: needed by a boat with a tag; `devices`: wires of its other sensors that have one.
    """

    FILE: ClassVar = file_kinds.RUN
    vessel: str
    site: str
    mission: str
    excitation: str | None = None
    mavlink: MavlinkLink
    uwb: UwbLink | None = None
    devices: dict[str, SensorWire] = msgspec.field(default_factory=dict)
    forward: ForwardLink | None = None
    vision: VisionTable | None = None
    telemetry: TelemetryLink | None = None
    control: Control = Control()
    battery: BatteryLimits = BatteryLimits()
    log: LogFolder = LogFolder()

    @staticmethod
    def wire_table(key: str) -> str:
        """The table that states a sensor's own wire, by its key in the vessel file."""
        return "uwb" if key == "uwb" else f"devices.{key}"

    def wire(self, key: str) -> str | None:
        """Address of a sensor's own wire, by its key in the vessel file; None: not stated."""
        if key == "uwb":
            return self.uwb.url if self.uwb else None
        return self.devices[key].url if key in self.devices else None

    def device_name(self, key: str) -> str:
        """Name of a sensor in messages and logs."""
        return self.uwb.tag if key == "uwb" and self.uwb else key


def load_run(text: str, *, name: str) -> RunFile:
    """Run file text -> RunFile. Raises ConfigError naming file and key."""
    return parse_toml(text, RunFile, name=name)
