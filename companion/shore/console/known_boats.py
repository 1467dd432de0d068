"""What a program on shore knows of boats: their telemetry, and the keys that their orders are signed with."""

from __future__ import annotations

import time

from companion.core.telemetry.order_sender import Place, Sender
from companion.shore.console.keys import Keys
from companion.shore.console.store import BoatRecord, BoatStore


class KnownBoats:
    """As orders ask for it (`answers.Boats`), at this moment."""

    def __init__(self, boats: BoatStore, keys: Keys) -> None:
        self._boats, self._keys = boats, keys

    def sender(self, boat: str) -> Sender | str:
        """The maker of its orders, or why there is none."""
        return self._keys.of(boat)

    def place(self, boat: str) -> Place | None:
        """Run and clock by its telemetry; None: not known."""
        known = self._of(boat)
        return known.place(time.monotonic_ns()) if known else None

    def runs(self, boat: str) -> tuple[str, ...]:
        """Runs that its telemetry shows at present."""
        known = self._of(boat)
        return known.runs(time.monotonic_ns()) if known else ()

    def _of(self, boat: str) -> BoatRecord | None:
        return self._boats.boats.get(boat)
