"""From the start of a process to the controller's first plan, and what memory it takes by then."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from companion.python_child import python
from sim.bench.request import BenchRequest, Found
from sim.bench.result import BenchRow, SolverRefused

STARTS = (("cold, no kept machine code", "rti"), ("warm", "rti"), ("warm, interpreted", "interpreted"))
LIMIT_S = 120.0


class ProcessStart(NamedTuple):
    """One start: seconds to the first plan, memory [MB], status of the plan, why there is no machine code."""

    name: str
    seconds: float
    rss_mb: float
    status: str
    why: str


def starts(vessel: Path) -> Iterator[ProcessStart]:
    """Each of `STARTS`, in its order, over one fresh cache. Raises RuntimeError where a process fails."""
    with tempfile.TemporaryDirectory() as cache:
        for name, method in STARTS:
            began = time.time()
            done = subprocess.run(
                python("-m", "sim.bench.controller.first_plan", str(vessel), method),
                env={**os.environ, "ARITRA_CACHE": cache}, capture_output=True, text=True, check=False, timeout=LIMIT_S,
            )  # fmt: skip
            if done.returncode:
                raise RuntimeError((done.stderr.strip() or "no plan").splitlines()[-1])
            at, rss_mb, status, why = json.loads(done.stdout.splitlines()[-1])
            yield ProcessStart(name, at - began, rss_mb, status, why)


def start(order: BenchRequest) -> Found:
    """Start-up: a fresh process from nothing to the first plan"""
    order.progress("start: cold, then warm")
    try:
        for one in starts(order.vessel_path):
            note = " ".join(word for word in (one.status if one.status != "ok" else "", one.why) if word)
            note = "" if one.name.endswith("interpreted") else note
            for unit, value in (("s", one.seconds), ("MB", one.rss_mb)):
                yield BenchRow(
                    part="start", problem="production", name=one.name, unit=unit, p50=value, count=1, note=note
                )
    except (RuntimeError, subprocess.TimeoutExpired) as error:
        yield SolverRefused(part="start", problem="production", name="first plan", why=str(error))
