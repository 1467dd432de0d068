"""Evidence that the boat drives on with what is left, that it is quiet where nothing is wrong, and what that costs."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any
from unittest import mock

import numpy as np

from companion.core.messages import Message, Tick
from companion.core.pilot.monitors.monitor import Monitor
from companion.core.pilot.pilot import Pilot
from companion.core.pilot.state import PilotState
from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.evidence.processes import processes
from tests.fault_lab.trial import Verdict, trial
from tests.fault_lab.weather import ROUND_S, sound_in_weather
from tests.support.drive_fixture import setup

FAULTY = {
    "dead": "thruster {} dead from 25",
    "at 40 %": "thruster {} weak 0.4 from 25",
    "reversed": "thruster {} reversed from 25",
    "swapped": "thruster {} swapped {} from 25",
}
HIGH_S = 3.0
FALSE_SEED = 30_000
HOUR_ROUNDS = round(3600 / ROUND_S)
COST_S = 60.0


def driving_on(full: bool) -> Iterator[Line]:
    """One thruster dead, at 40 %, reversed, swapped, mid-mission: 6 seeds each (--full: 20)"""
    seeds = range(1, 21) if full else range(1, 7)
    with processes() as pool:
        sound = float(np.median([v.cross_m for v in pool.map(_drive, [(seed, "") for seed in seeds])]))
        yield information("sound boat: cross-track error, median", sound, "m")
        for name, line in FAULTY.items():
            runs = list(pool.map(_drive, [(s, line.format(s % 4 + 1, (s + s // 4) % 3 + 1 + s % 4)) for s in seeds]))
            passed = sum(v.passed == len(setup(None).pilot.mission.path.points) for v in runs)
            goal = 18 * len(seeds) // 20
            yield at_least(f"{name}: all waypoints passed", passed, goal, "", f"of {len(seeds)}")
            through = [v.cross_m for v in runs if v.mode == "auto"]
            yield at_most(
                f"{name}: cross-track error over that of the sound boat", max(through) / sound, 2.0, "", "worst"
            )
            yield at_most(f"{name}: mean thrust above 40 %", max(v.high_s for v in runs), HIGH_S, "s", "worst")
        stuck = list(pool.map(_drive, [(s, f"thruster {s % 4 + 1} stuck 1900 from 25") for s in seeds]))
        inside = sum(v.true_farthest_m < 0 for v in stuck)
        yield exactly("stuck full: inside the fence", inside, len(seeds))


def quiet(full: bool) -> Iterator[Line]:
    """False alarms in weather, hull and thrusters off by 20 %, NLOS and dropouts: 1 h (--full: 24 h)"""
    rounds = 288 if full else 12
    runs, alarms = list[Verdict](), 0
    with processes() as pool:
        for v in pool.map(sound_in_weather, range(FALSE_SEED, FALSE_SEED + rounds)):
            runs.append(v)
            if v.mode != "auto":
                alarms += 1
                errors = [text for _, level, text in v.alerts if level == "error"]
                print(f"  seed {v.seed}: {v.modes[-1]}, {errors[:1]}")
            if len(runs) % HOUR_ROUNDS == 0:
                print(f"  {len(runs)} of {rounds} rounds: {alarms} changes of the mode", flush=True)
    hours = rounds * ROUND_S / 3600
    yield at_most(f"changes of the mode in {hours:.0f} h", alarms, max(1.0, hours / 24), "")
    yield exactly("runs that FAILED", sum(v.failed for v in runs), 0)


def cost(full: bool) -> Iterator[Line]:
    """What the tests of trust cost of a tick: processor time of 60 s under way"""
    spent, ticks = list[float](), list[tuple[float, float]]()

    def timed(function: Callable, times: list[float]) -> Callable:
        def call(*args: Any) -> Any:
            began = time.thread_time()
            result = function(*args)
            times.append(time.thread_time() - began)
            return result

        return call

    def step(pilot: Pilot, state: PilotState, inputs: Sequence[Message], t_ns: int) -> Any:
        before, whole = sum(spent), list[float]()
        result = timed(whole_step, whole)(pilot, state, inputs, t_ns)
        if any(isinstance(m, Tick) for m in inputs):
            ticks.append((whole[0], sum(spent) - before))
        return result

    whole_step = Pilot.step
    with contextlib.ExitStack() as stack:
        stack.enter_context(mock.patch.object(Pilot, "step", step))
        for kind in Monitor.__subclasses__():
            if kind.__module__.startswith("companion.core.pilot.trust"):
                for name in ("on_tick", "on_message"):
                    stack.enter_context(mock.patch.object(kind, name, timed(getattr(kind, name), spent)))
        trial(1, duration_s=COST_S)
    whole, trust = np.array(ticks).T
    yield at_most("share of one core at 10 Hz", 100 * sum(spent) / COST_S, 2.0, "%")
    p99 = 1000 * (np.percentile(whole, 99) - np.percentile(whole - trust, 99))
    yield at_most("a tick's p99 with them, less that without", p99, 0.2, "ms")
    yield information("their part of a tick, median", 1000 * float(np.median(trust)), "ms")


def _drive(case: tuple[int, str]) -> Verdict:
    seed, line = case
    return trial(seed, *([line] if line else []))


PARTS = (driving_on, quiet, cost)
