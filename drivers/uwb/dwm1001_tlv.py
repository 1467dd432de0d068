"""DWM1001 with PANS firmware, binary TLV API: the host polls, the module answers. 115200 8N1.

    poll     0C 00                                               dwm_loc_get
    answer   40 01 00 | 41 0D x y z qf | 49 L n  n x { addr u16, range u32, qf u8, x y z i32, qf u8 }
    refusal  40 01 e                                             e > 0

Little-endian, millimetres, quality 0-100, L = 1 + 20 n. Quality 0 of the position: no fix.

Integrity: no checksum. An answer must have all three headers in place, L agreeing with n, qualities <= 100,
no address twice and every range under the limit; else the scan goes on one byte later. A lost byte shifts
the quality behind a range into the range's highest byte, far over the limit, so shifted frames fall out
too; the next poll throws away what is left of an unfinished answer. What cannot be seen: a flipped bit in
the low bytes of a range or in an address. An answer equal to the last one to the millimetre is the module
repeating itself between two of its own updates, and is ignored.

Sources: the module's API guide as used by public parsers.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from companion.core.messages import AnchorRange, Message
from drivers.uwb.dwm1001 import AnchorReport, TagFix
from drivers.uwb.lines import MAX_RANGE_M, UwbCodecBase

POLL = b"\x0c\x00"
NOT_UNDERSTOOD = b"\x40\x01\x01"
_HEAD = b"\x40\x01\x00\x41\x0d"
_POSITION = struct.Struct("<iiiB")
_ANCHOR = struct.Struct("<HIBiiiB")
_FIXED = len(_HEAD) + _POSITION.size  # up to the anchors' TLV
_MAX_ANCHORS = 12  # the length byte leaves room for no more


class Dwm1001TlvCodec(UwbCodecBase):
    """Codec of the TLV API. `rate_hz`: poll rate; the module's own update rate is not changed."""

    def __init__(self, tag: str, *, rate_hz: float = 1.0) -> None:
        super().__init__(tag)
        if not rate_hz > 0.0:
            raise ValueError(f"rate_hz must be positive, not {rate_hz}")
        self._period_ns = round(1e9 / rate_hz)
        self.start_bytes()

    def start_bytes(self) -> list[bytes]:
        """Forget half an answer and the last one; poll at the next step."""
        self._buffer = bytearray()
        self._last = b""
        self._next_poll_ns: int | None = None
        return []

    def step(self, t_ns: int) -> list[bytes]:
        """The poll, when it is due. Whatever is left of an unfinished answer is thrown away then."""
        if self._next_poll_ns is not None and t_ns < self._next_poll_ns:
            return []
        late = self._next_poll_ns is None or t_ns - self._next_poll_ns > self._period_ns
        base_ns = t_ns if late or self._next_poll_ns is None else self._next_poll_ns
        self._next_poll_ns = base_ns + self._period_ns
        self._drop(len(self._buffer), "truncated")
        return [POLL]

    def feed(self, data: bytes, t_ns: int) -> list[Message]:
        """Messages completed by `data`, which arrived at `t_ns`. Never raises."""
        messages: list[Message] = []
        self._buffer += data
        while self._buffer:
            frame = self._frame()
            if frame is None:
                break
            if frame:
                messages += self._decode(frame, t_ns)
        return messages

    def _frame(self) -> bytes | None:
        """Next whole answer; b"" where bytes were dropped instead; None: more bytes are needed."""
        buffer = self._buffer
        if buffer[0] != _HEAD[0]:
            start = buffer.find(_HEAD[:1])
            return self._drop(len(buffer) if start < 0 else start, "noise")
        head = bytes(buffer[: len(_HEAD)])
        if head[:2] == _HEAD[:2] and len(head) > 2 and head[2] != 0:
            return self._drop(3, "refused")
        if not _HEAD.startswith(head):
            return self._drop(1, "noise")
        if len(buffer) < _FIXED + 3:
            return None
        kind, length, n = buffer[_FIXED : _FIXED + 3]
        if kind != 0x49 or n > _MAX_ANCHORS or length != 1 + n * _ANCHOR.size:
            return self._drop(1, "layout")
        size = _FIXED + 2 + length
        return bytes(buffer[:size]) if len(buffer) >= size else None

    def _drop(self, count: int, reason: str) -> bytes:
        del self._buffer[:count]
        self.counters.garbage += count
        if count:
            self.counters.reasons[reason] += count
        return b""

    def _decode(self, frame: bytes, t_ns: int) -> list[Message]:
        x, y, z, quality = _POSITION.unpack_from(frame, len(_HEAD))
        rows = list(_ANCHOR.iter_unpack(frame[_FIXED + 3 :]))
        sound = (
            quality <= 100
            and all(row[1] <= MAX_RANGE_M * 1e3 and row[2] <= 100 and row[6] <= 100 for row in rows)
            and len({row[0] for row in rows}) == len(rows)
        )
        if not sound:
            self._drop(1, "layout")
            return []
        del self._buffer[: len(frame)]
        self.counters.lines += 1
        if frame == self._last:
            self.counters.ignored += 1
            self.counters.reasons["repeated"] += 1
            return []
        self._last = frame
        self.counters.good += 1
        ranges = [AnchorRange(anchor=f"{r[0]:04X}", range_m=r[1] / 1e3, quality=r[2]) for r in rows]
        return self._ranges(ranges, t_ns) + self._position((x / 1e3, y / 1e3, z / 1e3), quality, t_ns)


def encode_location(anchors: Sequence[AnchorReport], fix: TagFix | None) -> bytes:
    """The answer to `0C 00`. Resolution 1 mm; without a fix the position is zero with quality 0."""
    position_m, quality = fix if fix is not None else ((0.0, 0.0, 0.0), 0)
    rows = [
        _ANCHOR.pack(int(a.anchor, 16), round(a.range_m * 1e3), a.quality, *_mm(a.position_m), 100) for a in anchors
    ]
    head = _HEAD + _POSITION.pack(*_mm(position_m), quality)
    return head + bytes((0x49, 1 + len(rows) * _ANCHOR.size, len(rows))) + b"".join(rows)


def _mm(position_m: tuple[float, float, float]) -> tuple[int, ...]:
    return tuple(round(v * 1e3) for v in position_m)
