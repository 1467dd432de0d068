"""Asked to end, by whatever signal: a command ends as by Ctrl-C, and the programs that it started end with it."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from asyncio import AbstractEventLoop  # slow to import, and most commands have no loop

ENDING = ("SIGTERM", "SIGHUP")
"""`kill` and a closed terminal; Windows has no SIGHUP."""


@contextlib.contextmanager
def ended_as_by_ctrl_c() -> Iterator[None]:
    """KeyboardInterrupt where the process would end on the spot. What is ignored (`nohup`), or handled, stays so."""
    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in (getattr(signal, name) for name in ENDING if hasattr(signal, name)):
            if signal.getsignal(number) is signal.SIG_DFL:
                before[number] = signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def call_when_asked_to_end(loop: AbstractEventLoop, end: Callable[[], object]) -> None:
    """For a command with an orderly end of its own: Ctrl-C, `kill` and a closed terminal call `end` on `loop`.

    What is ignored stays so: `nohup` is there for a terminal that closes.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_IGN:
            continue
        with contextlib.suppress(NotImplementedError):  # event loops of Windows have no signal handlers
            loop.add_signal_handler(number, end)
