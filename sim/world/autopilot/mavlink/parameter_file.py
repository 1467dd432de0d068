"""`@PARAM/param.pck`: all parameters in one file, for a download by MAVLink FTP.

Head: magic u16, parameters in the file u16, parameters in all u16. Then for each: type (1 int8 to 4 float) and flags
(16: a default follows) u8; how many letters it shares with the name before it (low 4 bits) and how many follow less 1
(high 4 bits) u8; these letters; the value; its default, where that is another and `?withdefaults=1` was asked for.
Zeros before an entry keep its last number from crossing a block of 239 bytes. A part (`start`, `count`) is not served.

Source: ArduPilot, libraries/AP_Filesystem/README.md and AP_Filesystem_Param.cpp (what is packed, and where zeros go).
"""

from __future__ import annotations

import itertools
import struct

from sim.world.autopilot.mavlink.files import DATA_BYTES
from sim.world.autopilot.parameter_table import TABLE, WireType
from sim.world.autopilot.parameters import ParameterStore

_PATH, _WITH_DEFAULTS = "/@PARAM/param.pck", "withdefaults=1"
_MAGIC, _MAGIC_DEFAULTS, _HAS_DEFAULT = 0x671B, 0x671C, 16
_TYPES = {WireType.INT8: (1, "<b"), WireType.INT16: (2, "<h"), WireType.INT32: (3, "<i"), WireType.REAL32: (4, "<f")}


def parameter_file(parameters: ParameterStore, path: str) -> bytes | None:
    """The file as of now; None where `path` is another one."""
    name, _, asked = path.partition("?")
    return packed_parameters(parameters, asked == _WITH_DEFAULTS) if name == _PATH else None


def packed_parameters(parameters: ParameterStore, with_defaults: bool) -> bytes:
    """All parameters, packed."""
    packed = struct.pack("<HHH", _MAGIC_DEFAULTS if with_defaults else _MAGIC, len(TABLE), len(TABLE))
    before = ""
    for index, row in enumerate(TABLE):
        name = parameters.wire_name(index)
        kind, form = _TYPES[row.kind]
        numbers = [parameters[row.name]]
        if with_defaults and row.default != numbers[0]:
            numbers.append(row.default)
        values = b"".join(struct.pack(form, n if row.kind is WireType.REAL32 else int(n)) for n in numbers)
        shared = min(_common(before, name), 15, len(name) - 1)
        rest, before = name[shared:].encode(), name
        size = struct.calcsize(form)
        over = (len(packed) + 2 + len(rest) + len(values)) % DATA_BYTES
        if size > 1 and 0 < over < size:
            packed += bytes(size - over)
        flags = _HAS_DEFAULT if len(numbers) > 1 else 0
        packed += struct.pack("BB", kind | flags, shared | (len(rest) - 1) << 4) + rest + values
    return packed


def _common(before: str, name: str) -> int:
    """How many letters both begin with."""
    return sum(1 for _ in itertools.takewhile(lambda pair: pair[0] == pair[1], zip(name, before, strict=False)))
