"""Dataflash logs over MAVLink: LOG_REQUEST_LIST, LOG_REQUEST_DATA, in pieces of 90 bytes.

Numbers from 1. Without logs the list is one LOG_ENTRY that says so; data leave at `PIECES_A_STEP` a step of the
simulation; a request beyond the end ends with a short piece (source, `AP_Logger_MAVLinkLogTransfer`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot.mavlink.link import PeerLink

PIECE_BYTES = 90
PIECES_A_STEP = 40
WRITTEN_S = 1_767_225_600
"""time_utc of the first log: 2026-01-01; each later one a minute after the one before."""


class Logs:
    """`stored`: contents, log 1 first."""

    def __init__(self, stored: Sequence[bytes] = ()):
        self.stored = list(stored)
        self._due: dict[PeerLink, deque[tuple[int, int]]] = {}

    def list_to(self, link: PeerLink, start: int, end: int) -> None:
        """Answer LOG_REQUEST_LIST."""
        count = len(self.stored)
        if not count:
            link.send(wire.MAVLink_log_entry_message(0, 0, 0, 0, 0))
        for number in range(max(1, start), min(end, count) + 1):
            size, written_s = len(self.stored[number - 1]), WRITTEN_S + 60 * (number - 1)
            link.send(wire.MAVLink_log_entry_message(number, count, count, written_s, size))

    def data_to(self, link: PeerLink, number: int, offset: int, count: int) -> None:
        """Take a LOG_REQUEST_DATA; the pieces leave with `poll`."""
        if 1 <= number <= len(self.stored):
            end = min(offset + count, len(self.stored[number - 1]))
            pieces = range(offset, max(end, offset + 1), PIECE_BYTES)
            self._due.setdefault(link, deque()).extend((number, at) for at in pieces)

    def end(self, link: PeerLink) -> None:
        """LOG_REQUEST_END: no more of it."""
        self._due.pop(link, None)

    def poll(self) -> None:
        """Send what is due in one step."""
        for link, due in self._due.items():
            for _ in range(min(PIECES_A_STEP, len(due))):
                number, at = due.popleft()
                data = self.stored[number - 1][at : at + PIECE_BYTES]
                link.send(wire.MAVLink_log_data_message(number, at, len(data), list(data.ljust(PIECE_BYTES, b"\0"))))
