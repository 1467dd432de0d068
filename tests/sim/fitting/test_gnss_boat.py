"""A boat without UWB: its vessel file, fits and diagnosis of its logs. Seeds 8, 3."""

import shlex

import msgspec
import pytest
from msgspec.structs import replace

from companion.__main__ import main
from companion.boat.load_run import EXAMPLES, setup_of
from companion.core.configuration.sensors import Gnss, Sensors
from companion.core.configuration.tables import ConfigError
from companion.core.model.load_vessel import load_vessel
from companion.core.model.vessel_text import vessel_toml
from companion.logs.readers.table import write_run
from companion.logs.runs.run import Run
from sim.fitting.diagnose.catalogue import catalogue
from sim.fitting.diagnose.report.findings import Findings
from sim.fitting.identify.result import fit_structured
from sim.fitting.identify.vessel_out import identified_vessel
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

UWB = boat("aritra")
TAG = UWB.sensors.tag
GNSS = Gnss(
    x_m=TAG.x_m, y_m=TAG.y_m, z_m=TAG.z_m, rate_Hz=5.0, position_sigma_m=0.07, latency_s=TAG.latency_s, source="test"
)
BOAT = replace(UWB, sensors=Sensors(imu=UWB.sensors.imu, gnss=GNSS))
RANGES_ONLY = {"uwb_latency", "uwb_lever_arm", "uwb_scale", "clock_drift", "nlos"}


def drive(true, seed: int, seconds: float) -> Run:
    run = teleop_run(true, seed, seconds, uwb_hz=5.0, sigma_m=0.07)
    return Run(run.table.select(c for c in run.table.columns if not c.startswith("true_")), run.meta)


def test_the_file_loads_as_written_and_has_one_sensor_of_positions():
    text = vessel_toml(BOAT)
    assert "[sensors.gnss]" in text and "uwb" not in text
    assert load_vessel(text, name="gnss.toml") == BOAT
    both = replace(BOAT, sensors=replace(BOAT.sensors, uwb=TAG))
    neither = replace(BOAT, sensors=Sensors(imu=UWB.sensors.imu))
    for wrong, found in ((both, "both"), (neither, "neither")):
        with pytest.raises(ConfigError, match=f"sensors: expected one of the tables uwb and gnss, found {found}"):
            vessel_toml(wrong)


@pytest.mark.long
def test_a_fit_finds_place_and_delay_of_the_antenna():
    true = replace(UWB, sensors=UWB.sensors.with_position(x_m=TAG.x_m + 0.1, latency_s=TAG.latency_s + 0.1))
    result = fit_structured([drive(true, 3, 120.0)], BOAT)
    found = identified_vessel(BOAT, result, date="2026-01-01")
    assert found.sensors.uwb is None and found.sensors.gnss is not None
    assert found.sensors.gnss.latency_s == pytest.approx(GNSS.latency_s + 0.1, abs=0.03)
    assert found.sensors.gnss.x_m == pytest.approx(GNSS.x_m + 0.1, abs=0.05)
    assert load_vessel(vessel_toml(found), name="found.toml") == found


def test_what_only_ranges_have_is_not_in_the_catalogue():
    run = drive(UWB, 8, 20.0)
    names, with_uwb = ({e.name for e in catalogue(v, [run])} for v in (BOAT, UWB))
    assert not names & RANGES_ONLY
    assert names - with_uwb == {"gnss_latency", "gnss_lever_arm"}
    assert with_uwb - names == RANGES_ONLY - {"nlos"}


@pytest.mark.long
def test_a_weak_thruster_is_named_and_the_file_keeps_its_antenna(tmp_path):
    weak = replace(UWB, thrusters=tuple(replace(t, gain=0.5) if i == 0 else t for i, t in enumerate(UWB.thrusters)))
    write_run(drive(weak, 8, 80.0), tmp_path / "drive.csv")
    (tmp_path / "gnss.toml").write_text(vessel_toml(BOAT))
    main(shlex.split(f"diagnose {tmp_path}/drive.csv --vessel {tmp_path}/gnss.toml --out {tmp_path}/out"))
    found = msgspec.json.decode((tmp_path / "out" / "findings.json").read_bytes(), type=Findings)
    assert [cause.name for cause in found.causes] == ["thruster_gain:front_port"]
    extended = load_vessel((tmp_path / "out" / "extended.toml").read_text(), name="extended.toml")
    assert extended.sensors.uwb is None and extended.sensors.gnss is not None


def test_a_run_file_with_a_tag_is_not_for_it():
    files = {"run.toml": "aritra.toml", "site.toml": "sites/basin.toml", "mission.plan": "missions/square.plan"}
    texts = {role: (EXAMPLES / path).read_text() for role, path in files.items()} | {"vessel.toml": vessel_toml(BOAT)}
    names = {role: role for role in texts}
    said = r"run\.toml: uwb: vessel\.toml has no table sensors\.uwb: leave it out, or --config deploy/lake\.toml"
    with pytest.raises(ConfigError, match=said):
        setup_of(texts, names)
