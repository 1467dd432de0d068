"""Evidence for the real autopilot: missions and stops on the firmware that ARDUROVER names, and on the simulated one.

ARDUROVER=path[:path] scripts/evidence firmware: desktop builds of ArduPilot Rover. Without one the same lines are of
the simulated autopilot alone, and it says so.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from scipy.stats import chi2

from sim.world.environment import Weather
from sim.world.world import World, WorldSetup
from tests.evidence.firmware.provisioning import provisioning
from tests.evidence.firmware.questions import questions
from tests.evidence.firmware.stops import stops
from tests.evidence.line import Line, at_most, between, exactly
from tests.evidence.main_job.parts import drive_mission, reference_boat
from tests.support.autopilots.firmware_rig import binaries, firmware_world

SEEDS = range(1, 6)
START = 8.0, 8.0, math.radians(20)
WAVES = Weather(H_s_m=0.35, T_p_s=2.5)
"""Roll of 5 degrees and pitch of 3 (amplitude) in the simulator's figures for this size of hull."""
READY_S = 30.0
"""The mission begins so long after the autopilot's: a real one arms after 22 s. On both, so that ranges err alike."""
GOALS = (
    ("cross_track_rms_m", 0.11, "m"),
    ("overshoot_m", 0.30, "m"),
    ("u_rmse_m_s", 0.05, "m/s"),
    ("v_rmse_m_s", 0.05, "m/s"),
    ("position_rmse_m", 0.12, "m"),
    ("station_error_m", 0.3, "m"),
    ("station_error_deg", 5.0, "deg"),
)
Case = tuple[str, bool, int, bool]


def drive(case: Case) -> dict[str, float]:
    """One mission: binary ("": the simulated autopilot), GPS, seed, waves."""
    binary, gps, seed, waves = case
    vessel = reference_boat()[0].vessel
    imu = replace(  # the firmware's simulated board has sensors without noise, and so has this one beside it
        vessel.sensors.imu, accel_sigma_m_s2=1e-6, gyro_sigma_rad_s=1e-6, heading_sigma_rad=1e-6,
        accel_bias_sigma_m_s2=0.0, gyro_bias_sigma_rad_s=0.0, heading_wander_sigma_rad=1e-6,
    )  # fmt: skip
    vessel = replace(vessel, sensors=replace(vessel.sensors, imu=imu))
    setup = WorldSetup(vessel, reference_boat()[0].site, start=START, weather=WAVES if waves else Weather())
    if not binary:
        return drive_mission(World(setup, seed), READY_S)
    with (
        tempfile.TemporaryDirectory() as folder,
        closing(firmware_world(Path(binary), Path(folder), setup, seed, gps=gps)) as world,
    ):
        return drive_mission(world, READY_S)


def kinds() -> list[tuple[str, str, bool]]:
    """Name, binary, GPS of every autopilot that is at hand."""
    real = [
        (f"{path.parent.name}, GPS {'on' if gps else 'off'}", str(path), gps) for path in binaries() for gps in (0, 1)
    ]
    if not real:
        print("  (ARDUROVER names no firmware: the simulated autopilot alone)")
    return [("simulated", "", False), *((name, path, bool(gps)) for name, path, gps in real)]


def missions(full: bool) -> Iterator[Line]:
    """Missions: seeds 1-5 on every autopilot at hand, GPS off and on"""
    yield from _missions(False, GOALS)


def waves(full: bool) -> Iterator[Line]:
    """Waves: the same while waves roll and pitch the hull"""
    yield from _missions(True, (("cross_track_rms_m", 0.2, "m"),))


def _missions(rough: bool, goals: tuple[tuple[str, float, str], ...]) -> Iterator[Line]:
    autopilots = kinds()
    cases = [(binary, gps, seed, rough) for _, binary, gps in autopilots for seed in SEEDS]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        runs = list(pool.map(drive, cases))
    ours = runs[: len(SEEDS)]
    for k, (name, binary, _) in enumerate(autopilots):
        mine = runs[k * len(SEEDS) : (k + 1) * len(SEEDS)]
        yield exactly(f"{name}: waypoints missed", sum(r["missed"] for r in mine), 0)
        for key, goal, unit in goals:
            values = [r[key] for r in mine]
            yield at_most(f"{name}: {key}", max(values), goal, unit, f"worst of 5; median {np.median(values):.3f}")
        nees = float(np.mean([r["nees"] for r in mine]))
        band = chi2.ppf([0.025, 0.975], 6 * len(mine)) / len(mine)
        yield between(f"{name}: NEES of pose and velocity", nees, *band, note="95 % band of chi2(30)/5")
        if binary and not rough:
            for key, _, _ in goals:
                ratio = float(np.mean([r[key] for r in ours]) / np.mean([r[key] for r in mine]))
                yield between(f"{name}: simulated / real, {key}", ratio, 0.9, 1.1, note="means of 5")


PARTS = (missions, waves, stops, provisioning, questions)
