"""Stops on the real autopilot and on the simulated one: neutral in time, and nothing moves when the cause is over."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from companion.core.preflight.parameter_file import parse_parameters
from sim.world.autopilot.parameter_table import BOARD_PARAMETERS
from sim.world.world import WorldSetup
from tests.evidence.line import Line, at_most, exactly
from tests.evidence.main_job.parts import reference_boat
from tests.evidence.processes import processes
from tests.support.autopilots.firmware_rig import ARDUPILOT, binaries, world_with
from tests.support.autopilots.stop_trial import Stopped, Trial, try_stop
from tests.support.autopilots.stops import ALL, StopSet

START = 8.0, 8.0, 0.35
SEED = 1


class StopCase(NamedTuple):
    """One stop (`number`) of a set (`name`) on a firmware; binary "": the simulated autopilot."""

    binary: str
    name: str
    number: int


def run(case: StopCase) -> Stopped:
    """Drive, stop, give back, wait."""
    chosen = ALL[case.name]
    boat, stop = reference_boat()[0], chosen.stops[case.number]
    setup = WorldSetup(
        boat.vessel, boat.site, start=START, receiver_us=chosen.receiver_us, parameters=_simulated(chosen)
    )
    with world_with(
        case.binary, setup, SEED, gps=chosen.gps, wiring=chosen.wiring, parameters=chosen.parameters
    ) as world:
        return try_stop(Trial(world), stop)


def _simulated(chosen: StopSet) -> dict[str, float]:
    """The wiring's file for the simulated autopilot."""
    name = f"{chosen.wiring}.param"
    return {**BOARD_PARAMETERS, **parse_parameters((ARDUPILOT / name).read_text(encoding="utf-8"), name=name)}


def stops(full: bool) -> Iterator[Line]:
    """Stops: what stops the boat, what gives back what it took, and a minute without the operator's start"""
    real = [(path.parent.name, str(path)) for path in binaries()]
    if not real:
        print("  (ARDUROVER names no firmware: the simulated autopilot alone)")
    autopilots = [("simulated", ""), *real]
    cases = [
        (title, StopCase(binary, name, number))
        for title, binary in autopilots
        for name, chosen in ALL.items()
        if binary or chosen.simulated
        for number in range(len(chosen.stops))
    ]
    with processes() as pool:
        results = pool.map(run, [case for _, case in cases])
        for (title, case), stopped in zip(cases, results, strict=True):
            yield from _lines(f"{title}, {case.name}", case, stopped)


def _lines(title: str, case: StopCase, stopped: Stopped) -> Iterator[Line]:
    stop = ALL[case.name].stops[case.number]
    yield at_most(f"{title}: {stop.name}: neutral after", stopped.neutral_s, stop.neutral_s, "s")
    note = f"the boat: {stopped.mode}" if stopped.mode else "no companion"
    yield exactly("   largest pulse off neutral in the minute after", stopped.away_us, 0, "us", note)
    yield exactly(f"   other mode at the end than {stop.mode or 'none'} (1: yes)", stopped.mode != stop.mode, 0)
