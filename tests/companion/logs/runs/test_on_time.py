"""Logs whose inertial samples came late through filters: each stands where it belongs, and nothing else moves."""

import json

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.logs.readers.table import read_csv, write_run
from companion.logs.runs.decimate import decimated
from companion.logs.runs.on_time import on_time
from companion.logs.runs.run import Run, RunError, RunMeta
from companion.logs.runs.splits import part


def motion(t):
    """Heading, which wraps; its rate; force ahead and to starboard; roll."""
    return 3.0 + 0.4 * np.sin(t), 0.4 * np.cos(t), np.sin(3 * t), np.cos(2 * t), 0.05 * np.sin(t)


def log(r_late_s: float, a_late_s: float, *, told: bool = True, own_rows: bool = False) -> Run:
    """20 s: IMU at 50 Hz, late; heading and roll in its rows, or 7 ms after; positions at 5 Hz; a command in 0.7 s."""
    t, t_psi, t_p = np.arange(1000) / 50, np.arange(1000) / 50 + 0.007 * own_rows, np.arange(100) / 5 + 0.003
    imu = pl.DataFrame({"t_s": t, "r_rad_s": motion(t - r_late_s)[1], "ax_m_s2": motion(t - a_late_s)[2],
                        "ay_m_s2": motion(t - a_late_s)[3]})  # fmt: skip
    psi = (motion(t_psi)[0] + np.pi) % (2 * np.pi) - np.pi
    attitude = pl.DataFrame({"t_s": t_psi, "psi_rad": psi, "phi_rad": motion(t_psi)[4], "theta_rad": 0 * t_psi})
    places = pl.DataFrame({"t_s": t_p, "north_m": np.sin(t_p), "east_m": np.cos(t_p)})
    table = imu
    for other in (attitude, places):
        table = table.join(other, on="t_s", how="full", coalesce=True)
    table = table.sort("t_s")
    at = table["t_s"].to_numpy()
    table = table.with_columns(
        battery_v=pl.lit(15.0), pwm_port=pl.Series(1500.0 + 50 * (np.floor(at / 0.7 + 1e-9) % 3))
    )
    late = {"r_rad_s": r_late_s, "ax_m_s2": a_late_s, "ay_m_s2": a_late_s} if told else {}
    return Run(table, RunMeta(source="made up", late_s=late))


@settings(max_examples=20, deadline=None)
@given(r_late=st.sampled_from((0.0, 0.0113, 0.0563)), a_late=st.floats(0.001, 0.06), own_rows=st.booleans())
def test_every_sample_is_the_motion_at_its_instant(r_late, a_late, own_rows):
    was = log(r_late, a_late, own_rows=own_rows)
    run = on_time(was)
    for column, which in {"psi_rad": 0, "r_rad_s": 1, "ax_m_s2": 2, "ay_m_s2": 3, "phi_rad": 4}.items():
        t, value = run.samples(column)
        off = (value - motion(t)[which] + np.pi) % (2 * np.pi) - np.pi
        assert len(t) >= 995
        assert np.abs(off).max() < 1e-4  # a line between two samples errs by h^2 / 8 times the curvature
    t, a = run.samples("ax_m_s2")
    assert t == pytest.approx(was.samples("ax_m_s2")[0] - a_late, abs=1e-12)  # jumps with every command: never blended
    assert np.array_equal(a, was.samples("ax_m_s2")[1])
    for names in (("north_m", "east_m"), *([("psi_rad",)] if own_rows else [])):
        for told, found in zip(was.samples(*names), run.samples(*names), strict=True):
            assert np.array_equal(told, found)
    (_, *stamps), pulses = run.commands()  # the first holds from the first row, which is earlier
    assert np.array_equal(stamps, was.commands()[0][1:]) and np.array_equal(pulses, was.commands()[1])
    assert run.table.select("battery_v", "pwm_port").null_count().row(0) == (0, 0)
    assert run.table.columns == was.table.columns


def test_one_row_stays_one_row_and_it_is_done_once():
    run = on_time(log(0.0113, 0.0113))
    assert len(run.samples("psi_rad", "r_rad_s", "ax_m_s2")[0]) == 999  # the first heading would be before the log
    assert run.meta.late_s == {} and on_time(run) is run
    unknown = log(0.0113, 0.0113, told=False)
    assert on_time(unknown) is unknown
    assert on_time(log(0.0, 0.0)).samples("r_rad_s")[0][0] == 0.0


@pytest.mark.parametrize("late_s", [{"north_m": 0.1}, {"ax_m_s2": -0.5}, {"r_rad_s": 100.0}])
def test_what_no_filter_does_is_refused(late_s, tmp_path):
    path = tmp_path / "run.csv"
    write_run(log(0.0113, 0.0113), path)
    old = next(line for line in path.read_text().splitlines() if line.startswith("# late_s"))
    path.write_text(path.read_text().replace(old, f"# late_s = {json.dumps(late_s)}"))
    with pytest.raises(RunError, match="late_s"):
        read_csv(path)


def test_a_log_without_it_is_written_as_older_programs_read_it(tmp_path):
    write_run(log(0.0, 0.0, told=False), tmp_path / "run.csv")
    assert "late_s" not in (tmp_path / "run.csv").read_text()


def test_means_and_parts_are_on_time_too():
    late, on = log(0.0113, 0.0113), log(0.0, 0.0)
    for piece, of in ((decimated(late).run, decimated(on).run), (on_time(part(late, 5.0, 9.0)), part(on, 5.0, 9.0))):
        t, r = piece.samples("r_rad_s")
        assert np.abs(r - np.interp(t, *of.samples("r_rad_s")))[1:-1].max() < 5e-4
    assert on_time(part(late, 5.0, 9.0)).whole is late
