"""Alerts as things change: health of the estimate, source of the leases, anchors that the site file does not know.

It also keeps the time for which the estimate has been degraded: after `Control.blind_s` of that the boat may not
drive.
"""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec.structs import replace

from companion.core.estimation.health import SETTLES
from companion.core.messages import Alert, Health, OverrideLease, StateEstimate, UwbRanges
from companion.core.pilot.modes import Event
from companion.core.pilot.monitors.monitor import Monitor, MonitorReport, TickView

RECOVERED_NS = 2_000_000_000
"""An estimate that has been healthy for less still counts as degraded; assumed."""


class AnnunciatorState(msgspec.Struct, frozen=True):
    """What the latest alerts said. `source`: of the leases; `unknown_anchors`: those already named.

    `degraded_ns`: since when [ns] the estimate has not been healthy for `RECOVERED_NS` in one go; `healthy_ns`: since
    when it is healthy; `known`: whether it ever was.
    """

    health: Health = "initialising"
    source: str = "neutral"
    unknown_anchors: frozenset[str] = frozenset()
    degraded_ns: int | None = None
    healthy_ns: int | None = None
    known: bool = False


class Annunciator(Monitor[AnnunciatorState]):
    """Conditions `unfit` and `degraded`, and alerts. `anchors`: known names; `blind_s`: how long it may be degraded."""

    hears = (StateEstimate, OverrideLease, UwbRanges)
    initial = AnnunciatorState()

    def __init__(self, anchors: tuple[str, ...], blind_s: float):
        self._anchors, self._blind_s = anchors, blind_s

    def on_message(self, state: AnnunciatorState, message: Any, t_ns: int) -> tuple[AnnunciatorState, MonitorReport]:
        """Alerts of what changes with this message."""
        if isinstance(message, StateEstimate):
            state, alerts = at_estimate(state, message)
        elif isinstance(message, OverrideLease):
            state, alerts = at_lease(state, message)
        else:
            state, alerts = at_ranges(state, message, self._anchors)
        return state, MonitorReport(alerts=tuple(alerts))

    def on_tick(self, state: AnnunciatorState, view: TickView) -> tuple[AnnunciatorState, MonitorReport]:
        """Whether the boat may drive by the estimate, and whether an excitation may."""
        estimate, conditions = view.estimate, dict[Event, str]()
        reason = f"state estimate {estimate.health}: {estimate.reason}"
        if estimate.health not in ("healthy", "degraded"):
            conditions["unfit"] = reason
        elif too_long := degraded_too_long(state, view.t_ns, self._blind_s):
            conditions["unfit"] = too_long
        if estimate.health != "healthy":
            conditions["degraded"] = reason
        return state, MonitorReport(conditions)


def at_estimate(state: AnnunciatorState, estimate: StateEstimate) -> tuple[AnnunciatorState, list[Alert]]:
    """Alert of a change of health, with its reason.

    The seconds in which a first estimate settles do not count, also where the IMU was heard after the first position.
    """
    if not state.known and estimate.reason == SETTLES:
        return replace(state, degraded_ns=None), []
    t_ns, changed = estimate.t_ns, estimate.health != state.health
    healthy_ns = (state.healthy_ns or t_ns) if estimate.health == "healthy" else None
    since = (state.degraded_ns or t_ns) if estimate.health == "degraded" else state.degraded_ns
    if healthy_ns is not None and t_ns - healthy_ns >= RECOVERED_NS:
        since = None
    known = state.known or estimate.health == "healthy"
    state = replace(state, health=estimate.health, degraded_ns=since, healthy_ns=healthy_ns, known=known)
    if not changed:
        return state, []
    level = "info" if estimate.health in ("healthy", "initialising") else "warning"
    text = f"state estimate {estimate.health}" + (f": {estimate.reason}" if estimate.reason else "")
    return state, [Alert(t_ns=estimate.t_ns, level=level, text=text)]


def at_lease(state: AnnunciatorState, lease: OverrideLease) -> tuple[AnnunciatorState, list[Alert]]:
    """Alert when the fallback ladder is entered, changed or left."""
    before, state = state.source, replace(state, source=lease.source)
    if lease.source == before or "neutral" in (before, lease.source):
        return state, []
    if lease.source == "plan":
        return state, [Alert(t_ns=lease.t_ns, level="info", text="the controller's plans are back")]
    text = f"driving by {lease.source.replace('_', ' ')}: {lease.reason}"
    return state, [Alert(t_ns=lease.t_ns, level="warning", text=text)]


def at_ranges(
    state: AnnunciatorState, ranges: UwbRanges, anchors: tuple[str, ...]
) -> tuple[AnnunciatorState, list[Alert]]:
    """Alert, once each, of anchors that the site file does not know: their ranges are not used."""
    new = {r.anchor for r in ranges.ranges} - set(anchors) - state.unknown_anchors
    if not new:
        return state, []
    text = f"UWB anchor {', '.join(sorted(new))} is not in the site file (it knows {', '.join(anchors)}): not used"
    alert = Alert(t_ns=ranges.t_ns, level="warning", text=text)
    return replace(state, unknown_anchors=state.unknown_anchors | new), [alert]


def degraded_too_long(state: AnnunciatorState, t_ns: int, limit_s: float) -> str | None:
    """Why the boat may not go on with a degraded estimate, or None."""
    if state.health != "degraded" or state.degraded_ns is None or t_ns - state.degraded_ns <= limit_s * 1e9:
        return None
    return f"state estimate degraded for more than {limit_s:g} s"
