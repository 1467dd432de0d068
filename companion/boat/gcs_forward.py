"""A ground station beside the companion: it sees the autopilot's stream and ours, and may speak where allowed.

    autopilot -> every frame as it came -> station          our own frames, but TIMESYNC -> station
    station -> GcsFirewall -> autopilot                     only where the run file says `writable`

Nothing here makes the control loop wait: what the station's port does not take is dropped and counted, a station
that is absent costs nothing, and a fault of its port is one alert and a new attempt.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Literal

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.boat.clock import Clock
from companion.core.messages import Alert
from drivers.mavlink.gcs_firewall import RATE_BYTES_S, UNTOLD, GcsFirewall
from drivers.ports.port import Port

RETRY_NS = 2_000_000_000
"""Between attempts to open a port (assumed)."""
TELL_AGAIN_NS = 60_000_000_000
"""The station is told of the same refusal at most so often (assumed: its program may repeat itself)."""


class GcsForward:
    """The station's side of one run. `gate`: judges what it sends; None: nothing of it passes (read-only).

    `words`: frames of a text for the station, by which it hears of each refusal; the alert about it comes once.
    `shown`: frames given to the port; `read_only_bytes`: bytes of the station that were dropped unread.
    """

    def __init__(
        self, port: Port, gate: GcsFirewall | None, clock: Clock, words: Callable[[str], Sequence[bytes]]
    ) -> None:
        self.shown = 0
        self.read_only_bytes = 0
        self._port, self._gate, self._clock, self._words = port, gate, clock, words
        self._open = False
        self._told: set[str] = set()
        self._counted: dict[tuple[str, str], int] = {}
        self._told_ns: dict[str, int] = {}

    def show(self, frame: bytes) -> None:
        """Show the station a frame of the autopilot; dropped where its port is not open."""
        if self._open:
            with contextlib.suppress(OSError):
                self._port.send(frame)
                self.shown += 1

    def show_own(self, frame: bytes) -> None:
        """Show the station a frame of ours. Not TIMESYNC: a station may answer it in the autopilot's place."""
        if int.from_bytes(frame[7:10], "little") != dialect.MAVLINK_MSG_ID_TIMESYNC:
            self.show(frame)

    async def run(
        self, to_autopilot: Callable[[bytes], object], tell: Callable[[Alert], None], disarmed: Callable[[], bool]
    ) -> None:
        """For ever: keep the port open, and pass on what the station may say. Cancelling closes the port."""
        try:
            while True:
                try:
                    await self._port.open()
                    self._open = True
                    while data := await self._port.receive():
                        self._hear(data, to_autopilot, tell, disarmed())
                    trouble = "the other end is gone"
                except OSError as error:
                    trouble = error.strerror or str(error)
                await self._shut()
                self._tell_once(tell, f"forward: {self._port.name}: {trouble}; trying again", "warning")
                await self._clock.sleep_until(self._clock.now_ns() + RETRY_NS)
        finally:
            await self._shut()

    async def _shut(self) -> None:
        self._open = False
        with contextlib.suppress(OSError):
            await self._port.close()

    def _hear(
        self, data: bytes, to_autopilot: Callable[[bytes], object], tell: Callable[[Alert], None], disarmed: bool
    ) -> None:
        if self._gate is None:
            self.read_only_bytes += len(data)
            text = f"ground station on {self._port.name}: it may look, but what it sends is dropped"
            self._tell_once(tell, f"{text} (forward.writable is false)", "info")
            return
        for frame in self._gate.feed(data, self._clock.now_ns(), disarmed=disarmed):
            to_autopilot(frame)
        for refusal, count in self._gate.refused.items():
            if count > self._counted.get(refusal, 0) and refusal[0] not in UNTOLD:
                self._counted[refusal] = count
                self._refuse(*refusal, tell)
        if self._gate.flood_bytes:
            text = f"ground station sends more than {RATE_BYTES_S} bytes a second: dropped, not to delay our commands"
            self._tell_once(tell, text, "warning")

    def _refuse(self, name: str, reason: str, tell: Callable[[Alert], None]) -> None:
        """One alert for the boat's people, and a word to the station, again where it tries later."""
        self._tell_once(tell, f"ground station's {name} not passed on: {reason}", "warning")
        text, now = f"Aritra: {name} refused: {reason}", self._clock.now_ns()
        if now - self._told_ns.get(text, -TELL_AGAIN_NS) >= TELL_AGAIN_NS:
            self._told_ns[text] = now
            for frame in self._words(text):
                self.show(frame)

    def _tell_once(self, tell: Callable[[Alert], None], text: str, level: Literal["info", "warning"]) -> None:
        if text not in self._told:
            self._told.add(text)
            tell(Alert(t_ns=self._clock.now_ns(), level=level, text=text))
