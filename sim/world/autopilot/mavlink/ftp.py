"""MAVLink FTP that has no files: every request but the clean-ups is refused, so that clients fall back.

Payload: sequence u16, session u8, opcode u8, size u8, requested opcode u8, burst u8, padding u8, offset u32,
then data. A refusal is opcode 129 with the error code in the first data byte (7: unknown command).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

_HEADER = struct.Struct("<HBBBBBBI")
_PAYLOAD_BYTES = 251
_ACK, _NAK = 128, 129
_UNKNOWN_COMMAND = 7
_CLEAN_UP = frozenset({1, 2})  # TerminateSession, ResetSessions


def answer(payload: Sequence[int]) -> bytes:
    """Reply payload (251 bytes) to a request payload."""
    sequence, session, opcode = _HEADER.unpack_from(bytes(payload))[:3]
    refused = opcode not in _CLEAN_UP
    header = _HEADER.pack((sequence + 1) % 65536, session, _NAK if refused else _ACK, int(refused), opcode, 0, 0, 0)
    return (header + bytes([_UNKNOWN_COMMAND] if refused else [])).ljust(_PAYLOAD_BYTES, b"\0")
