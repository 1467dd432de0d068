"""What differs between the two firmware versions that were observed.

    4.6   SYSID_THISMAV, SYSID_MYGCS; a stream asked for faster than 80 % of the loop is capped without a word;
          pilot inputs of the mixer are whole per cent; a file's path must not be counted with its NUL
    4.7   MAV_SYSID, MAV_GCS_SYSID; such a request is DENIED and changes nothing; inputs are not rounded; paths
          may be counted with their NUL; SR0_* are MAV1_*, TELEM_DELAY is MAV_TELEM_DELAY

Inside the simulation a parameter has its 4.6 name; `wire_name` and `known_name` translate at the wire.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType

_RATES = "RAW_SENS", "EXT_STAT", "RC_CHAN", "RAW_CTRL", "POSITION", "EXTRA1", "EXTRA2", "EXTRA3", "PARAMS"
RENAMED_IN_4_7 = MappingProxyType(
    {
        "SYSID_THISMAV": "MAV_SYSID",
        "SYSID_MYGCS": "MAV_GCS_SYSID",
        "TELEM_DELAY": "MAV_TELEM_DELAY",
        **{f"SR0_{rate}": f"MAV1_{rate}" for rate in _RATES},
    }
)
_OLD_NAME = {new: old for old, new in RENAMED_IN_4_7.items()}


@dataclass(frozen=True)
class Firmware:
    """`minor` of version 4.`minor`; `renamed`: 4.6 name -> name on the wire."""

    minor: int
    denies_fast_streams: bool
    whole_per_cent: bool
    counts_nul: bool
    renamed: MappingProxyType[str, str] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def flight_sw_version(self) -> int:
        """AUTOPILOT_VERSION.flight_sw_version: major, minor, patch and type, a byte each (type 0: development)."""
        return 4 << 24 | self.minor << 16

    @property
    def banner(self) -> str:
        """What it calls itself."""
        return f"ArduRover V4.{self.minor}.0-dev (simulated)"

    def wire_name(self, name: str) -> str:
        """The name that this version uses on the wire."""
        return self.renamed.get(name, name)

    def known_name(self, wire_name: str) -> str | None:
        """The simulation's name of what this version calls `wire_name`; None where it has no such name."""
        name = old_name(wire_name)
        return name if self.wire_name(name) == wire_name else None


def old_name(name: str) -> str:
    """The 4.6 name of a parameter named in either way: what parameter files are read with."""
    return _OLD_NAME.get(name, name)


FIRMWARE = {
    "4.6": Firmware(6, denies_fast_streams=False, whole_per_cent=True, counts_nul=False),
    "4.7": Firmware(7, denies_fast_streams=True, whole_per_cent=False, counts_nul=True, renamed=RENAMED_IN_4_7),
}
"""Versions by name."""
