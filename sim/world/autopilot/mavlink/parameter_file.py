"""`@PARAM/param.pck`: all parameters in one file, for a download by MAVLink FTP.

Head: magic u16, parameters in the file u16, parameters in all u16. Then for each: type (1 int8 to 4 float) u8; how
many letters it shares with the name before it (low 4 bits) and how many follow less 1 (high 4 bits) u8; these letters;
the value. Zeros before an entry keep its value from crossing a block of 239 bytes.

Source: ArduPilot, libraries/AP_Filesystem/README.md and AP_Filesystem_Param.cpp (what is packed, and where zeros go).
"""

from __future__ import annotations

import itertools
import struct

from sim.world.autopilot.mavlink.files import DATA_BYTES
from sim.world.autopilot.parameter_table import TABLE, WireType
from sim.world.autopilot.parameters import ParameterStore

PATH = "/@PARAM/param.pck"
_MAGIC = 0x671B
_TYPES = {WireType.INT8: (1, "<b"), WireType.INT16: (2, "<h"), WireType.INT32: (3, "<i"), WireType.REAL32: (4, "<f")}


def packed_parameters(parameters: ParameterStore) -> bytes:
    """The file as of now."""
    packed = struct.pack("<HHH", _MAGIC, len(TABLE), len(TABLE))
    before = ""
    for index, row in enumerate(TABLE):
        name = parameters.wire_name(index)
        kind, form = _TYPES[row.kind]
        shared = min(len(_common(before, name)), 15, len(name) - 1)
        rest, before = name[shared:].encode(), name
        size = struct.calcsize(form)
        over = (len(packed) + 2 + len(rest) + size) % DATA_BYTES
        if size > 1 and 0 < over < size:
            packed += bytes(size - over)
        value = parameters[row.name]
        packed += struct.pack("BB", kind, shared | (len(rest) - 1) << 4) + rest
        packed += struct.pack(form, value if row.kind is WireType.REAL32 else int(value))
    return packed


def _common(before: str, name: str) -> str:
    """What both begin with."""
    return "".join(a for a, _ in itertools.takewhile(lambda pair: pair[0] == pair[1], zip(name, before, strict=False)))
