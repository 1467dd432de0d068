"""Questions by MAVLink to an autopilot in a stepped world, and its answers in words that two autopilots can share.

An answer leaves out what is chance or content of a sensor: times, counters, sequence numbers, values of streams. Of a
message without a row in `_FIELDS` its type is all that counts. Words are sorted, and the same word counts once.
"""

from __future__ import annotations

import re
import struct
import time
from collections.abc import Callable, Sequence

from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.stepped import SteppedWorld

S = 1_000_000_000
PEER = "asker"
COMPANION = (1, 191)
GROUND = (255, 190)
SETTLE_S = 30.0
"""The firmware's estimator is initialised and its inertial sensors agree by then: 18 s observed."""
PERIOD_S = 0.1
PATIENCE_S, FILE_ANSWER = 5.0, "FILE_TRANSFER_PROTOCOL"
"""How long [s, this machine's clock] an answer about files is waited for; assumed."""
NEUTRAL = [1500] * 4 + [65535] * 4 + [1500] * 4 + [0] * 6
_UNASKED = re.compile(r"EKF|AHRS|GPS|Barometer|ArduRover|Beginning INS|gate:|[A-Z][0-9a-f]{24}|PreArm: (AHRS|Radio)")
"""What the firmware says by itself: while it settles, its name and that of the board, every 30 s why it would not arm.
How texts begin."""
_COUNTERS = frozenset({"STAT_RUNTIME", "STAT_FLTTIME", "STAT_RESET", "MIS_TOTAL", "SIM_PIN_MASK"})
"""Parameters that the firmware changes and tells by itself."""

_FIELDS: dict[str, tuple[str, ...]] = {
    "COMMAND_ACK": ("command", "result", "target_system", "target_component"),
    "MESSAGE_INTERVAL": ("message_id", "interval_us"),
    "MISSION_ACK": ("type", "mission_type"),
    "MISSION_COUNT": ("count", "mission_type"),
    "MISSION_CURRENT": ("seq",),
    "MISSION_ITEM_INT": ("seq", "frame", "command", "x", "y", "mission_type"),
    "MISSION_REQUEST": ("seq", "mission_type"),
    "MISSION_REQUEST_INT": ("seq", "mission_type"),
    "HOME_POSITION": ("latitude", "longitude"),
    "GPS_GLOBAL_ORIGIN": ("latitude", "longitude"),
    "LOG_ENTRY": ("id", "num_logs"),
    "PING": ("seq", "target_system"),
}
"""What of a message is compared, by its type."""


class Dialogue:
    """One asker on the wire of `world`. `override`: channels that are held meanwhile, at 10 Hz; None: none."""

    def __init__(self, world: SteppedWorld):
        self.world = world
        self.override: Sequence[int] | None = NEUTRAL
        self.got: list[wire.MAVLink_message] = []
        self._parser = wire.MAVLink(None)
        self._parser.robust_parsing = True
        self._senders: dict[tuple[int, int], wire.MAVLink] = {}
        self._due_ns = 0
        world.add_peer(PEER)

    def send(self, message: wire.MAVLink_message, sender: tuple[int, int] = COMPANION) -> None:
        """One message now, from a system and component."""
        mav = self._senders.setdefault(sender, wire.MAVLink(None, *sender))
        data = message.pack(mav)
        mav.seq = (mav.seq + 1) % 256
        self._take(self.world.mavlink(data, PEER))

    def wait(self, seconds: float) -> list[wire.MAVLink_message]:
        """Step that long; what came."""
        before, end_ns = len(self.got), self.world.t_ns + round(seconds * S)
        while self.world.t_ns < end_ns:
            if self.override is not None and self.world.t_ns >= self._due_ns:
                self._due_ns = self.world.t_ns + round(PERIOD_S * S)
                self.send(wire.MAVLink_rc_channels_override_message(0, 0, *self.override))
            for _, data in self.world.step().mavlink:
                self._take(data)
        return self.got[before:]

    def ask(self, message: wire.MAVLink_message, sender: tuple[int, int] = COMPANION, seconds: float = 0.3) -> str:
        """Send and wait: the answer in words."""
        before = len(self.got)
        self.send(message, sender)
        self.wait(seconds)
        return in_words(self.got[before:])

    def ask_file(self, payload: bytes) -> str:
        """The same for a file transfer. A firmware has a thread of its own for files, by this machine's clock."""
        before, end_s = len(self.got), time.monotonic() + PATIENCE_S
        self.send(wire.MAVLink_file_transfer_protocol_message(0, 1, 1, payload))
        self.wait(0.5)
        while time.monotonic() < end_s and not any(m.get_type() == FILE_ANSWER for m in self.got[before:]):
            self.wait(PERIOD_S)
        return in_words(self.got[before:])

    def command(self, number: int, *params: float, seconds: float = 0.3) -> str:
        """A COMMAND_LONG to 1/1."""
        return self.ask(command(number, *params), seconds=seconds)

    def state(self) -> str:
        """Mode and arming, from the heartbeat."""
        beat = self.latest(0, "HEARTBEAT")
        return f"base {beat.base_mode} mode {beat.custom_mode} type {beat.type}" if beat else "no heartbeat"

    def latest(self, message_id: int, name: str) -> wire.MAVLink_message | None:
        """A message that is asked for once; None where it does not come."""
        before = len(self.got)
        self.send(command(wire.MAV_CMD_REQUEST_MESSAGE, message_id))
        self.wait(0.3)
        return next((m for m in reversed(self.got[before:]) if m.get_type() == name), None)

    def settle(self, quiet: bool = True) -> Dialogue:
        """Past the start; `quiet`: then everything that streams by itself is off, but heartbeats."""
        self.wait(SETTLE_S)
        if quiet:
            self.send(wire.MAVLink_request_data_stream_message(1, 1, wire.MAV_DATA_STREAM_ALL, 0, 0))
            self.wait(1.0)
        return self

    def _take(self, data: bytes) -> None:
        self.got += self._parser.parse_buffer(data) or []


def command(number: int, *params: float, target: tuple[int, int] = (1, 1)) -> wire.MAVLink_message:
    """A COMMAND_LONG."""
    values = [float(p) for p in params] + [0.0] * (7 - len(params))
    return wire.MAVLink_command_long_message(*target, number, 0, *values)


def command_int(number: int, *params: float) -> wire.MAVLink_message:
    """A COMMAND_INT: params 5 and 6 are whole."""
    p = [float(value) for value in params] + [0.0] * (7 - len(params))
    return wire.MAVLink_command_int_message(1, 1, 0, number, 0, 0, *p[:4], int(p[4]), int(p[5]), p[6])


def in_words(messages: Sequence[wire.MAVLink_message]) -> str:
    """What the messages say; heartbeats and the autopilot's own TIMESYNC say nothing."""
    words = set()
    text = ""
    for message in filter(_says_something, messages):
        kind = message.get_type()
        if kind == "STATUSTEXT":
            text = (text if message.chunk_seq else "") + message.text
            if message.id == 0 or len(message.text) < 50:
                words |= {f"text {message.severity} {text}"} if not _UNASKED.match(text) else set()
        elif kind in _WORDS:
            words.add(_WORDS[kind](message))
        else:
            fields = " ".join(str(getattr(message, name)) for name in _FIELDS.get(kind, ()))
            words.add(f"{kind} {fields}".strip())
    return "; ".join(sorted(words)) or "nothing"


def _says_something(message: wire.MAVLink_message) -> bool:
    kind = message.get_type()
    if kind == "PARAM_VALUE":
        return message.param_id not in _COUNTERS or message.param_index != 65535
    if kind.startswith("UNKNOWN_"):  # newer than the dialect at hand
        return False
    return kind not in ("HEARTBEAT", "BAD_DATA") and (kind != "TIMESYNC" or message.tc1 != 0)


def _parameter(message: wire.MAVLink_message) -> str:
    named = "by name" if message.param_index == 65535 else "by index"
    return f"{message.param_id} = {message.param_value:.6g} type {message.param_type} {named}"


def _file(message: wire.MAVLink_message) -> str:
    payload = bytes(message.payload)
    _, session, opcode, size, asked, _, _, _ = struct.unpack_from("<HBBBBBBI", payload)
    what = {128: "ack", 129: f"nak {payload[12]}"}.get(opcode, str(opcode))
    return f"file {what} to {asked}, session {session}, {'data' if opcode == 128 and size else 'no data'}"


_WORDS: dict[str, Callable[[wire.MAVLink_message], str]] = {
    "PARAM_VALUE": _parameter,
    "FILE_TRANSFER_PROTOCOL": _file,
    "AUTOPILOT_VERSION": lambda m: f"AUTOPILOT_VERSION {m.flight_sw_version >> 16:#x} {m.capabilities}",
    "TIMESYNC": lambda m: f"TIMESYNC of {m.ts1}",
}
