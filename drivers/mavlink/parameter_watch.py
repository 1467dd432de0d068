"""Parameters that were read and are watched from then on, as a pure state machine: messages in, bytes to send out.

An autopilot broadcasts what somebody sets. A broadcast may be lost, and a script that sets a parameter without saving
it makes none: so all that are known are asked for again, one at a time, in turn. Of two questions one is of a
SERVOn_FUNCTION, which decides what drives a thruster.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from companion.core.messages import Message, ParamValue
from drivers.mavlink.encode import MavlinkEncoder

ASK_NS = 250_000_000
"""One question of 32 bytes and an answer of 37 so often, 2.4 % of 115200 baud: functions within 8 s, some 130 others
within 70 s."""


@dataclass(frozen=True)
class ParameterChange:
    """A parameter that is not what it was. `before`: None where it was not told until now."""

    name: str
    before: float | None
    now: float

    def __str__(self) -> str:
        was = "not told before" if self.before is None else f"it was {self.before:g}"
        return f"{self.name} is {self.now:g} now ({was})"


class ParameterWatch:
    """`values`: by name, as they are now. `relevant`: names whose changes count; others are not kept."""

    def __init__(self, encoder: MavlinkEncoder, values: Mapping[str, float], relevant: Iterable[str]) -> None:
        self.values = dict(values)
        self._encoder, self._relevant = encoder, frozenset(relevant) | frozenset(values)
        functions = [name for name in self.values if name.startswith("SERVO") and name.endswith("_FUNCTION")]
        others = [name for name in self.values if name not in functions]
        self._rings = deque(deque(ring) for ring in (functions, others) if ring)
        self._due_ns: int | None = None
        self._changes: list[ParameterChange] = []

    def step(self, messages: Iterable[Message], t_ns: int) -> list[bytes]:
        """Frames to send at `t_ns` [ns]. Call it with every batch of messages, and at 10 Hz if none come."""
        for message in messages:
            if isinstance(message, ParamValue) and message.name in self._relevant:
                before = self.values.get(message.name)
                if before != message.value:
                    self.values[message.name] = message.value
                    self._changes.append(ParameterChange(message.name, before, message.value))
        if self._due_ns is None:
            self._due_ns = t_ns + ASK_NS
        if t_ns < self._due_ns or not self._rings:
            return []
        self._due_ns = t_ns + ASK_NS
        self._rings.rotate(-1)
        ring = self._rings[0]
        ring.rotate(-1)
        return [self._encoder.param_request_read(ring[0])]

    def take_changes(self) -> list[ParameterChange]:
        """Changes since the last call."""
        changes, self._changes = self._changes, []
        return changes
