"""The thread of a firmware's process that runs its Lua scripts, which lockstep does not reach.

It waits by this machine's clock: it looks at the simulated one every millisecond (SITL_State.cpp, `wait_clock`). Where
other programs or a virtual machine's host keep it from doing so while the firmware's main loop goes on, a gate that is
written every 10 ms runs out after 200, and the boat stops, though nothing is wrong with it.
"""

from __future__ import annotations

import re
import time
from pathlib import Path

NAME = "Scripting"
LIMIT_S, LOOK_S = 0.5, 0.0002
"""How long to wait for its turn (it may wait for the main loop, which waits for us), and how often to look; assumed."""
_SLEPT = re.compile(r"^voluntary_ctxt_switches:\s+(\d+)", re.MULTILINE)


class ScriptThread:
    """Of the process `pid`. Linux alone tells, in `proc`; elsewhere there is nothing to wait for."""

    def __init__(self, pid: int, proc: Path = Path("/proc")):
        self._tasks = proc / str(pid) / "task"
        self._status: Path | None = None
        self._count: int | None = None

    def wait_for_turn(self) -> None:
        """Return once the thread has run and gone to sleep since the last call, or where there is none."""
        end_s = time.monotonic() + LIMIT_S
        while (count := self._slept()) is not None and count == self._count and time.monotonic() < end_s:
            time.sleep(LOOK_S)
        self._count = count

    def _slept(self) -> int | None:
        """How often it has gone to sleep; None while there is no such thread."""
        try:
            if self._status is None:
                named = (task for task in self._tasks.iterdir() if _text(task / "comm").strip() == NAME)
                self._status = next((task / "status" for task in named), None)
            found = _SLEPT.search(_text(self._status)) if self._status else None
        except OSError:  # it ended, or the firmware has started again
            self._status = found = None
        return int(found[1]) if found else None


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace")
