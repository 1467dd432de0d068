"""The parameter store: typed values, clamped as ArduPilot clamps them.

set(name, value)   adds 0.01 away from zero, cuts and clamps to the type; False for a name that does not
                   exist and for a value that is not finite (the firmware stays silent on both)
find(wire_name)    the index of a name as this firmware version spells it; None for an unknown one
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

from sim.world.autopilot.firmware import FIRMWARE, Firmware, old_name
from sim.world.autopilot.parameter_table import TABLE, WireType

_BITS = {WireType.INT8: 8, WireType.INT16: 16, WireType.INT32: 32}


def stored(kind: WireType, value: float) -> float:
    """The number that a parameter of this type keeps when it is given a finite `value`."""
    if kind is WireType.REAL32:
        largest = 3.4028234663852886e38
        return struct.unpack("<f", struct.pack("<f", max(-largest, min(largest, value))))[0]
    top = 2 ** (_BITS[kind] - 1)
    whole = math.trunc(value + math.copysign(0.01, value))  # source: `AP_Param::set_float`
    return float(max(-top, min(top - 1, whole)))


class ParameterStore:
    """All parameters by their 4.6 name. `version` counts changes, so that readers may cache what they derive.

    `changes` to the defaults may use the names of either version; ValueError for an unknown one.
    """

    def __init__(self, changes: Mapping[str, float], firmware: Firmware = FIRMWARE["4.6"]):
        self._values = {row.name: row.default for row in TABLE}
        self.firmware = firmware
        self.version = 0
        for name, value in changes.items():
            if not self.set(old_name(name), value):
                raise ValueError(f"simulated autopilot: no parameter {name} with a value {value}")

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def set(self, name: str, value: float) -> bool:
        """Store `value`; False where the name is unknown or the value not finite."""
        index = INDEX.get(name)
        if index is None or not math.isfinite(value):
            return False
        self._values[name] = stored(TABLE[index].kind, value)
        self.version += 1
        return True

    def find(self, wire_name: str) -> int | None:
        """Index of a parameter by its name on the wire, in capitals or not."""
        name = self.firmware.known_name(wire_name.upper())
        return INDEX.get(name) if name else None

    def wire_name(self, index: int) -> str:
        """Name on the wire of the parameter with this index."""
        return self.firmware.wire_name(TABLE[index].name)

    def saved(self) -> dict[str, float]:
        """Everything, as it survives a reboot."""
        return dict(self._values)


INDEX: dict[str, int] = {row.name: index for index, row in enumerate(TABLE)}
"""Position of each name on the wire."""
