"""Signs and sides: twelve faults alone and with another cause, right logs, and the runs of a real boat."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.fitting.engine.split import NamedLog
from sim.fitting.wiring.check import checked
from sim.fitting.wiring.evidence import candidates, evidence
from tests.evidence.line import Line, at_least, exactly, information
from tests.evidence.real_logs.blueboat import FIT, absent, blueboat, runs
from tests.sim.fitting.wiring.miswired import BESIDE, BOAT, FAULTS, drive

SEED, SECONDS = 93_000, 180.0
RIGHT_LOGS = 8
"""For each cause beside."""
COMPASS = "compass:hard_iron"
"""Off in all runs (facts of the data set, by hand); short ones cannot show it."""
TURN_US, TURN_S = 100.0, 0.5
"""A run holds turns where both outputs differ by more than this for so long."""


def named(*runs: Run, vessel: VesselFile = BOAT) -> list[str]:
    """What is put right in these logs, and what is told for certain."""
    logs = [NamedLog(f"log {i}", run) for i, run in enumerate(runs)]
    return [f.name for f in checked(logs, [], vessel).wiring.findings if f.certain or f.advice]


def wiring_faults(full: bool) -> Iterator[Line]:
    """Twelve ways of connecting the reference boat wrongly, each alone and with another cause of medium size beside"""
    print(f"  drives by hand of {SECONDS:.0f} s, each thruster alone at first; UWB at 1 Hz; seeds from {SEED} on")
    for k, beside in enumerate(BESIDE):
        missed = []
        for i, fault in enumerate(FAULTS):
            found = named(drive(fault, beside, seed=SEED + 100 * k + i, seconds=SECONDS))
            missed += [f"{fault}: {', '.join(found) or 'none'}"] if found != [fault] else []
        what = f"{len(FAULTS)} faults, beside each {beside}: named"
        goal = len(FAULTS) if beside == "nothing" else 10
        line = exactly if beside == "nothing" else at_least
        yield line(what, len(FAULTS) - len(missed), goal, "", "; ".join(missed))


def wiring_right(full: bool) -> Iterator[Line]:
    """Logs of boats that are connected as the file says, whatever else is wrong with them"""
    print(f"  seeds from {SEED + 1000} on; half of the logs with each thruster alone at first, half without")
    tried, false, nearest = candidates(BOAT), [], -np.inf
    for k, beside in enumerate(BESIDE):
        for i in range(RIGHT_LOGS):
            run = drive("", beside, seed=SEED + 1000 + 100 * k + i, seconds=SECONDS, alone_s=2.0 * (i % 2))
            false += named(run)
            seen = evidence(run, BOAT, tried)
            nearest = max(nearest, float(seen.nats[1:].max())) if seen else nearest
    yield exactly(f"{RIGHT_LOGS * len(BESIDE)} right logs: false names", len(false), 0, "", "; ".join(false))
    yield information("right logs: the nearest wrong way over the file", nearest, "nats", "6 are needed")


def wiring_blueboat(full: bool) -> Iterator[Line]:
    """Ten runs of a BlueBoat (jankristia/BlueBoatSystemIdentification), left and right thruster swapped in all"""
    every = runs(FIT)
    if not every:
        yield from absent()
        return
    vessel = blueboat()
    right = ["swapped:left+right"]
    for name, run in every.items():
        found, turns = [n for n in named(run, vessel=vessel) if n != COMPASS], holds_turns(run)
        text = ", ".join(found) or "none"
        if turns:
            yield exactly(f"BlueBoat run {name}, with turns: the swap named", found == right, 1, "", text)
        else:
            yield exactly(f"BlueBoat run {name}, straight: other names", len([f for f in found if f not in right]), 0)
    whole = named(*every.values(), vessel=vessel)
    yield exactly("BlueBoat, all ten together: swap and compass named", whole == [*right, COMPASS], 1)


def holds_turns(run: Run) -> bool:
    """Whether the outputs ever differ for long enough to turn the boat."""
    t_s, pwm = run.samples("pwm_left", "pwm_right")
    return float(np.diff(t_s, append=t_s[-1])[abs(pwm[:, 0] - pwm[:, 1]) > TURN_US].sum()) >= TURN_S


PARTS = (wiring_faults, wiring_right, wiring_blueboat)
