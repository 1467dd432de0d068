"""Streams joined into one table: no sample is moved, and every sample left out is noted."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.logs.readers.join import Stream, join
from companion.logs.runs.run import RunError, RunMeta

MS = 1_000_000


def stream(name, t_ms, columns, **options) -> Stream:
    t_ns = np.array(t_ms, dtype=np.int64) * MS
    return Stream(name, t_ns, {k: np.array(v, dtype=float) for k, v in columns.items()}, **options)


def commands(t_ms=(0,), pwm=(1500.0,)) -> Stream:
    return stream("commands", t_ms, {"pwm_a": pwm}, held=True)


def imu(t_ms, r=None) -> Stream:
    return stream("IMU", t_ms, {"r_rad_s": r if r is not None else np.arange(len(t_ms)) / 100})


stamps = st.lists(st.integers(0, 3000), min_size=1, max_size=60, unique=True).map(sorted)


@given(stamps, stamps, stamps)
def test_every_sample_stands_in_the_row_of_its_stamp(t_imu, t_uwb, t_pwm):
    """Oracle: plain Python dictionaries."""
    uwb = stream("UWB", t_uwb, {"north_m": np.arange(len(t_uwb)), "east_m": -np.arange(len(t_uwb))})
    pwm = 1500.0 + np.arange(len(t_pwm))
    run = join([imu(t_imu), uwb, commands(t_pwm, pwm)], RunMeta())
    zero = min(t_imu[0], t_uwb[0], t_pwm[0])
    rows = sorted({*t_imu, *t_uwb, *t_pwm})
    assert run.meta.zero_ns == zero * MS
    assert run.table["t_s"].to_list() == [(t - zero) * MS / 1e9 for t in rows]
    for t, row in zip(rows, run.table.iter_rows(named=True), strict=True):
        assert row["r_rad_s"] == (t_imu.index(t) / 100 if t in t_imu else None)
        assert row["north_m"] == (t_uwb.index(t) if t in t_uwb else None)
        given_by = [p for when, p in zip(t_pwm, pwm, strict=True) if when <= t]
        assert row["pwm_a"] == (given_by[-1] if given_by else None)
        assert row["battery_v"] is None
    assert run.meta.notes == ()


def test_attitudes_take_the_row_of_an_imu_sample_within_1_ms():
    t_ns = np.array([0, 20, 40, 60]) * MS
    near = Stream("attitude", t_ns + [300_000, -900_000, 1_500_000, 0], {"psi_rad": np.arange(4) / 10}, near="IMU")
    run = join([imu([0, 20, 40, 60]), near, commands()], RunMeta())
    assert run.table["psi_rad"].to_list() == [0.0, 0.1, None, 0.2, 0.3]
    assert run.table["t_s"][3] == 0.0415


def test_two_attitudes_near_one_sample_are_both_kept():
    close = Stream(
        "attitude", np.array([0, 19_600_000, 20_300_000, 40_000_000]), {"psi_rad": np.arange(4.0) / 9}, near="IMU"
    )
    run = join([imu([0, 20, 40]), close, commands()], RunMeta())
    assert sorted(run.samples("psi_rad")[1]) == pytest.approx(np.arange(4.0) / 9)
    one = join([imu([20]), close, commands()], RunMeta())
    assert len(one.samples("psi_rad")[1]) == 4


@given(st.lists(st.integers(0, 12), min_size=2, max_size=12, unique=True))
def test_attitudes_in_a_burst_keep_a_row_of_their_own(quarters):
    """Stamps a quarter of a millisecond apart, as they come after a stall, beside inertial samples 1 ms apart."""
    t_ns = np.sort(np.array(quarters)) * 250_000
    near = Stream("attitude", t_ns, {"psi_rad": np.arange(len(t_ns)) / 20}, near="IMU")
    run = join([imu([0, 1, 2, 3]), near, commands()], RunMeta())
    assert run.table["t_s"].is_unique().all()
    assert run.table["psi_rad"].drop_nulls().len() == len(t_ns)


def notes(run) -> list[tuple[str, float | None]]:
    return [(p.kind, p.t_s) for p in run.meta.notes]


def test_repeated_late_and_infinite_samples_are_told():
    run = join([imu([0, 20, 20, 40, 30, 60], [0.0, 0.1, 9.0, np.inf, 0.3, 0.4]), commands()], RunMeta())
    assert run.table["t_s"].to_list() == [0.0, 0.02, 0.03, 0.04, 0.06]
    assert run.table["r_rad_s"].to_list() == [0.0, 0.1, 0.3, None, 0.4]
    assert notes(run) == [("out of order", 0.03), ("duplicate", 0.02), ("not a number", 0.04)]
    assert "IMU: 1 samples repeat a stamp" in run.meta.notes[1].text


def test_a_clock_that_is_set_back_ends_the_stream_and_is_told():
    run = join([imu([5000, 5020, 5040, 3000, 3020], [0, 1, 2, 3, 4]), commands([5000])], RunMeta())
    assert run.table["r_rad_s"].to_list() == [0.0, 1.0, 2.0]
    assert notes(run) == [("clock jump", 0.04)]
    assert "goes back by 2.040 s; 2 samples after it are left out" in run.meta.notes[0].text


@pytest.mark.parametrize("off_ms", [8_590_000, 33_500, 1_100, -33_500])
def test_one_damaged_stamp_costs_one_sample(off_ms):
    """A flipped bit, of the commands or of a sensor, and another one later: all else stays where it was."""
    t_ms = [20 * k + (off_ms if k in (2, 50) else 0) for k in range(100)]
    left = [k for k in range(100) if k not in (2, 50)]
    run = join([imu(t_ms), commands([0])], RunMeta())
    assert run.samples("r_rad_s")[0] == pytest.approx([0.02 * k for k in left])
    assert run.samples("r_rad_s")[1].tolist() == [k / 100 for k in left]
    assert notes(run) == [("damaged", 0.02)]
    assert "IMU: 2 samples stamped more than 1 s off their neighbours are left out" in run.meta.notes[0].text
    run = join([imu([20 * k for k in range(100)]), commands(t_ms, 1500.0 + np.arange(100))], RunMeta())
    assert run.commands()[1][:, 0].tolist() == [1500 + k for k in left]
    assert run.duration_s == pytest.approx(1.98)


@pytest.mark.parametrize("at", [0, 99])
@pytest.mark.parametrize("which", ["IMU", "commands"])
def test_a_damaged_stamp_at_either_end_costs_one_sample(at, which):
    """So ends a log whose power was cut; it would be months long, or empty but for its first sample."""
    t_ms, damaged_ms = [20 * k for k in range(100)], [20 * k + 17_592_186_044 * (k == at) for k in range(100)]
    streams = {name: damaged_ms if name == which else t_ms for name in ("IMU", "commands")}
    run = join([imu(streams["IMU"]), commands(streams["commands"], 1500.0 + np.arange(100))], RunMeta())
    assert run.duration_s == pytest.approx(1.98)
    (note,) = run.meta.notes
    assert note.kind == "damaged" and f"{which}: " in note.text and "left out" in note.text
    left = [k for k in range(100) if k != at] if which == "IMU" else list(range(100))
    assert run.samples("r_rad_s")[1].tolist() == [k / 100 for k in left]


def test_a_slow_stream_whose_clock_is_set_back_by_less_than_two_samples_ends_there():
    run = join([imu([0, 4000, 8000, 12000, 9500, 13500, 17500]), commands()], RunMeta())
    assert run.samples("r_rad_s")[0].tolist() == [0.0, 4.0, 8.0, 12.0]
    assert notes(run) == [("clock jump", 12.0)]


def test_of_two_commands_at_one_instant_the_last_counts():
    run = join([imu([0, 10, 20]), commands([0, 10, 10], [1500, 1600, 1700])], RunMeta())
    assert run.table["pwm_a"].to_list() == [1500, 1700, 1700]


def test_what_lies_outside_the_log_is_cut_and_said_where_nothing_is_left():
    uwb = stream("UWB", [-50, 10, 90], {"north_m": [1, 2, 3], "east_m": [1, 2, 3]}, outside=True)
    run = join([imu([0, 20]), uwb, commands()], RunMeta())
    assert run.samples("north_m")[1].tolist() == [2.0]
    far = stream("UWB", [9000], {"north_m": [1], "east_m": [1]}, outside=True)
    run = join([imu([0, 20]), far, commands()], RunMeta())
    assert not run.known("north_m")
    assert "none of its 1 samples falls into the log: it begins +9.0 s from its start" in run.meta.notes[0].text


def test_without_commands_there_is_no_run():
    with pytest.raises(RunError, match="no thruster commands"):
        join([imu([0, 20])], RunMeta())


def test_two_streams_of_one_column_are_refused_by_name():
    gnss, uwb = (stream(name, [10], {"north_m": [1.0], "east_m": [2.0]}) for name in ("GNSS", "UWB"))
    with pytest.raises(RunError, match=r"drive\.mcap: north_m: of GNSS and of UWB"):
        join([imu([0, 20]), commands(), gnss, uwb], RunMeta(source="drive.mcap"))
    without = stream("UWB", [], {"north_m": [], "east_m": []})
    assert join([imu([0, 20]), commands(), gnss, without], RunMeta()).samples("north_m")[1].tolist() == [1.0]
