"""`aritra run` that breaks on SIGUSR1, for the kill matrix.

python -m tests.evidence.safe.companion_that_breaks FAULT run ...

FAULT: `core` (the pilot raises), `solver` (every solve raises), `solver_hangs` (the solve under way never returns),
`disk_cut` (every write of the log is an I/O error), `disk_hangs` (a sync never returns). The fault is put around the
program in this process alone; until the signal it is the program as it is.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping

from companion.__main__ import main
from companion.core.control.nmpc import Nmpc
from companion.core.pilot.pilot import Pilot
from companion.logs.part import LogPart

BROKEN = threading.Event()


def _around(owner: type, name: str, fault: Callable[[], None]) -> None:
    """Once broken, `fault` comes before the method."""
    method = getattr(owner, name)

    def broken(*args, **kwargs):
        if BROKEN.is_set():
            fault()
        return method(*args, **kwargs)

    setattr(owner, name, broken)


def _raise() -> None:
    raise RuntimeError("raised by the kill matrix")


def _no_disk() -> None:
    raise OSError(errno.EIO, os.strerror(errno.EIO))


def _hang() -> None:
    threading.Event().wait()


def _cut_disk() -> None:
    for method in ("__init__", "add", "sync", "finish"):
        _around(LogPart, method, _no_disk)


FAULTS: Mapping[str, Callable[[], None]] = {
    "core": lambda: _around(Pilot, "step", _raise),
    "solver": lambda: _around(Nmpc, "solve", _raise),
    "solver_hangs": lambda: _around(Nmpc, "solve", _hang),
    "disk_cut": _cut_disk,
    "disk_hangs": lambda: _around(LogPart, "sync", _hang),
}

if __name__ == "__main__":
    FAULTS[sys.argv[1]]()
    signal.signal(signal.SIGUSR1, lambda *_: BROKEN.set())
    sys.exit(main(sys.argv[2:]))
