"""Makerfabs ESP32 UWB / UWB Pro (DW1000): a JSON line per second among debug lines. 115200 8N1.

    {"links":[{"A":"1782","R":"1.0"},{"A":"1783","R":"0.9"}]}       R: metres as text, 0.1 m resolution
    from: 1782\\t Range: 1.02 m\\t RX power: -72.1 dBm               one raw range, 0.01 m resolution

Debug lines are preferred. They are printed as each range is made, so they carry the better number at the
better time; the vendor's example smooths R (mean of the new range and the two last means, starting from
zero: new links come in too short, moving ones lag) and repeats it for links that are gone. Once one debug
line was seen the JSON only ends a cycle and gives no range. Debug lines are gathered into one message until
the JSON comes, an anchor comes again, or one arrives more than GROUP_NS after the first of its group; the
message bears the arrival time of the last line in it and so may leave `feed` one line late.

Without debug lines the JSON gives the ranges, and the lost links among them must be guessed: a link is taken
for stale, and left out, when it kept its value for `STALE_CYCLES` lines while another one moved by
`STALE_MOVE_M`. Both numbers are assumed: at 0.5 m/s and 15 m a boat passing an anchor keeps a true range
within one step of 0.1 m for some 7 s. A resting boat is never affected. Until then the stale range does come
through: the estimator's gate must live with it.

Anchors are known by the hexadecimal short address as printed (upper case, no leading zeros).
Integrity: no checksum. Whole lines must match; a digit that became another digit cannot be seen.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import msgspec

from companion.core.messages import AnchorRange, Message
from drivers.uwb.lines import Garbage, Ignored, LineCodec, unique

STALE_CYCLES, STALE_MOVE_M = 8, 1.0  # lines, and metres; assumed, see above
GROUP_NS = 150_000_000  # assumed: one round of the tag's ranging with four anchors takes less
_DEBUG = re.compile(
    r"from: ?([0-9A-F]{1,4})\s+Range: ?(-?\d{1,4}\.\d\d) m"
    r"(?:\s+RX power: ?(?:(-\d{1,3}\.\d{1,2})|\d+\.\d+|nan|-?inf) dBm)"
)
_ID = re.compile(r"[0-9A-F]{1,4}")
_METRES = re.compile(r"-?\d{1,4}\.\d")


class _Link(msgspec.Struct, forbid_unknown_fields=True):
    A: str
    R: str


class _Links(msgspec.Struct, forbid_unknown_fields=True):
    links: list[_Link]


_DECODER = msgspec.json.Decoder(_Links)


@dataclass
class _Held:
    """How long a link has kept its value, and where the others were when it began [m]."""

    range_m: float
    cycles: int
    others_m: dict[str, float]


class MakerfabsCodec(LineCodec):
    """Codec of the Makerfabs DW1000 tags."""

    def __init__(self, tag: str) -> None:
        super().__init__(tag)
        self.start_bytes()

    def start_bytes(self) -> list[bytes]:
        """Forget half a line, the gathered ranges, and whether there are debug lines. Nothing to send."""
        self._group: dict[str, AnchorRange] = {}
        self._group_began_ns = self._group_last_ns = 0
        self._debug_seen = False
        self._held: dict[str, _Held] = {}
        return super().start_bytes()

    def _decode(self, line: str, t_ns: int) -> list[Message]:
        if match := _DEBUG.fullmatch(line):
            rssi_dbm = None if match[3] is None else float(match[3])
            return self._debug(AnchorRange(anchor=match[1], range_m=float(match[2]), rssi_dbm=rssi_dbm), t_ns)
        if line.startswith("{"):
            return self._json(line, t_ns)
        if "links" in line or "Range" in line or "from:" in line or not line.isprintable():
            raise Garbage("malformed")
        raise Ignored("text")

    def _debug(self, item: AnchorRange, t_ns: int) -> list[Message]:
        self._debug_seen = True
        full = item.anchor in self._group or (self._group and t_ns - self._group_began_ns > GROUP_NS)
        messages = self._flush() if full else []
        if not self._group:
            self._group_began_ns = t_ns
        self._group[item.anchor] = item
        self._group_last_ns = t_ns
        return messages

    def _flush(self) -> list[Message]:
        ranges, self._group = list(self._group.values()), {}
        return self._ranges(ranges, self._group_last_ns)

    def _json(self, line: str, t_ns: int) -> list[Message]:
        try:
            links = _DECODER.decode(line).links
        except msgspec.MsgspecError:
            raise Garbage("json") from None
        if not all(_ID.fullmatch(link.A) and _METRES.fullmatch(link.R) for link in links):
            raise Garbage("field")
        unique([link.A for link in links])
        if self._debug_seen:
            return self._flush()
        now_m = {link.A: float(link.R) for link in links}
        self._held = {anchor: self._follow(anchor, now_m) for anchor in now_m}
        fresh = [a for a in now_m if not self._stale(self._held[a], now_m)]
        if len(fresh) < len(now_m):
            self.counters.reasons["stale_link"] += len(now_m) - len(fresh)
        return self._ranges([AnchorRange(anchor=a, range_m=now_m[a]) for a in fresh], t_ns)

    def _follow(self, anchor: str, now_m: dict[str, float]) -> _Held:
        held = self._held.get(anchor)
        if held is not None and held.range_m == now_m[anchor]:
            held.cycles += 1
            return held
        return _Held(now_m[anchor], 0, {a: r for a, r in now_m.items() if a != anchor})

    def _stale(self, held: _Held, now_m: dict[str, float]) -> bool:
        moved_m = [abs(now_m[a] - before_m) for a, before_m in held.others_m.items() if a in now_m]
        return held.cycles >= STALE_CYCLES and max(moved_m, default=0.0) >= STALE_MOVE_M


def encode_links(ranges_m: Mapping[str, float]) -> bytes:
    """The JSON line: hexadecimal anchor ID -> range [m]. Resolution 0.1 m."""
    links = ",".join(f'{{"A":"{anchor}","R":"{r:.1f}"}}' for anchor, r in ranges_m.items())
    return f'{{"links":[{links}]}}\r\n'.encode("ascii")


def encode_debug(anchor: str, range_m: float, rssi_dbm: float) -> bytes:
    """One debug line. Resolution 0.01 m and 0.01 dBm."""
    return f"from: {anchor}\t Range: {range_m:.2f} m\t RX power: {rssi_dbm:.2f} dBm\r\n".encode("ascii")
