"""What the simulator's pen has written: pulse widths that leave the simulated autopilot, overrides that reach it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

THRUSTERS, THRUSTER_CHANNELS, STILL_CHANNELS = 4, range(9, 13), range(1, 5)
NEUTRAL_US, LOW_US, HIGH_US = 1500, 1100, 1900
AT_REST = frozenset({0, NEUTRAL_US})
_RELEASE = {True: 65534, False: 0}
_LEAVE_ALONE = {True: frozenset({0, 65535}), False: frozenset({65535})}


@dataclass(frozen=True)
class Step:
    """The simulated autopilot at one instant."""

    t_ns: int
    pulses_us: tuple[int, ...]
    armed: bool
    mode: int
    north_m: float
    east_m: float

    @property
    def thrusters_us(self) -> tuple[int, ...]:
        return self.pulses_us[:THRUSTERS]

    def off_neutral(self, rest: frozenset[int] = AT_REST) -> bool:
        return any(p not in rest for p in self.thrusters_us)


@dataclass(frozen=True)
class Override:
    """RC_CHANNELS_OVERRIDE as the autopilot or the wire saw it: channels 1 to 18."""

    t_ns: int
    channels: tuple[int, ...]

    def outside(self) -> int:
        """Thruster channels beyond 1100-1900 us; a release is none."""
        pulses = [self.channels[c - 1] for c in THRUSTER_CHANNELS]
        return sum(not LOW_US <= p <= HIGH_US and p not in {_RELEASE[True], *_LEAVE_ALONE[True]} for p in pulses)

    def elsewhere(self) -> int:
        """Other channels that get a pulse: 1-4 may have neutral."""
        return sum(self._is_wrong(c, p) for c, p in enumerate(self.channels[:16], start=1))

    @staticmethod
    def _is_wrong(channel: int, value: int) -> bool:
        if channel in THRUSTER_CHANNELS or value in _LEAVE_ALONE[channel > 8]:
            return False
        return not (channel in STILL_CHANNELS and value in (NEUTRAL_US, _RELEASE[False]))


@dataclass
class Pen:
    """Reads what the simulator's pen has written so far."""

    path: Path
    steps: list[Step] = field(default_factory=list)
    overrides: list[Override] = field(default_factory=list)
    _offset: int = 0

    def read(self) -> Self:
        """Take what is new."""
        if not self.path.exists():
            return self
        with self.path.open() as file:
            file.seek(self._offset)
            text, newline, _ = file.read().rpartition("\n")
        self._offset += len(text) + len(newline)
        for line in text.splitlines():
            kind, t_ns, *words = line.split()
            if kind == "s":
                pulses = tuple(map(int, words[:16]))
                armed, mode, north, east = words[16:]
                self.steps.append(Step(int(t_ns), pulses, armed == "1", int(mode), float(north), float(east)))
            else:
                self.overrides.append(Override(int(t_ns), tuple(map(int, words))))
        return self
