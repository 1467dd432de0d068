"""Runs one case, wherever it is called: in a process of this machine or on a node of a cluster.

Exceptions become the outcome's error. One case at a time in each process (the compiled NMPC has one memory), linear
algebra on one thread: then a case's figures are the same bits whoever runs it, as long as processor and versions are.
"""

from __future__ import annotations

import math
import os
import socket
import threading
import time
import traceback
from functools import cache
from importlib.metadata import version

from threadpoolctl import threadpool_limits

from companion.logs.metadata import log_metadata
from sim.campaign.case_files import case_setup
from sim.campaign.runners.job import CaseOutcome, Figure, Work

LIBRARIES = ("numpy", "scipy", "casadi", "filterpy", "polars", "statsmodels", "llvmlite")
"""On whose versions figures may depend."""
TRACE_LINES = 40
_one = threading.Lock()


@cache
def program() -> dict[str, str]:
    """Versions of this program and of the libraries that figures depend on."""
    about = log_metadata("", {})
    ours = {"aritra": about["version"], "git_revision": about["git_revision"], "python": about["python"]}
    return ours | {name: version(name) for name in LIBRARIES}


def run_work(work: Work) -> CaseOutcome:
    """The case's outcome. Raises nothing that a case can cause."""
    with _one, threadpool_limits(limits=1):
        begun = time.monotonic()
        figures, error, trace = {}, "", ""
        try:
            figures = {name: _finite(value) for name, value in _figures(work).items()}
        except Exception as failure:
            error = f"{type(failure).__name__}: {failure}"
            trace = "\n".join(traceback.format_exc().splitlines()[-TRACE_LINES:])
        return CaseOutcome(
            id=work.id,
            figures=figures,
            error=error,
            trace=trace,
            program=program(),
            begun_s=begun,
            seconds=time.monotonic() - begun,
            worker=f"{socket.gethostname()}:{os.getpid()}",
        )


def _figures(work: Work) -> dict[str, Figure]:
    if work.kind == "missions":
        from sim.campaign.mission import mission_figures  # noqa: PLC0415 - each kind's libraries where it is run

        return mission_figures(case_setup(work), work.settings, work.seed)
    from sim.campaign.fits import diagnose_figures, identify_figures  # noqa: PLC0415

    return (identify_figures if work.kind == "identify" else diagnose_figures)(case_setup(work), work)


def _finite(value: Figure) -> Figure:
    """Plain numbers; None where there is none."""
    if isinstance(value, str | bool) or value is None:
        return value
    if isinstance(value, int):
        return int(value)
    number = float(value)
    return number if math.isfinite(number) else None
