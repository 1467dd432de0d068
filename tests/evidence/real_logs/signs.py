"""Signs and sides: twelve faults alone and with another cause, right logs, and the runs of a real boat."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars as pl
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run, RunMeta
from sim.fitting.engine.split import NamedLog
from sim.fitting.wiring.check import checked
from sim.fitting.wiring.evidence import candidates, evidence
from tests.evidence.line import Line, at_least, exactly, information
from tests.sim.fitting.wiring.miswired import BESIDE, BOAT, FAULTS, drive
from tests.support.vessel_fixtures import boat

SEED, SECONDS = 93_000, 180.0
RIGHT_LOGS = 8
"""For each cause beside."""
BLUEBOAT = "ARITRA_BLUEBOAT"
RUNS = ("218", "221", "222", "223", "224", "226", "228", "230", "233", "235")
"""The runs to fit on; the others of the set are kept to judge by and are not read here."""
TURN_US, TURN_S = 100.0, 0.5
"""A run holds turns where both outputs differ by more than this for so long."""


def named(*runs: Run, vessel: VesselFile = BOAT) -> list[str]:
    """What is put right in these logs."""
    logs = [NamedLog(f"log {i}", run) for i, run in enumerate(runs)]
    return [f.name for f in checked(logs, [], vessel).wiring.corrected]


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
    folder = os.environ.get(BLUEBOAT)
    if not folder:
        yield information("BlueBoat: runs read", 0, "", f"skipped: set {BLUEBOAT} to the data set's folder sorted_data")
        return
    vessel = blueboat()
    runs = {name: blueboat_run(Path(folder) / f"fixed_00000{name}.csv") for name in RUNS}
    right = ["swapped:left+right"]
    for name, run in runs.items():
        found, turns = named(run, vessel=vessel), holds_turns(run)
        text = ", ".join(found) or "none"
        if turns:
            yield exactly(f"BlueBoat run {name}, with turns: the swap named", found == right, 1, "", text)
        else:
            yield exactly(f"BlueBoat run {name}, straight: other names", len([f for f in found if f not in right]), 0)
    yield exactly("BlueBoat, all ten together: the swap named", named(*runs.values(), vessel=vessel) == right, 1)


def blueboat() -> VesselFile:
    """The maker's figures (1.2 m, 14.5 kg without batteries) and the data set's arms of 0.285 m; the rest assumed."""
    twin = boat("twin")
    inertia = replace(
        twin.inertia, mass_kg=17.0, I_z_kg_m2=2.5, X_udot_kg=-1.7, Y_vdot_kg=-15.0, N_rdot_kg_m2=-2.0, source="assumed"
    )
    port, starboard = twin.thrusters
    left = replace(port, name="left", x_m=-0.45, y_m=-0.285)
    right = replace(starboard, name="right", x_m=-0.45, y_m=0.285)
    sensors = replace(twin.sensors, uwb=replace(twin.sensors.tag, x_m=0.0, y_m=0.0))
    return replace(twin, name="blueboat", inertia=inertia, thrusters=(left, right), sensors=sensors)


def blueboat_run(path: Path) -> Run:
    """One file of `sorted_data`: ms, degrees; GPS repeats fixes; the left output is mirrored (1490 us is ahead)."""
    raw = pl.read_csv(path, infer_schema_length=None)
    moved = (pl.col("x_ned").diff() != 0) | (pl.col("y_ned").diff() != 0)
    psi = pl.col("yaw").radians()
    table = raw.select(
        t_s=(pl.col("original_timestamp") - pl.col("original_timestamp").first()) / 1000,
        pwm_left=3000.0 - pl.col("thr_left"),
        pwm_right=pl.col("thr_right").cast(pl.Float64),
        battery_v=pl.lit(None, pl.Float64),
        psi_rad=pl.arctan2(psi.sin(), psi.cos()),
        r_rad_s=pl.col("yaw_rate"),
        ax_m_s2=pl.col("surge_dot"),
        ay_m_s2=pl.col("sway_dot"),
        north_m=pl.when(moved).then(pl.col("x_ned")),
        east_m=pl.when(moved).then(pl.col("y_ned")),
    )
    return Run(table, RunMeta(source=path.name))


def holds_turns(run: Run) -> bool:
    """Whether the outputs ever differ for long enough to turn the boat."""
    t_s, pwm = run.samples("pwm_left", "pwm_right")
    return float(np.diff(t_s, append=t_s[-1])[abs(pwm[:, 0] - pwm[:, 1]) > TURN_US].sum()) >= TURN_S


PARTS = (wiring_faults, wiring_right, wiring_blueboat)
