"""Find MAVLink 1 and 2 frames in a byte stream; lose at most the frames that a fault hits.

pymavlink's own `parse_buffer` skips as many bytes as a broken frame claims to have, so one flipped byte may
swallow the neighbours too: with one flipped byte in 1,000 of a real stream (1,223 frames hit) it lost about
1,480 and made up about 90 messages with unknown ids. Here a candidate that fails its checksum costs one
byte, its marker, and the search goes on inside it. A frame of an unknown id has no checksum that could be
verified; its length is believed only where the frame before it was good and another marker follows it.

The wire format and the checksum are pymavlink's (`MAVLink.decode`); this file only decides where a frame
begins. Source: https://mavlink.io/en/guide/serialization.html
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

_V1, _V2 = dialect.PROTOCOL_MARKER_V1, dialect.PROTOCOL_MARKER_V2
_HEADER_LEN = {_V1: dialect.HEADER_LEN_V1, _V2: dialect.HEADER_LEN_V2}
_MARKER = re.compile(rb"[\xfd\xfe]")
_CRC_LEN = 2
STALE_NS = 500_000_000
"""An incomplete frame that waits for longer than this no longer blocks those behind it (assumed; a full
frame of 280 bytes takes 49 ms at 57,600 baud)."""


class Framer:
    """Bytes in, decoded pymavlink messages out. Never raises on any bytes.

    `bad_data` counts faults (places where the stream stopped making sense), `bad_bytes` the bytes skipped,
    `unknown` the frames per message id that the dialect does not know. `on_frame` gets the bytes of every frame
    that was found, those of unknown ids too.
    """

    def __init__(self) -> None:
        self.bad_data = 0
        self.bad_bytes = 0
        self.unknown: dict[int, int] = {}
        self.on_frame: Callable[[bytes], None] | None = None
        self._mav = dialect.MAVLink(None)
        self._buf = bytearray()
        self._synced = True
        self._waiting_since_ns: int | None = None

    def feed(self, data: bytes, t_ns: int) -> list[Any]:
        """Messages that `data` completes, in order. `t_ns` [ns] only ages an incomplete frame."""
        self._buf += data
        out: list[Any] = []
        pos = 0
        while (pos := self._seek(pos)) < len(self._buf):
            header = self._header(pos)
            known = header is not None and header[1] in dialect.mavlink_map
            if header is None or not (known or self._synced):
                pos = self._reject(pos)
                continue
            length, ident = header
            if pos + length + (not known) > len(self._buf):
                if not self._stale(t_ns):
                    break
                pos = self._reject(pos)
            else:
                pos = self._decode(pos, length, out) if known else self._pass_over(pos, length, ident)
        del self._buf[:pos]
        return out

    def _seek(self, pos: int) -> int:
        """Position of the next marker at or after `pos`; the end of the buffer where there is none."""
        found = _MARKER.search(self._buf, pos)
        start = found.start() if found else len(self._buf)
        if start > pos:
            self._lose_sync()
            self.bad_bytes += start - pos
        return start

    def _header(self, pos: int) -> tuple[int, int] | None:
        """Length [bytes] and message id that the candidate at `pos` claims; None: it is no frame.

        Where the header is not here yet: the length of the header and an id that stands for known.
        """
        buf, marker = self._buf, self._buf[pos]
        header_len = _HEADER_LEN[marker]
        if len(buf) - pos < header_len:
            return header_len, dialect.MAVLINK_MSG_ID_HEARTBEAT
        length = header_len + buf[pos + 1] + _CRC_LEN
        if marker == _V1:
            return length, buf[pos + 5]
        flags = buf[pos + 2]
        if flags & ~dialect.MAVLINK_IFLAG_SIGNED:
            return None
        signature = dialect.MAVLINK_SIGNATURE_BLOCK_LEN if flags else 0
        return length + signature, int.from_bytes(buf[pos + 7 : pos + 10], "little")

    def _decode(self, pos: int, length: int, out: list[Any]) -> int:
        """Check and decode the complete candidate of known id at `pos`; returns where to go on."""
        try:
            out.append(self._mav.decode(self._buf[pos : pos + length]))
        except dialect.MAVError:
            return self._reject(pos)
        self._synced, self._waiting_since_ns = True, None
        self._show(pos, length)
        return pos + length

    def _pass_over(self, pos: int, length: int, ident: int) -> int:
        """Count the frame of unknown id at `pos`, behind a good frame, if a marker follows it too."""
        if self._buf[pos + length] not in _HEADER_LEN:
            return self._reject(pos)
        self.unknown[ident] = self.unknown.get(ident, 0) + 1
        self._waiting_since_ns = None
        self._show(pos, length)
        return pos + length

    def _show(self, pos: int, length: int) -> None:
        if self.on_frame is not None:
            self.on_frame(bytes(self._buf[pos : pos + length]))

    def _reject(self, pos: int) -> int:
        self._lose_sync()
        self.bad_bytes += 1
        self._waiting_since_ns = None
        return pos + 1

    def _lose_sync(self) -> None:
        self.bad_data += self._synced
        self._synced = False

    def _stale(self, t_ns: int) -> bool:
        """Has the frame at the head of the buffer been incomplete for too long? Starts the clock."""
        if self._waiting_since_ns is None:
            self._waiting_since_ns = t_ns
        return t_ns - self._waiting_since_ns > STALE_NS
