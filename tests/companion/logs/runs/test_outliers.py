"""Impossible values: a few are left blank and told, many refuse the log."""

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
