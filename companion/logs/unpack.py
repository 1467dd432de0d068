"""Unpacking the chunks of a log within limits: what a file may cost in memory and time follows from its size.

A chunk says how much it unpacks to, and may lie: 192 kB unpack to 6 GB. So it is unpacked no further than it says, it
may say no more than `MOST_CHUNK_BYTES`, and all chunks of a file together get a `Budget`.
"""

from __future__ import annotations

import io
import struct
import zlib

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema

MOST_CHUNK_BYTES = 16 * 1024**2
"""What one chunk may unpack to: 256 times our own, four times what other writers of MCAP make; assumed."""
MOST_RATIO = 100
"""What a file may unpack to over its size, beside one chunk: ours unpack to 3 times; assumed."""
_MESSAGE = struct.Struct("<HIQQ")
"""Channel, sequence, log time, publish time; the message's data follows."""


class ChunkError(Exception):
    """Why a chunk is not read."""


def most_bytes(size: int) -> int:
    """What a file of `size` bytes may unpack to."""
    return MOST_CHUNK_BYTES + MOST_RATIO * size


class Budget:
    """How many bytes the chunks of a file of `size` bytes may still unpack to."""

    def __init__(self, size: int):
        self.most = self.left = most_bytes(size)

    def spend(self, size: int) -> None:
        """Take `size` bytes, or raise ChunkError where there are not so many left."""
        if size > self.left:
            text = f"it would unpack to {_size(size)}, and this file to more than {_size(self.most)} in all"
            raise ChunkError(f"{text}: {MOST_RATIO} times its size")
        self.left -= size


def unpack(chunk: Chunk, budget: Budget) -> bytes:
    """Content of a chunk whose size and checksum are right. Raises ChunkError."""
    size = chunk.uncompressed_size
    if size > MOST_CHUNK_BYTES:
        raise ChunkError(f"it would unpack to {_size(size)}; a chunk may have {_size(MOST_CHUNK_BYTES)}")
    budget.spend(size)
    try:
        data = _unpacked(chunk.compression, chunk.data, size + 1)
    except (zstandard.ZstdError, RuntimeError, MemoryError) as error:  # lz4 raises RuntimeError
        raise ChunkError(f"cannot be unpacked: {error}") from None
    if len(data) != size:
        raise ChunkError(f"unpacks to {'more' if len(data) > size else 'fewer'} than the {size} bytes that it says")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ChunkError("its checksum is wrong")
    return data


def inside(data: bytes) -> list[McapRecord]:
    """Schemas, channels and messages of an unpacked chunk, all or none. Raises ChunkError."""
    records: list[McapRecord] = []
    at = 0
    while at < len(data):
        opcode, length, start = data[at], int.from_bytes(data[at + 1 : at + 9], "little"), at + 9
        at = start + length
        try:
            if start > len(data) or at > len(data):
                raise EndOfFile
            if opcode == Opcode.MESSAGE:
                channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, start)
                if length < _MESSAGE.size:
                    raise EndOfFile
                body = data[start + _MESSAGE.size : at]
                records.append(Message(channel, log_time, body, publish_time, sequence))
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                records.append((Schema if opcode == Opcode.SCHEMA else Channel).read(Exact(data[start:at])))
        except (McapError, struct.error, UnicodeDecodeError):
            raise ChunkError(f"a record inside, {start - 9} bytes from its beginning, cannot be read") from None
    return records


class Exact(ReadDataStream):
    """A record's body: whoever reads beyond its end gets EndOfFile, where mcap's own stream gives what is left."""

    def __init__(self, body: bytes):
        super().__init__(io.BytesIO(body))
        self._left = len(body)

    def read(self, length: int) -> bytes:
        """Next `length` bytes. Raises EndOfFile, also where a damaged length is more than an index can be."""
        if not 0 <= length <= self._left:
            raise EndOfFile
        self._left -= length
        return super().read(length)


def _unpacked(compression: str, packed: bytes, most: int) -> bytes:
    """The first `most` bytes of what `packed` unpacks to."""
    if compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(packed) as stream:
            return stream.read(most)
    if compression == "lz4":
        return lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=most)
    if compression:
        raise ChunkError(f"its compression {compression!r} is not known")
    return packed


def _size(size: int) -> str:
    return f"{size / 1e6:.4g} MB"
