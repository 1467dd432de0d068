"""Reading a log: typed messages in the order in which they were written, also from a damaged file.

A log is `NAME.mcap` with its continuations `NAME.part1.mcap`, ... of the same run; all are read as one. Reading
never needs the index, so a file that was cut off by SIGKILL or a power cut gives all that came before the cut; a
chunk whose checksum is wrong is left out, and so is a message that does not fit its class, as of another version. What
was met on the way stands in `damage`, `unknown` and `undecodable`; `read` is how many messages were, and `lacks_after`
after how many of them the first may be missing (None: none is known of).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec
from mcap.records import Attachment, Channel
from mcap.records import Message as MessageRecord

from companion.core.messages import GroundTruth, Message
from companion.logs.part_files import log_parts
from companion.logs.part_reader import LogError, Part, head_of, opened
from companion.logs.schema import KINDS, METADATA_NAME, RAW_PREFIX, VIEWER_PREFIX, RawBytes

_DECODERS = {kind: msgspec.json.Decoder(kind) for kind in (*KINDS.values(), RawBytes)}


SAME_RUN_NS = 60_000_000_000
"""Boat and simulator of one run state offsets of the wall clock that agree to some us, where it was not set between
their starts; assumed."""


class LogEntry(NamedTuple):
    """One logged message, not yet decoded. `log_time_ns` is wall clock; `sequence` counts per channel."""

    topic: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: bytes


def open_truth(path: Path, log: LogFile) -> LogFile:
    """The simulator's own log beside the boat's. Raises LogError where no ground truth stands in it (a boat's log is no
    truth), and where it is of another run: both state how far the wall clock is from theirs, which runs share.
    """
    truth = LogFile(path)
    if next(truth.messages(GroundTruth), None) is None:
        odd = " that this version can read" if truth.undecodable else "; expected the simulator's own log (truth.mcap)"
        raise LogError("; ".join([f"{path}: holds no ground truth{odd}", *truth.damage]))
    offsets_ns = truth.wall_offset_ns, log.wall_offset_ns
    if all(offsets_ns) and abs(offsets_ns[0] - offsets_ns[1]) > SAME_RUN_NS:
        raise LogError(f"{path}: is of another run than {log.path}, by the clocks that both state")
    return truth


class LogFile:
    """A log to read. Raises LogError (with the path) where there is no log to read at all, in none of its parts."""

    def __init__(self, path: Path):
        if not path.is_file():
            raise LogError(f"{path}: no such file")
        self.path = path
        self.paths = log_parts(path)
        self.damage: list[str] = []
        self.unknown: Counter[str] = Counter()
        self.undecodable: Counter[str] = Counter()
        self.read = 0
        self.lacks_after: int | None = None
        self.metadata: dict[str, str] = {}
        self.attachments: dict[str, bytes] = {}
        for record in head_of(self.paths):
            if isinstance(record, Attachment):
                self.attachments[record.name] = record.data
            elif record.name == METADATA_NAME:
                self.metadata = record.metadata

    @property
    def wall_offset_ns(self) -> int:
        """Wall clock minus the companion's monotonic clock; 0 where the log does not say. LogError: no whole number."""
        said = self.metadata.get("wall_offset_ns", "0")
        try:
            return int(said)
        except ValueError:
            raise LogError(f"{self.path}: metadata: wall_offset_ns: {said!r} is no whole number") from None

    def entries(self) -> Iterator[LogEntry]:
        """All messages of all parts in the order written. Restarts `damage` and the counters."""
        self.damage.clear()
        self.unknown.clear()
        self.undecodable.clear()
        self.read, self.lacks_after = 0, None
        last: dict[str, tuple[int, int]] = {}  # topic -> number that its next message has, `read` after its last one
        goes_on = ""
        for _, part, problem in opened(self.paths):
            if problem:
                self.damage.append(problem)
                self._lacks(self.read)
            if part is None:
                continue
            for entry in self._entries_of(part):
                due, since = last.get(entry.topic, (0, 0))
                if entry.sequence > due:
                    self._lacks(since)
                self.read += 1
                last[entry.topic] = entry.sequence + 1, self.read
                yield entry
            if part.damage:
                self.damage.append(part.damage)
            goes_on = part.goes_on
        self.damage += [goes_on] if goes_on else []
        for topic, count in self.undecodable.items():
            odd = f"{count} messages do not fit their class in this version: left out"
            self.damage.append(f"{self.path}: {topic}: {odd}")

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
            self._lacks(self.read - 1)
            return None

    def _lacks(self, after: int) -> None:
        self.lacks_after = after if self.lacks_after is None else min(after, self.lacks_after)

    def _entries_of(self, part: Part) -> Iterator[LogEntry]:
        topics = {record.id: record.topic for record in part.declared() if isinstance(record, Channel)}
        for record in part.records():
            if part.lost:
                self._lacks(self.read)
            if isinstance(record, MessageRecord):
                topic = topics.get(record.channel_id)
                if topic is None:  # its channel was declared in a damaged chunk, and there is no index
                    self.unknown[f"channel {record.channel_id}"] += 1
                    continue
                yield LogEntry(topic, record.log_time, record.publish_time, record.sequence, record.data)
            elif isinstance(record, Channel):
                topics[record.id] = record.topic
