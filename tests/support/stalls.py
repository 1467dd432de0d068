"""How long the machine stood still: tests in real time judge the product only where the machine gave it its time.

A process of its own sleeps 10 ms over and over and writes down each sleep that took longer by `STALL_S` or more. Only
that runs in it, and where it may it goes before all others: then a late sleep is the machine's (a shared host, a paused
guest) and not of whoever is tested beside it.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

STALL_S = 0.05
"""Half a period of the 10 Hz loop."""
NAP_S = 0.01


def overslept(now_s: Callable[[], float], sleep: Callable[[float], None]) -> Iterator[tuple[float, float]]:
    """Naps, for ever: when each ended [s], and how much longer it was than asked [s]."""
    while True:
        begun = now_s()
        sleep(NAP_S)
        ended = now_s()
        yield ended, ended - begun - NAP_S


class Stalls:
    """What the watching process has written down."""

    def __init__(self, path: Path):
        self._path = path

    def longest_s(self, since_s: float) -> float:
        """The longest stall that ended after `since_s` (time.monotonic) [s]; 0 without any."""
        lines = [line.split() for line in self._path.read_text().splitlines(keepends=True) if line.endswith("\n")]
        return max((float(stall) for ended, stall in lines if float(ended) > since_s), default=0.0)


@contextmanager
def watched(path: Path) -> Iterator[Stalls]:
    """The process watches while the context is open."""
    with path.open("w") as out:
        child = subprocess.Popen([sys.executable, __file__, str(os.getpid())], stdout=out)
    try:
        while not path.read_text() and child.poll() is None:
            time.sleep(NAP_S)
        yield Stalls(path)
    finally:
        child.kill()
        child.wait()


def watch(parent: int) -> None:
    """Until the parent ends. The first line says that the watch has begun."""
    with suppress(PermissionError):
        os.nice(-20)
    print(f"{time.monotonic():.3f} 0.000", flush=True)
    for ended_s, late_s in overslept(time.monotonic, time.sleep):
        if os.getppid() != parent:
            return
        if late_s >= STALL_S:
            print(f"{ended_s:.3f} {late_s:.3f}", flush=True)


if __name__ == "__main__":
    watch(int(sys.argv[1]))
