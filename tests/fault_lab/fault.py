"""One fault, and the line that says it: `TARGET KIND [SIZE] [from S] [to S]`.

thruster 2 weak 0.4 from 30        thruster 1 swapped 3 from 0        uwb frozen from 40 to 50
heading step 90 from 30            anchor 2 bias 3 from 30            wire delay 0.4 from 20
"""

from __future__ import annotations

import math
from dataclasses import dataclass

PUSH_N = (10.0, 40.0)
KINDS: dict[str, dict[str, tuple[float, float] | None]] = {
    "thruster": {"dead": None, "weak": (0.2, 0.6), "reversed": None, "stuck": (1100.0, 1900.0), "swapped": (1, 4)},
    "thrusters": {"reversed": None, "weak": (0.3, 0.6)},
    "uwb": {
        "frozen": None, "silent": None, "noise": (0.4, 2.0), "scale": (0.85, 1.15), "outliers": (0.2, 0.6),
        "late": (0.5, 2.0), "mirrored": None, "rotated": (90.0, 270.0),
    },
    "anchor": {"bias": (0.5, 5.0), "frozen": None, "silent": None, "moved": (1.0, 4.0)},
    "heading": {"offset": (-180.0, 180.0), "drift": (-4.0, 4.0), "noise": (5.0, 40.0), "frozen": None},
    "gyro": {"stuck": None, "flipped": None, "bias": (-0.3, 0.3), "scale": (0.3, 2.0), "noise": (0.05, 0.5)},
    "accel": {
        "bias": (-1.5, 1.5), "noise": (0.2, 2.0), "stuck": None, "flipped": None, "swapped": None,
        "saturated": (0.1, 1.0),
    },
    "imu": {"stuck": None},
    "wire": {"silent": None, "delay": (0.1, 0.8), "lost": (0.1, 0.9)},
    "battery": {"sag": (11.0, 14.0)},
    "boat": {"pushed": PUSH_N},
}  # fmt: skip
"""Target -> kind -> range of sizes of random faults [share, us, m, degrees, deg/s, rad/s, m/s^2, s, V, N] or None."""

FAMILIES = {
    "thruster": "thruster", "thrusters": "thruster", "wire": "link", "battery": "power", "boat": "surroundings",
}  # fmt: skip
"""Target -> what its faults should be called; all others are sensors."""

NUMBERED = {"thruster": 4, "anchor": 4}
"""Targets of which there are several."""


@dataclass(frozen=True)
class Fault:
    """`number`: of the thruster or anchor, from 1; `from_s`, `to_s`: simulated time since switch-on."""

    target: str
    kind: str
    number: int = 0
    size: float = math.nan
    from_s: float = 0.0
    to_s: float = math.inf

    def __post_init__(self):
        if self.kind not in KINDS.get(self.target, {}):
            raise ValueError(f"no fault {self.target!r} {self.kind!r}; there are {KINDS}")
        if (KINDS[self.target][self.kind] is None) != math.isnan(self.size):
            raise ValueError(
                f"{self.target} {self.kind}: a size is {'missing' if math.isnan(self.size) else 'too much'}"
            )

    def acts(self, t_s: float) -> bool:
        """Whether it is there at this time."""
        return self.from_s <= t_s < self.to_s

    @property
    def family(self) -> str:
        """What it should be called: sensor, thruster, link, power or surroundings."""
        return FAMILIES.get(self.target, "sensor")

    def __str__(self) -> str:
        number = f" {self.number}" if self.number else ""
        size = "" if math.isnan(self.size) else f" {self.size:g}"
        return f"{self.target}{number} {self.kind}{size} from {self.from_s:g}" + (
            f" to {self.to_s:g}" if math.isfinite(self.to_s) else ""
        )


def parse(line: str) -> Fault:
    """The fault that a line says; ValueError names what is wrong with it."""
    words = line.split()
    times = {"from": 0.0, "to": math.inf}
    for word in times:
        if word in words:
            at = words.index(word)
            times[word] = float(words[at + 1])
            del words[at : at + 2]
    target, number = words.pop(0), 0
    if target in NUMBERED:
        number = int(words.pop(0))
    kind, *size = words
    return Fault(target, kind, number, float(size[0]) if size else math.nan, times["from"], times["to"])
