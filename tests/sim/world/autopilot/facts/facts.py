"""The table of what the real ArduPilot Rover was seen to do: one row a fact, with a check on the simulated one.

A row names the section of the notes on the real firmware and the fact in words; `check()` fails where the
simulation does otherwise. FACTS is filled by the modules `wiring`, `rc` and `protocol`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as wire

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
DRIVING = "Driving four thrusters by RC override"
STREAMS = "Identity, streams, time"
ARMING = "Arming, modes, commands"
PARAMETERS = "Parameters, logs, signing"


class Fact(NamedTuple):
    """One row."""

    section: str
    words: str
    check: Callable[[], None]


FACTS: list[Fact] = []
NOT_SIMULATED = {
    DRIVING: ["the spread of latency about its median", "the safety switch's button"],
    STREAMS: ["SIMSTATE, which a board does not have"],
    ARMING: ["GUIDED and LOITER with a position", "stale vision blocks arming", "Accels inconsistent at the start"],
    PARAMETERS: ["1272 parameters: 270 of them", "dataflash logs over MAVLink"],
}
"""What is left out, by section; External position and the JSON backend are other parts' business."""


def fact(section: str, words: str):
    """Decorator: register a check."""

    def register(check):
        FACTS.append(Fact(section, words, check))
        return check

    return register


def one(channel, value):
    """An override that says something on one channel only."""
    values = [65535] * 8 + [0] * 10
    values[channel - 1] = value
    return wire.MAVLink_rc_channels_override_message(0, 0, *values)
