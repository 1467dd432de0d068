"""Every reader of bytes from outside under mutated input: `fuzzing` breaks valid files and streams, and counts.

A process for each reader, so that its memory is its own: growth of its peak from after the first tenth to the end.
"""

from __future__ import annotations

import os
import resource

from tests.evidence.line import Line, at_least, at_most, exactly
from tests.evidence.processes import processes
from tests.support.fuzzing.fuzz import fuzz
from tests.support.fuzzing.readers import READERS

SEED = 2026
MB = 1_000_000
SHARES = {"mavlink": 3.0, "mavlink, signed": 1.5, "ground station": 1.0, "log .mcap": 0.6, "log .bin": 0.6,
          "log .tlog": 0.5, "log .csv": 0.5, "excitation file": 0.2}  # fmt: skip
"""Millions of bytes for a reader; the others `OTHERS`."""
OTHERS = 0.3
GROWTH_MB = 100.0
"""A parser's tables and one decoded log; assumed. What grows with the input would be far above."""
SHOWN_BYTES = 200


def run(name: str) -> tuple[str, int, int, dict[str, int], dict[str, bytes], float]:
    """One reader: cases, bytes, documented errors, others with the bytes that caused them, growth [MB]."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # pymavlink's reader tells each bad byte there
    size = round(SHARES.get(name, OTHERS) * MB)
    first = fuzz(name, size // 10, SEED)
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    rest = fuzz(name, size - size // 10, SEED + 1)
    grown_mb = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb) / 1024
    return (
        name,
        first.cases + rest.cases,
        first.size + rest.size,
        dict(first.raised + rest.raised),
        first.wrong | rest.wrong,
        grown_mb,
    )


def lines(full: bool) -> list[Line]:
    """Fuzzing: MAVLink, UWB, configuration, missions, parameters and logs; seeds 2026 and 2027"""
    told_of: list[Line] = []
    total = undocumented = 0
    with processes(1, max_tasks_per_child=1) as pool:
        for name, cases, size, raised, wrong, grown_mb in pool.map(run, READERS):
            total, undocumented = total + size, undocumented + len(wrong)
            for kind, data in wrong.items():
                print(f"    {name}: {kind}: {data[:SHOWN_BYTES]!r}")
            told = ", ".join(f"{count} {kind}" for kind, count in raised.items()) or "none raised"
            note = f"{size / MB:.1f} MB, {cases} cases, {told}"
            told_of.append(at_most(f"{name}: growth of peak memory", grown_mb, GROWTH_MB, "MB", note))
    return [
        at_least("bytes given to the readers", total, 10 * MB),
        exactly("kinds of exception that are not the documented error", undocumented, 0),
        *told_of,
    ]
