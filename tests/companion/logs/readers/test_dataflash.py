"""Dataflash logs as runs: a real one against pymavlink, made-up ones for GPS, beacons and a UWB log beside."""

import gzip
from math import degrees, radians
from pathlib import Path

import msgspec
import numpy as np
import pytest
from pymavlink import DFReader

from companion.boat.load_run import EXAMPLES
from companion.core.configuration.site_file import load_site
from companion.logs.readers.read_run import ReadOptions, read_run
from companion.logs.runs.problems import grouped, problems
from companion.logs.runs.run import RunError
from tests.companion.logs.readers.run_logs import dataflash
from tests.support.vessel_fixtures import boat

SITE = load_site((EXAMPLES / "sites" / "basin.toml").read_text(), name="basin.toml")
UNIX_S = 1_700_000_000  # when the made-up log was booted
BOOT_US = 5_000_000


@pytest.fixture
def real(shared_data: Path, tmp_path: Path) -> Path:
    path = tmp_path / "small.BIN"
    path.write_bytes(gzip.decompress((shared_data / "ardusub" / "small.BIN.gz").read_bytes()))
    return path


def test_a_real_log_is_what_pymavlink_reads(real: Path):
    fields: dict[str, list] = {"RCOU": [], "IMU": [], "ATT": [], "BAT": []}
    with DFReader.DFReader_binary(str(real)) as log:
        while (m := log.recv_msg()) is not None:
            if m.get_type() in fields:
                fields[m.get_type()].append(m)
    run = read_run(real)
    zero_us = run.meta.zero_ns / 1000
    t_s, r = run.samples("r_rad_s")
    assert r.tolist() == [f.GyrZ for f in fields["IMU"]]
    np.testing.assert_allclose(t_s, [(f.TimeUS - zero_us) / 1e6 for f in fields["IMU"]], atol=1e-9)
    t_s, psi = run.samples("psi_rad")
    np.testing.assert_allclose(np.degrees(psi) % 360, [f.Yaw for f in fields["ATT"]], atol=1e-9)
    np.testing.assert_allclose(t_s, [(f.TimeUS - zero_us) / 1e6 for f in fields["ATT"]], atol=1e-3)
    assert run.thrusters == ("out1", "out2", "out3", "out4", "out5", "out6", "out13", "out14")
    t_s, pwm = run.samples("pwm_out3")
    at = [f.TimeUS - zero_us for f in fields["RCOU"]]
    held = [fields["RCOU"][i].C3 for i in np.searchsorted(at, np.round(t_s * 1e6), side="right") - 1]
    assert pwm.tolist() == held
    assert run.samples("battery_v")[1][-1] == pytest.approx(fields["BAT"][-1].Volt)
    assert {p.text.split(":")[0] for p in grouped(problems(run))["missing"]} == {"north_m"}
    assert run.duration_s == pytest.approx(23.7, abs=0.1)


def records(*, gps: bool = False, beacon: bool = False, seconds: float = 4.0):
    """A boat that drives due north at 1 m/s, heading 350 deg."""
    for k in range(round(seconds * 50)):
        t_us = BOOT_US + k * 20_000
        yield ("IMU", t_us, 0, 0.1, 0.2, 0.01 * k, 1.0, -2.0, -9.8)
        yield ("IMU", t_us, 1, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0)
        if k % 5 == 0:
            yield ("ATT", t_us + 300, 100, -200, 35000 - 36000)
            yield ("RCOU", t_us + 500, 1600 + k, 1500, 1400, 0, *([0] * 10))
        if k % 25 == 0:
            yield ("BAT", t_us, 0, 15.5)
            yield ("BAT", t_us, 1, 3.3)
        if gps and k % 10 == 0:
            gms = int(((UNIX_S + 18 - 315_964_800) % 604_800) * 1000 + t_us // 1000)
            week = (UNIX_S + 18 - 315_964_800) // 604_800
            north_m = 1e-6 * (t_us - BOOT_US)
            yield (
                "GPS",
                t_us,
                0,
                3,
                gms,
                week,
                round((SITE.lat_deg + north_m / 111_000) * 1e7),
                round(SITE.lon_deg * 1e7),
            )
        if beacon and k % 10 == 0:
            yield ("BCN", t_us, 1, 4, 3.0, 4.0, 5.0, 0.0, k / 50, -1.0, 0.3)


def written(tmp_path: Path, **options) -> Path:
    path = tmp_path / "made.BIN"
    path.write_bytes(dataflash(records(**options)))
    return path


def test_outputs_take_the_vessels_names_and_no_pulse_is_told_as_neutral(tmp_path):
    run = read_run(written(tmp_path), ReadOptions(vessel=boat("aritra")))
    assert run.thrusters == tuple(t.name for t in boat("aritra").thrusters)
    when, pwm = run.commands()
    assert pwm[0].tolist() == [1600.0, 1500.0, 1400.0, 1500.0]
    np.testing.assert_allclose(np.diff(when), 0.1)
    assert [p.text.split(":")[0] for p in run.meta.notes] == ["pwm_rear_starboard"]
    assert run.samples("ax_m_s2")[1].tolist() == [1.0] * 200  # IMU 1 is another sensor
    t_s, psi = run.samples("psi_rad")
    assert degrees(psi[0]) == pytest.approx(-10.0)
    assert t_s[1] == 0.1  # in the row of the IMU sample 0.3 ms before it
    assert run.samples("battery_v")[1][0] == 15.5


@pytest.mark.parametrize("is_logged", [True, False])
def test_outputs_beyond_the_fourteenth_are_read_or_unknown_but_never_neutral(tmp_path, is_logged):
    """ArduPilot logs outputs 15 to 18 in records of their own."""
    log = [("PARM", BOOT_US, f"SERVO{13 + k}_FUNCTION".encode(), 59.0 + k) for k in range(4)]
    for record in records():
        log.append(record)
        if record[0] == "RCOU" and is_logged:
            log.append(("RCO2", record[1] + 40, record[2] + 100, 1300, 0, 0))
    (tmp_path / "made.BIN").write_bytes(dataflash(log))
    run = read_run(tmp_path / "made.BIN", ReadOptions(vessel=boat("aritra")))
    assert "rear_port output 15, rear_starboard output 16 (by SERVOn_FUNCTION)" in run.meta.columns["pwm"]
    if is_logged:
        pwm_us = [r[2] + 100.0 for r in log if r[0] == "RCOU"]
        assert run.commands()[1][:, 2:].tolist() == [[us, 1300.0] for us in pwm_us]
    else:
        assert not run.known("pwm_rear_port") and not run.known("pwm_rear_starboard")
        assert "pwm_rear_port: no commands" in {p.text for p in problems(run)}


def test_of_two_outputs_at_one_instant_the_last_counts(tmp_path):
    log = list(records())
    at = next(k for k, r in enumerate(log) if r[0] == "RCOU")
    log.insert(at, ("RCOU", log[at][1], 1111, 1111, 1111, 1111, *([0] * 10)))
    (tmp_path / "made.BIN").write_bytes(dataflash(log))
    assert read_run(tmp_path / "made.BIN", ReadOptions(vessel=boat("aritra"))).commands()[1][0].tolist() == [
        1600,
        1500,
        1400,
        1500,
    ]


def test_headings_are_in_site_axes_as_positions_are(tmp_path):
    path = written(tmp_path)
    turned = msgspec.structs.replace(SITE, rotation_deg=30.0)
    true, site = (read_run(path, ReadOptions(site=site)).samples("psi_rad")[1] for site in (None, turned))
    assert np.allclose(np.exp(1j * (true - radians(30.0))), np.exp(1j * site))


def test_a_log_says_how_late_its_inertial_samples_are(tmp_path):
    path = tmp_path / "made.BIN"
    told = [("PARM", BOOT_US, b"INS_GYRO_FILTER", 4.0), ("PARM", BOOT_US, b"INS_ACCEL_FILTER", 10.0)]
    path.write_bytes(dataflash([*told, *records()]))
    run = read_run(path)
    assert run.meta.late_s == {column: pytest.approx(late, abs=1e-4) for column, late in
                               (("r_rad_s", 0.0563), ("ax_m_s2", 0.0225), ("ay_m_s2", 0.0225))}  # fmt: skip
    untold = read_run(written(tmp_path))
    assert untold.meta.late_s == {}
    assert untold.table.equals(run.table)  # the table is as logged


def test_gps_in_site_axes_and_without_a_site_from_the_first_fix(tmp_path):
    path = written(tmp_path, gps=True)
    t_s, places = read_run(path, ReadOptions(site=SITE)).samples("north_m", "east_m")
    c, s = np.cos(np.deg2rad(SITE.rotation_deg)), np.sin(np.deg2rad(SITE.rotation_deg))
    np.testing.assert_allclose(places @ [c, -s], t_s, rtol=0.01, atol=0.02)
    np.testing.assert_allclose(places @ [s, c], 0.0, atol=0.02)
    alone = read_run(path)
    assert alone.samples("north_m")[1][0] == 0.0
    assert "origin at the first fix" in alone.meta.columns["north_m"]
    assert alone.meta.latency_s is None


def test_a_beacon_gives_positions_and_ranges(tmp_path):
    run = read_run(written(tmp_path, beacon=True))
    t_s, places = run.samples("north_m", "east_m")
    np.testing.assert_allclose(places, np.column_stack([t_s, -np.ones_like(t_s)]), atol=1e-6)
    assert run.samples("range_1_m")[1].tolist() == [4.0] * len(t_s)
    assert not run.known("range_3_m")


def test_positions_of_a_beacon_are_in_site_axes_as_headings_are(tmp_path):
    """Due north at 1 m/s from 1 m west, by axes turned 30 deg clockwise; ranges do not turn."""
    path = written(tmp_path, beacon=True)
    run = read_run(path, ReadOptions(site=msgspec.structs.replace(SITE, rotation_deg=30.0)))
    t_s, places = run.samples("north_m", "east_m")
    along, across = (np.cos(radians(30.0)), -np.sin(radians(30.0))), (np.sin(radians(30.0)), np.cos(radians(30.0)))
    np.testing.assert_allclose(places, np.outer(t_s, along) - across, atol=1e-6)
    assert run.samples("range_1_m")[1].tolist() == [4.0] * len(t_s)


def uwb_lines(path: Path, offset_s: float = 0.0) -> Path:
    lines = [f"{UNIX_S + 5 + offset_s + k / 10:.3f} POS,{2 + k / 100:.2f},3.00,0.10,90" for k in range(30)]
    lines[4] = lines[4].replace("POS", "PXS")
    path.write_text("\n".join([*lines, "no stamp here"]) + "\n")
    return path


def test_a_uwb_log_is_joined_by_gps_time_or_by_a_stated_offset(tmp_path):
    beside = ReadOptions(
        vessel=boat("aritra"), site=SITE, uwb=uwb_lines(tmp_path / "uwb.txt"), uwb_format="dwm1001-lep"
    )
    run = read_run(written(tmp_path, gps=True), beside)
    t_s, places = run.samples("north_m", "east_m")
    expected = [k for k in range(30) if k != 4]
    np.testing.assert_allclose(t_s, [k / 10 for k in expected], atol=1e-6)
    np.testing.assert_allclose(places, [[3.0, round(2 + k / 100, 2)] for k in expected], atol=1e-9)
    assert {p.kind for p in run.meta.notes} == {"garbage", "no pulse"}
    assert "lines without stamp; line 31" in " ".join(p.text for p in run.meta.notes)
    blind = written(tmp_path)
    with pytest.raises(RunError, match=r"made\.BIN: no GPS time in it: state the offset"):
        read_run(blind, beside)
    stated = ReadOptions(uwb=beside.uwb, uwb_format="dwm1001-lep", uwb_offset_s=float(-UNIX_S))
    assert read_run(blind, stated).samples("north_m")[0] == pytest.approx(t_s, abs=1e-6)
    wrong = read_run(blind, ReadOptions(uwb=beside.uwb, uwb_format="dwm1001-lep", uwb_offset_s=0.0))
    assert "missing" in {p.kind for p in wrong.meta.notes}
    with pytest.raises(RunError, match=r"uwb\.txt: its wire format is not known"):
        read_run(blind, ReadOptions(uwb=beside.uwb, uwb_offset_s=0.0))


def test_neither_a_late_gps_record_nor_one_without_a_fix_moves_the_uwb_log(tmp_path):
    """The first one 0.9 s late, as after a busy start; another before it without a fix, which may have any week."""
    log = list(records(gps=True))
    at = next(k for k, r in enumerate(log) if r[0] == "GPS")
    name, t_us, receiver, _, gms, week, *place = log[at]
    log[at : at + 1] = [
        (name, t_us, receiver, 1, gms, 1000, 0, 0),
        (name, t_us + 900_000, receiver, 3, gms, week, *place),
    ]
    (tmp_path / "made.BIN").write_bytes(dataflash(log))
    run = read_run(tmp_path / "made.BIN", ReadOptions(uwb=uwb_lines(tmp_path / "uwb.txt"), uwb_format="dwm1001-lep"))
    assert run.samples("north_m")[0] == pytest.approx([k / 10 for k in range(30) if k != 4], abs=1e-6)


def test_text_stamps_may_be_iso_and_a_log_without_stamps_is_refused(tmp_path):
    iso = tmp_path / "iso.txt"
    iso.write_text("2023-11-14T22:13:25.250+00:00, POS,2.00,3.00,0.10,90\n")
    beside = ReadOptions(uwb=iso, uwb_format="dwm1001-lep", uwb_offset_s=float(-UNIX_S))
    assert read_run(written(tmp_path), beside).samples("east_m")[0].tolist() == [0.25]
    iso.write_text("POS,2.00,3.00,0.10,90\n")
    with pytest.raises(RunError, match=r"iso\.txt: line 1: expected a stamp"):
        read_run(written(tmp_path), beside)


def test_text_stamps_that_are_no_seconds_are_told(tmp_path):
    """Of milliseconds in int64 nanoseconds came an OverflowError, of one damaged stamp as well."""
    path = tmp_path / "uwb.txt"
    beside = ReadOptions(uwb=path, uwb_format="dwm1001-lep", uwb_offset_s=float(-UNIX_S))
    for zeros in ("000", "000000"):
        path.write_text("# my tag\n" + "".join(f"{UNIX_S + k}{zeros} POS,2.00,3.00,0.10,90\n" for k in range(3)))
        with pytest.raises(
            RunError, match=r"uwb\.txt: line 2: expected a stamp .*, found what looks like milliseconds"
        ):
            read_run(written(tmp_path), beside)
    for damaged in ("9999-01-01T00:00:00+00:00", "0001-01-01T00:00:00+00:00", "9800000000.5", f"{UNIX_S}1"):
        path.write_text(f"{UNIX_S + 5} POS,2.00,3.00,0.10,90\n{damaged} POS,2.00,3.00,0.10,90\n")
        run = read_run(written(tmp_path), beside)
        assert run.samples("east_m")[1].tolist() == [2.0]
        assert "1 lines without stamp; line 2" in " ".join(p.text for p in run.meta.notes)


def test_what_is_no_dataflash_log_or_has_no_outputs_is_named(tmp_path):
    path = tmp_path / "wrong.bin"
    path.write_bytes(b"hello")
    with pytest.raises(RunError, match=r"wrong\.bin: not a dataflash log"):
        read_run(path)
    path.write_bytes(dataflash([r for r in records() if r[0] != "RCOU"]))
    with pytest.raises(RunError, match=r"wrong\.bin: no servo outputs"):
        read_run(path)
