"""Rudder arming, the mode switch, signing and reboot beyond the single facts."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot import Rover
from tests.sim.world.autopilot.autopilot_fixture import Bench, command, of_type, override
from tests.sim.world.autopilot.facts.facts import FAILED, UNSUPPORTED, one
from tests.sim.world.autopilot.facts.protocol import KEY, is_signed, sign, signed_bench
from tests.sim.world.autopilot.facts.rc import rudder
from tests.sim.world.autopilot.facts.wiring import PLAIN, SCALED


def rudder_bench(changes=None):
    bench = Bench({"ARMING_RUDDER": 2, **(changes or {})})
    bench.run(1.2, every=override())
    return bench


def test_letting_go_of_the_rudder_begins_the_two_seconds_anew():
    bench = rudder_bench()
    for _ in range(3):
        assert not rudder(bench, 1900, 1.5)
        assert not rudder(bench, 1500, 0.3)


def test_the_rudder_arms_only_to_the_right_and_disarms_only_to_the_left():
    bench = rudder_bench()
    assert not rudder(bench, 1100, 5.0)
    assert rudder(bench, 1900, 2.3)
    assert rudder(bench, 1900, 5.0)


@pytest.mark.parametrize("mode", [15])
def test_the_rudder_does_nothing_in_modes_that_drive_themselves(mode):
    bench = rudder_bench({"ARMING_CHECK": 0})
    bench.send(command(176, 1, mode))
    assert not rudder(bench, 1900, 5.0)


def test_the_rudder_is_refused_as_a_command_would_be():
    assert not rudder(rudder_bench(PLAIN), 1900, 5.0)


def test_with_a_dead_zone_the_throttle_may_rest_within_it():
    bench = rudder_bench({"RC3_DZ": 30})
    values = [1900, 1500, 1530, 1500] + [65535] * 4 + [0] * 10
    bench.run(2.5, every=wire.MAVLink_rc_channels_override_message(0, 0, *values))
    assert bench.rover.vehicle.modes.armed


def test_a_stick_of_a_receiver_arms_too():
    bench = rudder_bench()
    bench.receiver(1900, 1500, 1500, 1500, *[1500] * 4)
    bench.run(3.2)
    assert bench.rover.vehicle.modes.armed


@pytest.mark.parametrize("us", [0, 850, 900, 2200, 65534])
def test_the_mode_switch_ignores_what_is_no_position(us):
    bench = Bench({f"MODE{n}": 4 for n in range(1, 7)})
    bench.run(1.2, every=override())
    bench.send(command(176, 1, 0))
    bench.run(1.0, every=one(8, us))
    assert bench.rover.vehicle.modes.mode == 0


def test_the_mode_switch_needs_a_new_position_and_time():
    bench = Bench({"MODE1": 4, "MODE6": 0})
    bench.run(1.2, every=override())
    bench.run(0.5, every=one(8, 1900))
    bench.run(0.15, every=one(8, 1100), period_s=0.02)  # a glitch
    assert bench.rover.vehicle.modes.mode == 0
    bench.run(0.5, every=one(8, 1100))
    assert bench.rover.vehicle.modes.mode == 4
    bench.send(command(176, 1, 0))  # somebody else's choice stays until the switch moves
    bench.run(2.0, every=one(8, 1100))
    assert bench.rover.vehicle.modes.mode == 0


def test_the_six_positions():
    for position, us in enumerate([1230, 1360, 1490, 1620, 1749, 1750], start=1):
        bench = Bench({f"MODE{n}": 4 if n == position else 0 for n in range(1, 7)})
        bench.run(1.2, every=override())
        bench.run(0.5, every=one(8, us))
        assert bench.rover.vehicle.modes.mode == 4, us


def test_radio_status_is_accepted_unsigned_everywhere():
    bench = signed_bench(1)
    bench.send(wire.MAVLink_radio_status_message(0, 0, 0, 0, 0, 0, 0))
    assert bench.rover.links["boat"].bad_data == 0
    bench.send(command(410))
    assert bench.rover.links["boat"].bad_data == 1


@pytest.mark.parametrize("timestamp", [0, 2**48 - 1, 2**48, 2**64 - 1])
def test_any_timestamp_of_a_key_is_survived(timestamp):
    bench = Bench()
    bench.send(wire.MAVLink_setup_signing_message(1, 1, KEY, timestamp))
    assert all(is_signed(m) for m in bench.run(2.0))


def test_timestamps_rise_over_all_links_and_over_a_new_link():
    bench = signed_bench(1)
    sign(bench, KEY)
    bench.senders["boat"].signing.timestamp = 500_000
    bench.send(command(410))
    bench.run(1.5)
    bench.join("late")
    bench.run(1.5)
    stamps = [int.from_bytes(m.get_msgbuf()[-12:-6], "little") for m in bench.got["late"]]
    assert stamps == sorted(stamps) and stamps[0] > 500_000


def test_a_new_key_makes_a_new_beginning():
    bench = signed_bench(1)
    sign(bench, KEY)
    assert bench.ack(command(410)) == FAILED
    other = bytes(32 * [9])
    bench.send(wire.MAVLink_setup_signing_message(1, 1, other, 100), "usb")
    sign(bench, other)
    bench.senders["boat"].signing.timestamp = 150  # lower than what was seen under the old key
    assert bench.ack(command(410)) == FAILED


def test_what_a_reboot_is_not():
    bench = Bench()
    assert [bench.ack(command(246, p)) for p in (0, 2, 3)] == [UNSUPPORTED] * 3
    with pytest.raises(ValueError, match=r"4\.5"):
        Rover(0, firmware="4.5")


def test_a_peer_that_calls_during_a_reboot_is_served_after_it():
    bench = Bench()
    bench.send(command(246, 1))
    assert bench.send(command(410), "late") == []
    bench.run(4.5)
    assert of_type(bench.got["late"], "HEARTBEAT")


@pytest.mark.parametrize(("radio_failsafe", "us"), [(0, 0), (1, 1500)])
def test_scaled_before_any_input_is_at_trim_only_in_a_radio_failsafe(radio_failsafe, us):
    bench = Bench({**SCALED, "SERVO_RC_FS_MSK": 0xF00, "FS_THR_ENABLE": radio_failsafe})
    bench.run(2.0)
    assert bench.rover.outputs_us[:4] == (us,) * 4
