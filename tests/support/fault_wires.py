"""What reached either end of the boat's wires, as pymavlink decodes it."""

from __future__ import annotations

from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as wire


@dataclass
class Heard:
    """What reached the two ends, in the order in which it did; times [ns]."""

    boat: list = field(default_factory=list)
    """(t, MAVLink message) that the boat was given whole."""
    rover: list = field(default_factory=list)
    """(t, override) that the autopilot was given whole."""
    uwb_ns: list = field(default_factory=list)
    commands: list = field(default_factory=list)
    sticks: list = field(default_factory=list)
    esc: list = field(default_factory=list)
    """(t, outputs 1 to 4 [us], armed and in MANUAL) at every step."""
    stalls: list = field(default_factory=list)
    """(from, to) while nothing of the boat ran."""
    shut_ns: list = field(default_factory=list)
    """Steps at which the boat's MAVLink port was not open."""


def frame_parser():
    parser = wire.MAVLink(None)
    parser.robust_parsing = True
    return parser


def whole(parser, data):
    """Messages that `data` completes, without what is none."""
    return [m for m in parser.parse_buffer(data) or [] if m.get_type() != "BAD_DATA"]
