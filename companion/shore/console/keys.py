"""Command keys of boats, looked for again and again; one that cannot be used costs its boat orders, and no other."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable

from companion.core.configuration.tables import ConfigError
from companion.core.telemetry.order_sender import Sender

LOOK_S = 2.0
"""Period of looking for a boat's key, whether it is missing, unusable or another by now [s]; assumed."""
NAMES = 1000
"""Names that are looked after at a time (assumed)."""
NO_KEY = "no command key for this boat (give --command-key BOAT=FILE)"


class Keys:
    """Makers of signed orders, by boat. `sender`: the name under which orders are given.

    `find`: the boat's key, or None, asked again now and then; ConfigError says what is wrong with its file. None: this
    console only looks. A key that was found counts until another is there in its place.
    """

    def __init__(self, find: Callable[[str], bytes | None] | None, sender: str) -> None:
        self._find, self._sender = find, sender
        self._found: dict[str, tuple[bytes, Sender]] = {}
        self._looked: dict[str, tuple[float, str]] = {}

    def __bool__(self) -> bool:
        return self._find is not None

    def of(self, boat: str) -> Sender | str:
        """The maker of a boat's orders, or why there is none, as a sentence."""
        why = self._look(boat)
        return self._found[boat][1] if boat in self._found else why or NO_KEY

    def problem(self, boat: str) -> str:
        """What is wrong with a boat's key; empty: nothing, or there is none."""
        why = self._look(boat)
        return "" if boat in self._found else why

    def _look(self, boat: str) -> str:
        """Look for its key, if the last time is long ago; what is wrong with the file."""
        now_s = time.monotonic()
        if boat in self._looked and now_s - self._looked[boat][0] < LOOK_S:
            return self._looked[boat][1]
        if len(self._looked) >= NAMES:
            self._looked.clear()
        key, why = None, ""
        try:
            key = self._find(boat) if self._find else None
        except (ConfigError, OSError) as error:
            why = f"{boat} can be given no orders: {error}"
        self._looked[boat] = now_s, why
        if key is not None and (boat not in self._found or self._found[boat][0] != key):
            self._found[boat] = key, Sender(boat, secrets.token_hex(8), self._sender, key, time.monotonic_ns)
        return why
