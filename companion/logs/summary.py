"""Summary of a log: one pass over it, counts and rates per topic, leases, plans, alerts, damage."""

from __future__ import annotations

from collections import Counter
from datetime import UTC, datetime

import msgspec

from companion.core.messages import Alert, OverrideLease, PlanResult
from companion.logs.configuration import zero_ns_of
from companion.logs.log_file import LogEntry, LogFile
from companion.logs.schema import KINDS, RAW_PREFIX, VIEWER_PREFIX


class TopicStats(msgspec.Struct):
    """One topic: mean rate and largest gap by recording time, messages missing by sequence number."""

    topic: str
    messages: int = 0
    bytes: int = 0
    rate_hz: float = 0.0
    largest_gap_s: float = 0.0
    missing: int = 0


class AlertLine(msgspec.Struct):
    """One alert; `t_s` counts from the log's first message (`zero_ns_of`)."""

    t_s: float
    level: str
    text: str


class LogSummary(msgspec.Struct, kw_only=True):
    """Contents of `aritra log info`. `start`: UTC. `undecodable`: messages that do not fit their class."""

    path: str
    parts: int
    start: str | None
    duration_s: float
    messages: int
    topics: list[TopicStats]
    metadata: dict[str, str]
    attachments: list[str]
    leases: dict[str, int]
    plans: dict[str, int]
    alerts: list[AlertLine]
    unknown: dict[str, int]
    undecodable: dict[str, int]
    damage: list[str]


class _Meter:
    """Running figures of one topic."""

    def __init__(self, entry: LogEntry):
        self.stats = TopicStats(entry.topic)
        self.first_ns = self.last_ns = entry.log_time_ns
        self.next_sequence = 0

    def add(self, entry: LogEntry) -> None:
        stats = self.stats
        stats.messages += 1
        stats.bytes += len(entry.data)
        stats.largest_gap_s = max(stats.largest_gap_s, (entry.log_time_ns - self.last_ns) / 1e9)
        stats.missing += max(entry.sequence - self.next_sequence, 0)
        self.last_ns = entry.log_time_ns
        self.next_sequence = entry.sequence + 1
        span_s = (self.last_ns - self.first_ns) / 1e9
        stats.rate_hz = (stats.messages - 1) / span_s if span_s > 0 else 0.0


def summarise(log: LogFile) -> LogSummary:
    """One pass over `log`."""
    meters: dict[str, _Meter] = {}
    leases: Counter[str] = Counter()
    plans: Counter[str] = Counter()
    alerts: list[Alert] = []
    zero_ns = zero_ns_of(log)
    start_ns = end_ns = None
    for entry in log.entries():
        start_ns = entry.log_time_ns if start_ns is None else min(start_ns, entry.log_time_ns)
        end_ns = max(end_ns or 0, entry.log_time_ns)
        meter = meters.get(entry.topic)
        if meter is None:
            meter = meters[entry.topic] = _Meter(entry)
        meter.add(entry)
        known = entry.topic in KINDS or entry.topic.startswith(RAW_PREFIX)
        match log.decode(entry) if known else None:
            case OverrideLease(source=source):
                leases[source] += 1
            case PlanResult(status=status):
                plans[status] += 1
            case Alert() as alert:
                alerts.append(alert)
    topics = sorted((meter.stats for meter in meters.values()), key=lambda stats: stats.topic)
    own = [t for t in topics if t.topic not in KINDS and not t.topic.startswith((RAW_PREFIX, VIEWER_PREFIX))]
    first_ns = start_ns or 0
    return LogSummary(
        path=str(log.path),
        parts=len(log.paths),
        start=None if start_ns is None else datetime.fromtimestamp(first_ns / 1e9, UTC).isoformat(" ", "seconds"),
        duration_s=0.0 if end_ns is None else (end_ns - first_ns) / 1e9,
        messages=sum(t.messages for t in topics),
        topics=topics,
        metadata=log.metadata,
        attachments=list(log.attachments),
        leases=dict(leases),
        plans=dict(plans),
        alerts=[AlertLine((alert.t_ns - zero_ns) / 1e9, alert.level, alert.text) for alert in alerts],
        unknown={**log.unknown, **{t.topic: t.messages for t in own}},
        undecodable=dict(log.undecodable),
        damage=list(log.damage),
    )
