"""Actuators: two boats with servos drive the demo mission; the boat of fixed thrusters does what it did, as fast."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np

from companion.core.constants import NEUTRAL_US
from companion.core.messages import OperatorCommand, OverrideLease
from sim.world.environment import Weather
from tests.evidence.house.closed_loop import same_logs
from tests.evidence.house.speed import ratios_to
from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.evidence.processes import processes
from tests.support.drive_fixture import driving, figures, settled, setup, voyage

BEFORE = os.environ.get("ARITRA_BASE", "233bd10")
"""The last commit with fixed thrusters only."""
SEEDS = range(1, 6)
WEATHER = {
    "calm": ({}, 0.25),
    "current 0.1 m/s, wind 3 m/s, plant 10 % off": (
        {"weather": Weather(V_c_m_s=0.1, beta_c_deg=70.0, V_w_m_s=3.0, beta_w_deg=200.0, gustiness=0.2),
         "mismatch": 0.1}, 0.35),
}  # fmt: skip
"""World, and largest cross-track error, RMS on straight parts [m]."""


def drive(case: tuple[str, str, int]) -> dict[str, float]:
    """One demo mission; figures against the truth."""
    boat, weather, seed = case
    run = voyage(seed, None, vessel=boat, **WEATHER[weather][0])
    done = run.run(settled(3.0), 260.0)
    ours = [lease for lease in run.of(OverrideLease) if lease.source != "neutral"]
    planned = sum(lease.source == "plan" for lease in ours) / max(len(ours), 1)
    misses = [p.miss_m for p in run.state.passed]
    return {"done": done, "passed": len(misses), "miss_m": max(misses, default=np.inf), "planned": planned,
            **figures(run, None)}  # fmt: skip


def stopped(case: tuple[str, int]) -> tuple[float, float]:
    """After STOP, and after all messages of ours are lost: farthest pulse from neutral at the outputs [us]."""
    boat, seed = case
    found = []
    for lose in (False, True):
        run = voyage(seed, vessel=boat)
        run.run(lambda r: driving(r) and r.state.guidance.s_m > 1.0, 60.0)
        if lose:
            run.world.rover.receive = lambda data, peer, t_ns: b""
        else:
            run.feed([OperatorCommand(t_ns=run.world.t_ns, command="stop")])
        run.run(lambda r: False, 2.5)
        outputs = run.world.rover.outputs_us[: len(run.world.vessel.controls)]
        found.append(float(max(abs(pulse - NEUTRAL_US) for pulse in outputs)))
    return found[0], found[1]


def actuators(full: bool) -> Iterator[Line]:
    """Actuators: rudder and azimuth boat over PWM channels on the stepped clock, five seeds; the X boat as before"""
    del full
    with processes(2) as pool:
        for boat in ("rudder", "azimuth"):
            waypoints = len(setup(None, boat).pilot.mission.path.waypoints)
            for weather, (_, cross_m) in WEATHER.items():
                got = list(pool.map(drive, [(boat, weather, seed) for seed in SEEDS]))
                what = f"{boat}, {weather}"
                passed = sum(g["passed"] == waypoints and bool(g["done"]) for g in got)
                yield exactly(f"{what}: seeds that passed all waypoints", passed, len(SEEDS))
                each = ", ".join(f"{g['cross_track_rms_m']:.2f}" for g in got)
                yield at_most(
                    "  cross-track RMS, worst seed", max(g["cross_track_rms_m"] for g in got), cross_m, "m", each
                )
                yield information("  farthest miss of a waypoint", max(g["miss_m"] for g in got), "m")
                yield at_least("  ticks driven by the plan", min(g["planned"] for g in got), 0.99)
                if boat == "azimuth":
                    yield at_most("  station kept, worst seed", max(g["station_error_m"] for g in got), 0.5, "m")
            for what, pulse in zip(("STOP", "all messages lost"), stopped((boat, 5)), strict=True):
                yield exactly(f"{boat}: pulses off neutral 2.5 s after {what}", pulse, 0, "us")
    yield from same_logs(BEFORE)
    yield from ratios_to(BEFORE)
