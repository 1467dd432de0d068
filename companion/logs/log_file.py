"""Reading a log: typed messages in the order in which they were written, also from a damaged file.

A log is `NAME.mcap` with its continuations `NAME.part1.mcap`, ...; all are read as one. Reading never needs
the index, so a file that was cut off by SIGKILL or a power cut gives all that came before the cut; a chunk
whose checksum is wrong is left out. What was met on the way stands in `damage`, `unknown` and `undecodable`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, McapRecord, Metadata, Schema
from mcap.records import Message as MessageRecord
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from companion.core.messages import Message
from companion.logs.part import log_parts
from companion.logs.schema import KINDS, METADATA_NAME, RAW_PREFIX, VIEWER_PREFIX, RawBytes

_DECODERS = {kind: msgspec.json.Decoder(kind) for kind in (*KINDS.values(), RawBytes)}


class LogError(Exception):
    """The file cannot be read as a log: path and reason."""


class LogEntry(NamedTuple):
    """One logged message, not yet decoded. `log_time_ns` is wall clock; `sequence` counts per channel."""

    topic: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: bytes


class Part:
    """Records of one file. After `records` is exhausted: `damage` (None: sound) and bytes kept and lost."""

    def __init__(self, path: Path):
        self.path = path
        self.damage: str | None = None
        self.kept_bytes = 0
        self.lost_bytes = 0
        try:
            self.size = path.stat().st_size
            with path.open("rb") as file:
                magic = file.read(len(MCAP0_MAGIC))
        except OSError as error:
            raise LogError(f"{path}: {error.strerror}") from None
        if not magic:
            raise LogError(f"{path}: the file is empty")
        if magic != MCAP0_MAGIC:
            raise LogError(f"{path}: not an MCAP log (its first bytes are {magic.hex(' ')})")

    def declared(self) -> list[Schema | Channel]:
        """Schemas and channels from the index at the end, if it exists: needed where their chunk is damaged."""
        try:
            with self.path.open("rb") as file:
                summary = SeekingReader(file, record_size_limit=self.size).get_summary()
        except Exception:  # no footer, or garbage: then the chunks alone must do
            return []
        return [*summary.schemas.values(), *summary.channels.values()] if summary else []

    def records(self) -> Iterator[McapRecord]:
        """All readable records, those inside chunks included, in file order."""
        bad_chunks: list[str] = []
        skipped = 0
        self.kept_bytes = len(MCAP0_MAGIC)
        with self.path.open("rb") as file:
            # A length beyond the file's own is damage; without the limit mcap would allocate it.
            records = StreamReader(file, emit_chunks=True, record_size_limit=self.size).records
            while True:
                try:
                    record = next(records)
                except StopIteration:
                    end, self.kept_bytes = None, file.tell()
                    break
                except Exception as error:  # mcap and struct raise a dozen kinds on garbage; all mean the same
                    end = f"ends without footer after byte {self.kept_bytes} ({_reason(error)})"
                    break
                self.kept_bytes = file.tell()
                if not isinstance(record, Chunk):
                    yield record
                    continue
                try:
                    inside = breakup_chunk(record, validate_crc=True)
                except Exception as error:  # as above, and zstd's own
                    bad_chunks.append(_reason(error))
                    skipped += len(record.data)
                    continue
                yield from inside
        self.kept_bytes -= skipped
        self.lost_bytes = self.size - self.kept_bytes
        problems = [f"{len(bad_chunks)} damaged chunk(s) left out ({bad_chunks[0]})"] if bad_chunks else []
        problems += [end] if end else []
        self.damage = f"{self.path}: {'; '.join(problems)}" if problems else None


class LogFile:
    """A log to read. Raises LogError (with the path) where there is no log to read at all."""

    def __init__(self, path: Path):
        if not path.is_file():
            raise LogError(f"{path}: no such file")
        self.path = path
        self.paths = log_parts(path)
        self.damage: list[str] = []
        self.unknown: Counter[str] = Counter()
        self.undecodable: Counter[str] = Counter()
        self.metadata: dict[str, str] = {}
        self.attachments: dict[str, bytes] = {}
        self._read_head()

    @property
    def wall_offset_ns(self) -> int:
        """Wall clock minus the companion's monotonic clock; 0 where the log does not say."""
        return int(self.metadata.get("wall_offset_ns", "0"))

    def entries(self) -> Iterator[LogEntry]:
        """All messages of all parts in the order written. Restarts `damage` and the counters."""
        self.damage.clear()
        self.unknown.clear()
        self.undecodable.clear()
        for path in self.paths:
            try:
                part = Part(path)
            except LogError as error:
                self.damage.append(str(error))
                continue
            yield from self._entries_of(part)
            if part.damage:
                self.damage.append(part.damage)

    def messages(self, *kinds: type[Message]) -> Iterator[Message]:
        """Typed messages in the order written, of `kinds` (default: all but raw bytes)."""
        wanted = frozenset(kinds or KINDS.values())
        for entry in self.entries():
            kind = KINDS.get(entry.topic)
            if kind in wanted:
                message = self.decode(entry)
                if message is not None:
                    yield message
            elif kind is None and not entry.topic.startswith((RAW_PREFIX, VIEWER_PREFIX)):
                self.unknown[entry.topic] += 1

    def raw(self, link: str | None = None) -> Iterator[RawBytes]:
        """Raw bytes of one link, or of all, in the order written."""
        for entry in self.entries():
            if entry.topic == RAW_PREFIX + link if link else entry.topic.startswith(RAW_PREFIX):
                message = self.decode(entry)
                if isinstance(message, RawBytes):
                    yield message

    def decode(self, entry: LogEntry) -> Message | None:
        """Message of a known topic or raw bytes; None (and counted) where the data does not fit its class."""
        kind = KINDS.get(entry.topic, RawBytes)
        try:
            return _DECODERS[kind].decode(entry.data)
        except msgspec.DecodeError:
            self.undecodable[entry.topic] += 1
            return None

    def _entries_of(self, part: Part) -> Iterator[LogEntry]:
        topics = {record.id: record.topic for record in part.declared() if isinstance(record, Channel)}
        for record in part.records():
            if isinstance(record, MessageRecord):
                topic = topics.get(record.channel_id)
                if topic is None:  # its channel was declared in a damaged chunk, and there is no index
                    self.unknown[f"channel {record.channel_id}"] += 1
                    continue
                yield LogEntry(topic, record.log_time, record.publish_time, record.sequence, record.data)
            elif isinstance(record, Channel):
                topics[record.id] = record.topic

    def _read_head(self) -> None:
        """Metadata and attachments of the first part; they stand before its first message."""
        for record in Part(self.path).records():
            if isinstance(record, Metadata) and record.name == METADATA_NAME:
                self.metadata.update(record.metadata)
            elif isinstance(record, Attachment):
                self.attachments[record.name] = record.data
            elif isinstance(record, MessageRecord | Channel | Schema):
                return


def _reason(error: Exception) -> str:
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
