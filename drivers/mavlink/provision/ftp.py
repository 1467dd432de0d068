"""Putting a file on an autopilot by MAVLink FTP: requests out, replies in. Sans-I/O.

    steps = upload_steps("/APM/scripts/gate.lua", content)
    request = next(steps)
    request = steps.send(reply)         # until StopIteration; raises FtpRefusedError

A path is sent without a terminating NUL: ArduPilot 4.6 takes the NUL, counted, for a wrong size (observed); 4.7 takes
both. A file is created in one session, written from its beginning, closed, and its checksum compared. A request that
is lost is sent again with its number, which the autopilot answers as before.

Payload, little endian:  u16 number | u8 session | u8 opcode | u8 size | u8 request's opcode | u8 burst complete | u8 0
| u32 offset | 239 bytes. Source: https://mavlink.io/en/services/ftp.html
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Generator
from typing import NamedTuple

PAYLOAD_BYTES, DATA_BYTES = 251, 239
_HEADER = struct.Struct("<HBBBBBBI")
_ACK, _NAK = 128, 129
_TERMINATE, _RESET, _CREATE, _WRITE, _MAKE_FOLDER, _CHECKSUM = 1, 2, 6, 7, 9, 14
INVALID_SESSION = 4
"""The autopilot has a file of somebody else open; it closes it after 3 s without a request (source)."""
_EXISTS, _NOT_FOUND = 8, 10
_REASONS = {
    1: "it fails, without a reason", 2: "it fails with error {errno} of its file system",
    3: "wrong size of the request", INVALID_SESSION: "another file transfer is under way", 5: "no free session",
    6: "end of file",
    7: "it does not know the request", 8: "the file exists", 9: "the file is protected", 10: "file not found",
}  # fmt: skip


class FtpRefusedError(Exception):
    """The autopilot refused a request. `code`: its error code."""

    def __init__(self, code: int, text: str):
        super().__init__(text)
        self.code = code


class FtpRequest(NamedTuple):
    """One request. `data`: at most 239 bytes."""

    opcode: int
    offset: int = 0
    data: bytes = b""

    def payload(self, number: int) -> bytes:
        """The 251 bytes of FILE_TRANSFER_PROTOCOL.payload; `number`: sequence number, modulo 65536."""
        header = _HEADER.pack(number % 65536, 0, self.opcode, len(self.data), 0, 0, 0, self.offset)
        return (header + self.data).ljust(PAYLOAD_BYTES, b"\0")


class FtpReply(NamedTuple):
    """One reply. `error`: code of a refusal, 0 for none."""

    error: int = 0
    data: bytes = b""

    @property
    def reason(self) -> str:
        """The refusal in words."""
        text = _REASONS.get(self.error, f"error {self.error}")
        return text.format(errno=self.data[1] if len(self.data) > 1 else "")


FtpSteps = Generator[FtpRequest, FtpReply, None]


def parse_reply(payload: bytes, request: FtpRequest, number: int) -> FtpReply | None:
    """The reply to `request` with sequence number `number`; None: the payload is no reply to it."""
    if len(payload) < _HEADER.size:
        return None
    answer, _, opcode, size, asked, _, _, _ = _HEADER.unpack_from(payload)
    if answer != (number + 1) % 65536 or asked != request.opcode or opcode not in (_ACK, _NAK):
        return None
    data = payload[_HEADER.size : _HEADER.size + size]
    return FtpReply(0, data) if opcode == _ACK else FtpReply(data[0] if data else 1, data)


def upload_steps(path: str, content: bytes) -> FtpSteps:
    """Requests that put `content` at an absolute `path` and compare it there; folders are made as needed."""
    yield FtpRequest(_RESET)  # a file that an interrupted transfer left open
    created = yield FtpRequest(_CREATE, 0, path.encode("ascii"))
    if created.error == _NOT_FOUND:
        yield from _make_folders(path)
        created = yield FtpRequest(_CREATE, 0, path.encode("ascii"))
    _accepted(created, f"{path} cannot be created")
    for offset in range(0, len(content), DATA_BYTES):
        written = yield FtpRequest(_WRITE, offset, content[offset : offset + DATA_BYTES])
        _accepted(written, f"{path} cannot be written")
    _accepted((yield FtpRequest(_TERMINATE)), f"{path} cannot be closed")
    reply = yield FtpRequest(_CHECKSUM, 0, path.encode("ascii"))
    _accepted(reply, f"{path} cannot be read back")
    if reply.data[:4] != struct.pack("<I", checksum(content)):
        raise FtpRefusedError(0, f"{path} is not what was sent")


def _make_folders(path: str) -> FtpSteps:
    """Every folder above `path`, outermost first; one that is there already is none the worse."""
    parts = path.strip("/").split("/")[:-1]
    for depth in range(1, len(parts) + 1):
        folder = "/" + "/".join(parts[:depth])
        made = yield FtpRequest(_MAKE_FOLDER, 0, folder.encode("ascii"))
        if made.error not in (0, 1, 2, _EXISTS):  # what really fails shows when the file is created
            _accepted(made, f"{folder} cannot be made")


def _accepted(reply: FtpReply, what: str) -> None:
    if reply.error:
        raise FtpRefusedError(reply.error, f"{what}: {reply.reason}")


def checksum(content: bytes) -> int:
    """CRC-32 without inversion before and after, as the protocol has it: zlib's, with both undone."""
    return zlib.crc32(content, 0xFFFFFFFF) ^ 0xFFFFFFFF
