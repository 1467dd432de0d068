"""Telemetry logs as runs: a real one against pymavlink, made-up ones for clocks, damage and a UWB log beside."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.core.constants import GRAVITY_M_S2
from companion.logs.readers.read_run import ReadOptions, read_run
from companion.logs.runs.problems import grouped, problems
from companion.logs.runs.run import RunError
from tests.companion.logs.readers.run_logs import tlog

UNIX_US = 1_700_000_000_000_000
BOOT_US = 4_000_000_000  # the autopilot has run for over an hour: servo stamps wrap during the log (2^32 us)


@pytest.fixture
def real(shared_data: Path, tmp_path: Path) -> Path:
    path = tmp_path / "small.tlog"
    path.write_bytes(gzip.decompress((shared_data / "ardusub" / "small.tlog.gz").read_bytes()))
    return path


def test_a_real_log_is_what_pymavlink_reads(real: Path):
    fields: dict[str, list] = {"ATTITUDE": [], "RAW_IMU": [], "SERVO_OUTPUT_RAW": [], "GPS_RAW_INT": []}
    log = mavutil.mavlink_connection(str(real))
    while (m := log.recv_match(type=list(fields))) is not None:
        fields[m.get_type()].append(m)
    log.close()
    run = read_run(real)
    unix = run.meta.zero_ns / 1e9

    def device(m) -> float:
        return m.time_boot_ms / 1e3 if hasattr(m, "time_boot_ms") else m.time_usec / 1e6

    for name, column, value in (
        ("RAW_IMU", "r_rad_s", lambda m: (m.zgyro + 0.5 * np.sign(m.zgyro)) / 1000),  # cut towards zero
        ("RAW_IMU", "ax_m_s2", lambda m: (m.xacc + 0.5 * np.sign(m.xacc)) / 1000 * GRAVITY_M_S2),
        ("ATTITUDE", "phi_rad", lambda m: m.roll),
    ):
        once = {device(m): m for m in reversed(fields[name])}  # repeated stamps: the first counts
        t_s, values = run.samples(column)
        assert len(values) == len(once), column
        expected = [once[k] for k in sorted(once)]
        np.testing.assert_allclose(values, [value(m) for m in expected], rtol=1e-12)
        spread = t_s + unix - [device(m) for m in expected]
        assert np.ptp(spread) < 0.05  # one clock, with a slow drift at most
        late = np.array([m._timestamp for m in expected]) - unix - t_s
        assert late.min() > -0.002  # nothing is later than its arrival (ATTITUDE in the row of the IMU: 1 ms)
    assert run.samples("north_m")[1][0] == 0.0
    found = grouped(problems(run))
    assert "every 0.50 s only" in found["coarse commands"][0].text


class Autopilot:
    """Frames of a boat with its own clock: `drift` fast against the host's, on a link with jitter."""

    def __init__(self, seconds: float, drift: float = 0.0, jitter_s: float = 0.0, seed: int = 1):
        self.records: list[tuple[int, bytes]] = []
        self.mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self.alien = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
        rng = np.random.default_rng(seed)
        for k in range(round(seconds * 20)):
            true_us = k * 50_000
            self.own_us = BOOT_US + round(true_us * (1 + drift))
            self.rx_us = UNIX_US + true_us + 20_000 + round(1e6 * jitter_s * rng.exponential())
            self.put(self.mav.attitude_encode(self.own_us // 1000, 0.01, -0.02, 0.5 + 0.001 * k, 0, 0, 0.02))
            self.put(self.mav.raw_imu_encode(self.own_us, 10, -20, -1001, 1, -2, k % 300, 0, 0, 0))
            self.put(self.mav.servo_output_raw_encode(self.own_us % 2**32, 0, *([1500 + k % 100] * 4), 0, 0, 0, 0))
            if k % 20 == 0:
                self.put(self.mav.heartbeat_encode(11, 3, 193, 0, 4))
                self.put(self.alien.heartbeat_encode(6, 8, 0, 0, 4), self.alien)
                self.put(self.alien.attitude_encode(1, 9.0, 9.0, 9.0, 0, 0, 0), self.alien)
                self.put(self.mav.sys_status_encode(0, 0, 0, 0, 15500, -1, -1, 0, 0, 0, 0, 0, 0))
                lat = round((48.0 + k / 20 / 111_200) * 1e7)
                self.put(self.mav.gps_raw_int_encode(0, 3, lat, 80_000_000, 0, 0, 0, 0, 0, 9))

    def put(self, message, mav=None) -> None:
        self.records.append((self.rx_us, bytes(message.pack(mav or self.mav))))

    def write(self, path: Path) -> Path:
        path.write_bytes(tlog(self.records))
        return path


def test_stamps_lose_the_links_jitter_and_keep_up_with_the_drift(tmp_path):
    """100 ppm over 200 s are 20 ms; the jitter's mean is 80 ms; servo stamps wrap on the way."""
    path = Autopilot(400.0, drift=1e-4, jitter_s=0.08).write(tmp_path / "a.tlog")
    run = read_run(path)
    for column in ("psi_rad", "r_rad_s"):
        t_s, _ = run.samples(column)
        true = np.arange(len(t_s)) * 0.05
        wrong = t_s + (run.meta.zero_ns / 1e9 - UNIX_US / 1e6) - true - 0.02
        assert np.abs(wrong).max() < 0.005
    when, pwm = run.commands()
    np.testing.assert_allclose(np.diff(when), 0.05, atol=2e-3)
    assert pwm[:5, 0].tolist() == [1500.0, 1501.0, 1502.0, 1503.0, 1504.0]
    assert run.samples("battery_v")[1].max() == 15.5
    assert "clock jump" not in grouped(problems(run))


def stamp_errors(path: Path, start_us: int = UNIX_US, column: str = "psi_rad") -> np.ndarray:
    """Stamps of a column that is sampled 20 times (positions: once) a second, less what they should be [s]."""
    run = read_run(path)
    t_s, values = run.samples(column)
    north = column == "north_m"  # at 1 m/s
    true = np.rint(values - values[0]) if north else np.rint((np.unwrap(values) - 0.5) / 0.001) * 0.05
    return t_s + run.meta.zero_ns / 1e9 - start_us / 1e6 - true - 0.02


@pytest.mark.parametrize("silent_s", [0.0, pytest.param(30.0, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    "steps",
    [
        *(pytest.param(((100, s),), marks=pytest.mark.long) for s in (2.0, -0.8)),
        ((120, -0.8), (160, 3.0)),
        ((40, 3600.0),),
    ],
)
def test_a_ground_stations_clock_that_is_set_does_not_stretch_time(tmp_path, steps, silent_s):
    """After so many seconds by so much: attitudes and fixes by arrival go on evenly, by the clock as it mostly was."""
    boat = Autopilot(200.0, drift=1e-4, jitter_s=0.02)
    path, begin_us = tmp_path / "a.tlog", boat.records[0][0]
    moved_us = [sum(round(by_s * 1e6) for at_s, by_s in steps if t - begin_us >= at_s * 1e6) for t, _ in boat.records]
    moved = zip(boat.records, moved_us, strict=True)
    away_s = steps[0][0] - silent_s
    boat.records = [(t + us, frame) for (t, frame), us in moved if us or t - begin_us < away_s * 1e6]
    boat.write(path)
    for column, most_s in (("psi_rad", 0.01), ("north_m", 0.15)):
        assert np.ptp(stamp_errors(path, column=column)) < most_s
    (note,) = (note for note in read_run(path).meta.notes if note.kind == "clock jump")
    assert f"was set {len(steps)} times" in note.text
    assert float(note.text.partition("(")[2].partition(" s after")[0]) == pytest.approx(steps[0][1], abs=0.02)


@pytest.mark.parametrize("at_s", [3.0, 197.0])
def test_a_clock_that_is_set_from_1970_to_now_costs_nothing(tmp_path, at_s):
    """A computer without a clock of its own finds the time soon after its start, or at the end of a dive."""
    boat = Autopilot(200.0, jitter_s=0.02)
    boat.records = [(t - UNIX_US * (t - UNIX_US < at_s * 1e6), frame) for t, frame in boat.records]
    path = boat.write(tmp_path / "a.tlog")
    run = read_run(path)
    assert len(run.samples("psi_rad")[0]) == 4000 and len(run.samples("north_m")[0]) == 200
    assert run.duration_s == pytest.approx(199.95, abs=0.1)
    (note,) = run.meta.notes
    assert note.kind == "clock jump" and "was set 1 times" in note.text


@pytest.mark.parametrize("bit", [46, 55, 63])
@pytest.mark.parametrize("at", [0, 500, -1])
def test_a_damaged_stamp_costs_its_record(tmp_path, bit, at):
    boat = Autopilot(20.0)
    t_us, frame = boat.records[at]
    boat.records[at] = (t_us ^ 1 << bit, frame)
    run = read_run(boat.write(tmp_path / "a.tlog"))
    assert run.duration_s == pytest.approx(19.95, abs=0.06) and len(run.samples("psi_rad")[0]) >= 399
    (note,) = run.meta.notes
    assert note.text == f"a.tlog: {len(frame) + 8} bytes passed over"


def test_of_two_links_to_one_autopilot_the_quicker_is_read(tmp_path):
    """A radio 1.5 s slower than the cable beside it: no second boot, and nothing of the quicker one is lost."""
    boat = Autopilot(60.0)
    boat.records = sorted(boat.records + [(t + 1_500_000, f) for t, f in boat.records], key=lambda record: record[0])
    path = boat.write(tmp_path / "a.tlog")
    run = read_run(path)
    assert len(run.samples("psi_rad")[0]) == 1200 and np.abs(stamp_errors(path)).max() < 0.01
    assert "clock jump" not in grouped(run.meta.notes)
    assert "as by a second link: left out" in grouped(run.meta.notes)["out of order"][0].text


def test_of_two_boats_in_one_log_the_one_that_is_left_out_is_named(tmp_path):
    boat, other = Autopilot(20.0), dialect.MAVLink(None, srcSystem=7, srcComponent=1)
    boat.put(other.heartbeat_encode(11, 3, 193, 0, 4), other)
    boat.put(other.attitude_encode(1, 9.0, 9.0, 9.0, 0, 0, 0), other)
    run = read_run(boat.write(tmp_path / "a.tlog"))
    (note,) = grouped(run.meta.notes)["another boat"]
    assert "the first is read, system 1 component 1; left out: system 7 component 1" in note.text
    assert run.samples("phi_rad")[1].max() < 0.02


def without_heartbeats(boat: Autopilot) -> Autopilot:
    boat.records = [r for r in boat.records if r[1][5 if r[1][0] == 0xFE else 7] != dialect.MAVLINK_MSG_ID_HEARTBEAT]
    return boat


def test_without_a_heartbeat_the_one_system_with_servo_outputs_is_read(tmp_path):
    whole = read_run(Autopilot(20.0).write(tmp_path / "a.tlog"))
    run = read_run(without_heartbeats(Autopilot(20.0)).write(tmp_path / "b.tlog"))
    assert run.table.equals(whole.table)
    assert "no heartbeat of an autopilot: system 1 component 1 is read" in run.meta.notes[0].text


def test_without_a_heartbeat_several_systems_with_servo_outputs_are_refused(tmp_path):
    boat, other = without_heartbeats(Autopilot(20.0)), dialect.MAVLink(None, srcSystem=7, srcComponent=1)
    boat.put(other.servo_output_raw_encode(1, 0, *([1500] * 8)), other)
    with pytest.raises(
        RunError, match=r"a.tlog: no heartbeat .* of several, system 1 component 1, system 7 component 1"
    ):
        read_run(boat.write(tmp_path / "a.tlog"))


def test_a_link_that_is_slow_for_a_while_is_no_clock_that_was_set(tmp_path):
    boat = Autopilot(200.0, jitter_s=0.02)
    slow = [60e6 < t - UNIX_US < 140e6 for t, _ in boat.records]
    boat.records = [(t + 1_000_000 * late, f) for (t, f), late in zip(boat.records, slow, strict=True)]
    path = boat.write(tmp_path / "a.tlog")
    assert np.abs(stamp_errors(path)).max() < 0.01
    assert "clock jump" not in grouped(read_run(path).meta.notes)


def test_half_a_log_that_came_late_makes_no_drift(tmp_path):
    """A crystal does not drift by a thousandth."""
    boat = Autopilot(200.0)
    boat.records = [(t + 200_000 * (t - UNIX_US > 100_000_000), f) for t, f in boat.records]
    assert np.ptp(stamp_errors(boat.write(tmp_path / "a.tlog"))) < 0.01


@pytest.mark.long
@pytest.mark.parametrize(("first_s", "second_s"), [(80.0, 300.0), (300.0, 80.0)])
def test_of_an_autopilot_that_is_started_anew_the_longer_boot_is_kept(tmp_path, first_s, second_s):
    path, pause_us = tmp_path / "a.tlog", round((first_s + 20.0) * 1e6)
    first, second = (Autopilot(seconds, jitter_s=0.02).records for seconds in (first_s, second_s))
    path.write_bytes(tlog([*first, *((t_us + pause_us, frame) for t_us, frame in second)]))
    run = read_run(path)
    assert len(run.samples("psi_rad")[0]) == 6000 and len(run.samples("north_m")[0]) == 300
    assert np.abs(stamp_errors(path, UNIX_US + (pause_us if second_s > first_s else 0))).max() < 0.01
    (note,) = (note for note in run.meta.notes if note.kind == "clock jump")
    assert "started anew 1 times; " in note.text and "records of its other boots are left out" in note.text


def test_the_first_fix_after_a_boot_is_not_of_the_boot_before(tmp_path):
    """It comes before anything that the autopilot has stamped, as does the voltage."""
    first, second = Autopilot(60.0), Autopilot(20.0)
    begin = len(second.records)
    second.put(second.mav.gps_raw_int_encode(0, 3, 481_000_000, 80_000_000, 0, 0, 0, 0, 0, 9))
    second.put(second.mav.sys_status_encode(0, 0, 0, 0, 9000, -1, -1, 0, 0, 0, 0, 0, 0))
    unstamped = [(UNIX_US + 63_000_000, frame) for _, frame in second.records[begin:]]
    anew = [(t_us + 63_100_000, frame) for t_us, frame in second.records[:begin]]
    path = tmp_path / "a.tlog"
    path.write_bytes(tlog([*first.records, *unstamped, *anew]))
    run = read_run(path)
    assert run.duration_s == pytest.approx(59.95, abs=0.01)
    assert run.samples("north_m")[1].max() < 60.0 and run.samples("battery_v")[1].min() == 15.5


def test_values_are_si_and_of_the_autopilot_alone(tmp_path):
    run = read_run(Autopilot(20.0).write(tmp_path / "a.tlog"))
    assert run.samples("r_rad_s")[1][7] == 0.0075  # 7 mrad/s are what was cut to 7
    assert run.samples("ax_m_s2")[1][0] == pytest.approx(0.0105 * GRAVITY_M_S2)
    assert run.samples("phi_rad")[1].max() < 0.02
    assert run.thrusters == ("out1", "out2", "out3", "out4")
    north = run.samples("north_m")[1]
    np.testing.assert_allclose(north, np.arange(20), rtol=2e-3, atol=0.01)
    assert "GPS antenna at the arrival" in run.meta.columns["north_m"]


def test_damage_costs_what_it_hits_and_is_told(tmp_path):
    boat = Autopilot(20.0)
    whole = read_run(boat.write(tmp_path / "a.tlog"))
    data = bytearray(tlog(boat.records))
    cut = data[:5000] + b"\x00" * 100 + data[5040:]
    cut[9000] ^= 0xFF
    path = tmp_path / "b.tlog"
    path.write_bytes(cut[:-13])
    run = read_run(path)
    lost = {c: len(whole.samples(c)[0]) - len(run.samples(c)[0]) for c in ("psi_rad", "r_rad_s")}
    assert 1 <= sum(lost.values()) <= 9
    assert grouped(run.meta.notes)["damaged"]


def test_a_uwb_log_beside_is_on_the_same_clock(tmp_path):
    uwb = tmp_path / "uwb.txt"
    uwb.write_text("".join(f"{UNIX_US / 1e6 + k:.3f} POS,1.00,{k}.00,0.10,90\n" for k in range(5)))
    path = Autopilot(20.0).write(tmp_path / "a.tlog")
    run = read_run(path, ReadOptions(uwb=uwb, uwb_format="dwm1001-lep"))
    t_s, places = run.samples("north_m", "east_m")
    zero_s = run.meta.zero_ns / 1e9 - UNIX_US / 1e6
    np.testing.assert_allclose(t_s + zero_s, np.arange(1, 5), atol=1e-6)  # the first lies before the log
    assert places.tolist() == [[float(k), 1.0] for k in range(1, 5)]
    moved = read_run(path, ReadOptions(uwb=uwb, uwb_format="dwm1001-lep", uwb_offset_s=0.5))
    np.testing.assert_allclose(moved.samples("north_m")[0] + zero_s, np.arange(5) + 0.5, atol=1e-6)


def test_what_is_no_telemetry_log_or_has_no_outputs_is_named(tmp_path):
    path = tmp_path / "a.tlog"
    path.write_bytes(b"hello, this is no log")
    with pytest.raises(RunError, match=r"a\.tlog: not a telemetry log"):
        read_run(path)
    boat = Autopilot(2.0)
    boat.records = [
        r for r in boat.records if dialect.MAVLink(None).decode(bytearray(r[1])).get_type() != "SERVO_OUTPUT_RAW"
    ]
    with pytest.raises(RunError, match=r"a\.tlog: no servo outputs"):
        read_run(boat.write(path))
