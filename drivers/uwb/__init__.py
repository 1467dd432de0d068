"""UWB tags: wire format in a vessel file -> codec. Every codec is sans-I/O: bytes in, messages out."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import ClassVar, Protocol

from companion.core.messages import Message
from drivers.uwb.dwm1001 import Dwm1001Codec
from drivers.uwb.dwm1001_tlv import Dwm1001TlvCodec
from drivers.uwb.lines import UwbCounters
from drivers.uwb.linktrack import LinkTrackCodec
from drivers.uwb.makerfabs import MakerfabsCodec
from drivers.uwb.mauwb import MauwbCodec
from drivers.uwb.trek1000 import Trek1000Codec


class UwbCodec(Protocol):
    """What every codec offers. `baud`: the port's usual speed; `tag`: name in its messages."""

    baud: ClassVar[int]
    tag: str
    counters: UwbCounters

    @property
    def understood(self) -> int:
        """Records that followed the format so far."""
        ...

    def start_bytes(self) -> list[bytes]:
        """Call when the port has been opened: forgets half a record; what to send at once."""
        ...

    def step(self, t_ns: int) -> list[bytes]:
        """What to send now; call at about 10 Hz."""
        ...

    def feed(self, data: bytes, t_ns: int) -> list[Message]:
        """UwbRanges and UwbPosition messages completed by bytes that arrived at `t_ns`. Never raises."""
        ...


CODECS: dict[str, Callable[..., UwbCodec]] = {
    "dwm1001-lec": Dwm1001Codec,
    "dwm1001-lep": partial(Dwm1001Codec, command="lep"),
    "dwm1001-les": partial(Dwm1001Codec, command="les"),
    "dwm1001-tlv": Dwm1001TlvCodec,
    "makerfabs": MakerfabsCodec,
    "mauwb": MauwbCodec,
    "trek1000": Trek1000Codec,
    "linktrack": LinkTrackCodec,
}
"""`wire_format` of a vessel file -> codec, called with `tag=...` and the codec's own options."""


def uwb_codec(wire_format: str, tag: str, rate_hz: float) -> UwbCodec:
    """Codec for a wire format; the rate is for those that are told one. Raises ValueError naming them."""
    if wire_format not in CODECS:
        raise ValueError(f"unknown UWB wire format {wire_format!r}; there are {', '.join(CODECS)}")
    rated = {"rate_hz": rate_hz} if wire_format.startswith("dwm1001") else {}
    return CODECS[wire_format](tag=tag, **rated)
