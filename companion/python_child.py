"""Python as a child process. It must not look into the current folder: a `sim.py` there would be taken for ours."""

from __future__ import annotations

import sys


def python(*words: object) -> list[str]:
    """The command of a Python that imports what this one has installed, whatever lies in the current folder."""
    return [sys.executable, "-P", *map(str, words)]


def aritra(*words: object) -> list[str]:
    """The command of `aritra` itself with these words."""
    return python("-m", "companion", *words)
