"""A tag that repeats its last ranges: its stream goes on while its anchors are silent, or the tag has hung.

A range carries noise of some centimetres in units of a millimetre or a centimetre, so that two readings in a row are
seldom equal (3 % at 1 cm and 0.1 m), and those of all anchors never. What repeats is not fused: a message whose ranges
all repeat, and an anchor that has repeated itself five times in a row.
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
from msgspec.structs import replace

from companion.core.messages import Alert, UwbPosition, UwbRanges
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport

ALERT_NS, ALERT_READINGS = 950_000_000, 4
"""Readings so old, and so many repeats of them, are told: a tag may renew its ranges once a second and say them ten
times; four repeats are chance once in a million messages. Assumed."""
ANCHOR_REPEATS = 5
"""Of one anchor alone; by chance (3 % a reading at 1 cm) once in 4,000 hours at 1 Hz with four anchors."""


class RangeRepeats(msgspec.Struct, frozen=True):
    """`last`: the latest reading of each anchor [m] and how often it has been repeated; `new_ns`: when something new
    was said; `told`: what the latest alert named, as text; `position`: the tag's own, and repeats of its coordinates.
    """

    last: Mapping[str, tuple[float, int]] = msgspec.field(default_factory=dict)
    new_ns: int = 0
    told: str = ""
    position: tuple[tuple[float, float] | None, int] = (None, 0)


class RepeatedRangesMonitor(Monitor[RangeRepeats]):
    """Withholds repeated messages, and takes out ranges of anchors that repeat themselves."""

    hears = (UwbRanges, UwbPosition)
    screens = True
    initial = RangeRepeats()

    def on_message(
        self, state: RangeRepeats, message: UwbRanges | UwbPosition, t_ns: int
    ) -> tuple[RangeRepeats, MonitorReport]:
        """One cycle of the tag."""
        if isinstance(message, UwbPosition):
            return self._position(state, message, t_ns)
        last = dict(state.last)
        for r in message.ranges:
            before, count = last.get(r.anchor, (None, 0))
            last[r.anchor] = (r.range_m, count + 1 if before == r.range_m else 0)
        counts = [last[r.anchor][1] for r in message.ranges]
        if len(counts) > 1 and min(counts) >= 1:
            return self._repeated(replace(state, last=last), sum(counts), t_ns)
        stuck = [r.anchor for r in message.ranges if last[r.anchor][1] >= ANCHOR_REPEATS]
        now = replace(state, last=last, new_ns=t_ns, told=", ".join(stuck))
        alerts = _changed(state, now, t_ns)
        if not stuck:
            return now, MonitorReport(alerts=alerts)
        good = tuple(r for r in message.ranges if r.anchor not in stuck)
        return now, MonitorReport(
            alerts=alerts, withhold=not good, instead=replace(message, ranges=good) if good else None
        )

    def _repeated(self, state: RangeRepeats, repeats: int, t_ns: int) -> tuple[RangeRepeats, MonitorReport]:
        """A message that says nothing new, with so many repeats since it was."""
        is_old = t_ns - state.new_ns >= ALERT_NS and repeats >= ALERT_READINGS
        now = replace(state, told="all" if is_old else state.told)
        return now, MonitorReport(alerts=_changed(state, now, t_ns), withhold=True)

    def _position(self, state: RangeRepeats, message: UwbPosition, t_ns: int) -> tuple[RangeRepeats, MonitorReport]:
        """The tag's own position."""
        place, (before, count) = (message.x_m, message.y_m), state.position
        if place == before:
            count += len(place)
            return self._repeated(replace(state, position=(place, count)), count, t_ns)
        if state.last:  # ranges come too, and judge
            return replace(state, position=(place, 0)), NOTHING
        now = replace(state, new_ns=t_ns, told="", position=(place, 0))
        return now, MonitorReport(alerts=_changed(state, now, t_ns))


def _changed(before: RangeRepeats, now: RangeRepeats, t_ns: int) -> tuple[Alert, ...]:
    """Alert where what repeats is another than before."""
    if now.told == before.told:
        return ()
    if not now.told:
        return (Alert(t_ns=t_ns, level="info", text="UWB: readings change again"),)
    who = "the tag repeats its last ranges" if now.told == "all" else f"anchor {now.told} repeats its last range"
    text = f"UWB: {who}: frozen, left out (are the anchors powered, has the tag hung?)"
    return (Alert(t_ns=t_ns, level="error", text=text),)
