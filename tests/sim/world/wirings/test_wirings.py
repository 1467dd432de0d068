"""The parameter files of deploy/ardupilot in the simulated autopilot: what the thrusters do when it goes wrong."""

import re
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as wire

import deploy
from companion.cli.simulator.autopilot_options import FOLDER, WIRED_CHANNELS, wirings
from companion.core.configuration.run_file import Control, MavlinkLink
from companion.core.constants import NEUTRAL_US
from drivers.mavlink.encode import PWM_MAX_US, PWM_MIN_US
from sim.world.autopilot.parameter_table import BOARD_PARAMETERS, BOAT_PARAMETERS, TABLE
from sim.world.autopilot.parameters import ParameterStore
from sim.world.autopilot.rover import GATE_CHANNELS
from tests.sim.world.autopilot.autopilot_fixture import command, of_type
from tests.sim.world.wirings.wiring_fixture import CASES, DRIVEN_US, EVENTS, PILOT_US, driven, load, outcome

PAGE = Path(__file__).resolve().parents[4] / "docs" / "autopilot.md"
outcome = cache(outcome)


@pytest.mark.parametrize("wiring", wirings())
@pytest.mark.parametrize("firmware", ["4.6", "4.7"])
def test_every_parameter_of_a_file_exists_and_is_stored_as_it_stands(wiring, firmware):
    values = load(wiring)
    bench, _ = driven(wiring, firmware=firmware)
    stored = bench.rover.vehicle.parameters
    assert {name: stored[name] for name in values} == values


def test_the_simulators_own_boat_is_the_recommended_wiring():
    mine, default = load("gate"), ParameterStore(BOAT_PARAMETERS)
    assert {name: default[name] for name in mine} == mine
    assert set(BOAT_PARAMETERS) - set(BOARD_PARAMETERS) <= set(mine)


@pytest.mark.parametrize("wiring", wirings())
def test_only_the_companion_may_override_and_channel_1_cannot_arm(wiring):
    values = load(wiring)
    assert values["SYSID_MYGCS"] == MavlinkLink(url="udpin:x:1").system_id == 1
    assert wiring == "unsafe_plain" or values["ARMING_RUDDER"] == 0
    bench, _ = driven(wiring)
    bench.join("gcs", system=255)
    bench.send(wire.MAVLink_rc_channels_override_message(0, 0, *[1900] * 18), "gcs")
    bench.run(0.1)
    assert bench.out(1) == DRIVEN_US


@pytest.mark.parametrize("event", EVENTS)
@pytest.mark.parametrize("receiver", [0, 8, 16])
def test_recommended_wiring_is_neutral_or_the_pilots_within_0_7_s(receiver, event):
    first_us, after_s = outcome("gate", receiver, event).changes[0]
    assert after_s <= 0.7
    assert first_us == (PILOT_US if (receiver, event) == (16, "companion dies") else 1500)
    assert all(us in (1500, PILOT_US) for us, _ in outcome("gate", receiver, event).changes)


def test_recommended_wiring_ends_in_hold_and_needs_to_be_asked_for_manual_again():
    bench, override = driven("gate")
    bench.run(2.2)
    assert bench.rover.vehicle.modes.mode == 4
    bench.run(3.0, every=override)
    assert bench.rover.outputs_us[:4] == (1500,) * 4
    assert bench.ack(command(176, 1, 0)) == 0
    bench.run(0.2, every=override)
    assert bench.rover.outputs_us[:4] == (DRIVEN_US,) * 4


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.floats(0.02, 0.45), st.sampled_from([0, 8, 16]), st.lists(st.integers(1100, 1900), min_size=4, max_size=4))
def test_recommended_wiring_never_holds_a_value_however_the_companion_ends(period_s, receiver, last):
    bench, _ = driven("gate", receiver)
    override = wire.MAVLink_rc_channels_override_message(0, 0, *[1500] * 4, *[65535] * 4, *last, *[0] * 6)
    bench.run(1.0, every=override, period_s=period_s)
    bench.send(override)
    bench.run(0.7)
    assert bench.rover.outputs_us[:4] == ((PILOT_US,) * 4 if receiver == 16 else (1500,) * 4)


def test_the_pilot_of_the_recommended_wiring_takes_over_with_the_channels_of_the_thrusters():
    bench, _ = driven("gate", 16)
    bench.run(0.7)
    bench.receiver(*[1500] * 8, 1600, 1400, 1550, 1450, *[1500] * 4)
    bench.run(0.1)
    assert bench.rover.outputs_us[:4] == (1600, 1400, 1550, 1450)


def test_plain_pass_through_is_frozen_for_ever():
    assert outcome("unsafe_plain", 0, "companion dies").changes == ()
    bench, _ = driven("unsafe_plain")
    bench.run(300.0)
    for cut in (command(176, 1, 4), command(400, 0)):
        bench.send(cut)
    bench.run(1.0)
    assert bench.rover.outputs_us[:4] == (DRIVEN_US,) * 4
    assert wirings()["unsafe_plain"].startswith("# DO NOT LOAD THIS INTO A BOAT")


@pytest.mark.parametrize("event", ["disarmed", "HOLD"])
def test_scaled_does_not_hear_disarming_or_hold_and_its_file_says_so(event):
    assert outcome("scaled", 0, event).changes == ()
    assert "disarming and HOLD do NOT stop the thrusters" in wirings()["scaled"]


def test_scaled_is_disarmed_after_a_loss_and_arms_again():
    bench, override = driven("scaled")
    assert bench.rover.vehicle.modes.armed
    bench.run(2.2)
    assert not bench.rover.vehicle.modes.armed
    bench.run(0.5, every=override)
    assert bench.ack(command(400, 1)) == 0


@pytest.mark.parametrize("event", EVENTS)
def test_omni_is_cut_by_everything(event):
    (us, after_s), *later = outcome("omni", 0, event).changes
    assert (us, later) == (1500, []) and after_s <= 0.7


@pytest.mark.parametrize(("wiring", "receiver"), CASES)
def test_the_table_of_the_documents_is_what_happens(wiring, receiver):
    cells = " | ".join(outcome(wiring, receiver, event).text for event in EVENTS)
    assert f"| `{wiring}` | {receiver or 'none'} | {cells} |" in PAGE.read_text(encoding="utf-8")


def test_streams_and_loop_of_the_recommended_wiring():
    bench, override = driven("gate")
    assert bench.ack(command(511, 30, 20_000)) == 0
    assert len(of_type(bench.run(2.0, every=override), "ATTITUDE")) == 100


def test_the_script_and_the_rest_of_the_boat_agree_on_channels_and_limits():
    script = (FOLDER / "gate.lua").read_text(encoding="utf-8")
    channels = tuple(map(int, re.search(r"CHANNELS = \{([^}]*)\}", script)[1].split(",")))
    limits = tuple(map(int, re.search(r"MIN_US, NEUTRAL_US, MAX_US = (.*)", script)[1].split(",")))
    functions = [int(n) for n in re.search(r"FUNCTIONS = \{([^}]*)\}", script)[1].split(",")]
    assert channels == WIRED_CHANNELS == GATE_CHANNELS
    assert not set(channels) & set(Control().neutral_channels)
    assert limits == (PWM_MIN_US, NEUTRAL_US, PWM_MAX_US)
    assert functions == [load("gate")[f"SERVO{n}_FUNCTION"] for n in range(1, 5)]
    assert {load("gate")[f"SERVO{n}_TRIM"] for n in range(1, 5)} == {NEUTRAL_US}


def test_the_files_come_with_the_package():
    assert FOLDER.parent == Path(deploy.__file__).parent
    assert len(TABLE) > 150
    assert set(wirings()) == {"gate", "scaled", "omni", "unsafe_plain"}
