"""MAVLink 2 signing as the firmware does it: one key for all links, kept over a reboot.

SETUP_SIGNING sets the key, and from then on everything that is sent is signed; a key of zeros ends it. What comes
in unsigned or wrongly signed is still accepted on SERIAL0 (USB is held to be secure) and dropped elsewhere, but
for RADIO_STATUS. It is not taken while armed (source, `GCS_MAVLINK::handle_setup_signing`).
"""

from __future__ import annotations

from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as wire

NO_KEY = bytes(32)
_ALWAYS_ACCEPTED = frozenset({wire.MAVLINK_MSG_ID_RADIO_STATUS, wire.MAVLINK_MSG_ID_RADIO})


@dataclass
class FirmwareSigningKey:
    """`timestamp`: 10 us units since 2015-01-01, never falling over all links."""

    secret: bytes = NO_KEY
    timestamp: int = 1

    def set(self, secret: bytes, timestamp: int) -> None:
        """Take the key of a SETUP_SIGNING; of its timestamp the 48 bits that a signature carries."""
        self.secret, self.timestamp = secret, max(1, timestamp & (1 << 48) - 1)

    def install(self, mav: wire.MAVLink, link_id: int, secure: bool) -> None:
        """Make one link sign and check; `secure`: it is SERIAL0."""
        signing = mav.signing
        signing.stream_timestamps.clear()
        if self.secret == NO_KEY:
            signing.secret_key, signing.sign_outgoing, signing.allow_unsigned_callback = None, False, None
            return
        signing.secret_key, signing.sign_outgoing, signing.link_id = self.secret, True, link_id
        signing.timestamp = self.timestamp
        signing.allow_unsigned_callback = lambda _, message_id: secure or message_id in _ALWAYS_ACCEPTED

    def learn(self, mav: wire.MAVLink) -> None:
        """Take over the highest timestamp that a link has used or seen."""
        self.timestamp = max(self.timestamp, mav.signing.timestamp)
