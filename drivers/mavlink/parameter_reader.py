"""Reading chosen parameters of the autopilot one by one, as a pure state machine: messages in, bytes to send out.

A name that the autopilot does not have is met with silence (observed), and so is a question too many (it queues
some 20, source): few are asked at a time, each again after `RETRY_NS`, and after `TRIES` a name counts as missing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from companion.core.messages import Message, ParamValue
from drivers.mavlink.encode import MavlinkEncoder

AT_ONCE = 12
"""Questions without an answer at one time; assumed."""
RETRY_NS = 300_000_000
TRIES = 4
"""Assumed: an answer takes some 10 ms; a serial line may lose one."""


class ParameterReader:
    """`values`: values by name as they came; `missing`: names that were asked for in vain."""

    def __init__(self, encoder: MavlinkEncoder, names: Iterable[str] = ()) -> None:
        self.values: dict[str, float] = {}
        self.missing: list[str] = []
        self._encoder = encoder
        self._waiting: deque[str] = deque()
        self._asked: dict[str, tuple[int, int]] = {}
        self.ask(names)

    def ask(self, names: Iterable[str]) -> None:
        """Read these too; what is told already is asked for again."""
        for name in names:
            if name not in self._waiting and name not in self._asked:
                self._waiting.append(name)

    @property
    def done(self) -> bool:
        """Everything asked for has been told or counts as missing."""
        return not self._waiting and not self._asked

    def step(self, messages: Iterable[Message], t_ns: int) -> list[bytes]:
        """Frames to send at `t_ns` [ns]. Call it with every batch of messages, and at 10 Hz if none come."""
        for message in messages:
            if isinstance(message, ParamValue):
                self.values[message.name] = message.value
                self._asked.pop(message.name, None)
        out = []
        for name, (tries, due_ns) in list(self._asked.items()):
            if t_ns < due_ns:
                continue
            if tries >= TRIES:
                del self._asked[name]
                self.missing.append(name)
            else:
                out.append(self._question(name, tries + 1, t_ns))
        while self._waiting and len(self._asked) < AT_ONCE:
            out.append(self._question(self._waiting.popleft(), 1, t_ns))
        return out

    def _question(self, name: str, tries: int, t_ns: int) -> bytes:
        self._asked[name] = tries, t_ns + RETRY_NS
        return self._encoder.param_request_read(name)
