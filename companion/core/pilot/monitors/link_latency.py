"""How late the link to the autopilot is, from TIMESYNC answers; a condition of the mode table (`modes`).

    round trip = arrival of the answer - ts1 (when it was asked, our clock)

The median of the last `ENOUGH` answers counts, so that one that was held up stops nobody, and of answers that arrive
together the quickest: what waited together was held up together, and the last one asked tells how the line is now.
An autopilot that has never answered (old firmware) is not judged; `aritra check` says so. One that has, and does so
no more though its heartbeats come, is late beyond measure.
"""

from __future__ import annotations

from statistics import median

import msgspec
from msgspec.structs import replace

from companion.core.messages import TimeSync
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport, TickView
from companion.core.preflight.link import LATE_NS

PROMPT_NS = 300_000_000
"""Late until the median is below; assumed. Serial and USB take 1 to 20 ms, radios (57600 baud) 100 to 200 ms."""
SILENT_NS = 5_000_000_000
"""So long without a fresh answer, twenty questions, is silence; assumed. A parameter download delays, not silences."""
ENOUGH = 5
"""Answers: three late ones in a row, at 4 Hz, are a second and a quarter and their own delay."""
LAG_NS, LAGGED_NS = 50_000_000, 5_000_000_000
"""A tick so late is a busy computer's, and for so long what comes late is its doing; assumed."""
TOGETHER_NS = 125_000_000
"""Half the time between two questions."""


class RoundTrips(msgspec.Struct, frozen=True):
    """`took_ns` of the last answers, newest last; `asked_ns`, `heard_ns`: of the newest; `late`: at the last tick.

    `lagged_ns`: when a tick of ours was last late by `LAG_NS`, and by how much.
    """

    took_ns: tuple[int, ...] = ()
    asked_ns: int | None = None
    heard_ns: int = 0
    late: bool = False
    lagged_ns: tuple[int, int] | None = None


NO_ANSWER = RoundTrips()


class LinkLatencyMonitor(Monitor[RoundTrips]):
    """Condition `link_late`. While our own ticks are late, the computer is to blame, not the line."""

    hears = (TimeSync,)
    initial = NO_ANSWER

    def on_message(self, state: RoundTrips, message: TimeSync, t_ns: int) -> tuple[RoundTrips, MonitorReport]:
        """One TIMESYNC. Questions (tc1 is 0) and repeated answers change nothing; the codec drops answers to others."""
        took_ns = message.t_ns - message.ts1_ns
        repeated = state.asked_ns is not None and message.ts1_ns <= state.asked_ns
        if message.tc1_ns == 0 or repeated or took_ns < 0:
            return state, NOTHING
        before = state.took_ns
        if before and message.t_ns - state.heard_ns < TOGETHER_NS:
            took_ns, before = min(took_ns, before[-1]), before[:-1]
        latest = (*before, took_ns)[-ENOUGH:]
        return replace(state, took_ns=latest, asked_ns=message.ts1_ns, heard_ns=message.t_ns), NOTHING

    def on_tick(self, state: RoundTrips, view: TickView) -> tuple[RoundTrips, MonitorReport]:
        """Judge the link. After a silence of the autopilot what was known is of another link."""
        if view.lateness_ns >= LAG_NS:
            state = replace(state, lagged_ns=(view.t_ns, view.lateness_ns))
        if not view.autopilot_alive or state.asked_ns is None:
            return replace(NO_ANSWER, lagged_ns=state.lagged_ns), NOTHING
        if (silent_ns := view.t_ns - state.asked_ns) > SILENT_NS:
            text = f"the autopilot has not answered TIMESYNC for {silent_ns * 1e-9:.0f} s, though its heartbeats come"
            return replace(state, took_ns=(), late=True), MonitorReport({"link_late": text})
        if len(state.took_ns) == ENOUGH:
            limit_ns = PROMPT_NS if state.late else LATE_NS
            state = replace(state, late=median(state.took_ns) > limit_ns)
        if not state.late:
            return state, NOTHING
        duration = f" ({median(state.took_ns) * 1e-6:.0f} ms)" if state.took_ns else ""
        text = f"what is sent to the autopilot and back arrives late{duration}"
        return state, MonitorReport({"link_late": f"{text}: {_cause(state, view.t_ns)}"})


def _cause(state: RoundTrips, t_ns: int) -> str:
    """What to look for."""
    if state.lagged_ns and t_ns - state.lagged_ns[0] <= LAGGED_NS:
        return f"this computer is too busy, its own control loop was {state.lagged_ns[1] * 1e-6:.0f} ms late"
    return "look for a radio, a router or a full buffer on the way"
