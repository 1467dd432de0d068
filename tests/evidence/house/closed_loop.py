"""The log of a stepped mission is byte for byte what it was at the base commit."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.evidence.house.trees import BASE, ROOT, base_tree, output, start
from tests.evidence.line import Line, at_least, exactly

SEEDS = range(1, 11)
SECONDS = 60.0
MESSAGES = 5000
"""A mission of a minute has at least so many: nothing is compared with nothing."""


def closed_loop(full: bool) -> Iterator[Line]:
    """Closed loop: missions of 60 s on the stepped clock, ten seeds, here and at the base commit"""
    yield from same_logs(BASE)


def same_logs(commit: str) -> Iterator[Line]:
    """Logs of the example boat here and at a commit, byte for byte."""
    words = ["log", str(SECONDS), *map(str, SEEDS)]
    with base_tree(commit) as base, tempfile.TemporaryDirectory() as folder:
        # both at once: they share the machine, and no time is in the log
        children = [start(tree, words, Path(folder) / str(i)) for i, tree in enumerate((base, ROOT))]
        before, now = (digests(output(child)) for child in children)
    same = [seed for seed in SEEDS if before[seed] == now[seed]]
    others = [seed for seed in SEEDS if seed not in same]
    note = f"base {commit}" + (f"; differ: {', '.join(map(str, others))}" if others else "")
    yield at_least("messages in the shortest log", min(count for _, count in now.values()), MESSAGES)
    yield exactly("different logs among the seeds", len({digest for digest, _ in now.values()}), len(SEEDS))
    yield exactly("seeds whose log is the same byte for byte", len(same), len(SEEDS), "", note)


def digests(text: str) -> dict[int, tuple[str, int]]:
    """Seed -> (SHA-256 of the log, number of messages)."""
    rows = [line.split() for line in text.splitlines()]
    return {int(seed): (digest, int(count)) for seed, digest, count in rows}
