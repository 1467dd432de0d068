"""STATUSTEXT: texts longer than 50 characters go in chunks; cut them, and join them again.

A text of id 0 is complete in itself. Otherwise chunks of one id carry chunk_seq 0, 1, 2, ... and the last
one is shorter than 50 bytes (it holds the terminating zero). Chunks that never come are shown as "[...]"
once the text has waited for `TIMEOUT_NS`. Source: https://mavlink.io/en/messages/common.html#STATUSTEXT
"""

from __future__ import annotations

from typing import NamedTuple

CHUNK_LEN = 50
TIMEOUT_NS = 2_000_000_000
"""Wait for missing chunks (assumed: chunks are sent back to back)."""
MAX_PENDING = 8
"""Incomplete texts kept at once; the oldest is given out early when there are more (assumed)."""
GAP = b"[...]"


class Text(NamedTuple):
    """A joined text and its MAV_SEVERITY."""

    severity: int
    text: str


class _Pending(NamedTuple):
    since_ns: int
    severity: int
    chunks: dict[int, bytes]


def chunks(text: str) -> list[bytes]:
    """The fields of one text: all full but the last, which is shorter and so ends it."""
    raw = text.encode("ascii", errors="replace")
    return [raw[at : at + CHUNK_LEN] for at in range(0, len(raw) + 1, CHUNK_LEN)]


class ChunkJoiner:
    """Chunks in, texts out; one instance per sender."""

    def __init__(self) -> None:
        self._pending: dict[int, _Pending] = {}

    def add(self, severity: int, raw: bytes, ident: int, chunk_seq: int, t_ns: int) -> list[Text]:
        """Texts that this chunk completes. `raw`: the text field without its terminating zeros."""
        if ident == 0:
            return [Text(severity, _decode(raw))]
        pending = self._pending.setdefault(ident, _Pending(t_ns, severity, {}))
        pending.chunks[chunk_seq] = raw
        last = max(pending.chunks)
        if len(pending.chunks[last]) < CHUNK_LEN and len(pending.chunks) == last + 1:
            return [self._give(ident)]
        return [self._give(next(iter(self._pending)))] if len(self._pending) > MAX_PENDING else []

    def expire(self, t_ns: int) -> list[Text]:
        """Texts whose missing chunks did not come in time."""
        late = [i for i, pending in self._pending.items() if t_ns - pending.since_ns > TIMEOUT_NS]
        return [self._give(i) for i in late]

    def _give(self, ident: int) -> Text:
        pending = self._pending.pop(ident)
        parts: list[bytes] = []
        expected = 0
        for seq, chunk in sorted(pending.chunks.items()):
            parts += [GAP, chunk] if seq > expected else [chunk]
            expected = seq + 1
        if len(parts[-1]) == CHUNK_LEN:
            parts.append(GAP)
        return Text(pending.severity, _decode(b"".join(parts)))


def _decode(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode("utf-8", errors="replace")
