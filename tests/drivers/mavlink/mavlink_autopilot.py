"""Test helper: an independent sender and reader of MAVLink frames, plain pymavlink, nothing of ours."""

import struct
from collections import Counter
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect


class Sender:
    """Packs messages as (system, component): `Sender().heartbeat(...)` gives the frame's bytes."""

    def __init__(self, system: int = 1, component: int = 1, v1: bool = False) -> None:
        self.mav = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        self.v1 = v1

    def __getattr__(self, name: str):
        def send(*args: Any, **kwargs: Any) -> bytes:
            message = getattr(self.mav, f"{name}_encode")(*args, **kwargs)
            data = bytes(message.pack(self.mav, force_mavlink1=self.v1))
            self.mav.seq = (self.mav.seq + 1) % 256
            return data

        return send

    def beat(self, armed: bool = False, kind: int = 11, autopilot: int = 3, mode: int = 0) -> bytes:
        return self.heartbeat(kind, autopilot, 193 if armed else 65, mode, 4)

    def att(self, t_ms: int = 1000, yaw: float = 0.5) -> bytes:
        return self.attitude(t_ms, 0.01, -0.02, yaw, 0.001, 0.002, 0.003)

    def imu(self, t_us: int = 1_000_000, zacc: int = -1001) -> bytes:
        return self.raw_imu(t_us, 10, -20, zacc, 1, -2, 300, 0, 0, 0)


def read_one(data: bytes) -> Any:
    """The one message in `data`, decoded by a fresh pymavlink object."""
    messages = dialect.MAVLink(None).parse_buffer(data)
    assert messages is not None and len(messages) == 1
    return messages[0]


def frame(ident: int, payload: bytes) -> bytes:
    """A frame of any content with a good checksum, from 1/1."""
    head = dialect.MAVLink_header(ident, mlen=len(payload), srcSystem=1, srcComponent=1).pack()
    crc = dialect.x25crc(head[1:] + payload + bytes([dialect.mavlink_map[ident].crc_extra])).crc
    return head + payload + struct.pack("<H", crc)


def tlog_frames(data: bytes) -> list[tuple[int, bytes]]:
    """(stamp [us], frame) of every record of a tlog: big-endian u64 and a raw frame."""
    out: list[tuple[int, bytes]] = []
    at = 0
    while at < len(data):
        (t_us,) = struct.unpack_from(">Q", data, at)
        at += 8
        v2 = data[at] == 0xFD
        end = at + data[at + 1] + (12 if v2 else 8) + (13 if v2 and data[at + 2] & 1 else 0)
        out.append((t_us, data[at:end]))
        at = end
    return out


def pymavlink_counts(tlog: Path) -> Counter[str]:
    """Messages per type as pymavlink's own log reader counts them."""
    from pymavlink import mavutil

    log = mavutil.mavlink_connection(str(tlog))
    counts: Counter[str] = Counter()
    while (m := log.recv_match()) is not None:
        counts[m.get_type()] += 1
    log.close()
    return counts
