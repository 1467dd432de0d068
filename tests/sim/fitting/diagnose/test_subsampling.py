"""What of long logs is fitted: so much and no more, from everywhere, and nothing twice."""

from itertools import pairwise

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.logs.runs.run import Run
from companion.logs.runs.splits import HISTORY_S, part, recording_intervals
from sim.fitting.diagnose.job import diagnose
from sim.fitting.diagnose.posterior.clock import LogClock
from sim.fitting.diagnose.preparation.subsampling import LONGEST_S, PIECE_S, subsample
from sim.fitting.engine.split import PIECE_S as SHORTEST_S
from sim.fitting.engine.split import JobError, LogUse, NamedLog, Split, split
from sim.fitting.engine.windows import cut_windows
from tests.companion.logs.readers.run_logs import clean_run
from tests.support.vessel_fixtures import boat


def found(*lengths_s: float) -> Split:
    """Logs of which all is fitted."""
    logs = [NamedLog(f"log {i}", clean_run(seconds, i)) for i, seconds in enumerate(lengths_s)]
    used = tuple(LogUse(log, ((0.0, seconds),), ()) for log, seconds in zip(logs, lengths_s, strict=True))
    return Split(tuple(log.run for log in logs), (), used, "all")


def lasting(some: Split) -> float:
    return sum(high - low for used in some.used for low, high in used.fitted_s)


def test_what_is_short_is_fitted_whole():
    short = found(400.0, 500.0)
    assert subsample(short) is short


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(60, 1800), min_size=1, max_size=3).filter(lambda some: sum(some) > LONGEST_S))
def test_of_long_logs_so_much_is_fitted_and_from_everywhere(lengths_s):
    """Seconds of the pieces; none overlap; no two neighbours that are left out lie further apart than the share."""
    some = subsample(found(*map(float, lengths_s)))
    assert lasting(some) == pytest.approx(LONGEST_S, abs=1.5 * PIECE_S)
    assert len(some.fitted) == sum(len(used.fitted_s) for used in some.used)
    gap_s = PIECE_S * (sum(lengths_s) / LONGEST_S + 2)
    for used in some.used:
        edges = [edge for interval in used.fitted_s for edge in interval]
        assert (np.diff(edges) > 0).all()
        assert all(after[0] - before[1] <= gap_s for before, after in pairwise(used.fitted_s))
    if len(lengths_s) == 1:
        assert {LogClock.of(some.fitted).ahead_s(piece) for piece in some.fitted} == {0.0}, (
            "pieces of one log keep its clock"
        )


def test_the_rule_says_what_was_left_out():
    assert "of 40 minutes to fit, pieces of 50 s" in subsample(found(2400.0)).rule


VESSEL = boat("aritra")
SPACED = ("psi_rad", "r_rad_s", "ax_m_s2", "ay_m_s2", "north_m", "east_m")


def thin(seconds: float, source: str = "thin") -> Run:
    """A log of the example boat with rows at 2 Hz, positions at 1 Hz; commands change every ten seconds.

    Logs of other names are in other places.
    """
    t = np.arange(round(2 * seconds)) / 2
    second = np.where(np.arange(len(t)) % 2 == 0, float(len(source)), np.nan)
    pulses = {f"pwm_{thruster.name}": 1500 + 10.0 * (t // 10 % 20) for thruster in VESSEL.thrusters}
    values = (np.sin(0.05 * t), 0.05 * np.cos(0.05 * t), 0.01 * np.cos(t), 0.01 * np.sin(t), second + t / 50, second)
    columns = {"t_s": t, **pulses, "battery_v": np.full(len(t), 15.5), **dict(zip(SPACED, values, strict=True))}
    table = pl.DataFrame(columns).fill_nan(None)
    return Run(table, replace(clean_run(1.0).meta, source=source))


def with_gaps(run: Run, *gaps: tuple[float, float]) -> Run:
    """Nothing recorded in between."""
    silent = pl.any_horizontal([pl.col("t_s").is_between(a, b, closed="none") for a, b in gaps])
    return Run(run.table.filter(~silent), run.meta)


def blank(run: Run, begin_s: float, end_s: float, *columns: str) -> Run:
    """`columns` silent for a time, all else goes on."""
    there = pl.col("t_s").is_between(begin_s, end_s)
    return Run(run.table.with_columns(pl.when(~there).then(pl.col(c)).alias(c) for c in columns), run.meta)


def whole(run: Run, block_s: float | None = None, held_out: Run | None = None) -> Split:
    """As `diagnose` divides logs."""
    others = [NamedLog("other", held_out)] if held_out is not None else []
    return subsample(split([NamedLog("log", run)], others, VESSEL, block_s))


def unbroken(runs) -> bool:
    """Whether what is measured in any run lies within a second of the next, and the fit takes them all."""
    cut_windows(list(runs), VESSEL, 1.0)
    return all(np.diff(run.measured_s()).max() <= 1.0 for run in runs)


def notes(some: Split) -> list[str]:
    return [note.text for used in some.used for note in used.log.run.meta.notes]


@pytest.mark.long
@settings(max_examples=8, deadline=None)
@given(every=st.integers(40, 400), length=st.floats(5.0, 45.0), begin=st.integers(1, 300))
def test_an_hour_with_pauses_goes_through(every, length, begin):
    """Pauses of about half a minute, anywhere: as much is fitted as of a log without, none of it across a pause."""
    gaps = [(float(t), t + length) for t in range(begin, 3400, every + 50)]
    found = whole(with_gaps(thin(3600.0), *gaps))
    assert unbroken(found.fitted) and unbroken(part(out.run, *i) for out in found.held_out for i in out.inside or ())
    assert 0.8 * LONGEST_S < lasting(found) < 1.2 * LONGEST_S
    assert len(found.fitted) == len(found.used[0].fitted_s)


def test_minutes_without_any_record_are_no_piece():
    found = whole(with_gaps(thin(3600.0), (1000.0, 1300.0)), held_out=thin(60.0, "other"))
    assert unbroken(found.fitted)
    assert not any(low < 1300.0 and high > 1000.5 for low, high in found.used[0].fitted_s)


@pytest.mark.parametrize("silent", [("north_m", "east_m"), ("psi_rad",), SPACED])
def test_minutes_without_positions_or_heading_are_left_out(silent):
    run = blank(thin(3600.0), 1000.0, 1300.0, *silent)
    found = whole(run, held_out=thin(60.0, "other"))
    assert unbroken(found.fitted)
    blocks = whole(blank(thin(600.0), 100.0, 290.0, *silent), block_s=60.0)
    assert unbroken(blocks.fitted)
    assert "are not used" in notes(blocks)[0]


@pytest.mark.parametrize("known_s", [120.0, 300.0, 1800.0])
def test_of_a_long_log_in_which_little_can_be_used_all_of_that_is_fitted(known_s):
    run = blank(thin(3600.0), known_s, 3600.0, "north_m", "east_m")
    found = whole(run, held_out=thin(60.0, "other"))
    assert lasting(found) == pytest.approx(min(known_s, LONGEST_S), abs=1.5 * PIECE_S)
    assert f"over the {known_s / 60:.0f} that can be used" in found.rule


@settings(max_examples=8, deadline=None)
@given(begin=st.floats(20.0, 200.0), length=st.floats(3.0, 100.0))
def test_blocks_are_laid_between_pauses(begin, length):
    found = whole(with_gaps(thin(330.0), (begin, begin + length)), block_s=25.0)
    used = found.used[0]
    spans = recording_intervals(used.log.run)
    for low, high in (*used.fitted_s, *used.held_out_s):
        assert any(a <= low and high <= b for a, b in spans) and high - low >= SHORTEST_S
    assert unbroken(found.fitted)
    (out,) = found.held_out
    assert out.inside == used.held_out_s


def test_what_was_commanded_before_a_pause_is_not_taken_to_last():
    found = whole(with_gaps(thin(300.0), (99.0, 131.0)), held_out=thin(60.0, "other"))
    first, second = found.fitted
    assert first.table["t_s"][-1] == 99.0 and second.table["t_s"][0] == 131.0
    later = whole(thin(300.0), block_s=25.0).fitted[1]
    assert 50.0 - HISTORY_S - 0.5 <= later.table["t_s"][0] < 50.0


def test_what_is_too_short_between_pauses_is_said():
    found = whole(with_gaps(thin(300.0), (60.0, 80.0), (87.0, 110.0)), held_out=thin(60.0, "other"))
    (note,) = notes(found)
    assert note.startswith("7 s in pieces that are too short") and "8 positions" in note


def test_a_log_without_pauses_stays_as_it_is():
    run, plain = thin(300.0), whole(thin(300.0))
    middle = run.duration_s * 0.75
    assert plain.used[0].held_out_s == ((middle, run.duration_s),)
    (fitted,) = plain.fitted
    assert fitted.table.equals(run.table.select(fitted.table.columns).filter(pl.col("t_s") < middle))


def test_nothing_left_between_pauses_is_refused_by_name():
    pauses = [(t, t + 6.0) for t in np.arange(0.0, 300.0, 15.0)]
    with pytest.raises(JobError, match=r"log: 20 pauses and resets, the first at 0 s; nothing of it can be fitted"):
        whole(with_gaps(thin(300.0), *pauses), held_out=thin(60.0, "other"))
    with pytest.raises(JobError, match="log: nothing of it can be fitted: a piece needs 10 s with heading"):
        whole(blank(blank(thin(240.0), 0.0, 60.0, "psi_rad"), 120.0, 180.0, "psi_rad"), block_s=60.0)


def test_a_reference_that_is_a_part_of_what_is_diagnosed_is_refused_by_name():
    """It would show the fault itself as the boat's everyday noise."""
    log = thin(300.0, "log")
    cut = Run(log.table.filter(pl.col("t_s") > 100.0), replace(log.meta, source="calm"))
    with pytest.raises(JobError, match="calm: holds positions of log"):
        diagnose([log], VESSEL, reference=cut)
    with pytest.raises(JobError, match="calm: holds the same data as log"):
        diagnose([log], VESSEL, reference=Run(log.table, cut.meta))
