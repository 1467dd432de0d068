"""Ranges, or positions, that the estimator's gates reject more often than reflections explain: a cumulative sum of
log-likelihood ratios (Page 1954).

    sum = max(0, sum + ln(q(z) / p(z)))      p: one in ten is rejected, q: one in three

It blames nobody: the estimate may be wrong as well as the ranges.
"""

from __future__ import annotations

import math

import msgspec

from companion.core.configuration.vessel_file import VesselFile
from companion.core.messages import Alert, Innovation
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport
from companion.core.sensors.sensor import POSITION_INNOVATIONS
from companion.core.sensors.table import position_kind

SOUND_SHARE, BAD_SHARE = 0.1, 0.35
"""Rejected of all: twice the reflections of a basin with walls; what leaves the boat half of its ranges. Assumed."""
LIMIT = 8.0
"""Seven in a row, or six cycles of four with 42 % of outliers; assumed: 1 in 3,000 by chance."""
REJECTED, ACCEPTED = math.log(BAD_SHARE / SOUND_SHARE), math.log((1 - BAD_SHARE) / (1 - SOUND_SHARE))


class RejectionState(msgspec.Struct, frozen=True):
    """`sum` [nats]; `is_high`: since it reached `LIMIT`, until it is 0 again."""

    sum: float = 0.0
    is_high: bool = False


class RejectedRangesMonitor(Monitor[RejectionState]):
    """Says that too many are rejected, and when they fit again."""

    hears = (Innovation,)
    initial = RejectionState()

    def __init__(self, vessel: VesselFile):
        self._words = position_kind(vessel.sensors).words
        self._weight = self._words.weight(vessel.sensors.position.rate_Hz)

    def on_message(self, state: RejectionState, message: Innovation, t_ns: int) -> tuple[RejectionState, MonitorReport]:
        """One innovation of a range or coordinate."""
        if not message.sensor.startswith(POSITION_INNOVATIONS):
            return state, NOTHING
        ratio = ACCEPTED if message.accepted else REJECTED
        total = min(max(0.0, state.sum + self._weight * ratio), 2 * LIMIT)
        now = RejectionState(total, total >= LIMIT or (state.is_high and total > 0.0))
        if now.is_high is state.is_high:
            return now, NOTHING
        text = f"{self._words.readings} fit the estimate again"
        if now.is_high:
            text = (
                f"{self._words.readings}: a third or more do not fit the estimate and are rejected (reflections, or is"
                " the estimate wrong?)"
            )
        return now, MonitorReport(alerts=(Alert(t_ns=t_ns, level="warning" if now.is_high else "info", text=text),))
