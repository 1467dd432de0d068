"""Sensors that say the same again and again though the boat moves: stuck, though their stamps may well go on.

A boat at rest may read the same for minutes: the autopilot filters its sensors and sends whole milli-g and mrad/s.
So a reading that repeats is stuck only where something else says that it should have changed: the rates of (other)
inertial sensors or, where all of these repeat, the pulses of the thrusters. It is left out from then on, so that the
filter misses it as it misses a sensor that has fallen silent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import msgspec
from msgspec.structs import replace

from companion.core.messages import Alert, Attitude, ImuSample, Measured, OverrideLease
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport
from companion.core.sensors.table import KIND_OF, REPEATABLE

STUCK_NS, LEAST = 1_000_000_000, 5
"""So long, and so many readings; assumed."""
FELT_NS = 500_000_000
"""So long after something moved every sensor must have felt it: dead time, lag and filters are 0.4 s; assumed."""
MOVED_RAD_S, MOVED_US = 0.01, 60.0
"""Ten units of the wire; about 3 N of a T200, or 0.04 m/s^2 of the reference boat, four units."""
SMOOTHING = 0.2
"""Share of a new reading in the mean of rates that testify; assumed. White noise of 0.002 rad/s departs from its first
reading by the limit within a minute; its mean of some five readings does not."""


class Repeats(msgspec.Struct, frozen=True):
    """The last reading of one sensor, since when it has been said, and how often.

    `witness`: what the others said first after that, by their type; `moved_ns`: since when one of them says otherwise.
    """

    reading: tuple[float, ...] = ()
    since_ns: int = 0
    count: int = 0
    stuck: bool = False
    witness: Mapping[str, tuple[float, ...]] = msgspec.field(default_factory=dict)
    moved_ns: int | None = None


NOTHING_READ = Repeats()


class SensorRepeats(msgspec.Struct, frozen=True):
    """`by_type`: repeats of each sensor, by its message; `rates_rad_s`: mean p, q, r of those that have them."""

    by_type: Mapping[str, Repeats] = msgspec.field(default_factory=dict)
    rates_rad_s: Mapping[str, tuple[float, ...]] = msgspec.field(default_factory=dict)


class StuckSensorMonitor(Monitor[SensorRepeats]):
    """Withholds readings of a stuck sensor from the estimator; alerts as that begins and ends."""

    hears = (*REPEATABLE, OverrideLease)
    screens = True
    initial = SensorRepeats()

    def on_message(
        self, state: SensorRepeats, message: Measured | OverrideLease, t_ns: int
    ) -> tuple[SensorRepeats, MonitorReport]:
        """One more reading, or new pulses."""
        kind = type(message).__name__
        others = {k: r for k, r in state.by_type.items() if k != kind}
        if isinstance(message, OverrideLease):
            return _pulses_testify(state, message, t_ns), NOTHING
        if isinstance(message, (ImuSample, Attitude)):
            rates = (message.p_rad_s, message.q_rad_s, message.r_rad_s)
            if all(map(math.isfinite, rates)):
                mean = _mean(state.rates_rad_s.get(kind, rates), rates)
                others = {k: _testify(r, kind, mean, MOVED_RAD_S, t_ns) for k, r in others.items()}
                state = replace(state, rates_rad_s={**state.rates_rad_s, kind: mean})
        if KIND_OF[type(message)].repeatable(message) is None:
            return replace(state, by_type=others), NOTHING
        now, alerts = next_reading(state.by_type.get(kind, NOTHING_READ), message, t_ns)
        return replace(state, by_type={**others, kind: now}), MonitorReport(alerts=alerts, withhold=now.stuck)


def next_reading(before: Repeats, message: Measured, t_ns: int) -> tuple[Repeats, tuple[Alert, ...]]:
    """One more reading of one sensor at `t_ns` [ns]."""
    name, reading = KIND_OF[type(message)].repeatable(message) or ("", ())
    if reading != before.reading:
        alert = Alert(t_ns=t_ns, level="info", text=f"{name}: readings change again")
        return Repeats(reading, t_ns, 1), (alert,) if before.stuck else ()
    long_enough = t_ns - before.since_ns >= STUCK_NS and before.count + 1 >= LEAST
    moved = before.moved_ns is not None and t_ns - before.moved_ns >= FELT_NS
    now = replace(before, count=before.count + 1, stuck=before.stuck or (long_enough and moved))
    if not now.stuck or before.stuck:
        return now, ()
    same_s = (t_ns - before.since_ns) * 1e-9
    text = f"{name}: the same reading for {same_s:.1f} s though the boat moves: frozen, left out from now on"
    return now, (Alert(t_ns=t_ns, level="error", text=text),)


def _pulses_testify(state: SensorRepeats, lease: OverrideLease, t_ns: int) -> SensorRepeats:
    """What pulses say of inertial sensors that all repeat themselves; while one of them lives, it knows better."""
    inertial = {k: r for k, r in state.by_type.items() if k in (ImuSample.__name__, Attitude.__name__)}
    if any(r.count < LEAST for r in inertial.values()):
        return state
    says = tuple(map(float, lease.pwm_us))
    judged = {k: _testify(r, type(lease).__name__, says, MOVED_US, t_ns) for k, r in inertial.items()}
    return replace(state, by_type={**state.by_type, **judged})


def _mean(before: tuple[float, ...], rates: tuple[float, ...]) -> tuple[float, ...]:
    """The running mean of rates after one more reading."""
    return tuple(m + SMOOTHING * (x - m) for m, x in zip(before, rates, strict=True))


def _testify(repeats: Repeats, kind: str, says: Sequence[float], limit: float, t_ns: int) -> Repeats:
    """What another sensor, or the pulses, say of a reading that repeats."""
    if repeats.moved_ns is not None:
        return repeats
    first = repeats.witness.get(kind)
    if first is None:
        return replace(repeats, witness={**repeats.witness, kind: tuple(says)})
    moved = any(abs(a - b) >= limit for a, b in zip(first, says, strict=False))
    return replace(repeats, moved_ns=t_ns) if moved else repeats
