"""Dead time and lag of thrusters to a fraction of a millisecond, wherever samples fall and however late they come."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import polars as pl
import pytest

from companion.boat.load_run import EXAMPLES
from companion.core.configuration.imu_filters import late_by_filters
from companion.core.configuration.site_file import load_site
from companion.core.configuration.vessel_file import VesselFile
from companion.core.excitation.file import load_excitation
from companion.logs.runs.run import Run
from sim.fitting.excite.information import PLANNED
from sim.fitting.excite.nominal import fly_nominal
from sim.fitting.identify.result import fit_structured
from sim.world.ahrs import LowPass
from tests.support.vessel_fixtures import boat

PLAN = """
format = 1
name = "reversals"
segments = [
    { name = "surge", kind = "steps", X = 1.0, levels = [0.25, -0.25, 0.25, -0.25], hold_s = 2.0 },
    { name = "yaw", kind = "steps", N = 1.0, levels = [0.15, -0.15, 0.15, -0.15, 0.15, -0.15], hold_s = 2.0 },
]
"""
DEAD_TIME_S, LAG_S = 0.1137, 0.0874
HZ, GYRO_HZ, ACCEL_HZ = 100.0, 20.0, 10.0


def true_boat() -> VesselFile:
    vessel = boat("aritra")
    imu = msgspec.structs.replace(vessel.sensors.imu, rate_Hz=HZ)
    return msgspec.structs.replace(
        vessel,
        propulsion=msgspec.structs.replace(vessel.propulsion, dead_time_s=DEAD_TIME_S, lag_s=LAG_S),
        sensors=msgspec.structs.replace(vessel.sensors, imu=imu),
    )


@cache
def flown() -> Run:
    """Reversals, commanded at 10 Hz, sampled at 100 Hz without noise."""
    site = load_site((EXAMPLES / "sites" / "basin.toml").read_text(), name="basin.toml")
    return fly_nominal(load_excitation(PLAN, name="plan"), true_boat(), site).run


def seen(phase: int, *, filtered: bool) -> Run:
    """The log of an autopilot with filters or without, every second sample: the odd ones or the even ones."""
    table = flown().table
    inertial = np.flatnonzero(table["r_rad_s"].is_not_null().to_numpy())
    names = ("psi_rad", "r_rad_s", "ax_m_s2", "ay_m_s2")
    psi, r, a_x, a_y = (table[name].to_numpy()[inertial] for name in names)
    if filtered:
        gyro, accel = LowPass(HZ), LowPass(HZ)
        r = np.array([gyro((v, 0.0, 0.0), GYRO_HZ)[0] for v in r])
        a_x, a_y, _ = np.array([accel((x, y, 0.0), ACCEL_HZ) for x, y in zip(a_x, a_y, strict=True)]).T
    mine = inertial[phase::2]
    columns = {name: np.full(len(table), np.nan) for name in names}
    for name, values in zip(names, (psi, r, a_x, a_y), strict=True):
        columns[name][mine] = values[phase::2]
    late = late_by_filters({"INS_GYRO_FILTER": GYRO_HZ, "INS_ACCEL_FILTER": ACCEL_HZ}) if filtered else {}
    table = table.with_columns(**{name: pl.Series(values) for name, values in columns.items()}).fill_nan(None)
    return Run(table, msgspec.structs.replace(flown().meta, late_s=late))


@pytest.mark.parametrize("filtered", [False, True])
@pytest.mark.parametrize("phase", [0, 1])
def test_neither_the_phase_of_the_samples_nor_a_filter_moves_them(phase, filtered):
    """0.4 ms: a step of averaged samples, 100 ms long, in which a command falls always at the same place."""
    found = fit_structured([seen(phase, filtered=filtered)], boat("aritra"), replace(PLANNED, window_s=2.0))
    assert found["dead_time_s"].value == pytest.approx(DEAD_TIME_S, abs=4e-4)
    assert found["lag_s"].value == pytest.approx(LAG_S, abs=5e-4)


def test_a_filter_that_is_not_known_is_in_the_dead_time():
    run = seen(0, filtered=True)
    untold = Run(run.table, msgspec.structs.replace(run.meta, late_s={}))
    found = fit_structured([untold], boat("aritra"), replace(PLANNED, window_s=2.0))
    assert found["dead_time_s"].value - DEAD_TIME_S > 0.008
