"""The battery: its voltage without load spikes, and whether it is low or critical, by voltage or by per cent.

A limit counts once it has been passed for `LIMIT_NS`; it is left only well above, so that a pack that recovers
as soon as the thrusters rest does not switch to and fro.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from companion.core.configuration.run_file import BatteryLimits
from companion.core.messages import Battery
from companion.core.pilot.modes import Event
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport, TickView

VOLTAGE_SHARE = 0.2
"""Weight of a new voltage reading against the old mean: load spikes should not shake the thrust; assumed."""
VOLTAGE_RANGE = (0.5, 1.5)
"""Readings outside these shares of the nominal voltage are no pack's (0 V: no battery monitor); assumed."""
LIMIT_NS = 5_000_000_000
"""A thruster's start pulls a pack down for a second or two; assumed."""
RECOVERED = 1.05
"""Share of a limit above which it is left; assumed: a 4S pack at rest gains some 0.5 V."""


@dataclass(frozen=True)
class BatteryState:
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
        self._limits, self._range_v = limits, tuple(share * nominal_v for share in VOLTAGE_RANGE)

    def on_message(self, state: BatteryState, message: Battery, t_ns: int) -> tuple[BatteryState, MonitorReport]:
        """Take a reading; one that no pack of this nominal voltage has is left out."""
        least, most = self._range_v
        if not least <= message.voltage_v <= most:
            return state, NOTHING
        mean = state.voltage_v + VOLTAGE_SHARE * (message.voltage_v - state.voltage_v)
        percent = state.percent if message.remaining_percent is None else message.remaining_percent
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
