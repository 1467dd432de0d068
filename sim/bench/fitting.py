"""The structured fit beside scipy's least_squares on the same log. Needs polars (extra `analysis`)."""

from __future__ import annotations

import numpy as np

from sim.bench.controller.rounds import Timed
from sim.bench.request import BenchRequest, Found
from sim.bench.result import BenchRow, SolverRefused

LOG_S = 60.0
SEED = 4000
OURS, THEIRS = "structured fit", "scipy least_squares, 2-point"


def fit(order: BenchRequest) -> Found:
    """Identification: the structured fit and scipy on the same log of 60 s"""
    try:
        import polars  # noqa: F401, PLC0415 - an extra
    except ImportError:
        yield SolverRefused(part="fit", problem=f"{LOG_S:.0f} s of log", name=OURS, why="needs the extra `analysis`")
        return
    from sim.bench.scipy_fit import scipy_fit  # noqa: PLC0415 - needs polars
    from sim.fitting.identify.result import fit_structured  # noqa: PLC0415
    from sim.world.teleop_log import teleop_run  # noqa: PLC0415

    order.progress("fit: making a log")
    run = teleop_run(order.vessel, SEED, LOG_S)
    ours, theirs = Timed(), Timed()
    for k in range(order.rounds):
        order.progress(f"fit: round {k + 1} of {order.rounds}: {OURS}")
        ours.rounds.append(np.array([fit_structured([run], order.vessel).seconds]))
        order.progress(f"fit: round {k + 1} of {order.rounds}: {THEIRS}")
        theirs.rounds.append(np.array([scipy_fit(run, order.vessel).seconds]))
    for name, t in ((THEIRS, theirs), (OURS, ours)):
        yield BenchRow(
            part="fit", problem=f"{LOG_S:.0f} s of log", name=name, unit="s", p50=t.median(50), count=t.count,
            rounds=order.rounds, times=theirs.fastest(50) / t.median(50), reference=t is theirs,
        )  # fmt: skip
