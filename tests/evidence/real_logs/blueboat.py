"""A real catamaran with twin thrusters, GPS, compass: jankristia/BlueBoatSystemIdentification, read where it lies."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
import polars as pl
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.vessel_text import vessel_toml
from companion.logs.readers.table import write_run
from companion.logs.runs.run import Run, RunMeta
from sim.fitting.wiring.compass import compass_finding, hard_iron
from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.evidence.real_logs.recordings import held_out_scores, mean, over_baseline
from tests.support.vessel_fixtures import boat

FOLDER = "ARITRA_BLUEBOAT"
FIT = ("218", "221", "222", "223", "224", "226", "228", "230", "233", "235")
JUDGED = ("216", "220", "225", "232", "234", "239")
"""Judged by for the first time on 25 November 2026; nothing is chosen by them."""
GOALS = {"position": 2.6, "heading": 0.32, "u": 0.20, "r": 0.045}
R2_GOALS = {"u": 0.97, "r": 0.85}
UNITS = {"position": "m", "heading": "rad", "u": "m/s", "r": "rad/s"}
COLUMNS = {"gyro": ("r_rad_s",), "accelerations": ("ax_m_s2", "ay_m_s2")}


def blueboat(left_y_m: float = -0.285) -> VesselFile:
    """The maker's figures (1.2 m, 14.5 kg without batteries) and the data set's arms of 0.285 m; the rest assumed.

    As labelled in the data; `left_y_m` = 0.285: as the boat answers.
    """
    twin = boat("twin")
    inertia = replace(
        twin.inertia, mass_kg=17.0, I_z_kg_m2=2.5, X_udot_kg=-1.7, Y_vdot_kg=-15.0, N_rdot_kg_m2=-2.0, source="assumed"
    )
    port, starboard = twin.thrusters
    left = replace(port, name="left", x_m=-0.45, y_m=left_y_m)
    right = replace(starboard, name="right", x_m=-0.45, y_m=-left_y_m)
    sensors = replace(twin.sensors, uwb=replace(twin.sensors.tag, x_m=0.0, y_m=0.0))
    return replace(twin, name="blueboat", inertia=inertia, thrusters=(left, right), sensors=sensors)


def runs(names: Sequence[str]) -> dict[str, Run]:
    """Runs by name; none where the data set is not here."""
    folder = os.environ.get(FOLDER)
    return {name: blueboat_run(Path(folder) / f"fixed_00000{name}.csv") for name in names} if folder else {}


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
    return Run(table, RunMeta(source=path.name, columns={"pwm": "thr_left (mirrored), thr_right; axes NED, FRD"}))


def without(run: Run, *columns: str) -> Run:
    """The run with these columns blank."""
    return Run(run.table.with_columns(**dict.fromkeys(columns, pl.lit(None, pl.Float64))), run.meta)


def scores(fit: dict[str, Run], judge: dict[str, Run], vessel: VesselFile) -> dict[str, dict]:
    """What `aritra identify` says of `judge` after fitting `fit`, by model."""
    with tempfile.TemporaryDirectory() as folder:
        at = Path(folder)
        (at / "blueboat.toml").write_text(vessel_toml(vessel))
        for name, run in (fit | judge).items():
            write_run(run, at / f"{name}.csv")
        paths = [[at / f"{name}.csv" for name in part] for part in (fit, judge)]
        return held_out_scores(*paths, at / "blueboat.toml")


def at_10_s(score: dict, channel: str) -> float:
    """Rms error of a channel 10 s ahead."""
    return score["rms"][channel][score["horizons_s"].index(10)]


def overall(found: dict[str, dict], model: str) -> float:
    """Geometric mean over channels, 10 and 20 s ahead, of a model's error over that of the better baseline."""
    return mean(over_baseline(found, model, 10, 20))


def absent() -> Iterator[Line]:
    """Says that the data set is not here."""
    yield information("BlueBoat: runs read", 0, "", f"skipped: set {FOLDER} to the data set's folder sorted_data")


def blueboat_judged(full: bool) -> Iterator[Line]:
    """BlueBoat: ten runs fitted by the default command, labels as in the data, six others predicted"""
    fit, judge = runs(FIT), runs(JUDGED)
    if not fit:
        yield from absent()
        return
    found = scores(fit, judge, blueboat())
    for channel, goal in GOALS.items():
        yield at_most(f"BlueBoat: {channel} after 10 s", at_10_s(found["structured"], channel), goal, UNITS[channel])
    for channel, goal in R2_GOALS.items():
        yield at_least(f"BlueBoat: R2 of {channel} over 10 s", found["structured"]["r2"][channel], goal)
    yield information("BlueBoat: error over the better guess without a model", overall(found, "structured"))


def blueboat_compass(full: bool) -> Iterator[Line]:
    """BlueBoat: the compass, about 8 degrees off by a hand analysis of all runs, by every three of the ten runs"""
    every = runs(FIT)
    if not every:
        yield from absent()
        return
    vessel, named = blueboat(left_y_m=0.285), []
    for three in combinations(FIT, 3):
        found = hard_iron([every[name] for name in three], vessel)
        if found and found.is_clear:
            named.append(float(np.degrees(found.amplitude_rad)))
    inside = sum(6.0 <= amplitude <= 10.0 for amplitude in named)
    yield at_least("BlueBoat: sets of three runs that name the compass, of 120", len(named), 120)
    spread = f"{min(named, default=0):.1f} to {max(named, default=0):.1f} degrees"
    yield exactly("BlueBoat: of these with an amplitude of 6 to 10 degrees", inside, len(named), "", spread)
    (whole,) = compass_finding(every, vessel)
    yield information("BlueBoat: the compass by all ten runs", whole.nats or 0.0, "nats", whole.text)


def blueboat_single(full: bool) -> Iterator[Line]:
    """BlueBoat: each of the ten runs fitted alone, the other nine predicted; labels put right (with --full)"""
    every = runs(FIT) if full else {}
    if not every:
        yield from absent() if full else iter([information("BlueBoat, each run alone: with --full", float("nan"))])
        return
    for name, run in every.items():
        rest = {other: r for other, r in every.items() if other != name}
        found = scores({name: run}, rest, blueboat(left_y_m=0.285))
        stays = overall(found, "velocity stays")
        yield at_most(f"BlueBoat {name} alone: error over the better guess", overall(found, "structured"), stays)


def blueboat_columns(full: bool) -> Iterator[Line]:
    """BlueBoat: a sensor's column more, halves of the ten runs that predict each other (with --full)"""
    every = runs(FIT) if full else {}
    if not every:
        yield from absent() if full else iter([information("BlueBoat, a column more: with --full", float("nan"))])
        return
    halves = [{name: every[name] for name in FIT[i::2]} for i in (0, 1)]
    for i, fit in enumerate(halves):
        missing, before = dict(COLUMNS), float("nan")
        for added in ("poses", *COLUMNS):
            missing.pop(added, None)
            blank = [column for columns in missing.values() for column in columns]
            part = {name: without(run, *blank) for name, run in fit.items()}
            error = overall(scores(part, halves[1 - i], blueboat(left_y_m=0.285)), "structured")
            what = f"BlueBoat, half {i + 1}, {added}: error over the better guess"
            yield information(what, error) if added == "poses" else at_most(what, error, 1.03 * before)
            before = error


PARTS = (blueboat_judged, blueboat_compass, blueboat_single, blueboat_columns)
