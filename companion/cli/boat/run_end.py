"""When `aritra run --end-after S` ends by itself."""

from __future__ import annotations

from companion.core.messages import Alert, ExcitationStatus, GuidanceReference, Message, ModeStatus, OperatorCommand
from companion.core.pilot.order_expiry import has_expired

STOPPED_S = 60.0
"""An operator who stopped the boat, and has not started it again by then, is done with it; assumed."""


class RunEnd:
    """Mission or excitation has been done, or the boat in `safe`, for `after_s` [s]; None: it never ends by itself.

    So does a boat that an operator has stopped, after `STOPPED_S` at least, and at once one whose `order`, by which the
    run begins by itself, has expired; empty: an operator begins. `stopped`: it ended in one of these ways.
    """

    def __init__(self, after_s: float | None, order: str = ""):
        self._after_ns = None if after_s is None else after_s * 1e9
        self._order = order
        self._done_ns: int | None = None
        self._under_way = False
        self._stopped: tuple[str, int] = "", 0
        self.stopped = False

    def see(self, message: Message) -> bool:
        """Note one message; whether the run ends now."""
        if self._after_ns is None:
            return False
        if isinstance(message, GuidanceReference | ExcitationStatus):
            self._done_ns = (self._done_ns or message.t_ns) if message.phase in ("done", "failed") else None
        elif isinstance(message, ModeStatus):
            self._see_mode(message)
        elif isinstance(message, OperatorCommand) and message.command == "stop" and self._order:
            self._under_way = True  # it would have been: nobody else gives the order anew
        elif isinstance(message, Alert) and self._order and has_expired(self._order, message.text):
            self.stopped = True
        mode, since_ns = self._stopped
        patience_ns = max(self._after_ns, STOPPED_S * 1e9) if mode == "idle" else self._after_ns
        self.stopped = self.stopped or (mode != "" and message.t_ns - since_ns >= patience_ns)
        return self.stopped or (self._done_ns is not None and message.t_ns - self._done_ns >= self._after_ns)

    def _see_mode(self, status: ModeStatus) -> None:
        """`safe`, or `idle` once it was under way: since when."""
        self._under_way = self._under_way or status.mode != "idle"
        rests = status.mode == "safe" or (status.mode == "idle" and self._under_way)
        if not rests:
            self._stopped = "", 0
        elif status.mode != self._stopped[0]:
            self._stopped = status.mode, status.t_ns
