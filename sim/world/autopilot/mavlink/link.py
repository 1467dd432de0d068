"""One MAVLink peer: its own sequence numbers, message rates, parameter download and outgoing bytes.

Rates: an interval is cut to whole milliseconds and at most 80 % of SCHED_LOOP_RATE; what is asked for faster is
capped without a word (4.6) or denied (4.7). While a
parameter download runs every stream slows to 34/50 of its rate, as was seen on the real firmware.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot.mavlink.signing import FirmwareSigningKey
from sim.world.autopilot.mavlink.streams import ALWAYS_NS, STREAMED
from sim.world.autopilot.parameter_table import TABLE
from sim.world.autopilot.vehicle import SimulatedVehicle

_MS = 1_000_000
_NEVER = 2**63
_PARAMETER_NS = 2 * _MS  # 500 a second: a real download of 1272 took 1.3 to 3.3 s
_SLOWED_NUM, _SLOWED_DEN = 50, 34
_CHUNK = 50
NO_INDEX = 65535


class PeerLink:
    """`bad_data`: pieces of bytes that were no message; `serial`: the number of the port it comes in on; `heard`:
    systems and components that have spoken on it.
    """

    def __init__(self, vehicle: SimulatedVehicle, key: FirmwareSigningKey, serial: int):
        self.mav = wire.MAVLink(None, srcSystem=vehicle.system_id, srcComponent=1)
        self.mav.robust_parsing = True
        self.bad_data = 0
        self.heard: set[tuple[int, int]] = set()
        self.serial = serial
        self._key = key
        self.install_key()
        self._vehicle = vehicle
        self._outbox = bytearray()
        self._intervals_ns: dict[int, int] = {}
        self._due_ns: dict[int, int] = {}
        self._group_hz: dict[str, int] = {}
        self._next_ns = 0
        self._text_id = 0
        self._download = len(TABLE)
        self._download_ns = 0
        for message_id, streamed in STREAMED.items():
            interval_ns = ALWAYS_NS.get(message_id) or self._default_ns(streamed.group)
            self._schedule(message_id, interval_ns)
        self._due_ns[0] = vehicle.t_ns  # a heartbeat at once

    # --- out ---------------------------------------------------------------------------------------

    def send(self, message: wire.MAVLink_message) -> None:
        """Append one packed message."""
        self._outbox += message.pack(self.mav)
        self._key.learn(self.mav)
        self.mav.seq = (self.mav.seq + 1) % 256

    def take(self) -> bytes:
        """All bytes waiting, which are then gone."""
        data = bytes(self._outbox)
        self._outbox.clear()
        return data

    def send_text(self, severity: int, text: str) -> None:
        """STATUSTEXT, in chunks of 50 with a common id where it is longer."""
        data = text.encode("ascii", "replace")
        if len(data) <= _CHUNK:
            self.send(wire.MAVLink_statustext_message(severity, data))
            return
        self._text_id = self._text_id % 65535 + 1
        for chunk in range(len(data) // _CHUNK + 1):  # the last one is never full: its zero ends the text
            piece = data[chunk * _CHUNK : (chunk + 1) * _CHUNK]
            self.send(wire.MAVLink_statustext_message(severity, piece, self._text_id, chunk))

    def send_parameter(self, index: int, by_index: bool) -> None:
        """PARAM_VALUE of the parameter at `index` of the table; it says 65535 where it was not asked by index."""
        parameters, row = self._vehicle.parameters, TABLE[index]
        name, told = parameters.wire_name(index).encode(), index if by_index else NO_INDEX
        self.send(wire.MAVLink_param_value_message(name, parameters[row.name], row.kind, len(TABLE), told))

    def install_key(self) -> None:
        """Sign and check with the autopilot's signing key from now on."""
        self._key.install(self.mav, link_id=self.serial, secure=self.serial == 0)

    # --- rates -------------------------------------------------------------------------------------

    def interval_us(self, message_id: int) -> int:
        """Interval of a message [us], -1 where it is off."""
        interval_ns = self._intervals_ns.get(message_id, 0)
        return interval_ns // 1000 if interval_ns else -1

    def set_interval_us(self, message_id: int, interval_us: float) -> bool:
        """SET_MESSAGE_INTERVAL of a message in STREAMED: 0 default rate, -1 off; whether it is granted."""
        denies = self._vehicle.parameters.firmware.denies_fast_streams
        if denies and interval_us not in (0, -1) and interval_us * 1000 < self._shortest_ns:
            return False
        if interval_us == 0:
            always_ns = ALWAYS_NS.get(message_id)
            self._schedule(message_id, always_ns or self._default_ns(STREAMED[message_id].group))
        elif interval_us == -1:
            self._schedule(message_id, 0)
        else:
            self._schedule(message_id, max(1, int(min(interval_us, 60e6)) // 1000) * _MS)
        return True

    def set_group_rate(self, groups: tuple[str, ...], rate_hz: int) -> None:
        """REQUEST_DATA_STREAM: every message of these groups at one rate, 0 off."""
        self._group_hz.update(dict.fromkeys(groups, rate_hz))
        for message_id, streamed in STREAMED.items():
            if streamed.group in groups:
                self._schedule(message_id, 1000 // min(rate_hz, 1000) * _MS if rate_hz > 0 else 0)

    def _default_ns(self, group: str) -> int:
        if not group:
            return 0
        rate_hz = self._group_hz.get(group, self._vehicle.parameters[f"SR0_{group}"])
        return int(1000 / rate_hz) * _MS if rate_hz > 0 else 0

    @property
    def _shortest_ns(self) -> int:
        return int(1250 / self._vehicle.loop_rate_hz) * _MS

    def _schedule(self, message_id: int, interval_ns: int) -> None:
        if interval_ns <= 0:
            self._intervals_ns.pop(message_id, None)
            self._due_ns.pop(message_id, None)
        else:
            self._intervals_ns[message_id] = max(interval_ns, self._shortest_ns)
            self._due_ns[message_id] = self._vehicle.t_ns + self._intervals_ns[message_id]
        self._next_ns = 0

    # --- time --------------------------------------------------------------------------------------

    def start_download(self) -> None:
        """PARAM_REQUEST_LIST: send every parameter, from the first."""
        self._download = 0
        self._download_ns = self._next_ns = self._vehicle.t_ns

    def poll(self) -> None:
        """Send what is due at the vehicle's time."""
        t_ns = self._vehicle.t_ns
        if t_ns < self._next_ns:
            return
        downloading = self._advance_download(t_ns)
        for message_id, due_ns in self._due_ns.items():
            if due_ns <= t_ns:
                message = STREAMED[message_id].build(self._vehicle)
                if message is not None:
                    self.send(message)
                interval_ns = self._intervals_ns[message_id]
                if downloading:
                    interval_ns = interval_ns * _SLOWED_NUM // _SLOWED_DEN
                next_ns = due_ns + interval_ns
                self._due_ns[message_id] = next_ns if next_ns > t_ns else t_ns + interval_ns
        self._next_ns = min(self._due_ns.values(), default=_NEVER)
        if downloading:
            self._next_ns = min(self._next_ns, self._download_ns)

    def _advance_download(self, t_ns: int) -> bool:
        while self._download < len(TABLE) and self._download_ns <= t_ns:
            self.send_parameter(self._download, by_index=True)
            self._download += 1
            self._download_ns += _PARAMETER_NS
        return self._download < len(TABLE)
