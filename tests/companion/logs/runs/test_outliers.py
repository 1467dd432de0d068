"""Impossible values: a few are left blank and told, many refuse the log."""

import math

import numpy as np
import polars as pl
import pytest

from companion.logs.readers.cse1 import read_cse1
from companion.logs.readers.read_run import read_run
from companion.logs.runs.run import Run, RunError
from tests.companion.logs.readers.run_logs import clean_run


def with_values(column: str, value: float, count: int) -> str:
    table = clean_run(10.0).table.with_columns(setting_speed=0.4)
    row = pl.int_range(pl.len())
    return table.with_columns(
        pl.when(row % 10 == 0, row < 10 * count).then(value).otherwise(column).alias(column)
    ).write_csv()


@pytest.mark.parametrize(("column", "value"), [("setting_speed", -0.1), ("psi_rad", 213.9), ("pwm_left", 15.6)])
def test_one_impossible_value_is_left_blank_and_told(tmp_path, column, value):
    (tmp_path / "log.csv").write_text(with_values(column, value, 1))
    run = read_run(tmp_path / "log.csv")
    (note,) = (p for p in run.meta.notes if p.kind == "impossible")
    assert note.text.startswith(f"{column}: 1 values outside") and note.t_s == 0.0
    assert run.table[column].null_count() == 1 and run.table.height == 500


def test_both_of_a_pair_are_left_blank(tmp_path):
    table = clean_run(60.0).table
    row = pl.int_range(pl.len())
    table = table.with_columns(north_m=pl.when(row == 100).then(1e7).otherwise("north_m"))
    (tmp_path / "log.csv").write_text(table.write_csv())
    run = read_run(tmp_path / "log.csv")
    assert len(run.samples("north_m", "east_m")[0]) == len(clean_run(60.0).samples("north_m", "east_m")[0]) - 1


def test_many_refuse_the_log_by_line_and_column(tmp_path):
    (tmp_path / "log.csv").write_text(with_values("psi_rad", 213.9, 20))
    with pytest.raises(RunError, match=r"log\.csv: line 2: psi_rad: 213\.9"):
        read_run(tmp_path / "log.csv")


def test_a_setting_below_nought_does_not_lose_a_recording_of_the_basin(tmp_path):
    head = "t,x,y,phi,theta,psi,u1,u2,u3,u4,u5,tracking_lost,vsp_speed"
    rows = [f"{k / 20},0.{k:03},0,0,0,0.1,0.1,0,0,0,0,0,{-0.1 if k == 50 else 0.4}" for k in range(200)]
    (tmp_path / "run.csv").write_text("\n".join([head, *rows]) + "\n")
    run: Run = read_cse1(tmp_path / "run.csv")
    assert run.table["setting_vsp_speed"].null_count() == 1
    assert any(p.kind == "impossible" for p in run.meta.notes)


def read(tmp_path, table: pl.DataFrame) -> Run:
    (tmp_path / "log.csv").write_text(table.write_csv())
    return read_run(tmp_path / "log.csv")


WHOLE = clean_run(10.0).table


def with_stamps(**stamps: float | None) -> pl.DataFrame:
    """The table with other stamps, by row: `_100=2.0`."""
    t_s = WHOLE["t_s"].to_list()
    for row, value in stamps.items():
        t_s[int(row[1:])] = value
    return WHOLE.with_columns(t_s=pl.Series(t_s, dtype=pl.Float64))


@pytest.mark.parametrize(
    ("stamps", "kind", "said"),
    [
        (
            {"_100": 1.98},
            "duplicate",
            "line 102: t_s: 1.98 is there twice; the first row is kept; 1 such rows are",
        ),
        ({"_100": 1.0}, "duplicate", "line 102: t_s: 1.0 is there twice"),
        (
            {"_100": 1.01},
            "out of order",
            "line 102: t_s: 1.01 does not lie between the times of the rows around it",
        ),
        ({"_100": 9e9}, "out of order", "line 102: t_s: 9"),
        ({"_0": 9e9}, "out of order", "line 2: t_s: 9"),
        ({"_100": None}, "garbage", "line 102: t_s: no time; 1 such rows are left out"),
        ({"_100": float("nan"), "_200": float("inf")}, "garbage", "line 102: t_s: no time; 2 such rows are left out"),
    ],
)
def test_a_few_rows_with_a_wrong_time_are_left_out(tmp_path, stamps, kind, said):
    """A late stamp, or one far ahead: the rows that increase without it are most."""
    run = read(tmp_path, with_stamps(**stamps))
    (note,) = run.meta.notes
    assert note.kind == kind and note.text.startswith(said)
    kept = [row for row in range(500) if f"_{row}" not in stamps]
    assert run.table.equals(WHOLE[kept])


def test_each_kind_of_wrong_time_is_counted(tmp_path):
    run = read(tmp_path, with_stamps(_100=1.98, _200=0.501, _300=None))
    assert [(p.kind, p.t_s) for p in run.meta.notes] == [
        ("garbage", None),
        ("duplicate", 1.98),
        ("out of order", 0.501),
    ]
    assert run.table.height == 497


@pytest.mark.parametrize(
    ("value", "message"),
    [(None, "line 102: t_s: every row needs a time"), (1.98, "line 102: t_s: 1.98 follows 1.98; time must increase")],
)
def test_many_rows_with_a_wrong_time_refuse_the_table(tmp_path, value, message):
    with pytest.raises(RunError, match=message):
        read(tmp_path, with_stamps(**{f"_{row}": value for row in range(100, 120)}))


def test_a_clock_that_was_set_back_refuses_the_table(tmp_path):
    with pytest.raises(RunError, match=r"line 402: t_s: 0\.0 follows 7\.98"):
        read(tmp_path, with_stamps(**{f"_{row}": (row - 400) / 50 for row in range(400, 500)}))


def halves(count: int) -> pl.DataFrame:
    rows = pl.int_range(pl.len())
    return WHOLE.with_columns(east_m=pl.when((rows % 10 == 0) & (rows < 10 * count)).then(None).otherwise("east_m"))


def test_a_few_halves_of_positions_are_left_blank_and_many_refuse_the_table(tmp_path):
    run = read(tmp_path, halves(1))
    assert run.table["north_m"].null_count() == WHOLE["north_m"].null_count() + 1
    assert [(p.kind, p.t_s) for p in run.meta.notes] == [("not a number", 0.0)]
    assert run.meta.notes[0].text == "line 2: north_m, east_m: one without the other; 1 such rows, left blank"
    with pytest.raises(RunError, match="line 2: north_m, east_m: one is there without the other"):
        read(tmp_path, halves(20))


def test_one_slip_of_a_slow_channel_is_no_reason_to_refuse_and_two_are(tmp_path):
    """A column that comes once a second has sixty values in a minute."""
    rows = pl.int_range(pl.len())
    slow = WHOLE.with_columns(V_w_m_s=pl.when(rows % 25 == 0).then(3.0), beta_w_deg=pl.when(rows % 25 == 0).then(90.0))
    one = slow.with_columns(V_w_m_s=pl.when(rows == 100).then(-8.0).otherwise("V_w_m_s"))
    assert [p.kind for p in read(tmp_path, one).meta.notes] == ["impossible"]
    two = one.with_columns(V_w_m_s=pl.when(rows == 200).then(-8.0).otherwise("V_w_m_s"))
    with pytest.raises(RunError, match=r"line 102: V_w_m_s: -8; expected 0 to 100"):
        read(tmp_path, two)


def test_headings_of_0_to_2_pi_are_wrapped_with_a_note(tmp_path):
    psi_rad = (WHOLE["psi_rad"].to_numpy() + 2.0) % (2 * math.pi)
    run = read(tmp_path, WHOLE.with_columns(psi_rad=pl.Series(psi_rad)))
    assert psi_rad.max() > 4.0
    np.testing.assert_allclose(run.table["psi_rad"], np.arctan2(np.sin(psi_rad), np.cos(psi_rad)), atol=1e-12)
    assert [(p.kind, p.text) for p in run.meta.notes] == [("read as", "psi_rad: 0 to 2 pi; wrapped to -pi..pi")]
