"""Records of an MCAP file, also of a damaged one: behind a damaged place the reading goes on at the next record.

A record is opcode, length, body; nothing but a chunk's checksum proves one. So a place where a record could begin
counts as one if its opcode and length are possible and another record, or the file's end, follows; a chunk is known by
its own inner lengths and checksum, whatever became of its header. Format: https://mcap.dev/spec
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Footer, McapRecord, Message, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from companion.logs.unpack import Budget, ChunkError, Exact, inside, unpack

HEADER_BYTES = 9
_FOOTER_BYTES = 20
_OPCODES = frozenset(Opcode)
_READ: dict[int, Any] = {
    Opcode.SCHEMA: lambda body, _: Schema.read(body),
    Opcode.CHANNEL: lambda body, _: Channel.read(body),
    Opcode.MESSAGE: Message.read,
    Opcode.CHUNK: lambda body, _: Chunk.read(body),
    Opcode.FOOTER: lambda body, _: Footer.read(body),
    Opcode.ATTACHMENT: lambda body, _: Attachment.read(body),
    Opcode.METADATA: lambda body, _: Metadata.read(body),
}
"""What reads the body of a record, given its length, too."""
_COMPRESSION = HEADER_BYTES + 8 + 8 + 8 + 4
"""From a chunk's beginning to the length of its compression's name."""
_BEGINNING = re.compile(rb"(?=[\x01-\x0f].{4}\0{4})|(?=\x04\0{3}zstd)|(?=\x03\0{3}lz4)", re.DOTALL)
"""Where a record may begin (lengths below 4 GiB), or the name of a chunk's compression stands."""


@dataclass(frozen=True, slots=True)
class Found:
    """Bytes [start, end) of the file: records that stand there (those of a chunk), or why they are lost (`trouble`)."""

    start: int
    end: int
    records: tuple[McapRecord, ...] | list[McapRecord] = ()
    trouble: str = ""
    chunk: bool = False
    closes: bool = False


class Records:
    """Everything in `data`, a whole file (bytes, or a map of it)."""

    def __init__(self, data: Any):
        self._data, self._size = data, len(data)
        self._budget = Budget(self._size)

    def __iter__(self) -> Iterator[Found]:
        """What stands in the file, in order and without gaps, to its end."""
        at = len(MCAP0_MAGIC)
        if self._data[:at] != MCAP0_MAGIC:
            yield Found(0, at := self._resume(0), trouble="these are not the first bytes of an MCAP file")
        while at < self._size:
            found = self._at(at)
            if found is None:
                found = Found(at, self._resume(at + 1), trouble=self._why(at))
            yield found
            if found.closes:
                return
            at = found.end

    def summary(self) -> Iterator[Schema | Channel]:
        """Schemas and channels that the file's end repeats, if the end is sound; else all outside of chunks."""
        repeated = self._repeated()
        if repeated is not None:
            return iter(repeated)
        outside = (record for found in self if not found.chunk for record in found.records)
        return (record for record in outside if isinstance(record, Schema | Channel))

    def _repeated(self) -> list[Schema | Channel] | None:
        """Schemas and channels between the place that the footer names and the footer; None: there is none such."""
        footer = self._size - len(MCAP0_MAGIC) - HEADER_BYTES - _FOOTER_BYTES
        header = self._header(footer) if footer > 0 else None
        if header is None or header[0] != Opcode.FOOTER:
            return None
        (at,) = struct.unpack_from("<Q", self._data, header[1])
        found: list[Schema | Channel] = []
        while 0 < at < footer and (header := self._header(at)):
            opcode, _, at = header
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                if (record := self._read(*header)) is None:
                    return None
                found.append(record)
        return found if at == footer else None

    def _at(self, at: int) -> Found | None:
        """What begins at byte `at`; None where that cannot be told."""
        header = self._header(at)
        if header is None:
            return self._bare_chunk(at)
        opcode, start, end = header
        if opcode == Opcode.CHUNK:
            found = self._chunk(at, start, end)
            return found if found and (not found.trouble or self._follows(end)) else self._bare_chunk(at)
        if opcode == Opcode.FOOTER:
            whole = end + len(MCAP0_MAGIC) == self._size and self._data[end:] == MCAP0_MAGIC
            return Found(at, self._size, closes=True) if whole and self._read(*header) else None
        return self._plain(at, *header) if self._follows(end) else None

    def _plain(self, at: int, opcode: int, start: int, end: int) -> Found:
        """A record at `at` that is neither chunk nor footer."""
        if opcode not in _READ:
            return Found(at, end)  # of the index, or of a kind that nobody here needs
        record = self._read(opcode, start, end)
        if record is None or (opcode == Opcode.ATTACHMENT and not self._is_sound(start, end)):
            return Found(at, end, trouble=f"a damaged {Opcode(opcode).name}")
        return Found(at, end, (record,))

    def _header(self, at: int) -> tuple[int, int, int] | None:
        """Opcode, beginning and end of the body of a record at `at`; None where none can be there."""
        start = at + HEADER_BYTES
        if start > self._size:
            return None
        opcode, length = struct.unpack_from("<BQ", self._data, at)
        known = opcode in _OPCODES or opcode >= 0x80  # the latter: private records of other writers
        return (opcode, start, start + length) if known and start + length <= self._size else None

    def _follows(self, at: int) -> bool:
        """Whether a record, or the end of a file that was cut off, follows at `at`."""
        return at == self._size or self._header(at) is not None

    def _read(self, opcode: int, start: int, end: int) -> Any:
        try:
            return _READ[opcode](Exact(self._data[start:end]), end - start)
        except (McapError, struct.error, UnicodeDecodeError):
            return None

    def _is_sound(self, start: int, end: int) -> bool:
        """Whether an attachment's checksum (its last four bytes; 0: none) is right."""
        checksum = int.from_bytes(self._data[end - 4 : end], "little")
        return checksum in (0, zlib.crc32(self._data[start : end - 4]))

    def _chunk(self, at: int, start: int, end: int) -> Found | None:
        """A chunk with its body in [start, end); None where that is no chunk's."""
        chunk = self._read(Opcode.CHUNK, start, end)
        if chunk is None:
            return None
        inner = start + _COMPRESSION - HEADER_BYTES + 4 + len(chunk.compression) + 8 + len(chunk.data)
        if inner < end and self._follows(inner):
            end = inner  # the header says too much
        try:
            return Found(at, end, inside(unpack(chunk, self._budget)), chunk=True)
        except ChunkError as error:
            return Found(at, end, trouble=str(error), chunk=True)

    def _bare_chunk(self, at: int) -> Found | None:
        """A chunk at `at` whose header says anything: its inner lengths and its checksum must be right.

        Another record follows it: what unpacks a chunk does not mind bytes behind it.
        """
        name = at + _COMPRESSION
        if self._data[name : name + 8] != b"\x04\0\0\0zstd" and self._data[name : name + 7] != b"\x03\0\0\0lz4":
            return None
        place = name + 4 + self._data[name]
        if place + 8 > self._size or not any(self._data[name - 4 : name]):
            return None
        end = place + 8 + int.from_bytes(self._data[place : place + 8], "little")
        found = self._chunk(at, at + HEADER_BYTES, end) if end <= self._size and self._follows(end) else None
        return found if found and not found.trouble else None

    def _resume(self, at: int) -> int:
        """The first byte from `at` on at which a record begins; the file's size where none does."""
        for match in _BEGINNING.finditer(self._data, at):
            place = match.start()
            if self._data[place] in (3, 4) and (chunk := place - _COMPRESSION) >= at and self._bare_chunk(chunk):
                return chunk
            header = self._header(place)
            if header and header[0] in _OPCODES and self._leads_on(header):
                return place
        return self._size

    def _leads_on(self, header: tuple[int, int, int]) -> bool:
        """Whether the record that may begin here is whole as far as one sees, and another one follows it."""
        opcode, start, end = header
        if opcode == Opcode.FOOTER:
            return end + len(MCAP0_MAGIC) == self._size
        if opcode in _READ and self._read(opcode, start, end) is None:
            return False
        return self._header(end) is not None or (end == self._size and opcode == Opcode.CHUNK)

    def _why(self, at: int) -> str:
        if self._size - at < HEADER_BYTES:
            return "a record's beginning is missing"
        opcode, length = struct.unpack_from("<BQ", self._data, at)
        name = Opcode(opcode).name if opcode in _OPCODES else f"opcode {opcode}"
        if at + HEADER_BYTES + length > self._size:
            return f"a record ({name}) of {length} bytes would go beyond the file's end"
        return f"a record ({name}) that is damaged"
