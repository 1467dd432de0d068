"""`recover`: a damaged or rotated log -> one sound, indexed file, and what was kept and lost."""

from __future__ import annotations

from itertools import chain
from pathlib import Path

import msgspec
from mcap.records import Attachment, Channel, Metadata, Schema
from mcap.records import Message as MessageRecord

from companion.logs.part import ChannelInfo, LogItem, LogPart
from companion.logs.part_files import log_parts
from companion.logs.part_reader import LogError, Part, head_of, opened


class RecoverReport(msgspec.Struct, kw_only=True):
    """What `recover` kept. Last times: wall clock [ns], and the latest `t_ns` of a message (None: none)."""

    out: str
    parts: int
    messages: int = 0
    without_channel: int = 0
    kept_bytes: int = 0
    lost_bytes: int = 0
    last_log_time_ns: int | None = None
    last_t_ns: int | None = None
    damage: list[str] = msgspec.field(default_factory=list)


def recover(path: Path, out: Path | None = None) -> RecoverReport:
    """Join all parts of the log at `path` into `out` (default `NAME.recovered.mcap`): all that is readable.

    Raises LogError where `path` is no log, or where `out` exists or cannot be written.
    """
    out = out or path.with_name(f"{path.stem}.recovered{path.suffix}")
    paths = log_parts(path) if path.is_file() else (path,)
    head = head_of(paths)
    report = RecoverReport(out=str(out), parts=len(paths))
    try:
        target = LogPart(out)
    except OSError as error:
        raise LogError(f"{out}: {error.strerror}") from None
    try:
        copied: set[tuple[type, str]] = set()
        for record in head:
            _copy_head(record, target, copied)
        goes_on = ""
        for part_path, part, problem in opened(paths):
            if problem:
                report.damage.append(problem)
            if part is None:
                report.lost_bytes += part_path.stat().st_size
                continue
            _copy(part, target, report, copied)
            goes_on = part.goes_on
        report.damage += [goes_on] if goes_on else []
        target.finish()
    except BaseException as error:  # Ctrl-C, too: half a copy would bar the way of the next attempt
        target.discard()
        if isinstance(error, OSError):
            raise LogError(f"{out}: {error.strerror}") from None
        raise
    return report


def _copy(part: Part, target: LogPart, report: RecoverReport, copied: set[tuple[type, str]]) -> None:
    """Copy the records of one part, without metadata and attachments that are `copied` by now."""
    schemas: dict[int, Schema] = {0: Schema(id=0, data=b"", encoding="", name="")}
    channels: dict[int, ChannelInfo] = {}
    for record in chain(part.declared(), part.records()):
        if isinstance(record, MessageRecord):
            channel = channels.get(record.channel_id)
            if channel is None:
                report.without_channel += 1
                continue
            target.add(LogItem(channel, record.sequence, record.log_time, record.publish_time, record.data))
            report.messages += 1
            report.last_log_time_ns = max(report.last_log_time_ns or 0, record.log_time)
            report.last_t_ns = max(report.last_t_ns or 0, record.publish_time)
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel) and record.schema_id in schemas:
            channels[record.id] = _info(record, schemas[record.schema_id])
        elif isinstance(record, Metadata | Attachment):
            _copy_head(record, target, copied)
    report.kept_bytes += part.kept_bytes
    report.lost_bytes += part.lost_bytes
    if part.damage:
        report.damage.append(part.damage)


def _copy_head(record: Metadata | Attachment, target: LogPart, copied: set[tuple[type, str]]) -> None:
    """Copy metadata or an attachment unless one of its name is `copied`: they repeat in every part."""
    if (type(record), record.name) in copied:
        return
    copied.add((type(record), record.name))
    if isinstance(record, Metadata):
        target.add_metadata(record.name, record.metadata)
    else:
        target.add_attachment(record.name, record.data, record.log_time, record.media_type)


def _info(channel: Channel, schema: Schema) -> ChannelInfo:
    return ChannelInfo(
        channel.topic,
        schema.name,
        schema.data,
        tuple(channel.metadata.items()),
        channel.message_encoding,
        schema.encoding,
    )
