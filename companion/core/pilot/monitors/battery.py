"""The battery: its voltage without load spikes, and whether it is low or critical, by voltage or by per cent.

A limit counts once it has been passed for `LIMIT_NS`; it is left only well above, so that a pack that recovers
as soon as the thrusters rest does not switch to and fro.

A battery that is not told, or as no pack is, passes no limit: `BatteryWatch` says so.
"""

from __future__ import annotations

from typing import Literal

import msgspec
from msgspec.structs import replace

from companion.core.configuration.run_file import BatteryLimits
from companion.core.constants import pack_range
from companion.core.messages import Alert, Battery
from companion.core.pilot.modes import Event
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport, TickView

VOLTAGE_SHARE = 0.2
"""Weight of a new voltage reading against the old mean: load spikes should not shake the thrust; assumed."""
BLIND_NS = 10_000_000_000
"""So long without a reading that a pack can have is said; SYS_STATUS is asked for at 2 Hz. Assumed."""
LIMIT_NS = 5_000_000_000
"""A thruster's start pulls a pack down for a second or two; assumed."""
RECOVERED = 1.05
"""Share of a limit above which it is left; assumed: a 4S pack at rest gains some 0.5 V."""


class BatteryState(msgspec.Struct, frozen=True):
    """`voltage_v`: mean; `*_ns`: since when a limit has been passed; `low`, `critical`: for long enough."""

    voltage_v: float
    percent: int | None = None
    low_ns: int | None = None
    critical_ns: int | None = None
    low: bool = False
    critical: bool = False

    def __str__(self) -> str:
        voltage = f"{self.voltage_v:.1f} V"
        return voltage if self.percent is None else f"{voltage}, {self.percent} %"


class BatteryMonitor(Monitor[BatteryState]):
    """Conditions `battery_low` and `battery_critical`."""

    hears = (Battery,)

    def __init__(self, nominal_v: float, limits: BatteryLimits):
        self.initial = BatteryState(nominal_v)
        self._limits, self._range_v = limits, pack_range(nominal_v)

    def on_message(self, state: BatteryState, message: Battery, t_ns: int) -> tuple[BatteryState, MonitorReport]:
        """Take a reading; a voltage that no pack of this nominal one has is left out, as are per cent that none has."""
        (least, most), mean, percent = self._range_v, state.voltage_v, state.percent
        is_charge = message.remaining_percent is not None and 0 <= message.remaining_percent <= 100
        if is_voltage := least <= message.voltage_v <= most:
            mean += VOLTAGE_SHARE * (message.voltage_v - mean)
        if is_charge:
            percent = message.remaining_percent
        if not (is_voltage or is_charge):
            return state, NOTHING
        state, limits, t_ns = replace(state, voltage_v=mean, percent=percent), self._limits, message.t_ns
        low_ns, low = _passed(state, state.low_ns, state.low, limits.low_V, limits.low_percent, t_ns)
        critical_ns, critical = _passed(
            state, state.critical_ns, state.critical, limits.critical_V, limits.critical_percent, t_ns
        )
        return replace(state, low_ns=low_ns, low=low, critical_ns=critical_ns, critical=critical), NOTHING

    def on_tick(self, state: BatteryState, view: TickView) -> tuple[BatteryState, MonitorReport]:
        """Limits that count."""
        conditions: dict[Event, str] = {}
        if state.low:
            conditions["battery_low"] = f"battery low ({state})"
        if state.critical:
            conditions["battery_critical"] = f"battery critical ({state})"
        return state, MonitorReport(conditions)


class Reading(msgspec.Struct, frozen=True):
    """`since_ns`: instant of the latest one that a pack can have, or since when there could have been one; `blind`: it
    has been said that there is none; `seen`: what was told instead.
    """

    since_ns: int | None = None
    blind: bool = False
    seen: str = "nothing"


class BatteryReadings(msgspec.Struct, frozen=True):
    """What is told of the battery."""

    voltage: Reading = Reading()
    charge: Reading = Reading()


class BatteryWatch(Monitor[BatteryReadings]):
    """Alerts where limits of the battery count for nothing, as nothing that they could be held against is told."""

    hears = (Battery,)
    initial = BatteryReadings()

    def __init__(self, nominal_v: float, limits: BatteryLimits):
        self._range_v = pack_range(nominal_v)
        self._by_voltage = limits.low_V is not None or limits.critical_V is not None
        self._by_charge = limits.low_percent is not None or limits.critical_percent is not None

    def on_message(self, state: BatteryReadings, message: Battery, t_ns: int) -> tuple[BatteryReadings, MonitorReport]:
        """A reading; an alert where it is the first after it was said that there is none."""
        (least, most), percent = self._range_v, message.remaining_percent
        voltage, back = _told(state.voltage, least <= message.voltage_v <= most, f"{message.voltage_v:.1f} V", t_ns)
        seen = "nothing" if percent is None else f"{percent} %"
        charge, more = _told(state.charge, percent is not None and 0 <= percent <= 100, seen, t_ns)
        return BatteryReadings(voltage, charge), MonitorReport(alerts=back + more)

    def on_tick(self, state: BatteryReadings, view: TickView) -> tuple[BatteryReadings, MonitorReport]:
        """Readings that have not come for `BLIND_NS`. Of an autopilot that is silent nothing is expected."""
        least, most = self._range_v
        needed = f"a pack of {least:.1f} to {most:.1f} V was expected"
        limits = "low_V and critical_V count for nothing" if self._by_voltage else "thrust is reckoned without it"
        voltage, alerts = _missed(
            state.voltage, view, f"{needed}: {limits}; look at BATT_MONITOR", "error" if self._by_voltage else "warning"
        )
        charge, more = state.charge, ()
        if self._by_charge:
            why = "per cent were expected: low_percent and critical_percent count for nothing; look at BATT_CAPACITY"
            charge, more = _missed(state.charge, view, f"{why} and the current sensor", "error")
        return BatteryReadings(voltage, charge), MonitorReport(alerts=alerts + more)


def _told(before: Reading, sound: bool, seen: str, t_ns: int) -> tuple[Reading, tuple[Alert, ...]]:
    """One more reading."""
    if not sound:
        return replace(before, seen=seen), ()
    back = Alert(t_ns=t_ns, level="info", text=f"battery: {seen} is told, and its limits count again")
    return Reading(t_ns), (back,) if before.blind else ()


def _missed(
    before: Reading, view: TickView, why: str, level: Literal["warning", "error"]
) -> tuple[Reading, tuple[Alert, ...]]:
    """One more tick; the alert once it has been too many without a reading."""
    if before.since_ns is None or not view.autopilot_alive:
        return replace(before, since_ns=view.t_ns), ()
    if before.blind or view.t_ns - before.since_ns < BLIND_NS:
        return before, ()
    text = f"battery: the autopilot has told {before.seen} for {BLIND_NS * 1e-9:.0f} s, and {why}"
    return replace(before, blind=True), (Alert(t_ns=view.t_ns, level=level, text=text),)


def _passed(
    battery: BatteryState, since_ns: int | None, was: bool, volts: float | None, percent: float | None, t_ns: int
) -> tuple[int | None, bool]:
    """Since when a limit has been passed, and whether that counts."""
    share = RECOVERED if was else 1.0
    below = volts is not None and battery.voltage_v < share * volts
    below = below or (percent is not None and battery.percent is not None and battery.percent < share * percent)
    if not below:
        return None, False
    since_ns = t_ns if since_ns is None else since_ns
    return since_ns, was or t_ns - since_ns >= LIMIT_NS
