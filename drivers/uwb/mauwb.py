"""Makerfabs MaUWB (DW3000) with AT firmware: ranges only, the host computes positions.

    AT+RANGE=tid:7,mask:0F,seq:128,range:(997,1321,911,738,0,0,0,0),ancid:(0,1,2,3,-1,-1,-1,-1)
    AT+RANGE=tid:1,mask:04,seq:63,range:(0,0,30,0,0,0,0,0),rssi:(0.00,0.00,-77.93, ... )
    {"id":1,"range":[0,53,423,0,0,0,0,0]}

Ranges in centimetres, 0 = none; mask hexadecimal; `rssi` [dBm, 0 = none] and `ancid` both optional. The
anchor is `ancid` (-1: unused slot) where given, else the slot number; both as decimal text: "0", "1", ...
A range counts if the mask has the bit of its slot, or of its ancid (firmwares may differ; assumed).
115200 or 250000 8N1 by firmware.

Integrity: no checksum. Whole lines must match, lists must have equal lengths. Once a line with `ancid` was
seen, lines without it are cut ones and dropped, as their slots are not identities. A digit that became
another digit cannot be seen.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated

import msgspec

from companion.core.messages import AnchorRange, Message
from drivers.uwb.lines import Garbage, Ignored, LineCodec, unique

SLOTS = 8
_AT = re.compile(
    r"AT\+RANGE=tid:(\d{1,3}), ?mask:([0-9A-Fa-f]{1,2}), ?seq:(\d{1,3}), ?range:\((-?\d{1,15}(?:,-?\d{1,15}){0,7})\)"
    r"(?:, ?rssi:\((-?\d+\.\d+(?:,-?\d+\.\d+){0,7})\))?(?:, ?ancid:\((-?\d{1,6}(?:,-?\d{1,6}){0,7})\))?"
)


Centimetres = Annotated[int, msgspec.Meta(gt=-(10**15), lt=10**15)]
"""At most 15 digits, as in `_AT`: what any slot of a line may say without taking the others with it."""


class _Demo(msgspec.Struct, forbid_unknown_fields=True):
    id: int
    range: list[Centimetres]


_DECODER = msgspec.json.Decoder(_Demo)


class MauwbCodec(LineCodec):
    """Codec of MaUWB log lines. `tid`: take only this tag's lines (an anchor's port logs every tag)."""

    def __init__(self, tag: str, *, tid: int | None = None) -> None:
        super().__init__(tag)
        self._tid = tid
        self._ancid_seen = False

    def start_bytes(self) -> list[bytes]:
        """Forget half a line and the firmware's habits. Nothing to send."""
        self._ancid_seen = False
        return super().start_bytes()

    def _decode(self, line: str, t_ns: int) -> list[Message]:
        if match := _AT.fullmatch(line):
            return self._at(match, t_ns)
        if line.startswith("{"):
            return self._demo(line, t_ns)
        if "range" in line.lower() or not line.isprintable():
            raise Garbage("malformed")
        raise Ignored("text")

    def _at(self, match: re.Match[str], t_ns: int) -> list[Message]:
        tid, mask, _, range_text, rssi_text, ancid_text = match.groups()
        cm = [int(v) for v in range_text.split(",")]
        rssi = [0.0] * len(cm) if rssi_text is None else [float(v) for v in rssi_text.split(",")]
        if ancid_text is not None:
            ids = [int(v) for v in ancid_text.split(",")]
        elif self._ancid_seen:
            raise Garbage("ancid_missing")
        else:
            ids = list(range(len(cm)))
        if not len(cm) == len(rssi) == len(ids):
            raise Garbage("list_length")
        unique([str(i) for i in ids if i >= 0])
        self._check_tag(int(tid))
        self._ancid_seen = ancid_text is not None
        bits = int(mask, 16)
        return self._ranges(
            [
                AnchorRange(anchor=str(i), range_m=r / 100, rssi_dbm=dbm if dbm < 0.0 else None)
                for slot, (r, i, dbm) in enumerate(zip(cm, ids, rssi, strict=True))
                if r != 0 and i >= 0 and (bits >> slot & 1 or bits >> i & 1)
            ],
            t_ns,
        )

    def _demo(self, line: str, t_ns: int) -> list[Message]:
        try:
            demo = _DECODER.decode(line)
        except msgspec.MsgspecError:
            raise Garbage("json") from None
        if len(demo.range) > SLOTS:
            raise Garbage("list_length")
        self._check_tag(demo.id)
        items = [AnchorRange(anchor=str(i), range_m=r / 100) for i, r in enumerate(demo.range) if r != 0]
        return self._ranges(items, t_ns)

    def _check_tag(self, tid: int) -> None:
        if self._tid is not None and tid != self._tid:
            raise Ignored("other_tag")


def encode_at(
    tid: int,
    seq: int,
    ranges_m: Mapping[int, float],
    *,
    rssi_dbm: Mapping[int, float] | None = None,
    ancid: bool = True,
) -> bytes:
    """One AT+RANGE line: anchor number -> range [m]; up to 8. Resolution 0.01 m.

    With `ancid` the anchors fill the slots in order; without it the anchor number (0-7) is the slot.
    """
    ids = ([*ranges_m, *[-1] * SLOTS])[:SLOTS] if ancid else list(range(SLOTS))
    cm = [round(ranges_m.get(i, 0.0) * 100) for i in ids]
    mask = sum(1 << slot for slot, r in enumerate(cm) if r)
    line = f"AT+RANGE=tid:{tid},mask:{mask:02X},seq:{seq % 256},range:({','.join(map(str, cm))})"
    if rssi_dbm is not None:
        line += f",rssi:({','.join(f'{rssi_dbm.get(i, 0.0):.2f}' for i in ids)})"
    if ancid:
        line += f",ancid:({','.join(map(str, ids))})"
    return (line + "\r\n").encode("ascii")


def encode_demo(tid: int, ranges_m: Mapping[int, float]) -> bytes:
    """The demo firmware's JSON line: anchor number 0-7 -> range [m]. Resolution 0.01 m."""
    cm = ",".join(str(round(ranges_m.get(i, 0.0) * 100)) for i in range(SLOTS))
    return f'{{"id":{tid},"range":[{cm}]}}\r\n'.encode("ascii")
