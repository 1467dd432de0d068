"""When `aritra run --end-after S` ends by itself."""

from __future__ import annotations

from companion.core.messages import ExcitationStatus, GuidanceReference, Message, ModeStatus


class RunEnd:
    """Mission or excitation has been done, or the boat in `safe`, for `after_s` [s]; None: it never ends by itself.

    `stopped_itself`: it ended in `safe`.
    """

    def __init__(self, after_s: float | None):
        self._after_ns = None if after_s is None else after_s * 1e9
        self._done_ns: int | None = None
        self._safe_ns: int | None = None
        self.stopped_itself = False

    def see(self, message: Message) -> bool:
        """Note one message; whether the run ends now."""
        if self._after_ns is None:
            return False
        if isinstance(message, GuidanceReference | ExcitationStatus):
            self._done_ns = (self._done_ns or message.t_ns) if message.phase in ("done", "failed") else None
        elif isinstance(message, ModeStatus):
            self._safe_ns = (self._safe_ns or message.t_ns) if message.mode == "safe" else None
        if self._safe_ns is not None and message.t_ns - self._safe_ns >= self._after_ns:
            self.stopped_itself = True
        return self.stopped_itself or (self._done_ns is not None and message.t_ns - self._done_ns >= self._after_ns)
