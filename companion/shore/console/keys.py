"""Command keys of boats, looked for again and again; one that cannot be used costs its boat orders, and no other."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable

from companion.core.configuration.tables import ConfigError
from companion.core.telemetry.order_sender import Sender

LOOK_S = 2.0
"""Period of looking for a boat's missing or unusable key [s]; assumed."""
NAMES = 1000
"""Names that are looked after at a time (assumed)."""
NO_KEY = "no command key for this boat (give --command-key BOAT=FILE)"


class Keys:
    """Makers of signed orders, by boat. `sender`: the name under which orders are given.

    `find`: the boat's key, or None, asked again now and then; ConfigError says what is wrong with its file. None: this
    console only looks.
    """

    def __init__(self, find: Callable[[str], bytes | None] | None, sender: str) -> None:
        self._find, self._sender = find, sender
        self._senders: dict[str, Sender] = {}
        self._problems: dict[str, tuple[float, str]] = {}

    def __bool__(self) -> bool:
        return self._find is not None

    def of(self, boat: str) -> Sender | str:
        """The maker of a boat's orders, or why there is none, as a sentence."""
        if boat not in self._senders:
            self._look(boat)
        return self._senders.get(boat) or self._problems[boat][1] or NO_KEY

    def problem(self, boat: str) -> str:
        """What is wrong with a boat's key; empty: nothing, or there is none."""
        if boat not in self._senders:
            self._look(boat)
        return "" if boat in self._senders else self._problems[boat][1]

    def _look(self, boat: str) -> None:
        now_s = time.monotonic()
        if boat in self._problems and now_s - self._problems[boat][0] < LOOK_S:
            return
        if len(self._problems) >= NAMES:
            self._problems.clear()
        try:
            key = self._find(boat) if self._find else None
            self._problems[boat] = now_s, ""
        except (ConfigError, OSError) as error:
            key, self._problems[boat] = None, (now_s, f"{boat} can be given no orders: {error}")
        if key is not None:
            self._senders[boat] = Sender(boat, secrets.token_hex(8), self._sender, key, time.monotonic_ns)
