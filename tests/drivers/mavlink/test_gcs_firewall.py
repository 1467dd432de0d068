"""What a ground station may send through us: every refusal, and that the rest passes untouched."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as wire

from drivers.mavlink.framing import Framer
from drivers.mavlink.gcs_firewall import (
    BURST_BYTES,
    RATE_BYTES_S,
    REFUSED,
    REFUSED_COMMANDS,
    REFUSED_COMMANDS_UNLESS_DISARMED,
    REFUSED_UNLESS_DISARMED,
    GcsFirewall,
)
from tests.drivers.mavlink.mavlink_autopilot import Sender

S = 1_000_000_000
STATION = Sender(system=255, component=190)
KINDS = {kind.msgname: kind for kind in wire.mavlink_map.values()}


def blank(name, system=255, component=190):
    """A frame of this type with zeros in every field."""
    kind = KINDS[name]
    size = kind.unpacker.size
    head = wire.MAVLink_header(kind.id, mlen=size, srcSystem=system, srcComponent=component).pack()
    return head + bytes(size) + struct.pack("<H", wire.x25crc(head[1:] + bytes(size) + bytes([kind.crc_extra])).crc)


def command(number, sender=STATION, kind="command_long"):
    if kind == "command_long":
        return sender.command_long(1, 1, number, 0, 9, 1700, 0, 0, 0, 0, 0)
    return sender.command_int(1, 1, 0, number, 0, 0, 9, 1700, 0, 0, 0, 0, 0)


def passes(frame, disarmed=True, system=1):
    gate = GcsFirewall(system)
    out = gate.feed(frame, S, disarmed=disarmed)
    assert out in ([], [frame]), "as it is, or not at all"
    assert sum(gate.passed.values()) + sum(gate.refused.values()) == 1
    return bool(out)


@pytest.mark.parametrize("name", sorted(REFUSED))
def test_refused_types(name):
    assert not passes(blank(name))


@pytest.mark.parametrize("kind", ["command_long", "command_int"])
@pytest.mark.parametrize("number", sorted(REFUSED_COMMANDS))
def test_refused_commands(number, kind):
    assert not passes(command(number, kind=kind))


def test_what_could_move_a_thruster_is_in_the_tables():
    """Written out, so that nothing falls out of them unseen."""
    sticks = {"RC_CHANNELS_OVERRIDE", "MANUAL_CONTROL", "HIL_RC_INPUTS_RAW"}
    outputs = {"SET_ACTUATOR_CONTROL_TARGET", "HIL_CONTROLS", "HIL_ACTUATOR_CONTROLS", "CAN_FRAME", "CANFD_FRAME"}
    assert sticks | outputs | {"SETUP_SIGNING", "REQUEST_DATA_STREAM"} <= set(REFUSED)
    assert {183, 184, 187, 209, 310, 511, 32000} <= set(REFUSED_COMMANDS)
    assert {"PARAM_SET", "FILE_TRANSFER_PROTOCOL"} <= set(REFUSED_UNLESS_DISARMED)
    assert {245, 180} <= set(REFUSED_COMMANDS_UNLESS_DISARMED)


@pytest.mark.parametrize("number", sorted(REFUSED_COMMANDS_UNLESS_DISARMED))
def test_commands_that_set_only_while_disarmed(number):
    assert passes(command(number)) and not passes(command(number), disarmed=False)


@pytest.mark.parametrize("name", sorted(REFUSED_UNLESS_DISARMED))
def test_settings_only_while_disarmed(name):
    assert passes(blank(name)) and not passes(blank(name), disarmed=False)


@pytest.mark.parametrize("number", [11, 21, 20, 176, 185, 246, 300, 400, 410, 512, 520, 5300])
def test_what_takes_the_boat_away_from_us_or_asks_passes_always(number):
    """Modes, land, return, flight termination, reboot, mission start, arm and disarm, home, versions, safety switch."""
    assert passes(command(number), disarmed=False)


@pytest.mark.parametrize(
    "name", ["HEARTBEAT", "SET_MODE", "PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "MISSION_COUNT", "TIMESYNC"]
)
def test_looking_after_the_boat_passes_always(name):
    assert passes(blank(name), disarmed=False)


def test_nobody_speaks_in_our_name():
    for component in (1, 190, 191):
        assert not passes(blank("HEARTBEAT", 1, component))
    assert passes(blank("HEARTBEAT", 1, 191), system=7)


def test_unknown_types_do_not_pass():
    """A good frame of an id that pymavlink does not know, between two that it does."""
    good = blank("HEARTBEAT")
    strange = bytes([0xFD, 4, 0, 0, 9, 255, 190, 0xFE, 0xFF, 0xEE, 1, 2, 3, 4, 0, 0])
    gate = GcsFirewall(1)
    assert gate.feed(good + strange + good, S, disarmed=True) == [good, good]


def test_a_flood_is_cut_and_the_rest_still_passes():
    gate, beat = GcsFirewall(1), blank("HEARTBEAT")
    total = 0
    for i in range(10_000):
        total += sum(map(len, gate.feed(beat, S + i * 100_000, disarmed=True)))
    assert BURST_BYTES < total <= BURST_BYTES + RATE_BYTES_S * 1.0 + len(beat)
    assert gate.flood_bytes == 10_000 * len(beat) - total
    assert gate.feed(beat, 5 * S, disarmed=True) == [beat]


@settings(max_examples=100, deadline=None)
@given(st.lists(st.sampled_from(["HEARTBEAT", "RC_CHANNELS_OVERRIDE", "PARAM_SET", "noise"]), max_size=12), st.data())
def test_however_the_bytes_are_cut_no_refused_frame_passes(names, data):
    """Also behind noise, and with a frame's bytes inside another's."""
    chunks = [b"\xfd\x09\x00" if name == "noise" else blank(name) for name in names]
    stream, out, at, gate = b"".join(chunks), b"", 0, GcsFirewall(1)
    while at < len(stream):
        size = data.draw(st.integers(1, 90))
        out += b"".join(gate.feed(stream[at : at + size], S, disarmed=False))
        at += size
    got = {m.get_type() for m in Framer().feed(out, S)}
    assert got <= {"HEARTBEAT"}
