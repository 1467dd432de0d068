"""Sensors that say the same again and again: a device that is stuck, though its stamps may well go on.

Inertial sensors are never without noise. Readings that are the same to the last bit for `STUCK_NS` are left out from
then on, so that the filter misses them as it misses a sensor that has fallen silent.
"""

from __future__ import annotations

from dataclasses import dataclass

from companion.core.messages import Alert, Attitude, ImuSample

STUCK_NS, LEAST = 1_000_000_000, 5
"""So long, and so many readings; assumed: an autopilot on a table changes some digit in that time."""


@dataclass(frozen=True)
class Repeats:
    """The last reading of one sensor, since when it has been said, and how often."""

    reading: tuple[float, ...] = ()
    since_ns: int = 0
    count: int = 0
    stuck: bool = False


NOTHING_HEARD = Repeats()


def hear(known: Repeats, message: ImuSample | Attitude, t_ns: int) -> tuple[Repeats, list[Alert]]:
    """One more reading at `t_ns`; while `stuck`, it should not be used. Told as that begins and ends."""
    reading, name = _reading(message)
    if reading != known.reading:
        told = [Alert(t_ns=t_ns, level="info", text=f"{name}: readings change again")] if known.stuck else []
        return Repeats(reading, t_ns, 1), told
    stuck = t_ns - known.since_ns >= STUCK_NS and known.count + 1 >= LEAST
    now = Repeats(reading, known.since_ns, known.count + 1, stuck)
    if not stuck or known.stuck:
        return now, []
    text = f"{name}: the same reading for {(t_ns - known.since_ns) * 1e-9:.1f} s: frozen, left out from now on"
    return now, [Alert(t_ns=t_ns, level="error", text=text)]


def _reading(message: ImuSample | Attitude) -> tuple[tuple[float, ...], str]:
    rates = (message.p_rad_s, message.q_rad_s, message.r_rad_s)
    if isinstance(message, ImuSample):
        return (message.ax_m_s2, message.ay_m_s2, message.az_m_s2, *rates), f"IMU ({message.source})"
    return (message.phi_rad, message.theta_rad, message.psi_rad, *rates), "attitude"
