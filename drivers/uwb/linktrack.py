"""Nooploop LinkTrack, binary NLink protocol, frame Node_Frame2. 921600 8N1, little-endian.

    offset  0  55 04          13  position 3 x int24 [mm]     118  n, then n nodes of 13 bytes:
            2  length u16     22  velocity 3 x int24 [1e-4 m/s]    0 role, 1 id, 2 range int24 [mm],
            4  role, id       116 voltage u16 [mV]                 5 first-path and 6 received power
            6  time u32 [ms]                                         [-0.5 dBm], 7 time u32 [ms], 11 spare
           10  precision 3 x u8 [cm]                          last byte: sum of all before, modulo 256

-8388000 in an int24 field means invalid. Positions are ENU in the frame in which the anchors were set up
(x east, y north, z up if they were surveyed so). They go into UwbPosition unchanged, for that message's
frame is the anchors' own; turning it into NED is the matter of whoever knows the survey. Anchors are known
by their decimal id: "0", "1", ... Ranges to other tags (role 2) are left out.

Integrity: header, length agreeing with n, and the sum: any single wrong byte is caught; two errors that
cancel in the sum are not. After a bad frame the scan goes on one byte behind its header.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import ClassVar

from companion.core.messages import AnchorRange, Message
from drivers.uwb.lines import UwbCodecBase

HEADER = b"\x55\x04"
INVALID = -8388000
ANCHOR, TAG = 1, 2  # roles
_FIXED = 119  # bytes before the nodes
_NODE = 13
_MAX_NODES = 40  # assumed: a LinkTrack cell holds fewer anchors; bounds how long a false header can stall


class LinkTrackCodec(UwbCodecBase):
    """Codec of Node_Frame2. Other NLink frames are skipped as noise."""

    baud: ClassVar[int] = 921600

    def __init__(self, tag: str) -> None:
        super().__init__(tag)
        self._buffer = bytearray()

    def start_bytes(self) -> list[bytes]:
        """Forget half a frame. Nothing to send."""
        self._buffer.clear()
        return []

    def feed(self, data: bytes, t_ns: int) -> list[Message]:
        """Messages completed by `data`, which arrived at `t_ns`. Never raises."""
        messages: list[Message] = []
        self._buffer += data
        while self._buffer:
            frame = self._frame()
            if frame is None:
                break
            if frame:
                self.counters.lines += 1
                self.counters.good += 1
                messages += self._decode(frame, t_ns)
        return messages

    def _frame(self) -> bytes | None:
        """Next sound frame; b"" where bytes were dropped instead; None: more bytes are needed."""
        buffer = self._buffer
        start = buffer.find(HEADER)
        if start < 0:
            start = len(buffer) - (buffer[-1] == HEADER[0])
        if start > 0:
            return self._drop(start, "noise")
        if len(buffer) < 4:
            return None
        size = int.from_bytes(buffer[2:4], "little")
        nodes, odd = divmod(size - _FIXED - 1, _NODE)
        whole = len(buffer) >= size
        if odd or not 0 <= nodes <= _MAX_NODES or (whole and buffer[_FIXED - 1] != nodes):
            return self._drop(1, "length")
        if not whole:
            return None
        if sum(buffer[: size - 1]) & 0xFF != buffer[size - 1]:
            return self._drop(1, "checksum")
        frame = bytes(buffer[:size])
        del buffer[:size]
        return frame

    def _drop(self, count: int, reason: str) -> bytes:
        del self._buffer[:count]
        self.counters.garbage += count
        self.counters.reasons[reason] += count
        return b""

    def _decode(self, frame: bytes, t_ns: int) -> list[Message]:
        ranges = []
        for at in range(_FIXED, len(frame) - 1, _NODE):
            role, number, rx_power = frame[at], frame[at + 1], frame[at + 6]
            mm = _int24(frame, at + 2)
            if role == TAG:
                self.counters.reasons["other_tag"] += 1
            elif mm == INVALID:
                self.counters.reasons["invalid_range"] += 1
            else:
                ranges.append(AnchorRange(anchor=str(number), range_m=mm / 1e3, rssi_dbm=-rx_power / 2))
        messages = self._ranges(ranges, t_ns)
        x, y, z = (_int24(frame, 13 + 3 * i) for i in range(3))
        if INVALID in (x, y, z):
            self.counters.reasons["no_fix"] += 1
            return messages
        return messages + self._position((x / 1e3, y / 1e3, z / 1e3), None, t_ns)


def _int24(frame: bytes, at: int) -> int:
    return int.from_bytes(frame[at : at + 3], "little", signed=True)


def _pack24(value: int) -> bytes:
    return value.to_bytes(3, "little", signed=True)


def encode_node_frame2(
    tag_id: int,
    time_ms: int,
    ranges_m: Mapping[int, float],
    position_m: tuple[float, float, float] | None,
    rssi_dbm: float = -80.0,
) -> bytes:
    """One Node_Frame2 of a tag: anchor id -> range [m], position ENU [m] or None. Resolution 1 mm.

    Velocity and angles are zero, the attitude quaternion is one, precision 5 cm, 4.95 V (assumed values).
    """
    position = [INVALID] * 3 if position_m is None else [round(v * 1e3) for v in position_m]
    power = round(-2 * rssi_dbm)
    frame = bytearray(_FIXED)
    frame[0:2] = HEADER
    struct.pack_into("<HBBI", frame, 2, _FIXED + _NODE * len(ranges_m) + 1, TAG, tag_id, time_ms & 0xFFFFFFFF)
    frame[10:13] = bytes((5, 5, 5))
    frame[13:22] = b"".join(_pack24(v) for v in position)
    struct.pack_into("<f", frame, 82, 1.0)
    struct.pack_into("<HB", frame, 116, 4950, len(ranges_m))
    for number, range_m in ranges_m.items():
        frame += bytes((ANCHOR, number)) + _pack24(round(range_m * 1e3)) + bytes((power, power))
        frame += struct.pack("<IH", time_ms & 0xFFFFFFFF, 0)
    return bytes(frame) + bytes((sum(frame) & 0xFF,))
