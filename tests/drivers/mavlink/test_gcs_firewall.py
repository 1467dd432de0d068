"""What a ground station may send through us: the lists, written out once more, and that nothing else passes."""

import struct
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as wire

from drivers.mavlink.framing import Framer
from drivers.mavlink.gcs_firewall import (
    BURST_BYTES,
    RATE_BYTES_S,
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


ALWAYS = {
    "HEARTBEAT", "PING", "TIMESYNC", "STATUSTEXT", "SET_MODE", "AUTOPILOT_VERSION_REQUEST", "PARAM_REQUEST_LIST",
    "PARAM_REQUEST_READ", "PARAM_EXT_REQUEST_LIST", "PARAM_EXT_REQUEST_READ", "MISSION_REQUEST_LIST",
    "MISSION_REQUEST_PARTIAL_LIST", "MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK", "FENCE_FETCH_POINT",
    "RALLY_FETCH_POINT",
}  # fmt: skip
AT_REST = {
    "PARAM_SET", "PARAM_EXT_SET", "FILE_TRANSFER_PROTOCOL", "MISSION_COUNT", "MISSION_ITEM", "MISSION_ITEM_INT",
    "MISSION_WRITE_PARTIAL_LIST", "MISSION_CLEAR_ALL", "MISSION_SET_CURRENT", "FENCE_POINT", "RALLY_POINT",
    "SET_HOME_POSITION", "SET_GPS_GLOBAL_ORIGIN", "LOG_REQUEST_LIST", "LOG_REQUEST_DATA", "LOG_REQUEST_END",
    "LOG_ERASE", "SYSTEM_TIME",
}  # fmt: skip
COMMANDS_ALWAYS = {20, 21, 176, 185, 193, 246, 300, 400, 401, 410, 510, 512, 519, 520, 521, 522, 525, 528, 5300, 42428}
COMMANDS_AT_REST = {
    179, 180, 207, 224, 241, 242, 245, 42004, 42005, 42006, 42007, 42424, 42425, 42426, 42429, 42651, 42701,
}  # fmt: skip
PLAIN = {246: (1.0, 0.0)}
"""Parameters 1 and 2 where zeros are not what passes."""


def command(number, first=None, second=None, sender=STATION, kind="command_long"):
    usual = PLAIN.get(number, (0.0, 0.0))
    first, second = usual[0] if first is None else first, usual[1] if second is None else second
    if kind == "command_long":
        return sender.command_long(1, 1, number, 0, first, second, 0, 0, 0, 0, 0)
    return sender.command_int(1, 1, 0, number, 0, 0, first, second, 0, 0, 0, 0, 0)


def passes(frame, disarmed=True, system=1):
    gate = GcsFirewall(system)
    out = gate.feed(frame, S, disarmed=disarmed)
    assert out in ([], [frame]), "as it is, or not at all"
    assert sum(gate.passed.values()) + sum(gate.refused.values()) == 1
    return bool(out)


@pytest.mark.parametrize("name", sorted(set(KINDS) - {"COMMAND_LONG", "COMMAND_INT"}))
def test_of_all_types_those_of_the_lists_pass(name):
    assert passes(blank(name), disarmed=False) == (name in ALWAYS)
    assert passes(blank(name)) == (name in ALWAYS | AT_REST)


@pytest.mark.parametrize("kind", ["command_long", "command_int"])
@pytest.mark.long
def test_of_all_65536_commands_those_of_the_lists_pass(kind):
    passed = {False: set(), True: set()}
    for disarmed, found in passed.items():
        gate = GcsFirewall(1)
        for number in range(65536):
            if gate.feed(command(number, kind=kind), number * S, disarmed=disarmed):
                found.add(number)
    assert passed[False] == COMMANDS_ALWAYS
    assert passed[True] == COMMANDS_ALWAYS | COMMANDS_AT_REST


def test_what_once_passed_while_armed_does_not_any_more():
    """Calibration of gyro and compass, positions, a restart of the gate script, the bootloader, switches, goals."""
    for number, params in (
        (241, (1, 0)),
        (42424, (0, 0)),
        (42701, (0, 0)),
        (42650, (0, 0)),
        (218, (9, 2)),
        (192, (0, 0)),
    ):
        assert not passes(command(number, *params), disarmed=False), number
    for name in ("GPS_INPUT", "VISION_POSITION_ESTIMATE", "ODOMETRY", "SET_POSITION_TARGET_LOCAL_NED", "PARAM_MAP_RC"):
        assert not passes(blank(name), disarmed=False) and not passes(blank(name))
    assert not passes(command(42650)), "the bootloader not at rest either"


@pytest.mark.parametrize("kind", ["command_long", "command_int"])
def test_arming_passes_but_not_past_the_autopilot_s_checks(kind):
    assert passes(command(400, 1, 0, kind=kind)) and passes(command(400, 0, 21196, kind=kind), disarmed=False)
    for forced in (2989, 21196, float("nan")):
        assert not passes(command(400, 1, forced, kind=kind))


@pytest.mark.parametrize(("first", "passed"), [(1, True), (0, False), (2, False), (3, False), (42, False)])
def test_of_reboots_only_the_plain_one_passes(first, passed):
    """3 stays in the bootloader, 42 breaks the firmware for its developers' tests."""
    assert passes(command(246, first), disarmed=False) == passed == passes(command(246, first))


def test_a_refusal_names_the_command():
    gate = GcsFirewall(1)
    gate.feed(command(209) + command(60000) + command(60001), S, disarmed=True)
    assert [name for name, _ in gate.refused] == ["DO_MOTOR_TEST", "command of an unknown number"]
    assert sum(gate.refused.values()) == 3


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


def test_the_page_names_everything_that_passes():
    page = (Path(__file__).parents[3] / "docs" / "ground-station.md").read_text()
    commands = {wire.enums["MAV_CMD"][n].name.removeprefix("MAV_CMD_") for n in COMMANDS_ALWAYS | COMMANDS_AT_REST}
    assert not [name for name in ALWAYS | AT_REST | commands if f"`{name}`" not in page]
