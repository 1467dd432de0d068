"""A folder of logs that does not outgrow its quota: names for new logs, and which old ones go.

Only files with the names that `new_log` gives (and their parts) are ever deleted: a log that was renamed stays.
Age alone deletes nothing: on a boat the date can be wrong, and then every log would look old.
"""

from __future__ import annotations

import asyncio
import re
import stat
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from time import strftime as format_time
from time import struct_time
from typing import NamedTuple

from companion.boat.clock import Clock
from companion.core.messages import Alert
from companion.logs.part_files import log_parts

NAME = re.compile(r"(aritra-\d{8}-\d{6}(?:-\d+)?)(?:\.part(\d+))?\.mcap")
FRESH_S = 60.0
"""A log written to so lately belongs to a process that runs (the recorder writes every 0.25 s)."""
RELEASED_S = 1_767_225_600.0
"""2026-01-01 UTC, the year of this program's first version. What is dated before was written under a clock that had not
been set, as of a board without a battery for it: nobody knows how old it is, and it may be of this morning."""
PERIOD_NS = 60_000_000_000
MB = 1_000_000


class Stored(NamedTuple):
    """One file in the folder. `modified_s`: wall clock."""

    name: str
    size_bytes: int
    modified_s: float


class Swept(NamedTuple):
    """What one look at the folder did: names deleted, what is left, and what could not be done."""

    deleted: tuple[str, ...]
    left_bytes: int
    problem: str | None


def new_log(folder: Path, now: struct_time) -> Path:
    """A name that is not taken: `aritra-DATE-TIME.mcap`, then `-2`, `-3` (a clock may show a time again)."""
    stem = format_time("aritra-%Y%m%d-%H%M%S", now)
    path, number = folder / f"{stem}.mcap", 1
    while path.exists() or log_parts(path)[1:]:
        number += 1
        path = folder / f"{stem}-{number}.mcap"
    return path


def stored_logs(folder: Path) -> Iterator[Stored]:
    """Logs in a folder, by name, without links: a person's `aritra-latest.mcap`, say. Raises OSError."""
    for path in folder.glob("aritra-*.mcap"):
        try:
            status = path.lstat()
        except FileNotFoundError:  # another process deleted it meanwhile
            continue
        if NAME.fullmatch(path.name) and not stat.S_ISLNK(status.st_mode):
            yield Stored(path.name, status.st_size, status.st_mtime)


def to_delete(files: Iterable[Stored], *, quota_bytes: float, running: str, now_s: float) -> list[Stored]:
    """Files to delete so that the rest fits into the quota, in this order: oldest log first, its parts in order; logs
    dated before RELEASED_S last.

    A log is as old as its newest part. Never any part of the log `running` (its first file's name), of one
    written to within `FRESH_S`, or a file with another name; so what is left may still exceed the quota.
    """
    ours = [(match, file) for file in files if (match := NAME.fullmatch(file.name))]
    newest: dict[str, float] = {}
    for match, file in ours:
        newest[match[1]] = max(newest.get(match[1], file.modified_s), file.modified_s)
    spared = {match[1] for match, file in ours if abs(now_s - file.modified_s) < FRESH_S}
    if match := NAME.fullmatch(running):
        spared.add(match[1])
    excess = sum(file.size_bytes for _, file in ours) - quota_bytes
    doomed = []

    def order(pair: tuple[re.Match[str], Stored]) -> tuple[bool, float, str, int]:
        log, number = pair[0].groups()
        return newest[log] < RELEASED_S, newest[log], log, int(number or 0)

    for match, file in sorted(ours, key=order):
        if excess > 0 and match[1] not in spared:
            doomed.append(file)
            excess -= file.size_bytes
    return doomed


def sweep(folder: Path, *, quota_bytes: float, running: str, now_s: float) -> Swept:
    """Delete the files of `to_delete`. Waits for the disk; an error of the disk is returned, never raised."""
    try:
        files = list(stored_logs(folder))
    except OSError as error:
        return Swept((), 0, f"logs in {folder}: {error.strerror}")
    deleted, refused = [], []
    for file in to_delete(files, quota_bytes=quota_bytes, running=running, now_s=now_s):
        try:
            (folder / file.name).unlink(missing_ok=True)
            deleted.append(file)
        except OSError as error:
            refused.append(f"{file.name}: {error.strerror}")
    left = sum(file.size_bytes for file in files) - sum(file.size_bytes for file in deleted)
    problem = None
    if refused:
        problem = f"logs in {folder}: cannot delete {refused[0]}"
    elif left > quota_bytes:
        problem = f"logs in {folder}: the one being written needs more than log.quota_MB = {quota_bytes / MB:g}"
    return Swept(tuple(file.name for file in deleted), left, problem)


async def keep_within(look: Callable[[], Swept], clock: Clock, tell: Callable[[Alert], None]) -> None:
    """Call `look` every minute, in a thread, for ever; alerts of deleted logs, and once of a problem while it lasts."""
    known: str | None = None
    while True:
        await clock.sleep_until(clock.now_ns() + PERIOD_NS)
        swept = await asyncio.to_thread(look)
        for alert in alerts(swept, known, clock.now_ns()):
            tell(alert)
        known = swept.problem


def alerts(swept: Swept, known: str | None, t_ns: int) -> list[Alert]:
    """Alerts of deleted logs and of a new problem. `known`: the problem of the latest alert."""
    messages = []
    if swept.deleted:
        text = f"old logs deleted for log.quota_MB: {', '.join(swept.deleted)}"
        messages.append(Alert(t_ns=t_ns, level="info", text=text))
    if swept.problem and swept.problem != known:
        messages.append(Alert(t_ns=t_ns, level="warning", text=swept.problem))
    return messages
