"""Recorder: every message and every raw byte into an MCAP log, without ever making the control loop wait.

`record` encodes the message and queues it (no lock, no I/O, microseconds). A background thread empties the
queue every `PERIOD_S`, ends the chunk and calls fsync, so SIGKILL loses at most one period, and a power cut
one period plus one fsync. A disk error never reaches the caller, not even at the start: messages wait in the queue
while a new part of the log is tried every `RETRY_S`, what is lost is counted, and `problem` says so.

Times in the log: log_time is when the message was recorded, as wall clock (monotonic + `wall_offset_ns`,
fixed at the start and kept in the metadata); publish_time is the message's own `t_ns` (monotonic). Gaps in a
channel's sequence numbers are messages that were lost.
"""

from __future__ import annotations

import errno
import threading
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, Self

import msgspec

from companion.core.messages import Alert, Message, topic
from companion.logs.foxglove import VIEWER_KINDS, viewer_message, world_from_ned
from companion.logs.part import ChannelInfo, LogItem, LogPart
from companion.logs.part_files import log_parts, part_path
from companion.logs.schema import GOES_ON_NAME, METADATA_NAME, RAW_PREFIX, RawBytes, flow, viewer_schema

PERIOD_S = 0.25  # between flushes; a quarter of the second that may be lost
RETRY_S = 5.0  # between attempts on a disk that refused
HANG_S = 3.0  # a write that takes longer is a `problem` while it hangs; assumed
CLOSE_S = 5.0  # how long the end of a run waits for a disk that hangs; assumed: what stops the service waits longer
SLOW_S = 0.75  # a flush that takes longer than this breaks the promise of 1 s: said in `problem`
ROTATE_BYTES = 64 * 1024 * 1024  # some 20 minutes: a file's index waits in memory, 2.5 kB for each quarter of a second
REFUSED_NS = 1_000_000_000  # a message that was refused is a `problem` for so long; assumed
OVER_NS = 10_000_000_000  # a problem that was gone for so long is over: a slow disk comes and goes; assumed
MAX_QUEUED = 50_000  # messages; about 100 s of a disk that hangs, some 25 MB
DISK_TROUBLE = {
    errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS, errno.EUCLEAN, errno.EBADMSG, errno.ETIMEDOUT, errno.ENODEV,
    errno.ENXIO, errno.ESTALE,
}  # fmt: skip
"""What a disk says that is full, damaged or gone: no boat stays ashore for it. All else at the start is a path to
correct."""
INLINE_BATCH = 1_000  # messages between writes where there is no background thread


class _Stream:
    """A channel and the number of its next message."""

    __slots__ = ("channel", "sequence")

    def __init__(self, channel: ChannelInfo):
        self.channel = channel
        self.sequence = 0


class Recorder:
    """One log being written. `record` and `record_raw` belong to one thread.

    `metadata`: see `log_metadata`. `attachments`: file name -> content. `folder`: made where it is not there.
    `background=False` writes in the caller's thread and waits for the disk: for stepped clocks that outrun it.
    Raises OSError where the first file cannot be created for another reason than `DISK_TROUBLE` (FileExistsError: a log
    is never overwritten).
    """

    def __init__(
        self,
        path: Path,
        metadata: Mapping[str, str],
        now_ns: Callable[[], int],
        *,
        wall_offset_ns: int,
        attachments: Mapping[str, bytes] | None = None,
        folder: Path | None = None,
        rotate_bytes: int = ROTATE_BYTES,
        background: bool = True,
    ):
        self.path, self._folder = path, folder
        self.slowest_sync_s = 0.0
        self._now_ns = now_ns
        self._offset_ns = wall_offset_ns
        self._metadata = {**metadata, "log_format": "1", "wall_offset_ns": str(wall_offset_ns)}
        self._attachments = dict(attachments or {})
        self._rotate_bytes = rotate_bytes
        self._encoder = msgspec.json.Encoder(enc_hook=_numpy_scalar)
        self._streams: dict[type | str, _Stream] = {}
        self._queue: deque[LogItem] = deque()
        self._refused, self._refusal, self._refused_ns = 0, "", 0  # written by the caller's thread
        self._dropped, self._disk_problem = 0, ""  # written under the lock
        self._lock = threading.Lock()
        self._closed = False
        self._writing_ns: int | None = None  # since when the disk's side has been at it; read by the caller's thread
        self._retry_ns = self._number = 0
        self._part: LogPart | None = None
        self._begin()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True) if background else None
        if self._thread:
            self._thread.start()

    @property
    def lost(self) -> int:
        """Messages that are not in the log, at most: of a batch that failed, the first chunks may be."""
        return self._refused + self._dropped

    @property
    def problem(self) -> str | None:
        """Text for an alert while something is wrong, else None. It changes only with the reason."""
        since_ns = self._writing_ns
        if since_ns is not None and self._now_ns() - since_ns > HANG_S * 1e9:
            reason = f"the disk hangs: a write has not come back for {HANG_S:g} s; what follows waits in memory"
        else:
            refused = self._refusal if self._now_ns() - self._refused_ns <= REFUSED_NS else ""
            reason = self._disk_problem or refused
        return f"log {self.path}: {reason}" if reason else None

    # --- the control loop's side -------------------------------------------------------------------

    def record(self, message: Message) -> None:
        """Log one message, and what a viewer shows for it. Never waits for the disk, never raises."""
        self._put(type(message), message, message.t_ns)
        viewer = viewer_message(message, self._offset_ns)
        if viewer is not None:
            self._put(type(viewer), viewer, message.t_ns)

    def record_raw(self, link: str, direction: Literal["rx", "tx"], data: bytes) -> None:
        """Log bytes as they came (`rx`) or went (`tx`), stamped now, on topic `/raw/<link>`."""
        now = self._now_ns()
        self._put(link, RawBytes(t_ns=now, link=link, direction=direction, data=data), now)

    def _put(self, key: type | str, message: msgspec.Struct, t_ns: int) -> None:
        stream = self._streams.get(key)
        if stream is None:
            stream = self._streams[key] = _Stream(_channel(key))
        sequence = stream.sequence
        stream.sequence = sequence + 1
        try:
            data = self._encoder.encode(message)
        except (TypeError, ValueError) as error:
            self._refuse(f"{stream.channel.topic} cannot be written: {error}")
            return
        if self._closed or len(self._queue) >= MAX_QUEUED:
            self._refuse("closed" if self._closed else "the disk does not keep up")
            return
        log_time_ns = max(self._now_ns() + self._offset_ns, 0)
        self._queue.append(LogItem(stream.channel, sequence, log_time_ns, max(t_ns, 0), data))
        if self._thread is None and len(self._queue) >= INLINE_BATCH:
            self.sync()

    def _refuse(self, reason: str) -> None:
        self._refused += 1
        self._refusal, self._refused_ns = reason, self._now_ns()

    # --- the disk's side ---------------------------------------------------------------------------

    def sync(self) -> None:
        """Write what is queued and put it on the disk. Blocks; the background thread calls it by itself."""
        with self._lock:
            if not self._closed and (self._part or self._now_ns() >= self._retry_ns):
                self._drain()

    def close(self) -> None:
        """Write what is queued, then index and footer. May be called twice; a disk that hangs is not waited for."""
        self._stop.set()
        if self._thread:
            self._thread.join(CLOSE_S)
            if self._thread.is_alive():
                return  # it has the file: what it wrote before is readable, though without index
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self._drain()
            try:
                if self._part:
                    self._part.finish()
            except OSError as error:
                self._fail(error, 0)
            self._part = None
            self._dropped += len(self._queue)
            self._queue.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _begin(self) -> None:
        try:
            if older := log_parts(self.path)[1:]:  # it would end this log at its first rotation, and be read with it
                raise FileExistsError(errno.EEXIST, "is part of an older log", str(older[0]))
            self._part = self._open()
        except OSError as error:
            if error.errno not in DISK_TROUBLE:
                raise
            self._fail(error, 0)

    def _run(self) -> None:
        while not self._stop.wait(PERIOD_S):
            self.sync()

    def _drain(self) -> None:
        self._writing_ns = self._now_ns()
        try:
            self._write(self._writing_ns)
        finally:
            self._writing_ns = None

    def _write(self, start_ns: int) -> None:
        at_risk = 0
        try:
            self._part = part = self._part or self._open()
            at_risk = len(self._queue)
            for _ in range(at_risk):
                part.add(self._queue.popleft())
            part.sync()
            at_risk = 0
            if part.size >= self._rotate_bytes:
                part.add_metadata(GOES_ON_NAME, {})
                part.finish()
                self._part = None
                self._part = self._open()
        except Exception as error:  # a log must never stop a boat: whatever it is, `problem` tells
            self._fail(error, at_risk)
            return
        took_s = (self._now_ns() - start_ns) / 1e9
        self.slowest_sync_s = max(self.slowest_sync_s, took_s)
        self._disk_problem = f"the disk is slow: a flush took more than {SLOW_S} s" if took_s > SLOW_S else ""

    def _fail(self, error: Exception, lost: int) -> None:
        """Give up this file; the messages of the failed batch are lost, later ones wait for the next file."""
        if self._part:
            self._part.abandon()
            self._part = None
        self._dropped += lost
        self._disk_problem = f"{error}; a new file is tried every {RETRY_S:.0f} s"
        self._retry_ns = self._now_ns() + int(RETRY_S * 1e9)

    def _open(self) -> LogPart:
        """Next file, with metadata, attachments and the viewer's frame already on the disk."""
        now_ns = self._now_ns()
        wall_ns = max(now_ns + self._offset_ns, 0)
        if self._folder:
            self._folder.mkdir(parents=True, exist_ok=True)
        part = LogPart(part_path(self.path, self._number))
        try:
            part.add_metadata(METADATA_NAME, {**self._metadata, "part": str(self._number)})
            for name, data in self._attachments.items():
                part.add_attachment(name, data, wall_ns)
            frame = world_from_ned(wall_ns)
            part.add(LogItem(_channel(type(frame)), 0, wall_ns, max(now_ns, 0), self._encoder.encode(frame)))
            part.sync()
        except OSError:
            part.discard()
            raise
        self._number += 1
        return part


class RecordingAlerts:
    """What is said of a recorder's `problem`: each new one, and that it is over when it was gone for `OVER_NS`."""

    def __init__(self) -> None:
        self._known: str | None = None
        self._seen_ns = 0

    def step(self, problem: str | None, t_ns: int) -> Alert | None:
        """The alert that is due, if any."""
        if problem:
            self._seen_ns = t_ns
            if problem == self._known:
                return None
            self._known = problem
            return Alert(t_ns=t_ns, level="error", text=problem)
        known = self._known
        if known is None or t_ns - self._seen_ns < OVER_NS:
            return None
        self._known = None
        return Alert(t_ns=t_ns, level="info", text=f"over: {known}")


def _channel(key: type | str) -> ChannelInfo:
    """Channel of a message class, of a viewer's class, or of the link named `key`."""
    if isinstance(key, str):
        schema = viewer_schema(RawBytes, "aritra.RawBytes")
        return ChannelInfo(RAW_PREFIX + key, "aritra.RawBytes", schema, (("flow", flow(RawBytes)), ("link", key)))
    if key in VIEWER_KINDS:
        name = f"foxglove.{key.__name__}"
        return ChannelInfo(VIEWER_KINDS[key], name, viewer_schema(key, name), (("flow", "viewer"),))
    name = f"aritra.{key.__name__}"
    return ChannelInfo(topic(key), name, viewer_schema(key, name), (("flow", flow(key)),))


def _numpy_scalar(value: Any) -> Any:
    """numpy numbers as the Python numbers that they are."""
    if hasattr(value, "item"):
        return value.item()
    raise TypeError(f"{type(value).__name__} is not a number, text or struct")
