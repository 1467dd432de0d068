"""Prints the table: solves, starts and trajectories by each way. Some three minutes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator

import numpy as np

from companion.boat.load_run import EXAMPLES
from companion.core.control.rti.iteration import Rti
from companion.core.model.load_vessel import load_vessel
from sim.bench.controller.compare import IPOPT, recorded
from sim.bench.controller.nlp import Nlp
from sim.bench.controller.rounds import interleaved, rounds
from sim.bench.controller.solvers import CasadiPlanner, RtiPlanner
from sim.bench.controller.worlds import production_world
from sim.bench.request import STEP_S
from sim.studies.machine_code.ways import COMPILERS, SCANS, scanned, taken
from sim.trajectory import simulate

VESSEL = EXAMPLES / "boats" / "aritra.toml"
SOLVES, ROUNDS = 300, 5
DT_S, ONE_S, MANY, MANY_S = 0.01, 120.0, 64, 20.0


def solves() -> Iterator[str]:
    """The production problem, 2 iterations, the same recorded states in turn: ratios to IPOPT's fastest round."""
    world = production_world(load_vessel(VESSEL.read_text(encoding="utf-8"), name=VESSEL.name))
    nlp, step_s = Nlp(world.ocp), STEP_S["production"]
    planners: list[RtiPlanner | CasadiPlanner] = [CasadiPlanner(IPOPT, nlp, step_s, nlp.solver("ipopt", expand=False))]
    for way in COMPILERS:
        planner = RtiPlanner(way, nlp, step_s, compiled=False)
        with taken(way) as compiler:
            planner.rti = Rti(world.ocp, compiler=compiler)
        planners.append(planner)
    timed = rounds(planners, recorded(world, 1, SOLVES), ROUNDS)
    reference, first = timed[IPOPT], timed["emitter"]
    yield f"{'solve':32} {'p50 us':>9} {'p99 us':>9} {'IPOPT/p50':>9} {'IPOPT/p99':>9} {'off [N]':>9}"
    for name, t in timed.items():
        ratios = [reference.fastest(p) / t.median(p) for p in (50, 99)]
        p50, p99 = t.median(50) * 1e6, t.median(99) * 1e6
        yield f"{name:32} {p50:9.1f} {p99:9.1f} {ratios[0]:9.0f} {ratios[1]:9.0f} {t.off(first, 100):9.1g}"


def starts() -> Iterator[str]:
    """Fresh processes: with nothing kept, and again."""
    yield f"{'start to first plan':32} {'cold s':>9} {'MB':>9} {'warm s':>9} {'MB':>9}"
    for way in COMPILERS:
        with tempfile.TemporaryDirectory() as cache:
            told = [_start(way, cache) for _ in ("cold", "warm", "warm")]
        (cold_s, cold_mb), (warm_s, warm_mb) = told[0], min(told[1:])
        yield f"{way:32} {cold_s:9.2f} {cold_mb:9.0f} {warm_s:9.2f} {warm_mb:9.0f}"


def _start(way: str, cache: str) -> tuple[float, float]:
    began = time.time()
    done = subprocess.run(
        [sys.executable, "-m", "sim.studies.machine_code.start", str(VESSEL), way],
        env={**os.environ, "ARITRA_CACHE": cache}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    at, rss_mb, status = json.loads(done.stdout.splitlines()[-1])
    assert status == "ok", status
    return at - began, rss_mb


def trajectories() -> Iterator[str]:
    """From pulse widths, 100 Hz: simulated seconds per second of processor time, medians of rounds in turn."""
    vessel = load_vessel(VESSEL.read_text(encoding="utf-8"), name=VESSEL.name)

    def pulses(seconds: float, seed: int) -> np.ndarray:
        drawn = np.random.default_rng(seed).integers(1250, 1751, (round(seconds * 2), len(vessel.thrusters)))
        return np.repeat(drawn, round(0.5 / DT_S), axis=0)

    one, many = pulses(ONE_S, 1), np.stack([pulses(MANY_S, seed) for seed in range(MANY)])
    few = one[: len(one) // 10]

    def run(way: str, pwm: np.ndarray) -> np.ndarray:
        with scanned(way):
            return simulate(vessel, np.zeros((*pwm.shape[:-2], 6)), pwm, DT_S, voltage_v=15.6).x

    def timed(way: str, pwm: np.ndarray) -> Callable[[], float]:
        def seconds() -> float:
            began = time.thread_time()
            run(way, pwm)
            return time.thread_time() - began

        return seconds

    first = {way: run(way, few) for way in SCANS}  # also: whatever is made at a first call
    given = {way: (few, many[:, :100]) if way == "interpreter" else (one, many) for way in SCANS}
    for way, (_, together) in given.items():
        run(way, together)
    found = interleaved(
        {f"{way}|{k}": timed(way, pwm) for way, of in given.items() for k, pwm in enumerate(of)}, ROUNDS
    )
    yield f"{'trajectories, s/s':32} {'one':>9} {MANY:>9} {'off':>9}"
    for way, of in given.items():
        speed = [pwm[..., 0].size * DT_S / found[f"{way}|{k}"].median(50) for k, pwm in enumerate(of)]
        off = np.abs(first[way] - first["emitter"]).max()
        yield f"{way:32} {speed[0]:9.0f} {speed[1]:9.0f} {off:9.1g}"


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    for part in (starts, solves, trajectories):
        for line in part():
            print(line, flush=True)
