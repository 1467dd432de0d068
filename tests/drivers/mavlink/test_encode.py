import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.messages import OverrideLease
from drivers.mavlink.encode import MavlinkEncoder
from tests.drivers.mavlink.mavlink_autopilot import read_one


def encoder() -> MavlinkEncoder:
    return MavlinkEncoder(1, 191, 1, 1)


def lease(channels, pwm_us) -> OverrideLease:
    return OverrideLease(
        t_ns=0,
        index=0,
        channels=tuple(channels),
        pwm_us=tuple(pwm_us),
        valid_for_s=0.3,
        source="plan",
        reason="",
        f_command_n=(),
    )


def raw(m) -> list[int]:
    return [getattr(m, f"chan{i}_raw") for i in range(1, 19)]


@settings(deadline=None)
@given(st.dictionaries(st.integers(1, 16), st.integers(1100, 1900), max_size=16))
def test_override_touches_only_its_channels(wanted: dict[int, int]):
    """Left alone: 65535 on channels 1-8, 0 on 9-18; never 65534, which is a pulse width on 1-8."""
    m = read_one(encoder().override(lease(wanted.keys(), wanted.values())))
    assert (m.get_type(), m.get_srcSystem(), m.get_srcComponent()) == ("RC_CHANNELS_OVERRIDE", 1, 191)
    assert (m.target_system, m.target_component) == (1, 1)
    assert raw(m) == [wanted.get(c, 65535 if c <= 8 else 0) for c in range(1, 19)]


@pytest.mark.parametrize("pwm_us", [1099, 1901, 0, 65534, 65535, -1, 1500.0, True, float("nan"), None, np.int64(1500)])
def test_override_refuses_a_pulse_width_and_names_the_channel(pwm_us):
    with pytest.raises(ValueError, match="channel 3:"):
        encoder().override(lease([1, 3], [1500, pwm_us]))


@pytest.mark.parametrize("channel", [0, 17, 18, -1, 1.0, True])
def test_override_refuses_a_channel_that_no_override_reaches(channel):
    with pytest.raises(ValueError, match="is not one of 1 to 16"):
        encoder().override(lease([channel], [1500]))


def test_override_refuses_a_channel_given_twice_and_a_short_list():
    with pytest.raises(ValueError, match="channel 2 is given twice"):
        encoder().override(lease([2, 2], [1500, 1600]))
    with pytest.raises(ValueError, match="2 channels, 1 pulse widths"):
        encoder().override(lease([1, 2], [1500]))


def test_neutral_and_release():
    assert raw(read_one(encoder().neutral([1, 10]))) == ([1500] + [65535] * 7 + [0, 1500] + [0] * 8)
    assert raw(read_one(encoder().release([1, 8, 9, 16]))) == (
        [0] + [65535] * 6 + [0] + [65534] + [0] * 6 + [65534] + [0] * 2
    )


def test_heartbeat_of_a_companion():
    m = read_one(encoder().heartbeat())
    assert (m.type, m.autopilot, m.system_status) == (18, 8, 4)


def fields(m) -> tuple:
    return (m.command, m.target_system, m.target_component, *(getattr(m, f"param{i}") for i in range(1, 8)))


def test_commands():
    e = encoder()
    assert fields(read_one(e.command_long(5300, 0))) == (5300, 1, 1, 0, 0, 0, 0, 0, 0, 0)
    assert fields(read_one(e.set_message_interval("ATTITUDE", 50))) == (511, 1, 1, 30, 20000, 0, 0, 0, 0, 0)
    assert fields(read_one(e.request_message("AUTOPILOT_VERSION"))) == (512, 1, 1, 148, 0, 0, 0, 0, 0, 0)
    assert fields(read_one(e.set_mode(4))) == (176, 1, 1, 1, 4, 0, 0, 0, 0, 0)
    assert fields(read_one(e.arm()))[:4] == (400, 1, 1, 1)
    assert fields(read_one(e.disarm()))[:4] == (400, 1, 1, 0)


def test_parameters():
    e = encoder()
    m = read_one(e.param_request_read("SCHED_LOOP_RATE"))
    assert (m.param_id, m.param_index) == ("SCHED_LOOP_RATE", -1)
    with pytest.raises(ValueError, match="'SEVENTEEN_LETTERS'"):
        e.param_request_read("SEVENTEEN_LETTERS")
    with pytest.raises(ValueError, match="ASCII"):
        e.param_request_read("GRÖSSE")


@settings(deadline=None)
@given(st.integers(-(2**63), 2**63 - 1), st.integers(-(2**63), 2**63 - 1))
def test_timesync(tc1_ns: int, ts1_ns: int):
    m = read_one(encoder().timesync(tc1_ns, ts1_ns))
    assert (m.tc1, m.ts1) == (tc1_ns, ts1_ns)


def test_sequence_numbers_count_up_and_wrap():
    e = encoder()
    assert [read_one(e.heartbeat()).get_seq() for _ in range(258)] == [*range(256), 0, 1]
