"""A process of its own: to the first plan by one way. `python -m sim.studies.machine_code.start VESSEL WAY`

Prints a line of JSON: `time.time()` at the plan, resident memory [MB], status of the plan.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import psutil

from companion.boat.process_stats import MEGABYTE
from companion.core.control.nmpc import Actuation, Nmpc, NmpcSettings
from companion.core.model.load_vessel import load_vessel
from companion.core.model.manoeuvring import StructuredModel
from sim.bench.controller.first_plan import straight
from sim.studies.machine_code.ways import taken


def main(vessel_path: str, way: str) -> None:
    """Load, build, plan, tell."""
    vessel, settings = load_vessel(Path(vessel_path).read_text(encoding="utf-8"), name=vessel_path), NmpcSettings()
    with taken(way) as compiler:
        model, actuation = StructuredModel.of(vessel), Actuation.of(vessel)
        nmpc = Nmpc(model, actuation, settings, time.perf_counter, compiler=compiler)
    result, _ = nmpc.solve(straight(len(vessel.thrusters), settings), None)
    print(json.dumps([time.time(), psutil.Process().memory_info().rss / MEGABYTE, result.status]))


if __name__ == "__main__":
    main(*sys.argv[1:])
