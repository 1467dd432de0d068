"""What every UWB line codec shares: a bounded line splitter, counters, and the decode loop.

A codec is sans-I/O: `feed(data, t_ns)` turns bytes into messages, `start_bytes()` and `step(t_ns)` give the
bytes to send to devices that must be spoken to. Whatever does not follow the format's grammar from the first
character to the last is counted and dropped as a whole line: the text formats carry no checksum, so the
strict grammar of the whole line is the only sign of integrity there is.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import ClassVar

from companion.core.messages import AnchorRange, Message, UwbPosition, UwbRanges

MIN_RANGE_M = 0.10  # assumed: nearer, no boat floats; a "none" of 0 cm with one wrong digit falls below it
LINE_LIMIT = 1024  # [bytes]; the longest line of the formats here (twelve anchors of `les`) has about 450
MAX_RANGE_M = 300.0  # assumed: a DW1000 reaches about 290 m in free sight at its slowest rate (data sheet)


class Garbage(Exception):
    """A record that breaks the format. Raised by a decoder, caught and counted by `feed`."""


class Ignored(Exception):
    """A record that is understood and holds no measurement. Raised by a decoder, caught by `feed`."""


@dataclass
class UwbCounters:
    """What became of the input.

    `lines`: complete lines (text) or frames (binary); `good`: those that followed the format; `ignored`:
    understood, no measurement inside; `garbage`: lines (text) or bytes (binary) thrown away; `reasons`: why,
    for records and for single ranges left out of a good record.
    """

    lines: int = 0
    good: int = 0
    ignored: int = 0
    garbage: int = 0
    reasons: Counter[str] = field(default_factory=Counter)


class LineSplitter:
    """Cuts a byte stream at LF, with a bounded memory. The result does not depend on the chunking."""

    def __init__(self, limit: int = LINE_LIMIT) -> None:
        self._limit = limit
        self.clear()

    def clear(self) -> None:
        """Forget the unfinished line."""
        self._buffer = bytearray()
        self._overflow = False

    @property
    def tail(self) -> bytes:
        """The unfinished line so far (a shell prompt ends without a line end)."""
        return bytes(self._buffer)

    def push(self, data: bytes) -> list[bytes | None]:
        """Lines completed by `data`, stripped of white space, empty ones left out.

        None stands for a line that has grown too long; the rest of it is skipped in silence.
        """
        *complete, rest = data.split(b"\n")
        lines: list[bytes | None] = []
        for part in complete:
            self._extend(part, lines)
            line = bytes(self._buffer).strip(b" \t\r\0")
            if line:
                lines.append(line)
            self.clear()
        self._extend(rest, lines)
        return lines

    def _extend(self, part: bytes, lines: list[bytes | None]) -> None:
        if self._overflow:
            return
        self._buffer += part
        if len(self._buffer) > self._limit:
            self._overflow = True
            self._buffer.clear()
            lines.append(None)


class UwbCodecBase:
    """Common parts of all UWB codecs.

    `tag`: name of the tag in the messages; a range under MIN_RANGE_M or over MAX_RANGE_M is left out.
    Messages carry t_ns = t_rx_ns = arrival of the bytes that complete them: the tag's latency is the
    estimator's affair.
    """

    baud: ClassVar[int] = 115200

    def __init__(self, tag: str) -> None:
        self.tag = tag
        self.counters = UwbCounters()

    @property
    def understood(self) -> int:
        """Records that followed the format so far, those without a measurement included."""
        return self.counters.good + self.counters.ignored

    def start_bytes(self) -> list[bytes]:
        """Call when the port has been opened: forgets half a record; what to send at once."""
        return []

    def step(self, t_ns: int) -> list[bytes]:
        """What to send now. Call several times a second (10 Hz is plenty)."""
        del t_ns
        return []

    def _ranges(self, ranges: list[AnchorRange], t_ns: int) -> list[Message]:
        """The usable ones of `ranges` as at most one UwbRanges; the others are counted by reason."""
        usable = []
        for item in ranges:
            if item.range_m == 0.0:
                self.counters.reasons["zero_range"] += 1
            elif not MIN_RANGE_M <= item.range_m <= MAX_RANGE_M:
                self.counters.reasons["range_limit"] += 1
            else:
                usable.append(item)
        if not usable:
            return []
        return [UwbRanges(t_ns=t_ns, t_rx_ns=t_ns, tag=self.tag, ranges=tuple(usable))]

    def _position(self, xyz_m: tuple[float, float, float], quality: int | None, t_ns: int) -> list[Message]:
        """One UwbPosition; none where the tag says quality 0 (no fix, assumed)."""
        if quality == 0:
            self.counters.reasons["no_fix"] += 1
            return []
        x, y, z = xyz_m
        return [UwbPosition(t_ns=t_ns, t_rx_ns=t_ns, tag=self.tag, x_m=x, y_m=y, z_m=z, quality=quality)]


class LineCodec(UwbCodecBase):
    """Base of the text codecs: a subclass gives `_decode(line, t_ns)`."""

    def __init__(self, tag: str) -> None:
        super().__init__(tag)
        self._splitter = LineSplitter()

    def start_bytes(self) -> list[bytes]:
        """Forget half a line. Nothing to send."""
        self._splitter.clear()
        return []

    def feed(self, data: bytes, t_ns: int) -> list[Message]:
        """Messages completed by `data`, which arrived at `t_ns` [ns, companion monotonic]. Never raises."""
        messages: list[Message] = []
        for line in self._splitter.push(data):
            self.counters.lines += 1
            try:
                found = self._decode(self._text(line), t_ns)
            except Garbage as why:
                self.counters.garbage += 1
                self.counters.reasons[str(why)] += 1
            except Ignored as why:
                self.counters.ignored += 1
                self.counters.reasons[str(why)] += 1
            else:
                self.counters.good += 1
                messages += found
        return messages

    @staticmethod
    def _text(line: bytes | None) -> str:
        if line is None:
            raise Garbage("too_long")
        try:
            text = line.decode("ascii")
        except UnicodeDecodeError:
            raise Garbage("not_ascii") from None
        return text

    def _decode(self, line: str, t_ns: int) -> list[Message]:
        """Messages in one line; raises Garbage or Ignored with the reason."""
        raise NotImplementedError


def unique(anchors: list[str]) -> None:
    """Raise Garbage where one anchor occurs twice: a half line joined to another shows like this."""
    if len(set(anchors)) != len(anchors):
        raise Garbage("duplicate_anchor")
