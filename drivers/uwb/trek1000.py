"""Decawave TREK1000 / EVK1000 and clones: one text line per report over USB. Numbers in hexadecimal.

    mc 0f 00000663 000005a3 00000512 000004cb 095f c1 00024c24 a0:0
    |  |  `-- four ranges [mm] (eight on clones)  |    |  |        `-- reporter (a/t), tag : anchor
    |  `-- mask of valid ranges    range number --'    |  `-- time, shortened by clones
    `-- mc corrected, mr raw, ma anchor to anchor      `-- sequence

The range in place i belongs to anchor i, known as "0", "1", ... Ranges whose mask bit is off are left out.
A TREK prints the raw line behind the corrected one of the same cycle: once `mc` was seen `mr` is ignored, so
no range comes twice. `ma` is ignored. 115200 8N1 on clones with a UART.

Integrity: no checksum, fixed field widths. A digit that became another digit cannot be seen.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Literal

from companion.core.messages import AnchorRange, Message
from drivers.uwb.lines import Garbage, Ignored, LineCodec

_LINE = re.compile(
    r"m([cra]) ([0-9a-f]{2})((?: [0-9a-f]{8}){4}|(?: [0-9a-f]{8}){8}) [0-9a-f]{4} [0-9a-f]{2} [0-9a-f]{1,8}"
    r" [at](\d{1,2}):(\d{1,2})"
)


class Trek1000Codec(LineCodec):
    """Codec of TREK1000 lines. `tag_number`: take only this tag's lines (an anchor's port reports all)."""

    def __init__(self, tag: str, *, tag_number: int | None = None) -> None:
        super().__init__(tag)
        self._tag_number = tag_number
        self._corrected_seen = False

    def start_bytes(self) -> list[bytes]:
        """Forget half a line and the firmware's habits. Nothing to send."""
        self._corrected_seen = False
        return super().start_bytes()

    def _decode(self, line: str, t_ns: int) -> list[Message]:
        match = _LINE.fullmatch(line)
        if match is None:
            raise Garbage("malformed")
        kind, mask, fields, number, _ = match.groups()
        if kind == "a":
            raise Ignored("anchor_to_anchor")
        if self._tag_number is not None and int(number) != self._tag_number:
            raise Ignored("other_tag")
        if kind == "r" and self._corrected_seen:
            raise Ignored("raw_beside_corrected")
        self._corrected_seen = kind == "c"
        bits = int(mask, 16)
        ranges = [
            AnchorRange(anchor=str(i), range_m=int(field, 16) / 1e3)
            for i, field in enumerate(fields.split())
            if bits >> i & 1
        ]
        return self._ranges(ranges, t_ns)


def encode_line(
    kind: Literal["mc", "mr", "ma"],
    ranges_m: Sequence[float | None],
    *,
    number: int,
    seq: int,
    time: int,
    tag: int = 0,
) -> bytes:
    """One line with four or eight ranges [m]; None clears the mask bit. Resolution 1 mm."""
    mask = sum(1 << i for i, r in enumerate(ranges_m) if r is not None)
    fields = " ".join(f"{round((r or 0.0) * 1e3):08x}" for r in ranges_m)
    tail = f"{number & 0xFFFF:04x} {seq & 0xFF:02x} {time & 0xFFFFFFFF:08x} a{tag}:0"
    return f"{kind} {mask:02x} {fields} {tail}\r\n".encode("ascii")
