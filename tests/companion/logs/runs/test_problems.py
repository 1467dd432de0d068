"""Faults put into a clean run are found where they are; the clean run has none."""

import numpy as np
import polars as pl
import pytest

from companion.logs.runs.problems import dead_columns, grouped, held_rows, problem_sentences, problems, unit_fault
from companion.logs.runs.run import LogProblem, Run
from tests.companion.logs.readers.run_logs import clean_run

PLACE = ("north_m", "east_m")


def edited(run: Run, first_s: float, last_s: float, **columns) -> Run:
    """`columns`: value (None: blank) or function of the old one, in rows of [first_s, last_s)."""
    inside = (pl.col("t_s") >= first_s) & (pl.col("t_s") < last_s)
    changes = []
    for name, value in columns.items():
        new = value(pl.col(name)) if callable(value) else pl.lit(value, pl.Float64)
        changes.append(pl.when(inside).then(new).otherwise(pl.col(name)).alias(name))
    return Run(run.table.with_columns(changes), run.meta)


def kinds(run: Run) -> dict[str, list[LogProblem]]:
    return grouped(problems(run))


def test_a_sentence_names_its_log_once():
    edited = LogProblem(kind="edited", text="day1.csv: the data is not what was written with its hash")
    said = ["day1.csv: edited: the data is not what was written with its hash."]
    assert problem_sentences({"day1.csv": [edited]}) == said


@pytest.mark.parametrize("seed", range(5))
def test_a_clean_run_has_no_problem(seed):
    assert problems(clean_run(60.0, seed)) == []


def only(run: Run, kind: str, column: str = "") -> LogProblem:
    """The one problem there is of that kind and column, and no other kind."""
    found = kinds(run)
    assert list(found) == [kind], found
    (problem,) = (p for p in found[kind] if column in p.text)
    return problem


def test_silence_of_one_channel_and_of_all():
    p = only(edited(clean_run(), 20.0, 22.0, north_m=None, east_m=None), "gap", "north_m")
    assert (p.t_s, p.length_s) == (pytest.approx(19.8), pytest.approx(2.2))
    p = only(edited(clean_run(), 30.0, 30.5, r_rad_s=None), "gap", "r_rad_s")
    assert (p.t_s, p.length_s) == (pytest.approx(29.98), pytest.approx(0.52))
    run = clean_run()
    paused = Run(run.table.filter(~pl.col("t_s").is_between(10.0, 12.99)))
    p = only(paused, "gap", "nothing at all")
    assert (p.t_s, p.length_s) == (pytest.approx(9.98), pytest.approx(3.02))
    p = only(edited(clean_run(), 50.0, 61.0, north_m=None, east_m=None), "gap", "north_m")
    assert p.length_s == pytest.approx(10.18)
    p = only(edited(clean_run(), 0.0, 5.0, north_m=None, east_m=None), "gap", "north_m")
    assert (p.t_s, p.length_s) == (0.0, pytest.approx(5.0))


def test_a_jump_of_the_clock_shows_as_silence_of_everything():
    run = clean_run()
    later = Run(run.table.with_columns(t_s=pl.when(pl.col("t_s") < 20).then("t_s").otherwise(pl.col("t_s") + 7.0)))
    p = kinds(later)["gap"][0]
    assert (p.t_s, p.length_s) == (pytest.approx(19.98), pytest.approx(7.02))
    assert "clock jumped" in p.text


def test_saturation_by_thruster_with_its_own_limits():
    p = only(edited(clean_run(), 5.0, 7.0, pwm_right=1900.0), "saturated", "pwm_right")
    assert (p.t_s, p.length_s) == (5.0, 2.0)
    assert "1900 us" in p.text
    run = edited(clean_run(), 5.0, 7.0, pwm_left=1750.0)
    assert problems(run) == []
    narrow = Run(run.table, type(run.meta)(pwm_limits_us={"left": (1250.0, 1750.0)}))
    assert only(narrow, "saturated", "pwm_left").length_s == 2.0


def test_idle_stretches_and_thrusters_that_never_move():
    p = only(edited(clean_run(), 40.0, 48.0, pwm_left=1510.0, pwm_right=1490.0), "idle")
    assert p.length_s == pytest.approx(8.0, abs=0.3)
    assert problems(edited(clean_run(), 40.0, 48.0, pwm_left=1510.0)) == []
    p = only(edited(clean_run(), -1, 99, pwm_left=1500.0), "constant", "pwm_left")
    assert "never changes (1500 us)" in p.text


@pytest.mark.parametrize("column", ["r_rad_s", "ax_m_s2", "psi_rad"])
def test_a_stuck_channel(column):
    p = next(p for p in kinds(edited(clean_run(), 10.0, 14.0, **{column: 0.125}))["stuck"])
    assert column in p.text
    assert (p.t_s, p.length_s) == (10.0, pytest.approx(3.98))


def test_a_stuck_tag():
    frozen = edited(clean_run(), 10.0, 20.0, north_m=lambda c: c * 0 + 3.0, east_m=lambda c: c * 0 + 4.0)
    assert {"stuck", "jump"} <= set(kinds(frozen))


def test_positions_that_jump_or_do_not_come():
    run = edited(clean_run(), 20.0, 20.1, north_m=lambda c: c + 6.0)
    found = kinds(run)
    assert list(found) == ["jump"]
    assert [p.t_s for p in found["jump"]] == pytest.approx([19.8, 20.0])
    run = clean_run()
    fix = run.table["north_m"].is_not_null()
    number = fix.cast(pl.Int64).cum_sum()
    every_third = fix & (number % 3 == 0)
    lost = run.table.with_columns(
        pl.when(every_third).then(None).otherwise(pl.col(c)).alias(c) for c in ("north_m", "east_m")
    )
    assert "33 % of the positions at 5.0 Hz did not come" in only(Run(lost), "positions").text
    slow = run.table.with_columns(
        pl.when(number % 10 == 1).then(pl.col(c)).otherwise(None).alias(c) for c in ("north_m", "east_m")
    )
    assert "at 0.50 Hz only" in only(Run(slow), "positions").text
    few = edited(run, 0.3, 99, north_m=None, east_m=None)
    assert "only 2 positions" in only(few, "positions").text


def test_what_is_not_there_at_all():
    missing = {
        p.text.split(":")[0]
        for p in kinds(edited(clean_run(), -1, 99, battery_v=None, north_m=None, east_m=None))["missing"]
    }
    assert missing == {"battery_v", "north_m"}
    p = only(edited(clean_run(), 3.0, 5.0, pwm_left=None), "missing", "pwm_left")
    assert (p.t_s, p.length_s) == (3.0, 2.0)
    p = only(edited(clean_run(), 20.0, 45.0, battery_v=15.5), "voltage")
    assert (p.t_s, p.length_s) == (20.0, pytest.approx(25.0))


@pytest.mark.parametrize(
    ("change", "hint"),
    [
        (lambda r: r * 57.29578, "deg/s"),
        (lambda r: -r, "positive to port"),
        (lambda r: r * 2.0, "turns 0.5 times"),
    ],
)
def test_heading_and_yaw_rate_that_disagree(change, hint):
    assert hint in only(edited(clean_run(), -1, 99, r_rad_s=change), "disagree").text


def test_a_biased_gyroscope_is_no_disagreement_and_no_turn_no_verdict():
    assert problems(edited(clean_run(), -1, 99, r_rad_s=lambda r: r + 0.1)) == []
    rng = np.random.default_rng(1)
    run = clean_run()
    n = run.table.height
    still = run.table.with_columns(
        psi_rad=pl.Series(0.002 * rng.normal(size=n)), r_rad_s=pl.Series(rng.normal(size=n) * 0.005)
    )
    assert problems(Run(still)) == []


def test_the_readers_notes_come_first():
    note = LogProblem(kind="damaged", text="x")
    assert problems(clean_run().with_notes([note])) == [note]


def test_columns_that_hold_one_value_throughout_are_dead():
    """Zeros in place of an IMU; east alone is a boat that drives due north; seven samples are few."""
    run = clean_run()
    assert dead_columns(run) == []
    assert dead_columns(edited(run, -1, 99, ax_m_s2=0.0, r_rad_s=0.5)) == ["r_rad_s", "ax_m_s2"]
    assert dead_columns(edited(run, 0.01, 99, ax_m_s2=0.0)) == []
    fixed = edited(run, -1, 99, north_m=lambda n: 0.0 * n)
    assert dead_columns(fixed) == []
    assert dead_columns(edited(fixed, -1, 99, east_m=lambda e: 0.0 * e)) == ["north_m", "east_m"]
    seven = edited(run, -1, 99, ax_m_s2=0.0).table.with_columns(ax_m_s2=pl.when(pl.int_range(pl.len()) < 7).then(0.0))
    assert dead_columns(Run(seven)) == []


def test_positions_that_are_held_are_told_and_a_boat_that_rests_keeps_one_a_period():
    run = clean_run()
    assert not held_rows(run, *PLACE).any()
    fix = pl.int_range(pl.len()) // 5
    held = run.table.with_columns(
        north_m=(pl.min_horizontal(fix, pl.len() // 10) * 0.3).cast(pl.Float64), east_m=pl.lit(2.0)
    )
    assert held_rows(Run(held), *PLACE).tolist() == [row % 5 != 0 for row in range(held.height)]


def test_readings_of_one_column_are_held_where_nearly_all_last_as_long():
    """A swell in five steps rests for longer at its crests. Seed 3."""
    t_s, rng = np.arange(600) / 100.0, np.random.default_rng(3)
    fresh = rng.normal(size=len(t_s))
    period = rng.choice([6, 7], 100).cumsum()
    steps = np.searchsorted(period, np.arange(len(t_s)), side="right")
    columns = ("r_rad_s", "ax_m_s2", "ay_m_s2")
    table = clean_run().table[: len(t_s)]
    assert table.height == len(t_s)
    table = table.with_columns(
        t_s=pl.Series(t_s),
        r_rad_s=pl.Series(fresh[steps]),
        ax_m_s2=pl.Series(np.round(5.0 * np.sin(t_s))),
        ay_m_s2=pl.Series(fresh),
    )
    held = {name: held_rows(Run(table), name) for name in columns}
    assert held["r_rad_s"].sum() == len(t_s) - len(np.unique(steps))
    assert not held["ax_m_s2"].any() and not held["ay_m_s2"].any()


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
@pytest.mark.parametrize("every", [1, 50])
def test_the_unit_of_the_time_is_named_by_its_power_of_ten(factor, unit, every):
    """Headings at 50 Hz and at 1 Hz."""
    table = clean_run(120.0).table.gather_every(every).with_columns(t_s=factor * pl.col("t_s"))
    assert f"is the time in {unit}? Write seconds" in unit_fault(Run(table))


def test_latitude_and_longitude_in_place_of_metres_are_asked_for():
    run = clean_run()
    degrees = {"north_m": pl.col("north_m") / 111_195 + 63.4, "east_m": pl.col("east_m") / 50_000 + 10.4}
    there = Run(run.table.with_columns(**degrees))
    said = unit_fault(there)
    assert said.startswith("north_m, east_m: all within 0.") and "latitude and longitude" in said
    exchanged = {"north_m": pl.col("east_m") / 50_000 + 100.4, "east_m": pl.col("north_m") / 111_195 - 33.4}
    assert unit_fault(Run(run.table.with_columns(**exchanged))) == said
    assert unit_fault(run) == ""
    rests = dict.fromkeys(("pwm_left", "pwm_right"), pl.lit(1500.0))
    assert unit_fault(Run(there.table.with_columns(**rests))) == ""
    tied = {c: 15.0 + 0.02 * (pl.col(c) - pl.col(c).mean()) for c in PLACE}
    assert unit_fault(Run(run.table.with_columns(**tied))) == ""
