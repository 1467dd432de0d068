"""Qorvo/Decawave DWM1001 with PANS firmware, UART shell: lines of `lec`, `lep` and `les`. 115200 8N1.

    lec   DIST,n,ANi,ID,x,y,z,range, ... [,POS,x,y,z,quality]
    lep   POS,x,y,z,quality
    les   ID[x,y,z]=range ID[x,y,z]=range ... [le_us=n] [est[x,y,z,quality]]

Metres with exactly two decimals, quality 0-100, right-handed frame set by the anchors' coordinates. An
anchor is known by its hexadecimal ID; the AN index is only its place in the line. A lec line may give ranges
and the position computed from those very ranges: an estimator fuses one of the two, not both.

Integrity: no checksum exists. A line must match from end to end: count n, rising AN indices, two decimals on
every number, no ID twice. A line that fails is dropped whole, also its parts that look sound: in the known
real damage (a half line joined to the next) nothing marks where the first half stops being true, and at
1-10 Hz one lost cycle costs nothing. What no decoder can see: a digit that became another digit (a wrong
range or ID of that one anchor), or a leading digit that was lost.

Sources: the module's firmware and API guides as used by public parsers.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from typing import Literal, NamedTuple

from companion.core.messages import AnchorRange, Message
from drivers.uwb.dwm1001_shell import ShellDialog
from drivers.uwb.lines import Garbage, Ignored, LineCodec, unique

_N = r"-?\d{1,4}\.\d\d"
_Q = r"\d{1,3}"
_AN = rf"AN(\d{{1,2}}),([0-9A-Fa-f]{{4}}),{_N},{_N},{_N},({_N})"
_LEC = re.compile(rf"DIST,(\d{{1,2}})((?:,{_AN})*)(?:,POS,({_N}),({_N}),({_N}),({_Q}))?")
_LEC_ANCHOR = re.compile(_AN)
_LEP = re.compile(rf"POS,({_N}),({_N}),({_N}),({_Q})")
_LES_ITEM = rf"([0-9A-Fa-f]{{4}})\[{_N},{_N},{_N}\]=({_N})"
_LES = re.compile(rf"({_LES_ITEM}(?: {_LES_ITEM})*)(?: le_us=\d+)?(?: est\[({_N}),({_N}),({_N}),({_Q})\])?")
_LES_ANCHOR = re.compile(_LES_ITEM)
_SHELL = re.compile(r"^(?:@\x01\x01|dwm> ?)+")  # prompts and answers of the other mode have no line end
_DATA_LIKE = re.compile(r"DIST|POS|AN\d|\d\.\d\d[,\]]|[^\x20-\x7e\t\r]")
_BANNER = b"Real Time Location System"
_PROMPT_TAIL = re.compile(rb"dwm> ?\Z")

Xyz = tuple[float, float, float]


class AnchorReport(NamedTuple):
    """One anchor in a report: hexadecimal ID, coordinates [m], range [m], quality 0-100 (TLV only)."""

    anchor: str
    position_m: Xyz
    range_m: float
    quality: int = 100


class TagFix(NamedTuple):
    """The tag's own position [m] in the frame of the anchors, quality 0-100."""

    position_m: Xyz
    quality: int


class Dwm1001Codec(LineCodec):
    """Codec of the DWM1001 shell. `rate_hz`: wanted update rate; `command`: the stream to ask for.

    A stream that already runs is taken as it is, whichever of the three it is: see ShellDialog.
    """

    def __init__(
        self,
        tag: str,
        *,
        rate_hz: float = 1.0,
        command: Literal["lec", "lep", "les"] = "lec",
    ) -> None:
        super().__init__(tag)
        self._dialog = ShellDialog(rate_hz, command)

    def start_bytes(self) -> list[bytes]:
        """Forget half a line and listen first. Nothing to send yet: a CR could stop a running stream."""
        self._dialog.restart()
        return super().start_bytes()

    def step(self, t_ns: int) -> list[bytes]:
        """What the shell dialogue sends now (call at about 10 Hz)."""
        return self._dialog.step(t_ns)

    def feed(self, data: bytes, t_ns: int) -> list[Message]:
        """Messages completed by `data`; notes the stream, banner, prompts and `40 01 01` for the dialogue."""
        good = self.counters.good
        tail_before = self._splitter.tail
        messages = super().feed(data, t_ns)
        tail = self._splitter.tail
        if self.counters.good > good:
            self._dialog.heard_stream(t_ns)
        if _BANNER in tail_before + data:
            self._dialog.heard_banner()
        if _PROMPT_TAIL.search(tail):
            self._dialog.heard_prompt()
        elif tail.endswith(b"@\x01\x01"):
            self._dialog.heard_not_in_shell()
        return messages

    def _decode(self, line: str, t_ns: int) -> list[Message]:
        line = _SHELL.sub("", line)
        if match := _LEC.fullmatch(line):
            return self._lec(match, t_ns)
        if match := _LEP.fullmatch(line):
            return self._fix(match.groups(), t_ns)
        if match := _LES.fullmatch(line):
            return self._items(_LES_ANCHOR.findall(match[1]), t_ns) + self._fix(match.groups()[-4:], t_ns)
        if _DATA_LIKE.search(line):
            raise Garbage("malformed")
        raise Ignored("shell_text")

    def _lec(self, match: re.Match[str], t_ns: int) -> list[Message]:
        groups = _LEC_ANCHOR.findall(match[2])
        if len(groups) != int(match[1]):
            raise Garbage("anchor_count")
        indices = [int(index) for index, _, _ in groups]
        if any(b <= a for a, b in itertools.pairwise(indices)):
            raise Garbage("anchor_order")
        return self._items([g[1:] for g in groups], t_ns) + self._fix(match.groups()[-4:], t_ns)

    def _items(self, items: list[tuple[str, str]], t_ns: int) -> list[Message]:
        unique([anchor.upper() for anchor, _ in items])
        ranges = [AnchorRange(anchor=anchor.upper(), range_m=float(r)) for anchor, r in items]
        return self._ranges(ranges, t_ns)

    def _fix(self, fields: Sequence[str | None], t_ns: int) -> list[Message]:
        x, y, z, quality = fields
        if x is None or y is None or z is None or quality is None:
            return []
        if int(quality) > 100:
            raise Garbage("quality")
        return self._position((float(x), float(y), float(z)), int(quality), t_ns)


def _xyz(position_m: Xyz) -> str:
    return ",".join(f"{v:.2f}" for v in position_m)


def encode_lec(anchors: Sequence[AnchorReport], fix: TagFix | None) -> bytes:
    """One `lec` line; without POS where there is no fix. Resolution 0.01 m."""
    parts = [f"DIST,{len(anchors)}"]
    parts += [f"AN{i},{a.anchor},{_xyz(a.position_m)},{a.range_m:.2f}" for i, a in enumerate(anchors)]
    if fix is not None:
        parts.append(f"POS,{_xyz(fix.position_m)},{fix.quality}")
    return (",".join(parts) + "\r\n").encode("ascii")


def encode_lep(fix: TagFix) -> bytes:
    """One `lep` line. Resolution 0.01 m."""
    return f"POS,{_xyz(fix.position_m)},{fix.quality}\r\n".encode("ascii")


def encode_les(anchors: Sequence[AnchorReport], fix: TagFix | None) -> bytes:
    """One `les` line. Resolution 0.01 m."""
    parts = [f"{a.anchor}[{_xyz(a.position_m)}]={a.range_m:.2f}" for a in anchors]
    if fix is not None:
        parts += ["le_us=2576", f"est[{_xyz(fix.position_m)},{fix.quality}]"]
    return (" ".join(parts) + "\r\n").encode("ascii")
