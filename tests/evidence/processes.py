"""Processes that share the work of a part of the evidence."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any


def processes(most: int | None = None, **more: Any) -> ProcessPoolExecutor:
    """A pool of `most` processes, one a processor where None; `more`: its other arguments. They begin anew: one that is
    forked from a program that has read a table waits for that program's threads for ever.
    """
    return ProcessPoolExecutor(most or os.cpu_count(), mp_context=get_context("spawn"), **more)
