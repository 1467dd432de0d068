"""`aritra sim --wiring ... --receiver ... --firmware ... --serial ... --param ...`: which autopilot it makes."""

from pathlib import Path

import pytest

from companion.__main__ import parser
from companion.boat.load_run import EXAMPLES, load_setup
from companion.cli.simulator.autopilot_options import autopilot
from companion.cli.simulator.sim import world_setup
from companion.core.configuration.tables import ConfigError
from sim.world.autopilot import BOAT_PARAMETERS
from sim.world.world import World
from tests.companion.command_line import exit_code

SETUP = load_setup(EXAMPLES / "aritra.toml")


def fields(*words):
    args = parser().parse_args(["sim", *words])
    return {**vars(world_setup(args, SETUP)), **autopilot(args, SETUP.pilot.vessel)}


def world(*words):
    args = parser().parse_args(["sim", *words])
    setup = world_setup(args, SETUP)
    return World(type(setup)(**{**vars(setup), **autopilot(args, SETUP.pilot.vessel)}), 1)


def test_without_options_it_is_our_boat():
    made = fields()
    assert made["parameters"] == BOAT_PARAMETERS
    assert (made["receiver_us"], made["firmware"], made["serial"]) == ((), "4.6", 0)


def test_wiring_receiver_firmware_port_and_parameters_reach_the_autopilot():
    words = "--wiring scaled --receiver 8 --firmware 4.7 --serial 1 --param FS_ACTION=2 --param MAV_GCS_SYSID=7"
    made = world(*words.split())
    made.rover.add_link("x")
    made.step()
    parameters = made.rover.vehicle.parameters
    assert [parameters[f"SERVO{n}_FUNCTION"] for n in range(1, 5)] == [148, 149, 150, 151]
    assert (parameters["FS_ACTION"], parameters["SYSID_MYGCS"]) == (2, 7)
    assert made.rover.vehicle.sensors.receiver_us == (1500,) * 8
    assert made.rover.links["x"].serial == 1
    assert parameters.firmware.minor == 7
    made.receiver_us = ()  # the receiver dies
    made.step()
    assert made.rover.vehicle.sensors.receiver_us == ()


def test_a_wiring_is_refused_for_a_boat_with_other_channels():
    vessel = load_setup(EXAMPLES / "aritra.toml").pilot.vessel
    from msgspec.structs import replace

    other = replace(vessel, thrusters=vessel.thrusters[:2])
    with pytest.raises(ConfigError, match="for thrusters on channels"):
        autopilot(parser().parse_args(["sim", "--wiring", "gate"]), other)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--param", "NOT_THERE=1"], "no parameter NOT_THERE"),
        (["--param", "FS_ACTION=x"], "FS_ACTION: 'x' is not a finite number"),
        (["--param", "FS_ACTION"], "expected NAME,VALUE"),
        (["--receiver", "3"], "expected a number of channels, 4 to 16"),
        (["--receiver", "x"], "expected a number of channels, 4 to 16"),
        (["--wiring", "best"], "'best': unknown value; choose from gate"),
        (["--firmware", "4.5"], "unknown value; choose from 4.6, 4.7"),
    ],
)
def test_bad_options_end_with_2_and_say_why(words, complaint, capsys, tmp_path: Path):
    assert exit_code("sim", "--uwb", tmp_path / "uwb", *words) == 2
    assert complaint in capsys.readouterr().err
