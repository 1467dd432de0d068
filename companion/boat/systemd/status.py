"""Notifications for the service manager, and when they are due: ready, alive, status, stopping.

    state = next_state(state, message)                 the newest messages that the status is made of
    known, lines = due_lines(known, state, timing)     once a lease; `timing` says whether it was sent

READY=1 follows the first lease that was sent, WATCHDOG=1 only a lease that was sent. So a loop that hangs,
and a wire that stays closed, both end in a restart, and nothing else in the process can feign life. Before the
first lease there is no watchdog: while the wire cannot be opened the start is extended again and again.
Both functions are pure; `Service` remembers, and sends again what the socket did not take.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

from companion.boat.systemd.notify import SdNotify
from companion.core.messages import (
    ExcitationStatus,
    GuidanceReference,
    LinkStatus,
    LoopTiming,
    Message,
    OverrideLease,
)

PETS_PER_WATCHDOG = 4
"""sd_watchdog_enabled(3) asks for 2; with 4 one lost datagram does not matter."""
STATUS_NS = 1_000_000_000
"""The status changes at most this often."""
EXTEND_NS, EXTENSION_US = 10_000_000_000, 60_000_000
"""While starting: every 10 s another minute. Building the controller takes seconds; a minute is assumed enough."""


@dataclass(frozen=True)
class ServiceState:
    """The newest messages that a status is made of."""

    lease: OverrideLease | None = None
    reference: GuidanceReference | None = None
    excitation: ExcitationStatus | None = None
    link: LinkStatus | None = None


@dataclass(frozen=True)
class ManagerState:
    """What the service manager knows. `pet_ns`, `status_ns`, `extended_ns`: of its latest notifications."""

    ready: bool = False
    status: str = ""
    status_ns: int | None = None
    pet_ns: int | None = None
    extended_ns: int | None = None


def next_state(state: ServiceState, message: Message) -> ServiceState:
    """The state after one message."""
    if isinstance(message, OverrideLease):
        return replace(state, lease=message)
    if isinstance(message, GuidanceReference):
        return replace(state, reference=message)
    if isinstance(message, ExcitationStatus):
        return replace(state, excitation=message)
    if isinstance(message, LinkStatus) and message.link == "mavlink":
        return replace(state, link=message)
    return state


def due_lines(
    known: ManagerState, state: ServiceState, timing: LoopTiming, watchdog_ns: int | None
) -> tuple[ManagerState, list[str]]:
    """Lines to send after one lease, and what the manager knows once it has taken them. `watchdog_ns`: None is off."""
    now, lines = timing.t_ns, []
    if timing.sent:
        if not known.ready:
            lines.append("READY=1")
        if watchdog_ns and _due(known.pet_ns, now, watchdog_ns // PETS_PER_WATCHDOG):
            lines.append("WATCHDOG=1")
            known = replace(known, pet_ns=now)
        known = replace(known, ready=True)
    elif not known.ready and _due(known.extended_ns, now, EXTEND_NS):
        lines.append(f"EXTEND_TIMEOUT_USEC={EXTENSION_US}")
        known = replace(known, extended_ns=now)
    text = status_text(state, sent=timing.sent)
    if text != known.status and _due(known.status_ns, now, STATUS_NS):
        lines.append(f"STATUS={text}")
        known = replace(known, status=text, status_ns=now)
    return known, lines


def status_text(state: ServiceState, *, sent: bool) -> str:
    """One line on what the boat does. `sent`: whether the newest lease went out."""
    if not sent:
        why = state.link.reason if state.link else ""
        return "no wire to the autopilot" + (f": {why}" if why else "")
    lease, g, x = state.lease, state.reference, state.excitation
    if lease is None or lease.source == "neutral":
        return f"neutral: {lease.reason}" if lease and lease.reason else "neutral"
    if lease.source == "excitation":
        return "excitation" + (f": {x.phase}, segment {min(x.segment + 1, x.segments)} of {x.segments}" if x else "")
    if lease.source == "manual":
        return f"by hand: {lease.reason}"
    where = f": {g.phase}, {g.waypoints_passed} waypoints passed" if g else ""
    return f"driving{where}" + ("" if lease.source == "plan" else f"; fallback {lease.source}")


class Service:
    """Notifies the service manager of one run. Outside a service nothing happens."""

    def __init__(self, notify: SdNotify):
        self._notify = notify
        self._state, self._known = ServiceState(), ManagerState()
        self._stopping = False

    def starting(self, what: str) -> None:
        """Status before the first lease, and a request for more time to start."""
        self._notify.send([f"STATUS=starting: {what}", f"EXTEND_TIMEOUT_USEC={EXTENSION_US}"])

    def see(self, message: Message) -> None:
        """Take one message; after a lease, send what is due."""
        self._state = next_state(self._state, message)
        if isinstance(message, LoopTiming) and not self._stopping:
            known, lines = due_lines(self._known, self._state, message, self._notify.watchdog_ns)
            if self._notify.send(lines):
                self._known = known

    def stopping(self) -> None:
        """Notify, once, that the end has begun."""
        if not self._stopping:
            self._stopping = True
            self._notify.send(["STOPPING=1", "STATUS=stopping: neutral for a second, then disarm and release"])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stopping()
        self._notify.close()


def _due(last_ns: int | None, now_ns: int, period_ns: int) -> bool:
    return last_ns is None or now_ns - last_ns >= period_ns
