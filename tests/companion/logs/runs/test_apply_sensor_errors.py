"""Runs freed of the sensors' known errors: what was put in comes out, whatever is blank stays blank."""

import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from companion.core.model.sensor_errors import apply_heading_errors, apply_imu_errors, apply_uwb_scale
from companion.logs.runs.apply_sensor_errors import calibrated
from companion.logs.runs.decimate import decimated
from companion.logs.runs.run import Run
from companion.logs.runs.splits import part
from tests.support.vessel_fixtures import boat

BASE = boat("aritra")
ERRORS = {"accel_bias_x_m_s2": 0.2, "gyro_bias_rad_s": 0.02, "gyro_scale": 0.05, "misalignment_rad": 0.3,
          "heading_offset_rad": 0.4, "hard_iron_cos_rad": 0.1, "hard_iron_sin_rad": -0.2}  # fmt: skip


def vessel(imu=None, **uwb):
    sensors = BASE.sensors
    sensors = replace(sensors, imu=replace(sensors.imu, **(imu or {})), uwb=replace(sensors.uwb, **uwb))
    return replace(BASE, sensors=sensors)


def log(wrong=None):
    """30 s: IMU at 20 Hz, positions at 5 Hz between its samples; seed 0. `wrong`: the vessel whose sensors err."""
    rng, n = np.random.default_rng(0), 600
    t = np.arange(n) * 0.05
    r, a_x, a_y = rng.normal(0, 0.3, (3, n))
    psi = (np.cumsum(r) * 0.05 + np.pi) % (2 * np.pi) - np.pi
    t_p = np.arange(150) * 0.2 + 0.01
    north, east = 10 + np.sin(t_p), 8 + np.cos(t_p)
    if wrong:
        imu, uwb = wrong.sensors.imu, wrong.sensors.uwb
        psi = (apply_heading_errors(imu, psi) + np.pi) % (2 * np.pi) - np.pi
        a_x, a_y, r = apply_imu_errors(imu, a_x, a_y, r)
        north, east = apply_uwb_scale(uwb, north, east)
        t_p = t_p + uwb.clock_drift_s_s * (t_p - t_p[0] - uwb.latency_s)
    one = pl.DataFrame({"t_s": t, "psi_rad": psi, "r_rad_s": r, "ax_m_s2": a_x, "ay_m_s2": a_y})
    two = pl.DataFrame({"t_s": t_p, "north_m": north, "east_m": east})
    table = one.join(two, on="t_s", how="full", coalesce=True).sort("t_s")
    held = {f"pwm_{x.name}": pl.Series(np.where(table["t_s"].to_numpy() < 9, 1500.0, 1600.0)) for x in BASE.thrusters}
    return Run(table.with_columns(battery_v=pl.lit(15.0), **held))


def test_without_known_errors_it_is_the_same_run():
    run = log()
    assert calibrated(run, BASE) is run


@pytest.mark.parametrize("known", [vessel(ERRORS), vessel(scale=0.05), vessel(clock_drift_s_s=0.01),
                                   vessel(ERRORS, scale=-0.1, clock_drift_s_s=-0.02)])  # fmt: skip
def test_what_the_sensors_did_is_undone(known):
    good, got = log(), calibrated(log(known), known)
    assert got.table.columns == log(known).table.columns
    for names in (("psi_rad",), ("r_rad_s",), ("ax_m_s2",), ("ay_m_s2",), ("north_m", "east_m")):
        (t, told), (t_got, values) = good.samples(*names), got.samples(*names)
        drift = 1e-3 if names[0] == "north_m" else 1e-12  # the clock drifts from the first message on, latency and all
        assert t_got == pytest.approx(t, abs=drift)
        assert values == pytest.approx(told, abs=1e-9)
    assert got.commands()[0] == pytest.approx(good.commands()[0], abs=0.06)
    assert (got.commands()[1] == good.commands()[1]).all()


def test_a_part_of_a_log_drifts_as_the_log_does():
    known = vessel(clock_drift_s_s=0.01)
    whole, piece = (calibrated(run, known).samples("north_m", "east_m") for run in (log(), part(log(), 20.0, 30.0)))
    assert piece[0] == pytest.approx(whole[0][-len(piece[0]) :]) and len(piece[0]) == 50
    blank = Run(log().table.with_columns(pl.lit(None, pl.Float64).alias(c) for c in ("north_m", "east_m")))
    assert not calibrated(blank, known).known("north_m")


def test_a_part_of_a_log_is_freed_of_the_drift_since_the_log_began():
    """The same whether it is cut before or after, in one go or in two, thinned or not."""
    known = vessel(clock_drift_s_s=0.017)
    drifting, (t_good, good) = log(known), log().samples("north_m", "east_m")
    for piece in (part(drifting, 20.0, 28.0), part(part(drifting, 10.0, 29.0), 20.0, 28.0),
                  decimated(part(drifting, 20.0, 28.0)).run):  # fmt: skip
        t, places = calibrated(piece, known).samples("north_m", "east_m")
        mine = slice(start := np.searchsorted(t_good, t[0] - 0.1), start + len(t))
        assert t == pytest.approx(t_good[mine], abs=2e-3)
        assert places == pytest.approx(good[mine], abs=1e-9)


def test_one_force_without_the_other_is_left_out_where_axes_are_turned():
    table = log().table.with_columns(ay_m_s2=pl.lit(None, dtype=pl.Float64))
    assert calibrated(Run(table), vessel(ERRORS)).known("ax_m_s2") is False
    biased = calibrated(Run(table), vessel({"accel_bias_x_m_s2": 0.2}))
    assert biased.samples("ax_m_s2")[1] == pytest.approx(log().samples("ax_m_s2")[1] - 0.2)
    assert not biased.known("ay_m_s2")
