"""An ArduPilot user's own log as the whole input: a simulated drive as dataflash bytes, read and identified. Seed 3."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from companion.__main__ import main
from companion.core.model.load_vessel import load_vessel
from companion.core.model.vessel_text import vessel_toml
from companion.logs.readers.read_run import ReadOptions, read_run
from companion.logs.runs.run import Run
from sim.fitting.validate import study
from tests.companion.logs.readers.run_logs import dataflash
from tests.sim.fitting.test_gnss_boat import BOAT, GNSS, UWB, drive

LATITUDE, LONGITUDE = 63.4, 10.4
M_PER_DEG = 111_475.0  # along a meridian at 63.4 degrees north, WGS84
BOOT_US = 5_000_000
OUTPUTS = {"front_port": 7, "front_starboard": 5, "rear_port": 8, "rear_starboard": 6}
"""Not the order of the vessel file: SERVOn_FUNCTION says so."""


def records(run: Run):
    """The run as the records of a dataflash log, in their integers."""
    for thruster in UWB.thrusters:
        name = f"SERVO{OUTPUTS[thruster.name]}_FUNCTION".encode()
        yield ("PARM", BOOT_US, name, 50.0 + thruster.channel)
    east_m_per_deg = (
        6_378_137.0
        * np.pi
        / 180
        * np.cos(np.radians(LATITUDE))
        / np.sqrt(1 - 0.00669437999 * np.sin(np.radians(LATITUDE)) ** 2)
    )
    for row in run.table.iter_rows(named=True):
        t_us = BOOT_US + round(row["t_s"] * 1e6)
        pulses = [0] * 14
        for name, n in OUTPUTS.items():
            pulses[n - 1] = round(row[f"pwm_{name}"])
        yield ("RCOU", t_us, *pulses)
        yield ("BAT", t_us, 0, row["battery_v"])
        if row["r_rad_s"] is not None:
            yield ("IMU", t_us, 0, 0.0, 0.0, row["r_rad_s"], row["ax_m_s2"], row["ay_m_s2"], -9.8)
        if row["psi_rad"] is not None:
            yield ("ATT", t_us, 0, 0, round(np.degrees(row["psi_rad"]) * 100))
        if row["north_m"] is not None:
            at = (LATITUDE + row["north_m"] / M_PER_DEG, LONGITUDE + row["east_m"] / east_m_per_deg)
            yield ("GPS", t_us, 0, 3, 1000, 2300, *(round(angle * 1e7) for angle in at))


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> tuple[Path, Run]:
    run = drive(UWB, 3, 120.0)
    path = tmp_path_factory.mktemp("ardupilot") / "00000012.BIN"
    path.write_bytes(dataflash(records(run)))
    return path, run


def test_outputs_are_wired_as_the_autopilots_parameters_say(log):
    path, run = log
    read = read_run(path, ReadOptions(vessel=BOAT))
    for name in run.thrusters:
        assert read.samples(f"pwm_{name}")[1].tolist() == pytest.approx(run.samples(f"pwm_{name}")[1], abs=0.5)
    assert "front_port output 7" in read.meta.columns["pwm"]
    assert not any(p.kind == "no pulse" for p in read.meta.notes)


def test_positions_are_metres_from_the_first_fix_and_the_antennas_place_is_the_files(log):
    path, run = log
    read = read_run(path, ReadOptions(vessel=BOAT))
    expected = run.samples("north_m", "east_m")[1]
    np.testing.assert_allclose(read.samples("north_m", "east_m")[1], expected - expected[0], atol=0.03)
    assert (read.meta.latency_s, read.meta.tag_arm_m) == (GNSS.latency_s, (GNSS.x_m, GNSS.y_m))
    assert read_run(path, ReadOptions(vessel=UWB)).meta.latency_s is None  # its UWB says nothing of GPS


@pytest.mark.long
def test_the_log_alone_is_identified(log, tmp_path, monkeypatch):
    monkeypatch.setattr(study, "stability", partial(study.stability, runs=5))
    (tmp_path / "gnss.toml").write_text(vessel_toml(BOAT))
    words = ["identify", str(log[0]), "--vessel", f"{tmp_path}/gnss.toml", "--out", f"{tmp_path}/out", "--no-taylor"]
    assert main(words) in (0, 1)
    found = load_vessel((tmp_path / "out" / "vessel.toml").read_text(), name="vessel.toml")
    assert found.sensors.gnss is not None
    assert found.sensors.gnss.latency_s == pytest.approx(GNSS.latency_s, abs=0.03)
    for one, true in zip(found.thrusters, UWB.thrusters, strict=True):
        assert one.gain == pytest.approx(true.gain, rel=0.1)
