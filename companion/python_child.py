"""Python as a child process. It must not look into the current folder: a `sim.py` there would be taken for ours."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1
"""Of prctl(2), linux/prctl.h."""


def python(*words: object) -> list[str]:
    """The command of a Python that imports what this one has installed, whatever lies in the current folder."""
    return [sys.executable, "-P", *map(str, words)]


def aritra(*words: object) -> list[str]:
    """The command of `aritra` itself with these words."""
    return python("-m", "companion", *words)


def dependent_aritra(*words: object) -> list[str]:
    """The same, ended as by `kill` when this process is gone, however it went: no boat drives on without it."""
    return python("-m", "companion.python_child", os.getpid(), *words)


def end_with(parent: int, number: signal.Signals = signal.SIGTERM) -> None:
    """Have the kernel send this signal to this process when its parent, of this number, ends. Linux only."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, number)
    if os.getppid() != parent:  # it was gone before we could ask
        signal.raise_signal(number)


if __name__ == "__main__":
    from companion.__main__ import main

    end_with(int(sys.argv[1]))
    sys.exit(main(sys.argv[2:]))
