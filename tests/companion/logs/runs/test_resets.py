"""Headings and positions that stay elsewhere after a jump are told and cut; slips that come back are not."""

import numpy as np
import polars as pl
import pytest

from companion.logs.runs.problems import BIASING, problem_sentences, problems
from companion.logs.runs.resets import reset_intervals, resets
from companion.logs.runs.run import Run
from companion.logs.runs.splits import recording_intervals
from tests.companion.logs.readers.run_logs import clean_run

AT_S = 30.0


def later(run: Run, until_s: float = np.inf, **more: float) -> Run:
    """`more` on the columns from `AT_S` on; headings stay wrapped."""
    inside = (pl.col("t_s") >= AT_S) & (pl.col("t_s") < until_s)
    new = {c: pl.when(inside).then(pl.col(c) + add).otherwise(pl.col(c)) for c, add in more.items()}
    if "psi_rad" in new:
        new["psi_rad"] = (new["psi_rad"] + np.pi) % (2 * np.pi) - np.pi
    return Run(run.table.with_columns(**new), run.meta)


@pytest.mark.parametrize("radians", [1.05, -0.4, 3.0])
@pytest.mark.parametrize("seed", [5, 6])
def test_a_heading_that_jumps_though_the_boat_does_not_turn(radians, seed):
    (found,) = resets(later(clean_run(60.0, seed), psi_rad=radians))
    assert found.kind == "heading jump" and found.t_s == pytest.approx(AT_S - 0.02)
    assert f"psi_rad jumps by {np.degrees(radians):.0f} degrees"[:24] in found.text and "at 30.0 s" in found.text


def test_a_position_that_stays_elsewhere():
    (found,) = resets(later(clean_run(), north_m=6.0))
    assert found.kind == "position jump" and "6.0 m at 29.8 s" in found.text
    assert found.t_s == pytest.approx(29.8) and found.length_s == pytest.approx(0.2)


def test_what_comes_back_is_none():
    slip = later(clean_run(), AT_S + 0.5, north_m=6.0)
    assert resets(slip) == [] and [p.kind for p in problems(slip)] == ["jump", "jump"]
    assert resets(later(clean_run(), AT_S + 0.3, psi_rad=1.0)) == []


@pytest.mark.parametrize("factor", [-1.0, 57.29578, -57.29578])
def test_whatever_unit_and_sign_the_yaw_rate_has(factor):
    rate = {"r_rad_s": factor * pl.col("r_rad_s")}
    run = Run(later(clean_run(), psi_rad=1.05).table.with_columns(**rate))
    assert [p.kind for p in resets(run)] == ["heading jump"]
    assert resets(Run(clean_run().table.with_columns(**rate))) == []


def test_headings_that_are_held_or_come_once_a_second_and_a_fast_boat_are_no_reset():
    held = {"psi_rad": pl.col("psi_rad").gather((pl.int_range(pl.len()) // 25) * 25)}
    assert resets(Run(clean_run().table.with_columns(**held))) == []
    slow = {"psi_rad": pl.when(pl.int_range(pl.len()) % 50 == 0).then(pl.col("psi_rad"))}
    assert resets(Run(clean_run().table.with_columns(**slow))) == []
    fast = {"north_m": pl.col("north_m") + 8.0 * pl.col("t_s")}
    run = Run(clean_run().table.with_columns(**fast))
    assert resets(run) == [] and {p.kind for p in problems(run)} == {"jump"}


def test_without_a_yaw_rate_or_positions_nothing_is_said():
    blank = dict.fromkeys(("r_rad_s", "north_m", "east_m"), pl.lit(None, pl.Float64))
    assert resets(Run(later(clean_run(), psi_rad=1.0).table.with_columns(**blank))) == []


def test_both_are_among_what_commands_print():
    said = problem_sentences({"a.csv": problems(later(clean_run(), psi_rad=1.0, north_m=6.0))})
    assert {"heading jump", "position jump"} <= set(BIASING)
    assert [line.split(": ")[1] for line in said] == ["heading jump", "position jump"]


def test_a_log_is_cut_at_a_reset_as_at_a_pause():
    run = later(clean_run(), north_m=6.0)
    assert recording_intervals(run) == [(0.0, pytest.approx(29.8)), (pytest.approx(30.0), pytest.approx(59.98))]
    paused = Run(later(clean_run(), north_m=20.0).table.filter(~pl.col("t_s").is_between(29.85, 33.0)))
    assert len(reset_intervals(paused)) == 1
    assert recording_intervals(paused) == [(0.0, pytest.approx(29.8)), (pytest.approx(33.2), pytest.approx(59.98))]
    assert recording_intervals(clean_run()) == [(0.0, pytest.approx(59.98))]


def test_fixes_once_a_second_of_which_single_ones_are_off_beside_a_boat_that_turns():
    """Against a false reset by every second such log: the boat turns half a circle while five fixes come."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        t_s = np.arange(0.0, 90.0)
        places = 2.0 * np.column_stack([np.cos(0.4 * t_s), np.sin(0.4 * t_s)]) + rng.normal(0.0, 0.05, (90, 2))
        assert len(reset_intervals(fixes(t_s, places + 3.0 * (t_s >= AT_S)[:, None]))) == 1
        places[3 * rng.choice(30, 9, replace=False)] += 2.5
        assert reset_intervals(fixes(t_s, places)) == []


def fixes(t_s: np.ndarray, places: np.ndarray) -> Run:
    run = clean_run(60.0)
    columns = {n: np.interp(t_s, run.table["t_s"], run.table[n].fill_null(0.0)) for n in run.table.columns[1:]}
    return Run(pl.DataFrame({"t_s": t_s, **columns, "north_m": places[:, 0], "east_m": places[:, 1]}), run.meta)


@pytest.mark.parametrize("turning_rad_s", [0.0, 0.2])
def test_a_reset_beside_a_boat_that_goes_a_metre_and_a_half_between_two_fixes(turning_rad_s):
    rng, found = np.random.default_rng(5), 0
    t_s = np.arange(0.0, 60.0)
    psi = 0.3 + turning_rad_s * t_s
    for _ in range(20):
        way = np.cumsum(1.5 * np.column_stack([np.cos(psi), np.sin(psi)]), axis=0) + rng.normal(0.0, 0.05, (60, 2))
        by = 5.0 * np.array([np.cos(angle := rng.uniform(0, 2 * np.pi)), np.sin(angle)])
        found += len(reset_intervals(fixes(t_s, way + by * (t_s >= AT_S)[:, None]))) == 1
    assert found >= 19
