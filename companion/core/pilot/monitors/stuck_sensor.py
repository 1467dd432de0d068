"""Sensors that say the same again and again: a device that is stuck, though its stamps may well go on.

Inertial sensors are never without noise. Readings that are the same to the last bit for `STUCK_NS` are left out from
then on, so that the filter misses them as it misses a sensor that has fallen silent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from companion.core.messages import Alert, Attitude, ImuSample
from companion.core.pilot.monitors.monitor import Monitor, MonitorReport

STUCK_NS, LEAST = 1_000_000_000, 5
"""So long, and so many readings; assumed: an autopilot on a table changes some digit in that time."""


@dataclass(frozen=True)
class Repeats:
    """The last reading of one sensor, since when it has been said, and how often."""

    reading: tuple[float, ...] = ()
    since_ns: int = 0
    count: int = 0
    stuck: bool = False


NOTHING_READ = Repeats()


@dataclass(frozen=True)
class SensorRepeats:
    """`by_type`: repeats of each inertial sensor, by the type of its message."""

    by_type: Mapping[str, Repeats] = field(default_factory=dict)


class StuckSensorMonitor(Monitor[SensorRepeats]):
    """Withholds readings of a stuck sensor from the estimator; alerts as that begins and ends."""

    hears = (ImuSample, Attitude)
    screens = True
    initial = SensorRepeats()

    def on_message(
        self, state: SensorRepeats, message: ImuSample | Attitude, t_ns: int
    ) -> tuple[SensorRepeats, MonitorReport]:
        """One more reading."""
        kind = type(message).__name__
        now, alerts = next_reading(state.by_type.get(kind, NOTHING_READ), message, t_ns)
        return SensorRepeats({**state.by_type, kind: now}), MonitorReport(alerts=alerts, withhold=now.stuck)


def next_reading(before: Repeats, message: ImuSample | Attitude, t_ns: int) -> tuple[Repeats, tuple[Alert, ...]]:
    """One more reading of one sensor at `t_ns` [ns]."""
    reading, name = _reading(message)
    if reading != before.reading:
        alert = Alert(t_ns=t_ns, level="info", text=f"{name}: readings change again")
        return Repeats(reading, t_ns, 1), (alert,) if before.stuck else ()
    stuck = t_ns - before.since_ns >= STUCK_NS and before.count + 1 >= LEAST
    now = Repeats(reading, before.since_ns, before.count + 1, stuck)
    if not stuck or before.stuck:
        return now, ()
    text = f"{name}: the same reading for {(t_ns - before.since_ns) * 1e-9:.1f} s: frozen, left out from now on"
    return now, (Alert(t_ns=t_ns, level="error", text=text),)


def _reading(message: ImuSample | Attitude) -> tuple[tuple[float, ...], str]:
    rates = (message.p_rad_s, message.q_rad_s, message.r_rad_s)
    if isinstance(message, ImuSample):
        return (message.ax_m_s2, message.ay_m_s2, message.az_m_s2, *rates), f"IMU ({message.source})"
    return (message.phi_rad, message.theta_rad, message.psi_rad, *rates), "attitude"
