"""Questions about parameters, messages, streams, addresses, overrides, files and missions."""

from __future__ import annotations

import math
import struct
from collections import Counter

from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot.parameter_table import TABLE
from tests.evidence.firmware.asked_commands import Answers
from tests.evidence.firmware.dialogue import GROUND, NEUTRAL, Dialogue, command, in_words

MESSAGES = (
    0, 1, 2, 4, 22, 24, 26, 27, 29, 30, 31, 32, 33, 34, 35, 36, 42, 46, 49, 62, 65, 74, 83, 85, 87, 105, 110, 111,
    116, 124, 125, 129, 132, 136, 137, 143, 147, 148, 152, 162, 163, 164, 165, 168, 173, 178, 181, 182, 191, 193, 194,
    226, 230, 234, 235, 241, 242, 245, 253, 259, 263, 281, 285, 290, 301, 331, 376, 435, 11030, 11038,
)  # fmt: skip
"""Message numbers: most of those that Rover knows, and some that it does not. AOA_SSA (11020) ends 4.6."""
NAMES = ("SYSID_MYGCS", "MAV_GCS_SYSID", "SYSID_THISMAV", "MAV_SYSID", "SR0_EXTRA1", "MAV1_EXTRA1", "TELEM_DELAY",
         "SERVO_AUTO_TRIM", "FS_TIMEOUT", "RC_OVERRIDE_TIME", "STAT_BOOTCNT", "NOT_THERE", "")  # fmt: skip
VALUES = (
    ("FS_ACTION", 1.0), ("FS_ACTION", 2.7), ("FS_ACTION", -2.7), ("FS_ACTION", 2.995), ("FS_ACTION", 300.0),
    ("FS_ACTION", -300.0), ("FS_ACTION", math.nan), ("FS_ACTION", math.inf), ("FS_THR_VALUE", 910.6),
    ("FS_THR_VALUE", 40000.0), ("FS_THR_VALUE", -40000.0), ("FS_OPTIONS", 1.6), ("FS_OPTIONS", -1.6),
    ("FS_TIMEOUT", 1.55), ("STAT_BOOTCNT", 7.0), ("STAT_RUNTIME", 7.0), ("NOT_THERE", 1.0),
    ("fs_action", 1.0), ("SERVO16_FUNCTION", 5.0), ("FORMAT_VERSION", 16.0),
)  # fmt: skip


def parameters(d: Dialogue) -> Answers:
    """PARAM_REQUEST_READ and PARAM_SET; every parameter that the simulated autopilot has."""
    d.settle(quiet=False)
    for name in NAMES:
        yield f"read {name}", _read(d, name)
    for index in (-1, 70000 - 65536, 30000):
        yield f"read index {index}", _values(d, wire.MAVLink_param_request_read_message(1, 1, b"", index))
    for row in TABLE:
        if not row.name.startswith(("RC", "SERVO", "STAT_", "MIS_TOTAL")) or row.name.startswith(
            ("RC9", "SERVO9", "RC_", "SERVO_")
        ):
            yield f"parameter {row.name}", _read(d, row.name)
    for name, value in VALUES:
        message = wire.MAVLink_param_set_message(1, 1, name.encode(), value, wire.MAV_PARAM_TYPE_REAL32)
        yield f"set {name} {value:g}", _values(d, message)
    typed = wire.MAVLink_param_set_message(1, 1, b"FS_ACTION", 2.0, wire.MAV_PARAM_TYPE_INT32)
    yield "set with another type", _values(d, typed)
    before = len(d.got)
    d.send(wire.MAVLink_param_request_list_message(1, 1))
    d.wait(20.0)
    rows = [m for m in d.got[before:] if m.get_type() == "PARAM_VALUE"]
    whole = len({m.param_index for m in rows if m.param_index != 65535}) == rows[0].param_count if rows else False
    yield "a download is whole", str(whole)
    yield "the number of parameters", str(rows[0].param_count if rows else 0)


def _read(d: Dialogue, name: str) -> str:
    return _values(d, wire.MAVLink_param_request_read_message(1, 1, name.encode(), -1))


def _values(d: Dialogue, message: wire.MAVLink_message) -> str:
    """The parameters that come, but for the ones that count the time by themselves."""
    before = len(d.got)
    d.send(message)
    d.wait(0.2)
    values = [m for m in d.got[before:] if m.get_type() == "PARAM_VALUE"]
    return in_words([m for m in values if m.param_id not in ("STAT_RUNTIME", "STAT_FLTTIME")])


def messages(d: Dialogue) -> Answers:
    """For each message: its interval, asked for once, at 10 Hz, off."""
    d.settle()
    for number in MESSAGES:
        name = _name(number)
        yield f"message {number} {name}: interval", d.command(wire.MAV_CMD_GET_MESSAGE_INTERVAL, number)
        yield f"message {number} {name}: once", d.command(wire.MAV_CMD_REQUEST_MESSAGE, number)
        said = d.command(wire.MAV_CMD_SET_MESSAGE_INTERVAL, number, 200_000, seconds=0.05)
        count = sum(m.get_type() == name for m in d.wait(1.5))
        then = "comes" if count >= 5 else f"{count} came" if count else "does not come"
        then = then if number else "beats"
        off = d.command(wire.MAV_CMD_SET_MESSAGE_INTERVAL, number, -1 if number else 1e6)
        yield f"message {number} {name}: 5 Hz", f"{said}; {then}; {off}"
    for interval_us in (1, 500, 5_999, 6_250, 10_000, 33_333, 1e6, 7e7, 0, -1, -2):
        said = d.command(wire.MAV_CMD_SET_MESSAGE_INTERVAL, 30, interval_us, seconds=0.05)
        said = f"{said}; {d.command(wire.MAV_CMD_GET_MESSAGE_INTERVAL, 30)}"
        yield f"ATTITUDE every {interval_us:g} us", said.replace("ATTITUDE; ", "")


def _name(number: int) -> str:
    return wire.mavlink_map[number].msgname if number in wire.mavlink_map else "?"


def streams(d: Dialogue) -> Answers:
    """What comes unasked, and what REQUEST_DATA_STREAM changes."""
    d.settle(quiet=False)
    for name, count in sorted(Counter(m.get_type() for m in d.wait(10.5)).items()):
        if name not in ("STATUSTEXT", "BAD_DATA", "TIMESYNC", "PARAM_VALUE"):
            yield f"unasked {name}", f"every {round(10.5 / count, 0):g} s"
    d.send(wire.MAVLink_request_data_stream_message(1, 1, 0, 0, 0))
    for stream in (1, 2, 3, 4, 6, 10, 11, 12, 99):
        d.send(wire.MAVLink_request_data_stream_message(1, 1, stream, 4, 1))
        d.wait(0.5)
        kinds = {m.get_type() for m in d.wait(1.5)} - {"HEARTBEAT", "TIMESYNC", "STATUSTEXT", "PARAM_VALUE"}
        for kind in sorted(kinds) or ["nothing"]:
            yield f"data stream {stream} {kind}", "comes"
        d.send(wire.MAVLink_request_data_stream_message(1, 1, stream, 4, 0))
        d.wait(0.3)


def addresses(d: Dialogue) -> Answers:
    """Who is meant, and by whom."""
    d.settle()
    for target in ((1, 1), (0, 0), (1, 0), (0, 1), (0, 50), (1, 50), (1, 191), (1, 154), (2, 1), (2, 0), (255, 190)):
        yield f"command to {target}", d.ask(command(520, 1, target=target))
        read = wire.MAVLink_param_request_read_message(*target, b"FS_ACTION", -1)
        yield f"parameter from {target}", d.ask(read)
    for sender in (GROUND, (1, 1), (1, 190), (7, 7)):
        yield f"command by {sender}", d.ask(command(520, 1), sender)
    d.override = None
    for sender in (GROUND, (7, 7), (1, 50)):
        d.send(wire.MAVLink_rc_channels_override_message(0, 0, *NEUTRAL))
        d.wait(0.2)
        d.send(wire.MAVLink_rc_channels_override_message(0, 0, *NEUTRAL[:8], 1777, *NEUTRAL[9:]), sender)
        d.wait(0.2)
        yield f"override by {sender}", str(_channel(d, 9))
    d.override = NEUTRAL
    yield "TIMESYNC", d.ask(wire.MAVLink_timesync_message(0, 4711))
    yield "TIMESYNC answered", d.ask(wire.MAVLink_timesync_message(5, 4711))
    yield "PING", d.ask(wire.MAVLink_ping_message(1, 5, 0, 0))
    yield "SYSTEM_TIME", d.ask(wire.MAVLink_system_time_message(1_700_000_000_000_000, 1))
    yield "LOG_REQUEST_LIST", d.ask(wire.MAVLink_log_request_list_message(1, 1, 1, 1)).split(" ")[0]
    yield "MANUAL_CONTROL", d.ask(wire.MAVLink_manual_control_message(1, 0, 0, 0, 0, 0))


def _channel(d: Dialogue, number: int) -> int | None:
    got = d.latest(65, "RC_CHANNELS")
    return getattr(got, f"chan{number}_raw") if got is not None else None


def overrides(d: Dialogue) -> Answers:
    """What an override puts on a channel, and what the gate makes of it."""
    d.settle()
    d.command(wire.MAV_CMD_DO_SET_MODE, 1, 0)
    d.command(wire.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    for channel in (1, 2, 5, 8, 9, 12, 13, 16, 17, 18):
        for value in (1, 800, 1600, 2200, 65533, 65534, 65535, 0):
            for held in (1555, value):
                d.override = [*NEUTRAL[: channel - 1], held, *NEUTRAL[channel:]]
                d.wait(0.3)
            yield f"channel {channel} at {value}", str(_channel(d, channel))
        d.override = NEUTRAL
    for value in (900, 1099, 1100, 1300, 1499, 1500, 1501, 1700, 1900, 1901, 2200):
        d.override = [*NEUTRAL[:8], *[value] * 4, *NEUTRAL[12:]]
        d.wait(0.3)
        got = d.latest(36, "SERVO_OUTPUT_RAW")
        yield f"gate at {value}", str([getattr(got, f"servo{n}_raw") for n in (1, 2, 3, 4)] if got else None)
    for name, act in (("HOLD", command(176, 1, 4)), ("disarmed", command(400, 0))):
        d.ask(act)
        got = d.latest(36, "SERVO_OUTPUT_RAW")
        yield f"gate at 2200, {name}", str([getattr(got, f"servo{n}_raw") for n in (1, 2, 3, 4)] if got else None)
    d.override = None
    for seconds in (1.0, 2.0):
        before = len(d.got)
        d.wait(seconds)
        yield f"silence, second {seconds:g}", f"{in_words(d.got[before:])} -> {d.state()}"


FOLDER, SCRIPT = b"/asked", b"/asked/asked.lua"
FILES: tuple[tuple[str, int, bytes, int], ...] = (
    ("nothing", 0, b"", 0), ("terminate", 1, b"", 0), ("reset", 2, b"", 0), ("list /", 3, b"/", 0),
    ("make a folder", 9, FOLDER, 0), ("make it again", 9, FOLDER, 0), ("list nowhere", 3, b"/nowhere", 0),
    ("list without a name", 3, b"", 0), ("list with its NUL", 3, b"/\0", 0), ("list beyond", 3, FOLDER, 99),
    ("list @SYS", 3, b"@SYS", 0), ("read unopened", 5, b"", 0), ("write unopened", 7, b"abc", 0),
    ("burst unopened", 15, b"", 0), ("open nowhere", 4, b"/nowhere.txt", 0), ("open a folder", 4, FOLDER, 0),
    ("reset the folder", 2, b"", 0), ("open @SYS/uarts.txt", 4, b"@SYS/uarts.txt", 0), ("read it", 5, b"", 0),
    ("open a second", 4, SCRIPT, 0), ("terminate @SYS", 1, b"", 0), ("open @PARAM", 4, b"@PARAM/param.pck", 0),
    ("read @PARAM", 5, b"", 0), ("reset @PARAM", 2, b"", 0), ("create with its NUL", 6, SCRIPT + b"\0", 0),
    ("reset created", 2, b"", 0), ("create", 6, SCRIPT, 0), ("create a second", 6, FOLDER + b"/other.lua", 0),
    ("write", 7, b"-- asked", 0), ("read while writing", 5, b"", 0), ("write further on", 7, b"more", 8),
    ("terminate written", 1, b"", 0), ("list the folder", 3, FOLDER, 0), ("list it with a slash", 3, FOLDER + b"/", 0),
    ("checksum", 14, SCRIPT, 0), ("checksum of nothing", 14, b"/nowhere.txt", 0), ("open", 4, SCRIPT, 0),
    ("read", 5, b"", 0), ("read beyond", 5, b"", 500), ("write while reading", 7, b"x", 0), ("burst", 15, b"", 0),
    ("terminate read", 1, b"", 0), ("open to write", 11, SCRIPT, 0), ("terminate opened", 1, b"", 0),
    ("create in no folder", 6, b"/nowhere/x.lua", 0), ("rename", 13, SCRIPT + b"\0/asked/other.lua", 0),
    ("rename with its NUL", 13, b"/asked/other.lua\0/asked/third.lua\0", 0), ("rename nothing", 13, b"/no\0/yes", 0),
    ("truncate", 12, b"x", 0), ("remove a file", 8, b"/asked/third.lua", 0),
    ("remove another", 8, b"/asked/other.lua", 0),
    ("remove it again", 8, b"/asked/other.lua", 0), ("remove the folder", 10, FOLDER, 0), ("opcode 77", 77, b"", 0),
)  # fmt: skip


def files(d: Dialogue) -> Answers:
    """MAVLink FTP, one request after the other."""
    d.settle()
    for sequence, (name, opcode, data, offset) in enumerate(FILES):
        size = len(data) or (80 if opcode in (5, 15) else 0)
        head = struct.pack("<HBBBBBBI", 3 * sequence, 0, opcode, size, 0, 0, 0, offset)
        payload = (head + data).ljust(251, b"\0")
        yield f"file: {name}", d.ask_file(payload)


def missions(d: Dialogue) -> Answers:
    """Mission protocol, home and origin."""
    d.settle()
    yield "mission: list", d.ask(wire.MAVLink_mission_request_list_message(1, 1), seconds=0.8)
    yield "mission: fence list", d.ask(wire.MAVLink_mission_request_list_message(1, 1, 1), seconds=0.8)
    yield "mission: rally list", d.ask(wire.MAVLink_mission_request_list_message(1, 1, 2), seconds=0.8)
    yield "mission: item that is not there", d.ask(wire.MAVLink_mission_request_int_message(1, 1, 7), seconds=0.8)
    yield "mission: upload of 2", d.ask(wire.MAVLink_mission_count_message(1, 1, 2), seconds=0.8)
    for seq in (0, 1):
        item = wire.MAVLink_mission_item_int_message(1, 1, seq, 3, 16, 0, 1, 0, 0, 0, 0, 129915000 + seq, 802337000, 0)
        yield f"mission: item {seq}", d.ask(item, seconds=1.0)
    yield "mission: count then", d.ask(wire.MAVLink_mission_request_list_message(1, 1), seconds=0.8)
    yield "mission: item 1 read back", d.ask(wire.MAVLink_mission_request_int_message(1, 1, 1), seconds=0.8)
    yield "mission: item 1 read back as float", d.ask(wire.MAVLink_mission_request_message(1, 1, 1))
    yield "mission: acknowledged", d.ask(wire.MAVLink_mission_ack_message(1, 1, 0))
    yield "mission: set current 1", d.ask(wire.MAVLink_mission_set_current_message(1, 1, 1))
    yield "mission: set current 9", d.ask(wire.MAVLink_mission_set_current_message(1, 1, 9))
    yield "mission: AUTO", f"{d.command(176, 1, 10)} -> {d.state()}"
    yield "mission: start", d.command(300)
    d.command(176, 1, 4)
    yield "mission: clear", d.ask(wire.MAVLink_mission_clear_all_message(1, 1))
    yield "mission: count at last", d.ask(wire.MAVLink_mission_request_list_message(1, 1), seconds=0.8)
    yield "home before", d.command(410)
    yield "origin before", d.command(512, 49)
    yield "origin set", d.ask(wire.MAVLink_set_gps_global_origin_message(1, 129915000, 802337000, 0), seconds=0.6)
    yield "origin then", d.command(512, 49)
    yield "home set", d.command(179, 0, 0, 0, 0, 12.9916, 80.2338, 0, seconds=0.6)
    yield "home then", d.command(410)
    yield "origin set again", d.ask(wire.MAVLink_set_gps_global_origin_message(1, 139915000, 802337000, 0), seconds=0.6)
