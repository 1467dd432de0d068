"""An ArduPilot user's own log is the whole input, for a boat without UWB too."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars as pl

from companion.__main__ import main
from companion.core.model.load_vessel import load_vessel
from companion.core.model.vessel_text import vessel_toml
from companion.logs.readers.read_run import ReadOptions, read_run
from companion.logs.runs.run import Run
from sim.fitting.diagnose.catalogue import catalogue
from sim.fitting.diagnose.preparation.swapped_columns import reject_swapped_columns, strange_scale
from tests.companion.logs.readers.run_logs import dataflash
from tests.evidence.line import Line, at_most, exactly
from tests.sim.fitting.test_ardupilot_log import records
from tests.sim.fitting.test_gnss_boat import BOAT, GNSS, RANGES_ONLY, UWB, drive

SEED, SECONDS = 3, 120.0


def ardupilot_log(full: bool) -> Iterator[Line]:
    """A simulated drive as dataflash bytes: read, identified by the command line without other options."""
    run = drive(UWB, SEED, SECONDS)
    with tempfile.TemporaryDirectory() as folder:
        at = Path(folder)
        (at / "00000012.BIN").write_bytes(dataflash(records(run)))
        (at / "gnss.toml").write_text(vessel_toml(BOAT))
        read = read_run(at / "00000012.BIN", ReadOptions(vessel=BOAT))
        off = [np.abs(read.samples(f"pwm_{t}")[1] - run.samples(f"pwm_{t}")[1]).max() for t in run.thrusters]
        yield at_most(".BIN: pulse widths of outputs 5 to 8, off by", float(max(off)), 0.5, "us", "whole us in the log")
        places, expected = (r.samples("north_m", "east_m")[1] for r in (read, run))
        yield at_most(
            ".BIN: GPS positions, off by", np.abs(places - expected + expected[0]).max(), 0.03, "m", "1e-7 deg"
        )
        code = main(["identify", f"{at}/00000012.BIN", "--vessel", f"{at}/gnss.toml", "--out", f"{at}/out"])
        yield at_most(".BIN: identify, exit code (2: refused)", code, 1)
        found = load_vessel((at / "out" / "vessel.toml").read_text(), name="vessel.toml").sensors.gnss
        late_s = found.latency_s if found else np.nan
        yield at_most(".BIN: identified latency of the antenna, off by", abs(late_s - GNSS.latency_s), 0.03, "s")


def boat_without_uwb(full: bool) -> Iterator[Line]:
    """What is looked for in the logs of a boat with GNSS alone."""
    names = {e.name for e in catalogue(BOAT, [drive(UWB, 8, 20.0)])}
    yield exactly("GNSS alone: causes of ranges that are looked for", len(names & RANGES_ONLY), 0)


def crashes(full: bool) -> Iterator[Line]:
    """Logs that were refused whole: a CSE1 recording with a setting of -0.1, and a factor of 0.298 as in spins."""
    head = "t,x,y,phi,theta,psi,u1,u2,u3,u4,u5,tracking_lost,vsp_speed"
    rows = [f"{k / 20},0.{k:03},0,0,0,0.1,0.1,0,0,0,0,0,{-0.1 if k == 50 else 0.4}" for k in range(200)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.csv"
        path.write_text("\n".join([head, *rows]) + "\n")
        kept = read_run(path).table
    yield exactly("a setting of -0.1 in 200 rows: rows read", kept.height, 200)
    yield exactly("a setting of -0.1 in 200 rows: values left blank", kept["setting_vsp_speed"].null_count(), 1)
    run = drive(UWB, SEED, SECONDS)
    blank = pl.lit(None, pl.Float64)
    own = [(pl.col(c) / 0.298).alias(c) for c in ("ax_m_s2", "ay_m_s2")]
    spins = Run(run.table.with_columns(*own, phi_rad=blank, theta_rad=blank), run.meta)
    reject_swapped_columns(spins)
    yield exactly("positions 0.298 times the accelerations: warnings", len(strange_scale(spins)), 1, "", "not refused")


PARTS = (ardupilot_log, boat_without_uwb, crashes)
