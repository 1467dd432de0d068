"""A recorder of the boat, and what its log holds."""

from pathlib import Path

from companion.boat.recorder import Recorder
from companion.core.messages import Tick
from companion.logs.log_file import LogFile

OFFSET_NS = 1_700_000_000_000_000_000


def make(path: Path, now_ns, **options) -> Recorder:
    return Recorder(path, {"vessel": "test"}, now_ns, wall_offset_ns=OFFSET_NS, **options)


def ticks(log: LogFile) -> list[int]:
    return [message.index for message in log.messages(Tick) if isinstance(message, Tick)]
