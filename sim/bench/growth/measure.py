"""How costs grow: the controller with horizon and thrusters, fits and diagnosis with logs and catalogue.

What more boats cost a shore console is measured by `scripts/evidence shore` (docs/benchmarks/shore.md).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

import msgspec
import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.control.nmpc import NmpcSettings
from sim.bench.controller.compare import recorded
from sim.bench.controller.nlp import Nlp
from sim.bench.controller.rounds import Solved, replay
from sim.bench.controller.solvers import CasadiPlanner, Planner, RtiPlanner
from sim.bench.controller.worlds import BenchWorld, production_world
from sim.bench.growth.scaling_exponent import grown
from sim.bench.request import STEP_S, BenchRequest, Found
from sim.bench.result import Growth, SolverRefused

HORIZONS = (10, 20, 40, 80, 160)
THRUSTERS = (2, 3, 4, 6, 8, 10, 12)
LOGS_S = (60, 120, 240, 480, 960)
WEAK = 0.8
"""Gain of the first thruster of the boat that is diagnosed, over that of the file."""
CATALOGUE = (0.12, 0.25, 0.5, 1.0)
"""Shares of the catalogue's kinds of effect that are known."""
SEED = 4000
US = 1e6


def horizon(order: BenchRequest) -> Found:
    """Growth of a solve with the horizon"""
    yield from _solves(order, "stages", {
        n: production_world(order.vessel, NmpcSettings(stages=n)) for n in HORIZONS
    })  # fmt: skip


def thrusters(order: BenchRequest) -> Found:
    """Growth of a solve with the number of thrusters"""
    yield from _solves(order, "thrusters", {
        n: production_world(with_thrusters(order.vessel, n)) for n in THRUSTERS
    })  # fmt: skip


def with_thrusters(vessel: VesselFile, n: int) -> VesselFile:
    """The same hull with `n` copies of its first thruster around it, each turned by 45 degrees from its neighbour's
    side; two look ahead.
    """
    angles = 2 * np.pi * (np.arange(n) + 0.5) / n
    half_length, half_beam = 0.3 * vessel.hull.length_m, 0.35 * vessel.hull.beam_m
    chosen = tuple(
        msgspec.structs.replace(
            vessel.thrusters[0], name=f"t{k}", channel=1 + k, x_m=float(half_length * np.cos(a)),
            y_m=float(half_beam * np.sin(a)), azimuth_deg=0.0 if n == 2 else 45.0 * (-1) ** k,
        )
        for k, a in enumerate(angles)
    )  # fmt: skip
    return msgspec.structs.replace(vessel, thrusters=chosen)


def _solves(order: BenchRequest, by: str, worlds: Mapping[int, BenchWorld]) -> Iterator[Growth]:
    """Medians of the fastest round of three ways to solve, at each size; in each round every size."""
    cases, timed = {}, {}
    for size, world in worlds.items():
        order.progress(f"growth: building {size} {by}")
        cases[size] = _three(world), recorded(world, order.seed, max(order.solves // 2, 3))
    for k in range(order.rounds):
        for size, (planners, asked) in cases.items():
            order.progress(f"growth: round {k + 1} of {order.rounds}, {size} {by}")
            for planner in planners:
                timed.setdefault(planner.name, {}).setdefault(size, Solved()).add(replay(planner, asked))
    for name, each in timed.items():
        yield grown(name, by, "us", list(each), [t.fastest(50) * US for t in each.values()])


def _three(world: BenchWorld) -> Sequence[Planner]:
    nlp, h = Nlp(world.ocp), STEP_S["production"]
    return [
        RtiPlanner("RTI, 2 iterations", nlp, h),
        CasadiPlanner("sqpmethod + hpipm, 1 step", nlp, h, nlp.one_step(), 5),
        CasadiPlanner("IPOPT, SX", nlp, h, nlp.solver("ipopt", expand=True)),
    ]


def logs(order: BenchRequest) -> Found:
    """Growth of fits and diagnosis with the log, and of a diagnosis with the catalogue"""
    try:
        from sim.fitting.diagnose.catalogue import catalogue  # noqa: PLC0415 - these need the extra `analysis`
        from sim.fitting.diagnose.job import diagnose  # noqa: PLC0415
        from sim.fitting.identify.result import fit_structured  # noqa: PLC0415
        from sim.world.teleop_log import teleop_logs  # noqa: PLC0415
    except ImportError:
        yield SolverRefused(part="growth", problem="logs", name="fit, diagnosis", why="needs the extra `analysis`")
        return

    driven = {s: teleop_logs(_weakened(order.vessel), order.vessel, [SEED], s) for s in LOGS_S}
    fits = {s: partial(fit_structured, driven[s], order.vessel) for s in LOGS_S}
    yield _timed(order, "structured fit", "s of log", fits)
    yield _timed(order, "diagnosis", "s of log", {s: partial(diagnose, driven[s], order.vessel) for s in LOGS_S})
    log = driven[LOGS_S[1]]
    kinds = list(dict.fromkeys(e.name.partition(":")[0] for e in catalogue(order.vessel, log) if e.family != "base"))
    known = [round(len(kinds) * share) for share in CATALOGUE]
    fewer = {n: partial(diagnose, log, order.vessel, without=kinds[n:]) for n in known}
    yield _timed(order, f"diagnosis, {LOGS_S[1]} s of log", "kinds of effect", fewer)


def _weakened(vessel: VesselFile) -> VesselFile:
    """With one thruster that gives less than its file says."""
    first, *others = vessel.thrusters
    weak = msgspec.structs.replace(first, gain=WEAK * first.gain)
    return msgspec.structs.replace(vessel, thrusters=(weak, *others))


def _timed(order: BenchRequest, what: str, by: str, calls: Mapping[int, Callable[[], object]]) -> Growth:
    """Processor seconds of one call at each size: it does not matter who else is on the machine."""
    took = []
    for size, call in calls.items():
        order.progress(f"growth: {what}, {size:g} {by}")
        began = time.process_time()
        call()
        took.append(time.process_time() - began)
    return grown(what, by, "s of processor", list(calls), took)
