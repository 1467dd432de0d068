"""Repeat a log: its inputs through the core again, and the first place where the outputs differ.

The log holds, in order, the inputs of each call of `pilot.step`, a StepMark, and the outputs. The core is pure,
so on the same machine with the same configuration the outputs come out bit for bit.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import msgspec

from companion.core.messages import INPUTS, OUTPUTS, Alert, Message, StepMark
from companion.core.pilot.pilot import Pilot


@dataclass(frozen=True)
class Difference:
    """First difference between replay and log: number and time of the call, logged and replayed output."""

    step: int
    t_ns: int
    logged: str
    replayed: str


@dataclass(frozen=True)
class Report:
    """What was repeated, and the first difference, if any."""

    steps: int
    inputs: int
    outputs: int
    difference: Difference | None


def replay(pilot: Pilot, messages: Iterable[Message]) -> Report:
    """Repeat `messages` (a log in write order). Alerts made by the shell are those that the replay lacks."""
    state = None
    pending: list[Message] = []
    expected: list[Message] = []
    steps = inputs = outputs = 0
    for message in messages:
        if isinstance(message, StepMark):
            if expected:
                return Report(steps, inputs, outputs, _differs(steps, message.t_ns, "nothing", expected[0]))
            state = state or pilot.initial(message.t_ns)
            if len(pending) != message.inputs:
                counts = f"{message.inputs} inputs", f"{len(pending)} in the log"
                return Report(steps, inputs, outputs, _differs(steps, message.t_ns, *counts))
            given, pending = pending, []
            state, made = pilot.step(state, given, message.t_ns)
            steps, inputs, outputs = steps + 1, inputs + len(given), outputs + len(made)
            expected = list(made)
        elif isinstance(message, OUTPUTS):
            if expected and _same(message, expected[0]):
                expected.pop(0)
            elif not isinstance(message, Alert):
                replayed = expected[0] if expected else "nothing"
                return Report(steps, inputs, outputs, _differs(steps, message.t_ns, message, replayed))
        elif isinstance(message, INPUTS):
            pending.append(message)
    return Report(steps, inputs, outputs, None)


def _same(a: Message, b: Message) -> bool:
    """Equal in the encoding of the log, so that numbers compare after a round trip through JSON."""
    return msgspec.json.encode(a) == msgspec.json.encode(b)


def _differs(step: int, t_ns: int, logged: object, replayed: object) -> Difference:
    return Difference(step, t_ns, str(logged), str(replayed))
