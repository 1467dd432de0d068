"""When a device link is searching, online, stale or lost, and why: the rules, without any wire. Pure."""

from __future__ import annotations

import errno
import random
from dataclasses import dataclass
from typing import NamedTuple

from companion.core.messages import HELD_PORT, LinkState


@dataclass(frozen=True, slots=True)
class LinkTiming:
    """When silence means what [s]. Defaults assumed, for a device that speaks at 1 Hz or faster."""

    stale_after_s: float = 1.5
    lost_after_s: float = 5.0
    backoff_min_s: float = 0.1
    backoff_max_s: float = 2.0
    guess_after_s: float = 3.0
    """Bytes without a message are told as a wrong baud rate after so long, and not before `stale_after_s`: what a
    device says as it starts, or when it is spoken to, is no message either.
    """

    def __post_init__(self) -> None:
        if not 0.0 < self.stale_after_s < self.lost_after_s:
            raise ValueError(f"need 0 < stale_after_s < lost_after_s, got {self}")
        if not 0.0 < self.backoff_min_s <= self.backoff_max_s:
            raise ValueError(f"need 0 < backoff_min_s <= backoff_max_s, got {self}")

    @property
    def stale_after_ns(self) -> int:
        """The same in ns."""
        return round(self.stale_after_s * 1e9)

    @property
    def lost_after_ns(self) -> int:
        """The same in ns."""
        return round(self.lost_after_s * 1e9)

    @property
    def guess_after_ns(self) -> int:
        """From the first byte without a message to the guess why, in ns."""
        return max(round(self.guess_after_s * 1e9), self.stale_after_ns)


@dataclass(frozen=True, slots=True)
class LinkObservations:
    """What is known of a link at one instant; times in ns since the event, or since the port opened."""

    fault: str
    """Why the port is not open; empty while it is."""
    framed: bool
    """A message was decoded since the port opened."""
    silent_ns: int
    """Since the last byte."""
    frameless_ns: int
    """Since the last message."""
    babble_ns: int
    """Since bytes began to come that decode to no message; 0 without such bytes."""
    speaks: bool = False
    """Some of these were sound frames or lines, which told nothing."""


class LinkVerdict(NamedTuple):
    """State of a link, its cause (same words as long as it lasts), and the reason with its numbers.

    `reopen`: close the port and start again. So it is once lost, and after `lost_after_s` of bytes that
    tell nothing: a udpin port may have locked on to the wrong sender. Mere silence before the first
    message is no ground: opening a serial port resets some devices, and they would never get to speak.
    """

    state: LinkState
    cause: str
    reason: str
    reopen: bool = False


def link_state(before: LinkState, seen: LinkObservations, timing: LinkTiming) -> LinkVerdict:
    """State after `before`, given what was seen, and why. Pure; the whole state machine.

    | before          | port   | messages since it opened | last message    | after     |
    |-----------------|--------|--------------------------|-----------------|-----------|
    | lost            | any    | any                      | any             | searching |
    | searching       | closed | any                      | any             | searching |
    | online, stale   | closed | any                      | any             | lost      |
    | searching       | open   | none                     | -               | searching |
    | online, stale   | open   | none                     | -               | lost      |
    | other than lost | open   | some                     | < stale_after_s | online    |
    | searching       | open   | some                     | older           | searching |
    | online, stale   | open   | some                     | < lost_after_s  | stale     |
    | online, stale   | open   | some                     | older           | lost      |
    """
    had_it = before in ("online", "stale")
    if seen.fault:
        return LinkVerdict("lost" if had_it else "searching", seen.fault, seen.fault, reopen=True)
    if before != "lost" and seen.framed and seen.frameless_ns < timing.stale_after_ns:
        return LinkVerdict("online", "messages", "messages arrive")
    cause, reason = _why_no_messages(seen, timing)
    if not had_it:
        enough = cause in ("garbage", "nothing") and seen.babble_ns >= timing.lost_after_ns
        return LinkVerdict("searching", cause, reason, reopen=enough)
    if seen.framed and seen.frameless_ns < timing.lost_after_ns:
        return LinkVerdict("stale", cause, reason)
    return LinkVerdict("lost", cause, reason, reopen=True)


def _why_no_messages(seen: LinkObservations, timing: LinkTiming) -> tuple[str, str]:
    """Cause and reason."""
    if seen.frameless_ns < timing.stale_after_ns:
        return "waiting", "port open, waiting for a message"
    if seen.babble_ns and seen.silent_ns < timing.stale_after_ns:
        if seen.babble_ns < timing.guess_after_ns:
            return "waiting", f"bytes come, and no message for {seen.frameless_ns * 1e-9:.1f} s"
        if seen.speaks:
            since = f"for {seen.babble_ns * 1e-9:.1f} s"
            return "nothing", f"it speaks, but has told nothing {since}: nothing in its sight, or not our device?"
        return "garbage", f"bytes but no valid frame for {seen.babble_ns * 1e-9:.1f} s: wrong baud rate?"
    return "silence", f"no bytes for {seen.silent_ns * 1e-9:.1f} s"


def open_fault(link: str, port: str, error: OSError) -> str:
    """Why `port` of `link` could not be opened; where another program holds it, what to do."""
    if error.errno != errno.EADDRINUSE:
        return f"cannot open {port}: {error.strerror or error}"
    option = f"--{link}" if link in ("mavlink", "uwb") else f"--device {link}=URL"
    return f"{port} {HELD_PORT} (another aritra run?): end it, or give {option}"


def backoff_s(attempt: int, rng: random.Random, timing: LinkTiming) -> float:
    """Pause before reconnecting [s]: doubles with each attempt (from 0), +-25 %, within the limits."""
    whole = timing.backoff_min_s * 2.0 ** min(attempt, 30)
    jittered = min(whole, timing.backoff_max_s) * rng.uniform(0.75, 1.25)
    return min(max(jittered, timing.backoff_min_s), timing.backoff_max_s)
