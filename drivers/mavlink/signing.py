"""MAVLink 2 signing of one link: outgoing frames are signed, incoming ones are believed only with our key.

    signature = first 48 bits of SHA-256(key, header, payload, checksum, link id, timestamp)
    timestamp = max(wall clock, last sent + 1, highest believed)     [10 us since 2015-01-01 00:00 UTC, 48 bits]

A frame is believed when its signature fits and its timestamp is newer than the last one of its stream (link id,
system, component); the first of a stream may be up to a minute behind us. Unsigned frames are refused, but for
those that a telemetry radio makes itself. pymavlink signs what we send, but does not check what we hear: it notes
the timestamp of a stream before it looks at the signature, so that one forged frame from the far future would
silence the autopilot for good. Source: https://mavlink.io/en/guide/message_signing.html

The key never leaves this file but into SHA-256: no repr, error or alert shows any of it.
"""

from __future__ import annotations

import hashlib
import hmac
from collections import Counter
from collections.abc import Callable
from typing import Any, Literal, NoReturn

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.core.messages import Alert

KEY_BYTES = 32
EPOCH_NS = 1_420_070_400_000_000_000
"""2015-01-01 00:00 UTC on the Unix clock [ns]."""
UNIT_NS = 10_000
LAST_TIMESTAMP = (1 << 48) - 1
NEW_STREAM_BEHIND = 60 * 10**9 // UNIT_NS
"""A stream heard for the first time may be this far behind us: one minute (MAVLink's guide)."""
UNSIGNED_WELCOME = frozenset({dialect.MAVLINK_MSG_ID_RADIO_STATUS, dialect.MAVLINK_MSG_ID_RADIO})
"""Made by telemetry radios, which have no key; nothing here acts on them."""
TELL_AGAIN_NS = 30_000_000_000
GREETING_NS = 5_000_000_000
"""An autopilot without a clock goes on from the time stamp that it stored, and is behind us until it has heard us:
what is old is not told before (assumed; it takes one heartbeat of ours, sent at 1 Hz)."""
NO_KEY = (
    "the autopilot signs what it sends and takes nothing unsigned on this port, and we have no key: name it in the run "
    "file (mavlink.signing_key), or use the autopilot's USB port"
)
"""What a person is told where the autopilot signs, does not answer, and there is no `Signing`."""
_SIGNATURE_LEN = 6

Verdict = Literal["believed", "welcome", "unsigned", "wrong", "old"]


def is_signed(message: Any) -> bool:
    """Whether a decoded pymavlink message carries a signature, of whatever key."""
    frame = message.get_msgbuf()
    return frame[0] == dialect.PROTOCOL_MARKER_V2 and bool(frame[2] & dialect.MAVLINK_IFLAG_SIGNED)


class SigningKey:
    """32 secret bytes that cannot be printed, copied into a log, or compared by looking. ValueError: no key."""

    __slots__ = ("_secret",)

    def __init__(self, secret: bytes) -> None:
        if len(secret) != KEY_BYTES:
            raise ValueError(f"a signing key has {KEY_BYTES} bytes, not {len(secret)}")
        if not any(secret):
            raise ValueError("a key of zeros means to the autopilot: no signing")
        self._secret = bytes(secret)

    def fits(self, frame: bytes | bytearray) -> bool:
        """Whether the signature at the end of `frame` was made with this key."""
        made = hashlib.sha256(self._secret + frame[:-_SIGNATURE_LEN]).digest()[:_SIGNATURE_LEN]
        return hmac.compare_digest(made, bytes(frame[-_SIGNATURE_LEN:]))

    def lend(self, mav: Any) -> None:
        """Make a pymavlink encoder sign with this key."""
        mav.signing.secret_key, mav.signing.sign_outgoing = self._secret, True

    def __repr__(self) -> str:
        return "SigningKey(hidden)"

    def __reduce__(self) -> NoReturn:
        raise TypeError("a signing key is not copied or stored")


class Signing:
    """Signing of one link with `key`. `wall_ns`: the Unix clock [ns], which may be wrong or jump.

    `floor`: the highest timestamp of an earlier run, which this one stays above. `key_name`: what people call
    the key (its file), for alerts. `counts`: frames heard, by verdict.
    """

    def __init__(self, key: SigningKey, wall_ns: Callable[[], int], *, key_name: str, floor: int = 0, link_id: int = 0):
        self.counts: Counter[Verdict] = Counter()
        self.timestamp = max(0, min(floor, LAST_TIMESTAMP))
        """The highest one sent or believed."""
        self._key, self._wall_ns, self._key_name, self._link_id = key, wall_ns, key_name, link_id
        self._streams: dict[tuple[int, int, int], int] = {}
        self._told: Counter[Verdict] = Counter()
        self._told_ns: int | None = None
        self._first_ns: int | None = None

    def equip(self, mav: Any) -> None:
        """Make a pymavlink encoder sign; call `stamp` before each of its frames."""
        self._key.lend(mav)
        mav.signing.link_id = self._link_id

    def stamp(self, mav: Any) -> None:
        """Give the encoder's next frame a timestamp above all before it."""
        self.timestamp = min(max(self._now(), self.timestamp + 1), LAST_TIMESTAMP)
        mav.signing.timestamp = self.timestamp

    def accepts(self, message: Any) -> bool:
        """Whether a decoded pymavlink message may be believed; counts it."""
        verdict = self._judge(message)
        self.counts[verdict] += 1
        return verdict in ("believed", "welcome")

    def alerts(self, t_ns: int) -> list[Alert]:
        """What was refused since the last alert, with what to look at; at once, then every 30 s at most."""
        news = self.counts - self._told
        if self._first_ns is None and news:
            self._first_ns = t_ns
        if self._first_ns is not None and t_ns - self._first_ns < GREETING_NS:
            news["old"], self._told["old"] = 0, self.counts["old"]
        if not any(news[v] for v in _ADVICE) or (self._told_ns is not None and t_ns - self._told_ns < TELL_AGAIN_NS):
            return []
        self._told, self._told_ns = self.counts.copy(), t_ns
        level = "warning" if news["believed"] else "error"
        return [
            Alert(
                t_ns=t_ns, level=level, text=f"{news[v]} MAVLink frame(s) refused: " + text.format(key=self._key_name)
            )
            for v, text in _ADVICE.items()
            if news[v]
        ]

    def _now(self) -> int:
        return max(0, (self._wall_ns() - EPOCH_NS) // UNIT_NS)

    def _judge(self, message: Any) -> Verdict:
        frame = message.get_msgbuf()
        if not is_signed(message):
            return "welcome" if message.get_msgId() in UNSIGNED_WELCOME else "unsigned"
        if not self._key.fits(frame):
            return "wrong"
        stream = (frame[-13], message.get_srcSystem(), message.get_srcComponent())
        timestamp = int.from_bytes(frame[-12:-6], "little")
        last = self._streams.get(stream, max(self.timestamp, self._now()) - NEW_STREAM_BEHIND - 1)
        if timestamp <= last:
            return "old"
        self._streams[stream] = timestamp
        self.timestamp = max(self.timestamp, timestamp)
        return "believed"


_ADVICE: dict[Verdict, str] = {
    "wrong": "signed with another key than {key}. Set the same key in the autopilot (ground station, signing setup, "
    "over USB) and in that file, or look for a stranger on this link",
    "unsigned": "not signed, and mavlink.signing_key asks for it. Set the key of {key} in the autopilot (ground "
    "station, signing setup, over USB), or take mavlink.signing_key out of the run file",
    "old": "their time stamps go back: a recording that somebody replays, two devices with the same system id, or an "
    "autopilot that has not heard us since its clock was set back. If it lasts, restart the autopilot",
}
