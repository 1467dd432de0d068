"""What befalls a log: damage of several kinds at places drawn at random, and chunks that unpack to far too much."""

from __future__ import annotations

import struct
import zlib
from itertools import pairwise
from pathlib import Path
from random import Random

import zstandard
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from companion.boat.recorder import Recorder
from companion.core.messages import Message

SYNC_NS = 250_000_000
"""How often the recorder ends a chunk (`companion/boat/recorder.py`)."""
KINDS = ("bit", "byte", "cut out", "put in", "overwritten", "zeros", "record header")


def record_synced(path: Path, messages: tuple[Message, ...]) -> Path:
    """Write messages as a run does, a chunk a quarter of a second."""
    now = [messages[0].t_ns]
    with Recorder(path, {"vessel": "x"}, lambda: now[0], wall_offset_ns=0, background=False) as recorder:
        synced_ns = now[0]
        for message in messages:
            now[0] = max(now[0], message.t_ns)
            if now[0] - synced_ns >= SYNC_NS:
                recorder.sync()
                synced_ns = now[0]
            recorder.record(message)
    return path


def headers(data: bytes) -> list[int]:
    """Where the records of a sound file begin."""
    at, found = len(MCAP0_MAGIC), []
    while at < len(data) - len(MCAP0_MAGIC):
        found.append(at)
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    return found


def damaged(data: bytes, kind: str, dice: Random, records: list[int]) -> bytes:
    """`data`, in which records begin at `records`, with one damage of a kind of KINDS."""
    at, size = dice.randrange(len(data)), dice.randint(1, 4096)
    if kind == "record header":
        at = dice.choice(records) + dice.randrange(9)
    if kind == "bit":
        return _put(data, at, bytes([data[at] ^ 1 << dice.randrange(8)]))
    if kind in ("byte", "record header"):
        return _put(data, at, bytes([data[at] ^ dice.randint(1, 255)]))
    if kind == "cut out":
        return data[:at] + data[at + size :]
    if kind == "put in":
        return data[:at] + dice.randbytes(size) + data[at:]
    return _put(data, at, bytes(size) if kind == "zeros" else dice.randbytes(size))[: len(data)]


def _put(data: bytes, at: int, new: bytes) -> bytes:
    return data[:at] + new + data[at + len(new) :]


def chunk_of(path: Path) -> bytes:
    """The first chunk of a log."""
    data = path.read_bytes()
    at, after = next((at, after) for at, after in pairwise(headers(data)) if data[at] == Opcode.CHUNK)
    return data[at:after]


def bomb(path: Path, unpacked: int, says: int | None = None, chunks: int = 1) -> Path:
    """An MCAP file of `chunks` chunks with `unpacked` zero bytes each, as one message; they say `says` bytes."""
    topic = b"/tick"
    channel = struct.pack("<HHI", 1, 0, len(topic)) + topic + struct.pack("<I", 4) + b"json" + struct.pack("<I", 0)
    head = _record(Opcode.CHANNEL, channel) + struct.pack("<BQHIQQ", Opcode.MESSAGE, 22 + unpacked, 1, 0, 1, 1)
    size = len(head) + unpacked
    packer = zstandard.ZstdCompressor(level=1).compressobj(size=size)
    block, parts, crc = bytes(1 << 20), [packer.compress(head)], zlib.crc32(head)
    for at in range(0, unpacked, len(block)):
        piece = block[: unpacked - at]
        parts.append(packer.compress(piece))
        crc = zlib.crc32(piece, crc)
    packed = b"".join([*parts, packer.flush()])
    body = struct.pack("<QQQII", 1, 1, size if says is None else says, crc, 4) + b"zstd"
    chunk = _record(Opcode.CHUNK, body + struct.pack("<Q", len(packed)) + packed)
    start = _record(Opcode.HEADER, struct.pack("<II", 0, 0))
    end = _record(Opcode.DATA_END, bytes(4)) + _record(Opcode.FOOTER, bytes(20))
    path.write_bytes(MCAP0_MAGIC + start + chunk * chunks + end + MCAP0_MAGIC)
    return path


def _record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body
