"""The JSON protocol of ArduPilot SITL on the wire: servo packets in, states out.

The firmware's side is `json_firmware`, written from ArduPilot's sources.
"""

import math
import struct
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.boat.load_run import EXAMPLES
from companion.cli.simulator.firmware_options import ADDRESS
from companion.core.preflight.parameter_file import parse_parameters
from sim.world.sitl.loopback import JsonWires
from sim.world.sitl.protocol import PORT, NotServos, PhysicsState, decode, encode
from tests.sim.world.sitl.json_firmware import parse
from tests.sim.world.sitl.sitl_fixture import AT_REST, packet

finite = st.floats(-1e6, 1e6)
vectors = st.tuples(finite, finite, finite)
states = st.builds(
    PhysicsState,
    timestamp_s=st.floats(0, 1e6),
    gyro_rad_s=vectors,
    accel_m_s2=vectors,
    position_m=vectors,
    velocity_m_s=vectors,
    attitude_rad=vectors,
    voltage_v=st.floats(0, 60),
    current_a=st.floats(0, 200),
)


@pytest.mark.parametrize("outputs", [16, 32])
@given(rate=st.integers(0, 65535), count=st.integers(0, 2**32 - 1), data=st.data())
def test_little_endian_magic_18458_has_16_pulses_and_29569_has_32(outputs, rate, count, data):
    pulses = data.draw(st.lists(st.integers(0, 65535), min_size=outputs, max_size=outputs))
    told = decode(packet(count, rate, pulses, outputs))
    assert (told.frame_rate_hz, told.frame_count, told.pulses_us) == (rate, count, tuple(pulses))


@pytest.mark.parametrize(
    ("sent", "outputs"),
    [
        ((1000, 0, 1000, 0), (0, 0, 0, 0)),
        ((1000, 0, 0, 0), (0, 0, 0, 0)),
        ((0, 0, 0, 0), (0, 0, 0, 0)),
        ((1000, 1100, 1000, 1100), (1000, 1100, 1000, 1100)),
        ((1000, 0, 1000, 1500), (1000, 0, 1000, 1500)),
        ((1100, 0, 1001, 0), (1100, 0, 1001, 0)),
        ((1500, 1500, 1000, 1500), (1500, 1500, 1000, 1500)),
    ],
    ids=str,
)
def test_outputs_that_nobody_writes_have_no_pulse_and_a_commanded_one_keeps_its_own(sent, outputs):
    assert decode(packet(pulses=sent)).outputs_us[:4] == outputs
    assert decode(packet(pulses=sent, outputs=32)).outputs_us[:4] == outputs


@given(st.binary(max_size=100))
def test_anything_else_is_refused(data):
    magics = (struct.pack("<H", 18458), struct.pack("<H", 29569))
    if data[:2] in magics and len(data) in (40, 72):
        return
    with pytest.raises(NotServos, match=r"bytes|magic"):
        decode(data)


@pytest.mark.parametrize(
    "data", [packet()[:-1], packet() + b"\0", packet(outputs=32)[:40], struct.pack(">HHI16H", 18458, *[0] * 18)]
)
def test_a_packet_cut_short_too_long_or_big_endian_is_refused(data):
    with pytest.raises(NotServos):
        decode(data)


@given(states)
def test_a_state_is_a_line_between_line_feeds_and_the_firmware_finds_every_number_in_it(state):
    data = encode(state)
    assert data[:2] == b"\n{" and data[-2:] == b"}\n" and data.count(b"\n") == 2
    assert parse(data.decode("ascii")) == {
        "timestamp": state.timestamp_s,
        "gyro": list(state.gyro_rad_s),
        "accel_body": list(state.accel_m_s2),
        "position": list(state.position_m),
        "attitude": list(state.attitude_rad),
        "velocity": list(state.velocity_m_s),
        "voltage": state.voltage_v,
        "current": state.current_a,
    }


@given(states)
def test_no_space_after_a_colon_or_the_firmware_cannot_read_it(state):
    text = encode(state).decode("ascii")
    assert ": " not in text
    assert parse(text.replace(":", ": ")) is None


def test_a_state_that_is_not_finite_never_leaves():
    with pytest.raises(ValueError, match="JSON"):
        encode(replace(AT_REST, voltage_v=math.nan))


def test_the_firmware_sends_to_port_9002_and_ten_more_for_each_instance(capsys):
    assert f"127.0.0.1:{PORT}" == ADDRESS == "127.0.0.1:9002" and JsonWires().bind == ("127.0.0.1", 9002)


@pytest.mark.parametrize("name", ["gate", "scaled", "omni", "unsafe_plain"])
def test_the_parameter_files_put_the_thrusters_on_outputs_1_to_4(name):
    """In the vessel file's order: channels 9-12, motors 1-4; so pulses 1-4 of a packet drive thrusters 1-4."""
    told = parse_parameters((EXAMPLES / "ardupilot" / f"{name}.param").read_text(), name=name)
    first = {"gate": 94, "scaled": 148, "omni": 33, "unsafe_plain": 59}[name]
    assert [told[f"SERVO{n}_FUNCTION"] for n in range(1, 5)] == [first, first + 1, first + 2, first + 3]
