"""A gamepad by Linux' joystick interface (/dev/input/js*): its events -> shares. Pure, but for `axis_codes`.

Why not the evdev package: it has no wheel for aarch64 and needs a compiler there. Why js* and not event*: opening it
gives the place of every axis at once, scaled to +-32767, where event* is silent until something moves; and a stick
must be known to rest before it may drive. `axis_codes` asks the kernel which axis is which (JSIOCGAXMAP). Events are
`struct js_event`: u32 ms, s16 value, u8 type, u8 number. Source: kernel documentation, input/joydev/joystick-api.

    left stick: ahead and sideways        right stick: turn        first button (A, cross): stop

A stick that is held still sends nothing, so silence is no release here. A pad that is unplugged ends the device; one
whose radio dies may leave its last place standing. Hence `FROZEN_S`: a stick that is off its middle and has not moved
at all for so long counts as let go of, and must rest before it counts again.
"""

from __future__ import annotations

import array
import fcntl
import struct

from drivers.sticks.mapping import NEUTRAL, RestFirst, Shares, shaped

EVENT = struct.Struct("<IhBB")
FULL = 32767
BUTTON, AXIS, INITIAL = 0x01, 0x02, 0x80
ABS_X, ABS_Y, ABS_RX = 0, 1, 3
"""Codes of linux/input-event-codes.h: left stick, and the right stick's x on Xbox and PlayStation pads."""
STOP_BUTTON = 0
DEAD_ZONE, EXPO = 0.12, 0.4
"""Assumed: worn sticks rest within a tenth of their middle; expo as hobby transmitters come."""
FROZEN_S = 10.0
"""Assumed: longer than hands hold a stick without a tremor, shorter than a basin."""
_JSIOCGAXMAP, _ABS_CNT = 0x80406A32, 64


class Gamepad:
    """One pad, from its connection on. `codes`: code of each axis by number (`axis_codes`)."""

    def __init__(self, codes: tuple[int, ...]) -> None:
        self._codes = codes
        self._places: dict[int, float] = {}
        self._buffer = b""
        self._rest = RestFirst()
        self._moved_ns: int | None = None

    @property
    def missing(self) -> tuple[int, ...]:
        """Codes of axes that are needed and that this pad does not have: it cannot drive."""
        return tuple(code for code in (ABS_X, ABS_Y, ABS_RX) if code not in self._codes)

    def feed(self, data: bytes, t_ns: int) -> list[str]:
        """Take what was read from the device at `t_ns` [ns]; "stop" for each press of the stop button."""
        self._buffer += data
        whole = len(self._buffer) - len(self._buffer) % EVENT.size
        events, self._buffer = self._buffer[:whole], self._buffer[whole:]
        out = []
        for _, value, kind, number in EVENT.iter_unpack(events):
            if kind & ~INITIAL == AXIS and number < len(self._codes):
                self._places[self._codes[number]] = max(-1.0, value / FULL)
                self._moved_ns = t_ns
            elif kind == BUTTON and number == STOP_BUTTON and value:
                out.append("stop")
        return out

    def shares(self, t_ns: int) -> Shares:
        """Where the sticks stand; neutral until every axis is known and all have been at rest once."""
        if self.missing or any(code not in self._places for code in (ABS_X, ABS_Y, ABS_RX)):
            return NEUTRAL
        raw = (-self._places[ABS_Y], self._places[ABS_X], self._places[ABS_RX])
        shares = Shares(*(shaped(v, dead_zone=DEAD_ZONE, expo=EXPO) for v in raw))
        if self._moved_ns is None or t_ns - self._moved_ns > FROZEN_S * 1e9:
            self._rest.lock()
        return self._rest.pass_on(shares)


def axis_codes(descriptor: int) -> tuple[int, ...]:
    """Codes of the axes of an open js* device, by number. Raises OSError."""
    codes = array.array("B", bytes(_ABS_CNT))
    fcntl.ioctl(descriptor, _JSIOCGAXMAP, codes)
    return tuple(codes)
