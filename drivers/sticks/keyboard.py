"""A terminal's keyboard as a stick with a dead man's grip: bytes and time in, shares and commands out. Pure.

    q  w  e      ahead, turning to port   ahead    ahead, turning to starboard
    a  s  d      turn to port             astern   turn to starboard              (w a s d: arrow keys, too)
    z     c      sideways to port                  sideways to starboard
    1 .. 9, 0    10 to 90 and 100 % of what the thrusters can give                space, x, Esc: stop

A terminal tells no key's release, and of several keys held it repeats only the last. So each key is a whole movement,
the next key replaces it, and a key that falls silent has been let go of. A key held repeats after a first delay of
0.25 s (Linux console) to 0.66 s (X11's default) and then 10 to 40 times a second; so silence means released after
`FIRST_S` for a key's first byte and after `REPEAT_S` once it repeats. A tap therefore moves the boat for `FIRST_S`.
With a first delay above `FIRST_S` the boat pauses once at the start of each key: `xset r rate 300 30` mends that.
"""

from __future__ import annotations

from typing import Literal

from drivers.sticks.mapping import NEUTRAL, Shares

FIRST_S = 0.65
REPEAT_S = 0.5
ESCAPE_S = 0.05
"""The bytes of an arrow key come together; what an Esc began and did not end for longer is the Esc key (assumed)."""
LEVEL = 0.3
"""Share of the full force at the start; assumed."""

Command = Literal["stop", "drive", "start", "hold", "excite", "mark", "quit"]

_MOVES = {
    b"w": Shares(surge=1.0),
    b"s": Shares(surge=-1.0),
    b"a": Shares(yaw=-1.0),
    b"d": Shares(yaw=1.0),
    b"q": Shares(surge=1.0, yaw=-0.5),
    b"e": Shares(surge=1.0, yaw=0.5),
    b"z": Shares(sway=-1.0),
    b"c": Shares(sway=1.0),
}
_ARROWS = {b"A": b"w", b"B": b"s", b"C": b"d", b"D": b"a"}
COMMANDS: dict[bytes, Command] = {
    b" ": "stop",
    b"x": "stop",
    b"\x1b": "stop",
    b"r": "drive",
    b"g": "start",
    b"h": "hold",
    b"p": "excite",
    b"m": "mark",
    b"\x03": "quit",
    b"\x04": "quit",
}
"""Key -> command: r takes the sticks, g starts the mission, h holds, p plays the excitation, m marks the log."""
_ESCAPE, _PARAMETERS = 0x1B, b"0123456789;"
_FUNCTION_KEY = ord("[")
"""On a Linux console the keys F1 to F5 are ESC [ [ A to E."""


class Keyboard:
    """`level`: share of the full force that a key means."""

    def __init__(self) -> None:
        self.level = LEVEL
        self._held: bytes | None = None
        self._until_ns = self._since_ns = 0
        self._escape = b""
        self._escape_ns = 0

    def feed(self, data: bytes, t_ns: int) -> list[Command]:
        """Take what the terminal gave at `t_ns` [ns], b"" if nothing; the commands in it, in order."""
        out: list[Command] = []
        if self._escape and t_ns - self._escape_ns > ESCAPE_S * 1e9:
            self._escape = b""
            out += self._press(b"\x1b", t_ns)
        for byte in data:
            out += self._take(byte, t_ns)
        return out

    def shares(self, t_ns: int) -> Shares:
        """Where the stick stands at `t_ns` [ns]: neutral once the key has fallen silent."""
        if self._held is None or not 0 <= t_ns - self._since_ns < self._until_ns - self._since_ns:
            self._held = None
            return NEUTRAL
        return Shares(*(self.level * share for share in _MOVES[self._held]))

    def release(self) -> None:
        """Let go of everything (the terminal is gone)."""
        self._held, self._escape = None, b""

    def _take(self, byte: int, t_ns: int) -> list[Command]:
        """One byte; those of an escape sequence (ESC [ or O, parameters, a final byte) go together."""
        if self._escape:
            return self._continue(byte, t_ns)
        if byte == _ESCAPE:
            self._escape, self._escape_ns = b"\x1b", t_ns
            return []
        return self._press(bytes([byte]), t_ns)

    def _continue(self, byte: int, t_ns: int) -> list[Command]:
        """The next byte after an ESC."""
        if byte == _ESCAPE:  # the Esc key, again and again
            stop, self._escape_ns = self._escape == b"\x1b", t_ns
            self._escape = b"\x1b"
            return self._press(b"\x1b", t_ns) if stop else []
        if self._escape == b"\x1b":
            if byte in b"[O":
                self._escape += bytes([byte])
                return []
            self._escape = b""
            return self._press(b"\x1b", t_ns) + self._press(bytes([byte]), t_ns)
        plain = len(self._escape) == 2
        if byte in _PARAMETERS or (plain and byte == _FUNCTION_KEY):
            self._escape += bytes([byte])
            return []
        self._escape = b""
        if not 0x40 <= byte <= 0x7E:  # no key's sequence goes on like that
            return self._press(bytes([byte]), t_ns)
        key = _ARROWS.get(bytes([byte])) if plain else None
        return self._press(key, t_ns) if key else []

    def _press(self, key: bytes, t_ns: int) -> list[Command]:
        key = key.lower()
        if key.isdigit():
            self.level = (int(key) or 10) / 10
        elif key in _MOVES:
            repeats = key == self._held and 0 <= t_ns - self._since_ns < self._until_ns - self._since_ns
            self._held, self._since_ns = key, t_ns
            self._until_ns = t_ns + round((REPEAT_S if repeats else FIRST_S) * 1e9)
        elif command := COMMANDS.get(key):
            if command == "stop":
                self._held = None
            return [command]
        return []
