"""How long an order to drive may wait in `starting`: what it was given for is another situation some time later.

Without an autopilot nobody sees it wait: the boat would drive off in the moment in which a cable is plugged in.
"""

from __future__ import annotations

from companion.core.pilot.modes import WANTED
from companion.core.pilot.state import PilotState

NOBODY_S = 10.0
"""Without an autopilot (assumed: its heartbeats come at 1 Hz, and a start is given when it is there)."""
WAITS_S = 120.0
"""For anything else, which stands in the reason meanwhile: an estimate settles in 12 s, the arming checks of an
autopilot that has just booted take up to a minute (assumed)."""


def has_expired(order: str, text: str) -> bool:
    """Whether the alert `text` says that `order` is dropped after its wait: here, or for the check of the autopilot."""
    return text.startswith(f"{order} expired")


def expiry(state: PilotState, heartbeat_ns: int | None, t_ns: int) -> str | None:
    """Why the order that `starting` waits with is dropped at `t_ns`; None: it is not.

    `heartbeat_ns`: instant of the autopilot's latest [ns]; None: there was none.
    """
    ordered_ns = state.ordered_ns
    if state.helm.mode != "starting" or ordered_ns is None:
        return None
    waited_ns, alone_ns = t_ns - ordered_ns, t_ns - max(ordered_ns, heartbeat_ns or ordered_ns)
    if waited_ns <= WAITS_S * 1e9 and alone_ns <= NOBODY_S * 1e9:
        return None
    (order,) = (event for event, mode in WANTED.items() if mode == state.helm.wanted)
    return f"{order} expired after {waited_ns * 1e-9:.0f} s ({state.helm.why}): give it again"
