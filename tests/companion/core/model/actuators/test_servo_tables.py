"""What the loader says of tables of servos."""

import tomllib

import pytest
import tomli_w

from companion.core.configuration.tables import ConfigError
from companion.core.model.load_vessel import load_vessel
from tests.support.vessel_fixtures import BOATS

CASES = [
    ("rudder", ("rudder", "channel", 9), r"thrusters\[0\].rudder.channel: channel 9 is there twice"),
    ("rudder", ("rudder", "name", "main"), r"thrusters\[0\].rudder.name: 'main' is there twice"),
    ("rudder", ("rudder", "angle_max_deg", 60.0), "angle_max_deg: pulses reach 45 deg"),
    ("rudder", ("rudder", "trim_us", 150), "angle_max_deg: pulses reach 28.1 deg"),
    ("rudder", ("rudder", "pwm_min_us", 1500), "pwm_min_us: expected pwm_min_us < 1500"),
    ("rudder", ("rudder", "area_m2", 90.0), "rudder.area_m2: expected 1e-05 to 20, found 90"),
    ("rudder", ("rudder", "source", " "), "needs a source"),
    ("rudder", (None, "azimuth_deg", 5.0), r"thrusters\[0\].azimuth_deg: a rudder's propeller pushes ahead"),
    ("azimuth", ("steering", "area", 1.0), r"thrusters\[0\].steering.area: unknown key"),
    ("azimuth", ("steering", "angle_max_deg", 181.0), r"angle_max_deg: expected 1 to 180"),
    (
        "azimuth",
        ("steering", "angle_max_deg", 89.0),
        r"thrusters\[0\].steering.angle_max_deg: expected at least 90, found",
    ),
]


@pytest.mark.parametrize(("name", "change", "says"), CASES)
def test_what_cannot_be_is_refused_by_its_key(name, change, says):
    data = tomllib.loads((BOATS / f"{name}.toml").read_text())
    table, key, value = change
    node = data["thrusters"][0] if table is None else data["thrusters"][0][table]
    node[key] = value
    with pytest.raises(ConfigError, match=says):
        load_vessel(tomli_w.dumps(data), name="boat.toml")


def test_a_thruster_is_steered_or_has_a_rudder_and_what_turns_has_no_wash():
    data = tomllib.loads((BOATS / "azimuth.toml").read_text())
    data["propulsion"]["wash"] = [{"behind": "bow", "ahead": "stern", "share": 0.1}]
    with pytest.raises(ConfigError, match="wash is for thrusters that do not turn"):
        load_vessel(tomli_w.dumps(data), name="boat.toml")
    rudder = tomllib.loads((BOATS / "rudder.toml").read_text())["thrusters"][0]["rudder"]
    data["propulsion"]["wash"] = []
    data["thrusters"][0]["rudder"] = {**rudder, "channel": 13}
    with pytest.raises(ConfigError, match="has steering and a rudder"):
        load_vessel(tomli_w.dumps(data), name="boat.toml")
