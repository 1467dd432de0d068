"""A process of its own: from nothing to the first plan of one boat.

`python -m sim.bench.controller.first_plan VESSEL METHOD`

Prints a line of JSON: `time.time()` at the plan, memory [MB], status of the plan, why there is no machine code.
Machine code is kept as on the boat (`companion.jit`).
"""

from __future__ import annotations

import json
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import psutil

from companion.boat.process_stats import MEGABYTE
from companion.core.control.nmpc import Actuation, Nmpc, NmpcSettings
from companion.core.guidance.reference_row import COLUMNS, Column
from companion.core.messages import SolveRequest
from companion.core.model.load_vessel import load_vessel
from companion.core.model.manoeuvring import StructuredModel
from companion.jit import CodeStore, compile_loops

AHEAD_M_S = 0.5


def straight(thrusters: int, settings: NmpcSettings) -> SolveRequest:
    """From rest, a metre beside a line to the north."""
    rows = np.zeros((settings.stages + 1, len(COLUMNS)))
    rows[:, Column.NORTH] = AHEAD_M_S * settings.step_s * np.arange(settings.stages + 1)
    rows[:, Column.U] = AHEAD_M_S
    x0 = np.zeros(6 + thrusters)
    x0[1] = 1.0
    return SolveRequest(
        t_ns=0, index=0, x0=tuple(x0.tolist()), reference=tuple(map(tuple, rows.tolist())),
        disturbance_n=(0.0, 0.0, 0.0), f_prev_n=(0.0,) * thrusters,
    )  # fmt: skip


def main(vessel_path: str, method: str) -> None:
    """Load, build, plan, tell."""
    vessel = load_vessel(Path(vessel_path).read_text(encoding="utf-8"), name=vessel_path)
    settings = NmpcSettings(method=method)  # type: ignore[arg-type] - a word of its parent process
    compiler = partial(compile_loops, store=CodeStore.of())
    nmpc = Nmpc(
        StructuredModel.of(vessel), Actuation.of(vessel), settings, time.perf_counter, compiler=compiler
    )  # fmt: skip
    result, _ = nmpc.solve(straight(len(vessel.thrusters), settings), None)
    at, rss_mb = time.time(), psutil.Process().memory_info().rss / MEGABYTE
    print(json.dumps([at, rss_mb, result.status, nmpc.why_not_compiled]))


if __name__ == "__main__":
    main(*sys.argv[1:])
