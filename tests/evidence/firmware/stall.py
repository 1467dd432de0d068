"""A companion that stands still under way: afterwards the estimate is not healthy until it is right."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from companion.core.messages import Alert, GroundTruth, OperatorCommand, StateEstimate
from sim.world.stepped import SteppedRun
from tests.evidence.firmware.missions import WAVES
from tests.evidence.firmware.worlds import READY_S, Autopilot, autopilots, world_of
from tests.evidence.line import Line, at_least, at_most, exactly
from tests.evidence.main_job.parts import reference_boat
from tests.evidence.processes import processes

STALLS_S = 2.0, 6.0, 20.0
SEEDS = range(1, 4)
AFTER_S = 25.0
UNDER_WAY_S = 90.0


class Stalled(NamedTuple):
    """Estimates that called themselves healthy after a stall: how many, and how wrong the worst was."""

    healthy: int
    away_m: float
    off_m_s: float
    alerts: int


def stand_still(run: SteppedRun, stall_s: float) -> Stalled:
    """The companion of a run that is under way stands still for so long, then goes on."""
    run.stall(stall_s)
    back_ns = run.world.t_ns
    run.run(lambda r: False, AFTER_S)
    truths = {m.t_ns: m for m in run.of(GroundTruth)}
    after = [(e, truths[e.t_ns]) for e in run.of(StateEstimate) if e.t_ns > back_ns]
    healthy = [(e, t) for e, t in after if e.health == "healthy"]
    away_m = max((math.hypot(e.north_m - t.north_m, e.east_m - t.east_m) for e, t in healthy), default=math.inf)
    off_m_s = max((math.hypot(e.u_m_s - t.u_m_s, e.v_m_s - t.v_m_s) for e, t in healthy), default=math.inf)
    alerts = sum(f"stood still for {stall_s:.1f} s" in alert.text for alert in run.of(Alert))
    return Stalled(len(healthy), away_m, off_m_s, alerts)


def _try(case: tuple[Autopilot, float, int, bool]) -> Stalled:
    autopilot, stall_s, seed, rough = case
    _, pilot, nmpc = reference_boat()
    with world_of(autopilot, seed, WAVES if rough else None) as world:
        run = SteppedRun(world, pilot, nmpc.solve, begin=None)
        run.run(lambda r: False, READY_S)
        run.feed([OperatorCommand(t_ns=world.t_ns, command="start")])
        if not run.run(lambda r: r.state.guidance is not None and r.state.guidance.s_m > 2.0 + 6.0 * seed, UNDER_WAY_S):
            raise RuntimeError(f"{autopilot.name}, seed {seed}: not under way after {UNDER_WAY_S:g} s")
        return stand_still(run, stall_s)


def stall(full: bool) -> Iterator[Line]:
    """Stalls: the companion stands still under way for 2, 6 and 20 s, seeds 1-3, calm and in waves"""
    kinds = autopilots()
    cases = [(k, s, seed, rough) for k in kinds for s in STALLS_S for seed in SEEDS for rough in (False, True)]
    with processes() as pool:
        results = list(zip(cases, pool.map(_try, cases), strict=True))
    for kind in kinds:
        for stall_s in STALLS_S:
            mine = [stalled for case, stalled in results if case[:2] == (kind, stall_s)]
            what, note = f"{kind.name}, {stall_s:g} s: while healthy again", f"worst of {len(mine)}"
            yield at_most(f"{what}, position off by", max(s.away_m for s in mine), 0.5, "m", note)
            yield at_most(f"{what}, velocity off by", max(s.off_m_s for s in mine), 0.2, "m/s", note)
            yield at_least("   healthy for, of 25 s", min(s.healthy for s in mine) * 0.1, 10.0, "s", "shortest")
            yield exactly("   runs without one alert of it", sum(s.alerts != 1 for s in mine), 0)
