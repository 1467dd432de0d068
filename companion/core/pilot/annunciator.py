"""What a person should be told as it changes: health of the estimate, source of the leases, unknown anchors.

A value and pure functions, like the pilot that it serves. It also keeps the time for which the estimate has
been degraded: after `Control.blind_s` of that the boat may not drive.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from companion.core.messages import Alert, Health, OverrideLease, StateEstimate, UwbRanges

RECOVERED_NS = 2_000_000_000
"""A filter that starts again calls itself healthy at once: only after so long is blindness over; assumed."""


@dataclass(frozen=True)
class AnnunciatorState:
    """What was last told. `degraded_ns`: since when the estimate has not been healthy for `RECOVERED_NS` in one go;

    `healthy_ns`: since when it is healthy.
    """

    health: Health = "initialising"
    source: str = "neutral"
    strangers: frozenset[str] = frozenset()
    degraded_ns: int | None = None
    healthy_ns: int | None = None


def at_estimate(seen: AnnunciatorState, estimate: StateEstimate) -> tuple[AnnunciatorState, list[Alert]]:
    """Tell a change of health, with its reason."""
    t_ns, changed = estimate.t_ns, estimate.health != seen.health
    healthy_ns = (seen.healthy_ns or t_ns) if estimate.health == "healthy" else None
    since = (seen.degraded_ns or t_ns) if estimate.health == "degraded" else seen.degraded_ns
    if healthy_ns is not None and t_ns - healthy_ns >= RECOVERED_NS:
        since = None
    seen = replace(seen, health=estimate.health, degraded_ns=since, healthy_ns=healthy_ns)
    if not changed:
        return seen, []
    level = "info" if estimate.health in ("healthy", "initialising") else "warning"
    text = f"state estimate {estimate.health}" + (f": {estimate.reason}" if estimate.reason else "")
    return seen, [Alert(t_ns=estimate.t_ns, level=level, text=text)]


def at_lease(seen: AnnunciatorState, lease: OverrideLease) -> tuple[AnnunciatorState, list[Alert]]:
    """Tell when the fallback ladder is entered, changed or left."""
    before, seen = seen.source, replace(seen, source=lease.source)
    if lease.source == before or "neutral" in (before, lease.source):
        return seen, []
    if lease.source == "plan":
        return seen, [Alert(t_ns=lease.t_ns, level="info", text="the controller's plans are back")]
    text = f"driving by {lease.source.replace('_', ' ')}: {lease.reason}"
    return seen, [Alert(t_ns=lease.t_ns, level="warning", text=text)]


def at_ranges(
    seen: AnnunciatorState, ranges: UwbRanges, anchors: tuple[str, ...]
) -> tuple[AnnunciatorState, list[Alert]]:
    """Tell, once each, of anchors that the site file does not know: their ranges are not used."""
    new = {r.anchor for r in ranges.ranges} - set(anchors) - seen.strangers
    if not new:
        return seen, []
    text = f"UWB anchor {', '.join(sorted(new))} is not in the site file (it knows {', '.join(anchors)}): not used"
    alert = Alert(t_ns=ranges.t_ns, level="warning", text=text)
    return replace(seen, strangers=seen.strangers | new), [alert]


def degraded_too_long(seen: AnnunciatorState, t_ns: int, limit_s: float) -> str | None:
    """Why the boat may not go on with a degraded estimate, or None."""
    if seen.health != "degraded" or seen.degraded_ns is None or t_ns - seen.degraded_ns <= limit_s * 1e9:
        return None
    return f"state estimate degraded for more than {limit_s:g} s"
