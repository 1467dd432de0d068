"""What the service manager is told, and when: ready, alive, in words what is going on, about to stop.

    heard' = hear(heard, message)            what the status is made of
    said', lines = say(said, heard, timing)  once a lease; `timing` tells whether it was sent

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
    """The newest of what a status is made of."""

    lease: OverrideLease | None = None
    reference: GuidanceReference | None = None
    excitation: ExcitationStatus | None = None
    link: LinkStatus | None = None


@dataclass(frozen=True)
class Said:
    """What the service manager knows. `pet_ns`, `status_ns`, `extended_ns`: when it was last told."""

    ready: bool = False
    status: str = ""
    status_ns: int | None = None
    pet_ns: int | None = None
    extended_ns: int | None = None


def hear(heard: ServiceState, message: Message) -> ServiceState:
    """Keep what matters of one message."""
    if isinstance(message, OverrideLease):
        return replace(heard, lease=message)
    if isinstance(message, GuidanceReference):
        return replace(heard, reference=message)
    if isinstance(message, ExcitationStatus):
        return replace(heard, excitation=message)
    if isinstance(message, LinkStatus) and message.link == "mavlink":
        return replace(heard, link=message)
    return heard


def say(said: Said, heard: ServiceState, timing: LoopTiming, watchdog_ns: int | None) -> tuple[Said, list[str]]:
    """Lines to send after one lease, and what is known once they are taken. `watchdog_ns`: None is no watchdog."""
    now, lines = timing.t_ns, []
    if timing.sent:
        if not said.ready:
            lines.append("READY=1")
        if watchdog_ns and _due(said.pet_ns, now, watchdog_ns // PETS_PER_WATCHDOG):
            lines.append("WATCHDOG=1")
            said = replace(said, pet_ns=now)
        said = replace(said, ready=True)
    elif not said.ready and _due(said.extended_ns, now, EXTEND_NS):
        lines.append(f"EXTEND_TIMEOUT_USEC={EXTENSION_US}")
        said = replace(said, extended_ns=now)
    text = words(heard, sent=timing.sent)
    if text != said.status and _due(said.status_ns, now, STATUS_NS):
        lines.append(f"STATUS={text}")
        said = replace(said, status=text, status_ns=now)
    return said, lines


def words(heard: ServiceState, *, sent: bool) -> str:
    """What the boat does, in a line. `sent`: the newest lease went out."""
    if not sent:
        why = heard.link.reason if heard.link else ""
        return "no wire to the autopilot" + (f": {why}" if why else "")
    lease, g, x = heard.lease, heard.reference, heard.excitation
    if lease is None or lease.source == "neutral":
        return f"neutral: {lease.reason}" if lease and lease.reason else "neutral"
    if lease.source == "excitation":
        return "excitation" + (f": {x.phase}, segment {min(x.segment + 1, x.segments)} of {x.segments}" if x else "")
    if lease.source == "manual":
        return f"by hand: {lease.reason}"
    where = f": {g.phase}, {g.waypoints_passed} waypoints passed" if g else ""
    return f"driving{where}" + ("" if lease.source == "plan" else f"; fallback {lease.source}")


class Service:
    """This run, as the service manager sees it. Outside a service nothing happens."""

    def __init__(self, notify: SdNotify):
        self._notify = notify
        self._heard, self._said = ServiceState(), Said()
        self._stopping = False

    def starting(self, what: str) -> None:
        """Say what takes its time before the first lease, and ask for that time."""
        self._notify.send([f"STATUS=starting: {what}", f"EXTEND_TIMEOUT_USEC={EXTENSION_US}"])

    def see(self, message: Message) -> None:
        """Note one message; after a lease, tell what is due."""
        self._heard = hear(self._heard, message)
        if isinstance(message, LoopTiming) and not self._stopping:
            said, lines = say(self._said, self._heard, message, self._notify.watchdog_ns)
            if self._notify.send(lines):
                self._said = said

    def stopping(self) -> None:
        """Say once that the end has begun."""
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
