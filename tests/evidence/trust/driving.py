"""Evidence that the boat drives on with what is left, that it is quiet where nothing is wrong, and what that costs."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from companion.core.model.manoeuvring import mass_matrix
from companion.core.model.thrusters import configuration_matrix
from companion.core.pilot.trust.hypothesis_bank import ThrusterBank
from sim.world.environment import Weather
from sim.world.sensors import UwbFaults
from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.fault_lab.trial import Verdict, trial
from tests.support.drive_fixture import setup

FAULTY = {
    "dead": "thruster {} dead from 25",
    "at 40 %": "thruster {} weak 0.4 from 25",
    "reversed": "thruster {} reversed from 25",
    "swapped": "thruster {} swapped {} from 25",
}
HIGH_S = 3.0
ROUND_S = 300.0
WAVES_M = (0.0, 0.1, 0.2)
FALSE_SEED = 30_000


def driving_on(full: bool) -> Iterator[Line]:
    """One thruster dead, at 40 %, reversed, swapped, mid-mission: 6 seeds each (--full: 20)"""
    seeds = range(1, 21) if full else range(1, 7)
    with ProcessPoolExecutor(os.cpu_count()) as pool:
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
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        runs = list(pool.map(_weather, range(FALSE_SEED, FALSE_SEED + rounds)))
    alarms = [v for v in runs if v.mode not in ("auto",)]
    for v in alarms:
        print(f"  seed {v.seed}: {v.modes[-1]}, {[text for _, level, text in v.alerts if level == 'error'][:1]}")
    hours = rounds * ROUND_S / 3600
    yield at_most(f"changes of the mode in {hours:.0f} h", len(alarms), max(1.0, hours / 24), "")
    yield exactly("runs that FAILED", sum(v.failed for v in runs), 0)


def cost(full: bool) -> Iterator[Line]:
    """What the bank of hypotheses costs a tick"""
    vessel = setup(None).pilot.vessel
    bank = ThrusterBank(configuration_matrix(vessel), mass_matrix(vessel))
    rng, state, took = np.random.default_rng(1), bank.initial(), []
    for _ in range(2000):
        w, f, a = rng.normal(0, 3, 3), rng.normal(0, 5, len(vessel.thrusters)), rng.normal(0, 0.3, 2)
        started = time.perf_counter()
        state = bank.step(state, w, f, a, 0.1)
        took.append(time.perf_counter() - started)
    yield at_most("share of one core at 10 Hz", 100 * 10 * float(np.mean(took)), 2.0, "%")
    yield information("one step, p99", 1000 * float(np.percentile(took, 99)), "ms")


def _drive(case: tuple[int, str]) -> Verdict:
    seed, line = case
    return trial(seed, *([line] if line else []))


def _weather(seed: int) -> Verdict:
    rng = np.random.default_rng([seed, 99])
    towards, wind_from = rng.uniform(0, 360, 2)
    weather = Weather(
        V_c_m_s=0.15, beta_c_deg=towards, V_w_m_s=5.0, beta_w_deg=wind_from, gustiness=0.3,
        H_s_m=float(rng.choice(WAVES_M)), T_p_s=float(rng.uniform(1.6, 2.6)),
    )  # fmt: skip
    faults = UwbFaults(dropout=0.1, nlos=0.05)
    return trial(seed, weather=weather, duration_s=ROUND_S, mismatch=0.2, faults=faults)


PARTS = (driving_on, quiet, cost)
