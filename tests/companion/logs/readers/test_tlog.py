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
