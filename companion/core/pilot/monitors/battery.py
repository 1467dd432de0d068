"""The battery: its voltage without load spikes, and whether it is low or critical, by voltage or by per cent.

A limit counts once it has been passed for `LIMIT_NS`; it is left only well above, so that a pack that recovers
as soon as the thrusters rest does not switch to and fro.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from companion.core.configuration.run_file import BatteryLimits
from companion.core.messages import Battery

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
        told = f"{self.voltage_v:.1f} V"
        return told if self.percent is None else f"{told}, {self.percent} %"


def read(pack: BatteryState, message: Battery, nominal_v: float, limits: BatteryLimits) -> BatteryState:
    """Take a reading; one that no pack of `nominal_v` has is left out."""
    least, most = (share * nominal_v for share in VOLTAGE_RANGE)
    if not least <= message.voltage_v <= most:
        return pack
    mean = pack.voltage_v + VOLTAGE_SHARE * (message.voltage_v - pack.voltage_v)
    percent = pack.percent if message.remaining_percent is None else message.remaining_percent
    pack = replace(pack, voltage_v=mean, percent=percent)
    low_ns, low = _passed(pack, pack.low_ns, pack.low, limits.low_V, limits.low_percent, message.t_ns)
    critical_ns, critical = _passed(
        pack, pack.critical_ns, pack.critical, limits.critical_V, limits.critical_percent, message.t_ns
    )
    return replace(pack, low_ns=low_ns, low=low, critical_ns=critical_ns, critical=critical)


def _passed(
    pack: BatteryState, since_ns: int | None, was: bool, volts: float | None, percent: float | None, t_ns: int
) -> tuple[int | None, bool]:
    """Since when a limit has been passed, and whether that counts."""
    share = RECOVERED if was else 1.0
    below = volts is not None and pack.voltage_v < share * volts
    below = below or (percent is not None and pack.percent is not None and pack.percent < share * percent)
    if not below:
        return None, False
    since_ns = t_ns if since_ns is None else since_ns
    return since_ns, was or t_ns - since_ns >= LIMIT_NS
