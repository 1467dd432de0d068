"""The boat in its world on the stepped clock, for tests of the pilot and of the whole chain."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import msgspec
import numpy as np

from companion.boat.load_run import EXAMPLES, RunSetup, load_setup, setup_of
from companion.core.control.nmpc import Actuation, Nmpc
from companion.core.messages import (
    GroundTruth,
    GuidanceReference,
    LoopTiming,
    Message,
    OverrideLease,
    StateEstimate,
)
from companion.core.model.manoeuvring import StructuredModel
from companion.core.pilot.pilot import Pilot, PilotState
from companion.jit import compile_loops
from sim.world.score import TrueTrack, estimation, station, track_of, tracking
from sim.world.stepped import SteppedRun
from sim.world.world import World, WorldSetup

START = (8.0, 8.0, float(np.deg2rad(20.0)))
CORNER = ((9.0, 9.0), (16.0, 9.0), (16.0, 16.0))
"""Two legs of 7 m: long enough to judge, short enough for every day."""


def mission_text(points=CORNER) -> str:
    legs = "".join(f"[[waypoints]]\nnorth_m = {n}\neast_m = {e}\nspeed_m_s = 0.5\n" for n, e in points)
    return 'name = "test"\n' + legs


@cache
def setup(points=CORNER, vessel=None) -> RunSetup:
    """The example run with a mission of these points (None: the square beside it), and another boat of deploy/boats."""
    square = load_setup(EXAMPLES / "aritra.toml")
    if points is None and vessel is None:
        return square
    texts = {**square.files}
    if points is not None:
        texts["mission.toml"] = mission_text(points)
    if vessel is not None:
        texts["vessel.toml"] = (EXAMPLES / "boats" / f"{vessel}.toml").read_text()
    return setup_of(texts, {name: name for name in texts})


@cache
def pilot(points=CORNER, vessel=None) -> Pilot:
    return Pilot(setup(points, vessel).pilot)


@cache
def nmpc(points=CORNER, vessel=None) -> Nmpc:
    """The NMPC without wall time: it measures none, and its rescue ends by iterations alone."""
    told = setup(points, vessel).pilot
    patient = msgspec.structs.replace(told.nmpc, rescue_time_s=60.0)
    return Nmpc(
        StructuredModel.of(told.vessel), Actuation.of(told.vessel), patient, lambda: 0.0, told.fence, compile_loops
    )


def voyage(seed: int, points=CORNER, wrap=lambda pilot: pilot, vessel=None, begin="start", **world) -> SteppedRun:
    """A run about to begin. `world`: fields of WorldSetup; `wrap`: put round the pilot; `vessel`: see `setup`."""
    told = setup(points, vessel).pilot
    chosen = WorldSetup(told.vessel, told.site, **{"start": START, **world})
    return SteppedRun(World(chosen, seed), wrap(pilot(points, vessel)), nmpc(vessel=vessel).solve, begin)


def settled(seconds: float):
    """Condition: on station, and that for a while."""

    def condition(run: SteppedRun) -> bool:
        guided = run.state.guidance
        done = guided.phase == "done" and guided.settled_ns is not None
        return done and run.world.t_ns - guided.settled_ns > seconds * 1e9

    return condition


def driving(run: SteppedRun) -> bool:
    return run.state.helm.mode == "auto" and run.state.guidance.phase == "leg"


def healthy(run: SteppedRun) -> bool:
    return run.of(StateEstimate)[-1].health == "healthy"


@cache
def under_way() -> tuple[PilotState, int]:
    """A pilot's state in the middle of its first leg with a healthy estimate, and its time [ns]. Seed 11."""
    run = voyage(11)
    assert run.run(lambda r: driving(r) and r.state.guidance.s_m > 1.5 and healthy(r), 30.0)
    run.run(lambda r: r.state.open_tick is None, 1.0)
    return run.state, run.world.t_ns


def by_tick(messages: Iterable[Message]) -> list[list[Message]]:
    """One list a tick, at its end the LoopTiming that a shell would add. A last tick that was cut short is left out."""
    ticks: list[list[Message]] = [[]]
    for message in messages:
        ticks[-1].append(message)
        if isinstance(message, OverrideLease):
            timing = LoopTiming(t_ns=message.t_ns, index=message.index, lateness_ms=0.2, imu_to_override_ms=9.0)
            ticks[-1].append(timing)
            ticks.append([])
    return ticks[:-1]


def track(run: SteppedRun) -> TrueTrack:
    return track_of(run.of(StateEstimate), run.of(GuidanceReference), run.of(GroundTruth))


def figures(run: SteppedRun, points=CORNER) -> dict[str, float]:
    """Everything that is judged: tracking, station, estimate."""
    driven = track(run)
    corners = np.array(setup(points).pilot.mission.path.points)
    last = corners[-1] - corners[-2]
    pose = (*corners[-1], float(np.arctan2(last[1], last[0])))
    return tracking(driven, corners) | station(driven, pose) | estimation(driven)
