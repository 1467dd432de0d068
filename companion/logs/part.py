"""One MCAP file being written. A log is its first file `NAME.mcap` and, after rotation or a disk error,
`NAME.part1.mcap`, `NAME.part2.mcap`, ...

Whatever was handed to `sync` is readable after SIGKILL and power cut, though the file then has no index;
`aritra log recover` writes one. Format: https://mcap.dev/spec
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from mcap.writer import Writer

from companion.logs.schema import METADATA_NAME

CHUNK_BYTES = 64 * 1024  # bounds what one damaged chunk costs; `sync` ends chunks earlier


class ChannelInfo(NamedTuple):
    """Identity of a channel, independent of the file it is written to."""

    topic: str
    schema_name: str
    schema: bytes
    metadata: tuple[tuple[str, str], ...] = ()
    message_encoding: str = "json"
    schema_encoding: str = "jsonschema"


class LogItem(NamedTuple):
    """One message to write. `sequence` counts per channel, also over lost messages."""

    channel: ChannelInfo
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    data: bytes


class LogPart:
    """One new MCAP file. Every method may raise OSError; an existing file is refused (FileExistsError)."""

    def __init__(self, path: Path):
        self.path = path
        self._file = open(path, "xb")  # noqa: SIM115 - closed by finish or abandon
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES)
        self._channels: dict[ChannelInfo, int] = {}
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        try:
            self._writer.start(profile=METADATA_NAME)
            _sync_directory(path.parent)
        except OSError:
            self.discard()
            raise

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._file.tell()

    def add(self, item: LogItem) -> None:
        """Write one message into the chunk in progress."""
        identifier = self._channels.get(item.channel)
        if identifier is None:
            identifier = self._register(item.channel)
        self._writer.add_message(
            identifier, item.log_time_ns, item.data, item.publish_time_ns, item.sequence & 0xFFFFFFFF
        )

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write one metadata record."""
        self._writer.add_metadata(name, dict(values))

    def add_attachment(self, name: str, data: bytes, log_time_ns: int, media_type: str = "text/plain") -> None:
        """Write one attached file."""
        self._writer.add_attachment(log_time_ns, log_time_ns, name, media_type, data)

    def sync(self) -> None:
        """End the chunk in progress and put everything on the disk. Blocks as long as the disk takes."""
        self._writer.flush()
        os.fsync(self._file.fileno())

    def finish(self) -> None:
        """Write index and footer, sync, close."""
        self._writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()

    def abandon(self) -> None:
        """Close without index; errors of the disk are ignored."""
        with contextlib.suppress(OSError):
            self._file.close()

    def discard(self) -> None:
        """Close and delete a file without content of value."""
        self.abandon()
        self.path.unlink(missing_ok=True)

    def _register(self, channel: ChannelInfo) -> int:
        schema = (channel.schema_name, channel.schema_encoding, channel.schema)
        if schema == ("", "", b""):
            self._schemas[schema] = 0  # MCAP's way to say: no schema
        elif schema not in self._schemas:
            self._schemas[schema] = self._writer.register_schema(*schema)
        identifier = self._writer.register_channel(
            channel.topic, channel.message_encoding, self._schemas[schema], dict(channel.metadata)
        )
        self._channels[channel] = identifier
        return identifier


def _sync_directory(folder: Path) -> None:
    """Make the file's name survive a power cut (POSIX: fsync of the directory)."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
