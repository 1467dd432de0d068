"""The controller against the solvers that a user could pick: the same recorded states, in turn, in one run."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from companion.core.control.nmpc import Actuation, Nmpc, NmpcSettings
from companion.core.messages import SolveRequest
from companion.core.model.manoeuvring import StructuredModel
from companion.jit import compile_loops
from sim.bench.controller.nlp import Nlp
from sim.bench.controller.rounds import CADENCE_S, RecordedProblem, Solved, Timed, record, replay, rounds, times_of
from sim.bench.controller.solvers import CasadiPlanner, Planner, RtiPlanner
from sim.bench.controller.worlds import TICK_S, BenchWorld
from sim.bench.request import STEP_S, BenchRequest, Found
from sim.bench.result import BenchRow, SolverRefused

IPOPT = "IPOPT, as in the paper"
OURS = "RTI, 2 iterations"
AT_CADENCE = "controller, at 10 Hz"
NO_REHEARSAL = "unrehearsed"
SETTLE = 10
"""Single steps with which a solver of one step begins."""
US = 1e6


class Absent(Exception):
    """A solver that is not to be had here; the text says why."""


def makers(world: BenchWorld) -> Mapping[str, Callable[[], Planner]]:
    """How to build each solver of a problem, by name, the reference first. They raise `Absent` or RuntimeError."""
    nlp, h = Nlp(world.ocp), STEP_S[world.name]

    def ours(name: str, *, compiled: bool = True, **options) -> Planner:
        made = RtiPlanner(name, nlp, h, compiled=compiled, **options)
        if compiled and made.rti.why_not_compiled:
            raise Absent(made.rti.why_not_compiled)
        return made

    def kept(name: str, *, expand: bool = False) -> Planner:
        return CasadiPlanner(name, nlp, h, nlp.solver("ipopt", expand=expand))

    def fatrop(name: str) -> Planner:
        as_it_wants = Nlp(world.ocp, rows=True)
        return CasadiPlanner(name, as_it_wants, h, as_it_wants.solver("fatrop", expand=True))

    return {
        IPOPT: partial(kept, IPOPT),
        "IPOPT, SX": partial(kept, "IPOPT, SX", expand=True),
        "fatrop, SX": partial(fatrop, "fatrop, SX"),
        "sqpmethod + hpipm, 1 step": lambda: CasadiPlanner("sqpmethod + hpipm, 1 step", nlp, h, nlp.one_step(), SETTLE),
        "RTI, 1 iteration": partial(ours, "RTI, 1 iteration", iterations=1),
        OURS: partial(ours, OURS),
        "RTI, converged": partial(ours, "RTI, converged", to=1e-9),
        "RTI interpreted, 1 iteration": partial(ours, "RTI interpreted, 1 iteration", compiled=False, iterations=1),
        "RTI interpreted, 2 iterations": partial(ours, "RTI interpreted, 2 iterations", compiled=False),
    }


def recorded(world: BenchWorld, seed: int, steps: int) -> list[RecordedProblem]:
    """What a boat that is driven by the real-time iteration asks at each tick."""
    return record(world, RtiPlanner("driver", Nlp(world.ocp), STEP_S[world.name]), seed, steps)[0]


def built(world: BenchWorld, asked: RecordedProblem) -> tuple[list[Planner], dict[str, str]]:
    """The solvers that run here, and why the others do not, by name."""
    planners, refused = [], {}
    for name, make in makers(world).items():
        try:
            planner = make()
            planner.begin(*asked)
            planners.append(planner)
        except (Absent, RuntimeError) as error:  # CasADi: a plugin that its wheel lacks here, or one that refuses
            refused[name] = str(error).strip().splitlines()[-1]
    return planners, refused


def compared(order: BenchRequest, problem: str) -> tuple[dict[str, Solved], dict[str, str]]:
    """Rounds of every solver of one problem by name, the reference first; and what refused."""
    world = order.world(problem)
    order.progress(f"{problem}: building the solvers")
    asked = recorded(world, order.seed, order.solves)
    planners, refused = built(world, asked[0])
    return rounds(planners, asked, order.rounds, lambda text: order.progress(f"{problem}: {text}")), refused


def solvers(order: BenchRequest) -> Found:
    """Solvers, hot, on the same recorded states"""
    for problem in order.problems:
        timed, refused = compared(order, problem)
        yield from (SolverRefused(part="solvers", problem=problem, name=name, why=why) for name, why in refused.items())
        reference = timed.get(IPOPT)
        for name, t in timed.items():
            yield _row("solvers", problem, name, t, reference, t.off(reference) if reference else None, t.unsolved)


def _row(
    part: str, problem: str, name: str, t: Timed, reference: Timed | None = None,
    off: float | None = None, unsolved: int = 0, note: str = "",
) -> BenchRow:  # fmt: skip
    p50, p99 = t.median(50), t.median(99)
    return BenchRow(
        part=part, problem=problem, name=name, unit="us", p50=p50 * US, p99=p99 * US, count=t.count,
        rounds=len(t.rounds),
        times=reference.fastest(50) / p50 if reference else None,
        times_p99=reference.fastest(99) / p99 if reference else None,
        reference=t is reference, off=off, unsolved=unsolved, note=note,
    )  # fmt: skip


class Cadence(NamedTuple):
    """Solves one right after the other; at a true 10 Hz with a rehearsal before each, as on the boat, and without."""

    hot: Timed
    rehearsed: Timed
    unrehearsed: Timed


def at_cadence(world: BenchWorld, asked: list[RecordedProblem]) -> Cadence:
    """The kernel: what sleeping costs, and what of it a rehearsal (`companion.boat.solver_thread`) saves."""
    planner = RtiPlanner("RTI", Nlp(world.ocp), STEP_S[world.name])
    took = [replay(planner, asked), replay(planner, asked, every_s=CADENCE_S, rehearse=planner.rehearse),
            replay(planner, asked, every_s=CADENCE_S)]  # fmt: skip
    return Cadence(*(Timed([one.seconds]) for one in took))


def controller(order: BenchRequest, asked: list[RecordedProblem]) -> Cadence:
    """The whole call that the boat makes, request in and plan out."""
    settings = NmpcSettings()
    nmpc = Nmpc(
        StructuredModel.of(order.vessel),
        Actuation.of(order.vessel),
        settings,
        time.perf_counter,
        compiler=compile_loops,
    )
    requests = [request(k, one) for k, one in enumerate(asked)]

    def run(every_s: float, rehearsed: bool) -> Timed:
        last, warm = (requests[0], None), None

        def solve(one: SolveRequest) -> None:
            nonlocal last, warm
            last = one, warm
            _, warm = nmpc.solve(*last)

        solve(requests[0])
        calls = (partial(solve, one) for one in requests[1:])
        times = times_of(calls, every_s=every_s, rehearse=(lambda: nmpc.solve(*last)) if rehearsed else None)
        return Timed([np.array([took for took, _ in times])])

    return Cadence(run(0.0, False), run(CADENCE_S, True), run(CADENCE_S, False))


def request(tick: int, one: RecordedProblem) -> SolveRequest:
    """A recorded state as the boat's own question, the last command that which its forces come from."""
    return SolveRequest(
        t_ns=round(tick * TICK_S * 1e9), index=tick, x0=tuple(one.x0.tolist()),
        reference=tuple(map(tuple, one.p.tolist())), disturbance_n=tuple(one.q.tolist()),
        f_prev_n=tuple(one.x0[6:].tolist()),
    )  # fmt: skip


def cadence(order: BenchRequest) -> Found:
    """The controller at a true 10 Hz, asleep between the solves, and hot"""
    for problem in order.problems:
        world = order.world(problem)
        asked = recorded(world, order.seed, order.cadence_solves)
        order.progress(f"{problem}: {len(asked)} solves at 10 Hz, twice {len(asked) * CADENCE_S:.0f} s")
        found = at_cadence(world, asked)
        yield _row("cadence", problem, "RTI, hot", found.hot)
        yield _row("cadence", problem, "RTI, at 10 Hz", found.rehearsed)
        yield _row("cadence", problem, f"RTI, at 10 Hz, {NO_REHEARSAL}", found.unrehearsed)
        if problem == "production":
            order.progress(f"{problem}: the same by the whole controller")
            found = controller(order, asked)
            yield _row("cadence", problem, "controller, hot", found.hot, note="request to plan")
            yield _row("cadence", problem, AT_CADENCE, found.rehearsed, note="request to plan")
            yield _row("cadence", problem, f"{AT_CADENCE}, {NO_REHEARSAL}", found.unrehearsed, note="request to plan")
