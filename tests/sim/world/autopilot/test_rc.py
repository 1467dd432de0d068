import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot import AT_REST
from sim.world.autopilot.parameters import ParameterStore
from sim.world.autopilot.rc import RcInput
from tests.sim.world.autopilot.autopilot_fixture import MS, Bench, S, of_type, override

STICKS = (1111,) * 16


def one(channel, value):
    """18 channels, all ignored but one."""
    values = [65535] * 8 + [0] * 10
    values[channel - 1] = value
    return values


def rc(**changes):
    return RcInput(ParameterStore(changes))


@pytest.mark.parametrize("channel", [1, 8, 9, 16])
def test_a_pulse_width_is_taken(channel):
    r = rc()
    r.override(one(channel, 1600), 0)
    assert r.radio_in_us[channel - 1] == 1600
    assert sum(r.radio_in_us) == 1600


@pytest.mark.parametrize(
    "channel, value, after_us",
    [
        (1, 0, 1111),  # release
        (8, 0, 1111),
        (1, 65535, 1600),  # leave alone
        (8, 65535, 1600),
        (1, 65534, 65534),  # no release: a pulse width
        (8, 65534, 65534),
        (9, 65534, 1111),  # release
        (16, 65534, 1111),
        (9, 0, 1600),  # ignored
        (16, 0, 1600),
        (9, 65535, 1600),
        (16, 65535, 1600),
    ],
)
def test_what_the_special_values_do_where_a_receiver_is(channel, value, after_us):
    r = rc()
    r.override(one(channel, 1600), 0)
    r.override(one(channel, value), 100 * MS)
    r.receiver(STICKS, 110 * MS)
    assert r.radio_in_us[channel - 1] == after_us


@pytest.mark.parametrize("channel, release", [(1, 0), (9, 65534)])
def test_without_a_receiver_a_release_changes_nothing(channel, release):
    r = rc()
    r.override(one(channel, 1600), 0)
    r.override(one(channel, release), S)
    r.receiver((), 2 * S)
    assert r.radio_in_us[channel - 1] == 1600


def test_a_release_counts_as_input_and_an_ignored_value_does_not():
    r = rc()
    r.override(one(1, 0), S)
    assert r.last_input_ns == S
    r.override([65535] * 8 + [0] * 10, 2 * S)
    assert r.last_input_ns == S


@pytest.mark.parametrize("timeout_s, until_s", [(3.0, 3.0), (0.5, 0.5)])
def test_sticks_take_over_each_channel_at_its_own_time(timeout_s, until_s):
    r = rc(RC_OVERRIDE_TIME=timeout_s)
    r.override(one(1, 1600), 0)
    r.override(one(9, 1700), 200 * MS)
    last_ns = round(until_s * S)
    r.receiver(STICKS, last_ns - 1)
    assert (r.radio_in_us[0], r.radio_in_us[8]) == (1600, 1700)
    r.receiver(STICKS, last_ns)
    assert (r.radio_in_us[0], r.radio_in_us[8]) == (1111, 1700)
    r.receiver(STICKS, last_ns + 200 * MS)
    assert (r.radio_in_us[0], r.radio_in_us[8]) == (1111, 1111)


def test_override_time_minus_one_never_expires_and_zero_refuses():
    r = rc(RC_OVERRIDE_TIME=-1)
    r.override(one(1, 1600), 0)
    r.receiver(STICKS, 3600 * S)
    assert r.radio_in_us[0] == 1600
    r = rc(RC_OVERRIDE_TIME=0)
    r.override(one(1, 1600), 0)
    assert (r.radio_in_us[0], r.last_input_ns) == (0, None)


def test_channels_17_and_18_are_ignored():
    r = rc()
    r.override([65535] * 8 + [0] * 8 + [1600, 1600], 0)
    assert r.radio_in_us == [0] * 16


@pytest.mark.parametrize(
    "system, target, taken", [(1, (0, 0), True), (1, (1, 1), True), (255, (1, 1), False), (1, (2, 1), False)]
)
def test_only_sysid_mygcs_may_override_and_only_this_vehicle(system, target, taken):
    bench = Bench()
    bench.join("peer", system=system)
    values = one(9, 1600)
    bench.send(wire.MAVLink_rc_channels_override_message(*target, *values), "peer")
    assert (bench.rover.vehicle.rc.radio_in_us[8] == 1600) is taken


def test_rc_channels_reports_overrides_and_receiver():
    bench = Bench()
    got = of_type(bench.run(1.5, every=override(high=[1600, 1601, 1602, 1603])), "RC_CHANNELS")[-1]
    assert (got.chan1_raw, got.chan9_raw, got.chan12_raw, got.chan13_raw) == (1500, 1600, 1603, 0)
    assert (got.chancount, got.rssi) == (0, 255)
    bench.sensors = msgspec.structs.replace(AT_REST, receiver_us=STICKS)
    got = of_type(bench.run(4.0), "RC_CHANNELS")[-1]
    assert (got.chan1_raw, got.chancount) == (1111, 16)
