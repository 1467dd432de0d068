"""A simulated UWB tag: measured ranges in, the bytes of the chosen wire format out. Sans-I/O.

Noise, non-line-of-sight and dropouts are the caller's: `cycle` takes ranges as measured, None for an anchor
that stayed silent. Positions are in the frame in which the anchors were set up (x east, y north, z up).
The DWM1001 formats are a whole module that has to be spoken to (`Dwm1001Module`); the others ignore input.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from drivers.uwb import linktrack, makerfabs, mauwb, trek1000
from drivers.uwb.dwm1001 import AnchorReport, TagFix, Xyz
from sim.world.dwm1001_module import Dwm1001Module

FORMATS: dict[str, str] = {
    "dwm1001-lec": "dwm1001-lec",
    "dwm1001-lep": "dwm1001-lep",
    "dwm1001-les": "dwm1001-les",
    "dwm1001-tlv": "dwm1001-tlv",
    "makerfabs": "makerfabs",
    "makerfabs-json": "makerfabs",
    "mauwb": "mauwb",
    "mauwb-rssi": "mauwb",
    "mauwb-demo": "mauwb",
    "trek1000": "trek1000",
    "linktrack": "linktrack",
}
"""Format of the simulated tag -> wire format of the codec that reads it (variants share a codec)."""

QUALITY = 97  # of positions and ranges, where the format has one; assumed
RSSI_DBM = -78.0  # assumed
_ID = {
    "dwm1001": (re.compile(r"[0-9A-F]{4}"), "four hexadecimal digits"),
    "makerfabs": (re.compile(r"[1-9A-F][0-9A-F]{0,3}"), "one to four hexadecimal digits, no leading zero"),
    "mauwb": (re.compile(r"[0-7]"), "0 to 7"),
    "trek1000": (re.compile(r"[0-7]"), "0 to 7"),
    "linktrack": (re.compile(r"1?\d?\d"), "0 to 199"),
}


class UwbTag:
    """One tag. `anchors`: ID -> place [m, set-up frame]; `tag_id`: its number where the format has one.

    `streaming`: a DWM1001 whose stream runs already when the companion connects. Raises ValueError for an
    unknown format or an anchor ID that the format cannot carry.
    """

    def __init__(
        self,
        wire_format: str,
        *,
        anchors: Mapping[str, Xyz],
        tag_id: int = 1,
        rate_hz: float = 1.0,
        streaming: bool = False,
    ) -> None:
        if wire_format not in FORMATS:
            raise ValueError(f"unknown UWB format {wire_format!r}; known: {', '.join(FORMATS)}")
        pattern, meaning = _ID[wire_format.split("-", maxsplit=1)[0]]
        for anchor in anchors:
            if not pattern.fullmatch(anchor):
                raise ValueError(f"anchor ID {anchor!r}: {wire_format} needs {meaning}")
        self._anchors = dict(anchors)
        self._tag_id = tag_id
        self._rate_hz = rate_hz
        self._count = -1
        self._held_m: dict[str, float] = {}
        stream = wire_format.removeprefix("dwm1001-")
        is_dwm1001 = stream != wire_format
        running = stream if streaming and stream != "tlv" else None
        self.module = Dwm1001Module(rate_hz, running) if is_dwm1001 else None
        self._encode = self._dwm1001 if is_dwm1001 else self._encoder(wire_format)

    @property
    def rate_hz(self) -> float:
        """Cycles per second at which `cycle` should be called now (a DWM1001 can be told another rate)."""
        return self._rate_hz if self.module is None else self.module.rate_hz

    def cycle(self, ranges_m: Mapping[str, float | None], position_m: Xyz | None, t_ns: int) -> bytes:
        """Bytes of one cycle. `ranges_m`: anchor -> measured range [m], None: silent; `t_ns`: now.

        `position_m`: what the tag itself would compute, None: no fix.
        """
        self._count += 1
        heard = {anchor: r for anchor in self._anchors if (r := ranges_m.get(anchor)) is not None}
        return self._encode(heard, position_m, t_ns)

    def receive(self, data: bytes, t_ns: int) -> bytes:
        """What the tag answers at once to bytes from the companion."""
        return b"" if self.module is None else self.module.receive(data, t_ns)

    def _encoder(self, wire_format: str) -> Callable[[dict[str, float], Xyz | None, int], bytes]:
        return {
            "makerfabs": self._makerfabs,
            "makerfabs-json": self._makerfabs_json,
            "mauwb": self._mauwb,
            "mauwb-rssi": self._mauwb_rssi,
            "mauwb-demo": self._mauwb_demo,
            "trek1000": self._trek1000,
            "linktrack": self._linktrack,
        }[wire_format]

    def _dwm1001(self, heard_m: dict[str, float], position_m: Xyz | None, t_ns: int) -> bytes:
        assert self.module is not None
        reports = [AnchorReport(a, self._anchors[a], r, QUALITY) for a, r in heard_m.items()]
        fix = None if position_m is None else TagFix(position_m, QUALITY)
        return self.module.cycle(reports, fix, t_ns)

    def _makerfabs(self, heard_m: dict[str, float], position_m: Xyz | None, t_ns: int) -> bytes:
        debug = b"".join(makerfabs.encode_debug(a, r, RSSI_DBM) for a, r in heard_m.items())
        return debug + self._makerfabs_json(heard_m, position_m, t_ns)

    def _makerfabs_json(self, heard_m: dict[str, float], _position: Xyz | None, _t_ns: int) -> bytes:
        """The links of silent anchors keep their last value; the vendor's smoothing is left out."""
        self._held_m.update(heard_m)
        return makerfabs.encode_links(self._held_m)

    def _mauwb(self, heard_m: dict[str, float], _position: Xyz | None, _t_ns: int) -> bytes:
        return mauwb.encode_at(self._tag_id, self._count, _numbered(heard_m))

    def _mauwb_rssi(self, heard_m: dict[str, float], _position: Xyz | None, _t_ns: int) -> bytes:
        rssi = {int(a): RSSI_DBM for a in heard_m}
        return mauwb.encode_at(self._tag_id, self._count, _numbered(heard_m), rssi_dbm=rssi, ancid=False)

    def _mauwb_demo(self, heard_m: dict[str, float], _position: Xyz | None, _t_ns: int) -> bytes:
        return mauwb.encode_demo(self._tag_id, _numbered(heard_m))

    def _trek1000(self, heard_m: dict[str, float], _position: Xyz | None, t_ns: int) -> bytes:
        places = 4 if all(int(a) < 4 for a in self._anchors) else 8
        ranges = [heard_m.get(str(i)) for i in range(places)]
        count, time_ms = self._count, t_ns // 1_000_000
        return b"".join(
            trek1000.encode_line(kind, ranges, number=count, seq=count, time=time_ms, tag=self._tag_id)
            for kind in ("mc", "mr")
        )

    def _linktrack(self, heard_m: dict[str, float], position_m: Xyz | None, t_ns: int) -> bytes:
        time_ms = t_ns // 1_000_000
        return linktrack.encode_node_frame2(self._tag_id, time_ms, _numbered(heard_m), position_m, RSSI_DBM)


def _numbered(heard_m: dict[str, float]) -> dict[int, float]:
    return {int(anchor): r for anchor, r in heard_m.items()}
