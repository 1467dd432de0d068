"""The mission protocol: lists of items that are stored and handed back; nothing flies them.

    MISSION_COUNT          begins an upload; each item is asked for with MISSION_REQUEST, the last one acknowledged
    MISSION_REQUEST_LIST   the number of items;    MISSION_REQUEST_INT, MISSION_REQUEST   one of them

One list a mission type: mission 0, fence 1, rally 2. MIS_TOTAL follows the mission. While one peer uploads, all other
requests are denied. Source: ArduPilot, MissionItemProtocol.cpp; https://mavlink.io/en/services/mission.html
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot.mavlink.link import PeerLink

_ACCEPTED, _ERROR, _UNSUPPORTED, _INVALID_SEQUENCE, _DENIED = 0, 1, 3, 13, 14
_TYPES = 0, 1, 2
_WARNING, _INFO = 4, 6
_SCALE = 1e-7
_OFTEN_NS = 8_000_000_000
"""An upload that says nothing for so long is given up."""


@dataclass
class _Upload:
    sender: tuple[int, int]
    type: int
    count: int
    due_ns: int


class MissionStore:
    """`items`: by mission type. `say(severity, text)`, `on_total(n)`: a mission of another size is stored.

    `names_the_fault`: an item that is not there is an invalid sequence (4.7), not an error (4.6).
    """

    def __init__(self, say: Callable[[int, str], None], on_total: Callable[[int], None], names_the_fault: bool):
        self.items: dict[int, list[Any]] = {kind: [] for kind in _TYPES}
        self.current = 0
        self._say, self._on_total = say, on_total
        self._missing = _INVALID_SEQUENCE if names_the_fault else _ERROR
        self._upload: _Upload | None = None
        self._warned = False

    def receive(self, link: PeerLink, message: Any, t_ns: int) -> None:
        """One message of the protocol."""
        kind, sender = message.mission_type, (message.get_srcSystem(), message.get_srcComponent())
        if self._upload is not None and t_ns > self._upload.due_ns:
            self._upload = None
        if kind not in _TYPES:
            _acknowledge(link, message, _UNSUPPORTED, kind)
            return
        name = message.get_type()
        busy = self._upload is not None and (sender != self._upload.sender or name != "MISSION_COUNT")
        if name == "MISSION_ITEM_INT":
            self._item(link, message, sender, t_ns)
        elif busy:
            _acknowledge(link, message, _ERROR if name == "MISSION_CLEAR_ALL" else _DENIED, kind)
        elif name == "MISSION_COUNT":
            self._begin(link, message, sender, t_ns)
        elif name == "MISSION_REQUEST_LIST":
            link.send(wire.MAVLink_mission_count_message(*sender, len(self.items[kind]), kind))
        elif name == "MISSION_CLEAR_ALL":
            self._store(kind, [])
            _acknowledge(link, message, _ACCEPTED, kind)
        else:
            self._hand_out(link, message, kind, as_float=name == "MISSION_REQUEST")

    def set_current(self, link: PeerLink, number: int) -> None:
        """MISSION_SET_CURRENT: an item that is there is answered with its number."""
        if number < len(self.items[0]):
            self.current = number
            link.send(wire.MAVLink_mission_current_message(number))

    def _begin(self, link: PeerLink, message: Any, sender: tuple[int, int], t_ns: int) -> None:
        kind = message.mission_type
        self._store(kind, [])
        if message.count == 0:
            _acknowledge(link, message, _ACCEPTED, kind)
            return
        self._upload = _Upload(sender, kind, message.count, t_ns + _OFTEN_NS)
        link.send(wire.MAVLink_mission_request_message(*sender, 0, kind))

    def _item(self, link: PeerLink, message: Any, sender: tuple[int, int], t_ns: int) -> None:
        upload = self._upload
        if upload is None:
            return
        stored = self.items[upload.type]
        if message.seq != len(stored):
            _acknowledge(link, message, _INVALID_SEQUENCE, upload.type)
            return
        if sender != upload.sender:
            _acknowledge(link, message, _DENIED, upload.type)
            return
        self._store(upload.type, [*stored, message])
        upload.due_ns = t_ns + _OFTEN_NS
        if len(self.items[upload.type]) < upload.count:
            link.send(wire.MAVLink_mission_request_message(*sender, message.seq + 1, upload.type))
            return
        self._upload = None
        self._say(_INFO, {0: "Flight plan received", 1: "Fence received", 2: "Rally points received"}[upload.type])
        _acknowledge(link, message, _ACCEPTED, upload.type)

    def _store(self, kind: int, items: list[Any]) -> None:
        before, self.items[kind] = len(self.items[kind]), items
        if kind == 0 and len(items) != before:
            self._on_total(len(items))

    def _hand_out(self, link: PeerLink, message: Any, kind: int, as_float: bool) -> None:
        to = message.get_srcSystem(), message.get_srcComponent()
        if message.seq >= len(self.items[kind]):
            if kind == 0:  # so that the peer learns how many there are
                link.send(wire.MAVLink_mission_count_message(*to, len(self.items[kind]), kind))
            _acknowledge(link, message, self._missing, kind)
            return
        item = self.items[kind][message.seq]
        head = (
            item.seq,
            item.frame,
            item.command,
            0,
            item.autocontinue,
            item.param1,
            item.param2,
            item.param3,
            item.param4,
        )
        if not as_float:
            link.send(wire.MAVLink_mission_item_int_message(*to, *head, item.x, item.y, item.z, kind))
            return
        if not self._warned:
            self._warned = True
            self._say(_WARNING, "got MISSION_REQUEST; use MISSION_REQUEST_INT!")
        link.send(wire.MAVLink_mission_item_message(*to, *head, item.x * _SCALE, item.y * _SCALE, item.z, kind))


def _acknowledge(link: PeerLink, message: Any, result: int, kind: int) -> None:
    to = message.get_srcSystem(), message.get_srcComponent()
    link.send(wire.MAVLink_mission_ack_message(*to, result, kind))
