"""One mission with faults on the stepped clock, and the verdict on it by truth.

FAILED: the estimate is `healthy` while more than 2 m wrong for 3 s, or thrust is commanded beyond the true fence for
0.5 s, or the mean thrust is above 40 % for 5 s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from companion.core.messages import Alert, GroundTruth, GuidanceReference, ModeStatus, OverrideLease, StateEstimate
from companion.core.pilot.trust.sensors.accelerometer_check import AccelerometerState
from companion.core.pilot.trust.sensors.heading_check import HeadingState
from companion.core.pilot.trust.sensors.motion_check import MotionState
from companion.core.pilot.trust.sensors.path_check import PathState
from companion.core.pilot.trust.thrusters.thruster_verdict import ThrusterState
from sim.world.environment import Weather
from sim.world.score import track_of, tracking
from sim.world.stepped import SteppedRun
from sim.world.world import WorldSetup
from tests.fault_lab.fault import Fault, parse
from tests.fault_lab.faulty_world import FaultyWorld
from tests.support.drive_fixture import nmpc, pilot, setup

DURATION_S = 150.0
WRONG_M, WRONG_S = 2.0, 3.0
BEYOND_S = 0.5
HIGH_SHARE, HIGH_S = 0.4, 5.0
MOVED_M = 1.0
"""A fault that moves the boat, or its estimate, by more than this must be told soon."""
TURNING_N = 1.0
"""A thruster that pushes less has stopped."""
TICK_S = 0.1


@dataclass(frozen=True)
class Verdict:
    """What became of one trial. Times in s, since switch-on or in all; `moved_s`: when the estimate was first wrong by
    more than `MOVED_M`; `alerts`: (time, level, text); `named`: (time, cause, what) of the findings, the first first.
    """

    faults: tuple[str, ...]
    seed: int
    mode: str
    passed: int
    healthy_wrong_s: float
    beyond_s: float
    high_s: float
    wrong_m: float
    cross_m: float
    true_farthest_m: float
    moved_s: float
    alerts: tuple[tuple[float, str, str], ...] = field(repr=False)
    modes: tuple[tuple[float, str], ...] = ()
    named: tuple[tuple[float, str, str], ...] = ()

    @property
    def failed(self) -> bool:
        """By the criterion above."""
        return self.healthy_wrong_s >= WRONG_S or self.beyond_s >= BEYOND_S or self.high_s >= HIGH_S

    @property
    def drives_s(self) -> float:
        """When the boat was first allowed to drive; infinite: never."""
        return next((t for t, mode in self.modes if mode == "auto"), math.inf)

    def first_alert_s(self, after_s: float) -> float:
        """Seconds from `after_s` to the first warning or error; infinite without one."""
        return next((t - after_s for t, level, _ in self.alerts if t >= after_s and level != "info"), math.inf)


def run_of(seed: int, lines: Sequence[str | Fault], weather: Weather | None = None, **world) -> SteppedRun:
    """A run about to begin: the demo's mission with these faults; `world`: fields of WorldSetup."""
    told = setup(None).pilot
    faults = [parse(line) if isinstance(line, str) else line for line in lines]
    rng = np.random.default_rng([seed, 7])
    start = (8 + rng.uniform(-0.5, 0.5), 8 + rng.uniform(-0.5, 0.5), rng.uniform(-0.6, 0.6))
    chosen = WorldSetup(told.vessel, told.site, **{"start": start, "weather": weather or Weather(), **world})
    return SteppedRun(FaultyWorld(chosen, seed, faults), pilot(None), nmpc(None).solve)


def trial(
    seed: int, *lines: str | Fault, weather: Weather | None = None, duration_s: float = DURATION_S, **world
) -> Verdict:
    """Drive the demo's mission with these faults, and judge."""
    run = run_of(seed, lines, weather, **world)
    run.run(lambda _: False, duration_s)
    return judge(run, seed, tuple(map(str, lines)))


def judge(run: SteppedRun, seed: int, faults: tuple[str, ...]) -> Verdict:
    """The verdict on a run that is over."""
    told = setup(None).pilot
    pairs = list(zip(run.of(StateEstimate), run.of(GroundTruth), strict=True))
    truth = np.array([(t.north_m, t.east_m) for _, t in pairs])
    wrong = np.array([math.hypot(e.north_m - t.north_m, e.east_m - t.east_m) for e, t in pairs])
    started = np.array([e.health != "initialising" for e, _ in pairs])
    healthy = np.array([e.health == "healthy" for e, _ in pairs])
    most = np.array([t.most_N for t in told.vessel.thrusters])
    commands = np.array([lease.f_command_n for lease in run.of(OverrideLease)])[: len(pairs)]
    forces = np.array([t.f_n for _, t in pairs])
    outside = np.array([told.fence.clearance(*place) < 0 for place in truth])
    turning = np.abs(commands).max(axis=1) > TURNING_N
    track = track_of(run.of(StateEstimate), run.of(GuidanceReference), run.of(GroundTruth))
    return Verdict(
        faults=faults,
        seed=seed,
        mode=run.state.helm.mode,
        passed=len(run.state.guidance.passed or run.state.passed),
        healthy_wrong_s=TICK_S * float((healthy & (wrong > WRONG_M)).sum()),
        beyond_s=TICK_S * float((outside[: len(turning)] & turning).sum()),
        high_s=TICK_S * float(((np.abs(forces) / most).mean(axis=1) > HIGH_SHARE).sum()),
        wrong_m=float(wrong[started].max(initial=0.0)),
        cross_m=tracking(track, np.array(told.mission.path.points))["cross_track_rms_m"],
        true_farthest_m=float(-min(told.fence.clearance(*place) for place in truth)),
        moved_s=1e-9 * pairs[far.argmax()][0].t_ns if (far := started & (wrong > MOVED_M)).any() else math.inf,
        alerts=tuple((a.t_ns * 1e-9, a.level, a.text) for a in run.of(Alert)),
        modes=_changes(run.of(ModeStatus)),
        named=_named(run),
    )


def _named(run: SteppedRun) -> tuple[tuple[float, str, str], ...]:
    """What the boat named, in the order in which it did; ranges that repeat are told by an alert alone."""
    monitors = AccelerometerState, HeadingState, MotionState, PathState, ThrusterState
    found = [(f.t_ns * 1e-9, f.cause, f.what) for kind in monitors for f in run.state.monitor(kind).findings]
    found += [
        (a.t_ns * 1e-9, "sensor", "position" if "UWB" in a.text else "imu")
        for a in run.of(Alert)
        if "left out" in a.text and ("UWB" in a.text or "frozen" in a.text)
    ]
    return tuple(sorted(found))


def _changes(statuses: Sequence[ModeStatus]) -> tuple[tuple[float, str], ...]:
    out: list[tuple[float, str]] = []
    for status in statuses:
        if not out or out[-1][1] != status.mode:
            out.append((round(status.t_ns * 1e-9, 1), status.mode))
    return tuple(out)
